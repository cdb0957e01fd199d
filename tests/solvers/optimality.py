"""The conditions of a quadratic program's optimum, written out dense and row by row."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, Point
from psmpc_cli.solvers.sqp_window import QpSolution

from .random_programs import Task


def objective(model: Linearization, step: Point) -> float:
    """The objective's change by the quadratic model."""
    H, c = _hessian(model)
    x = np.r_[step.X[1:].ravel(), step.tau]
    return float(c @ x + x @ H @ x / 2)


def energy(model: Linearization, one: Point, other: Point) -> float:
    """Half the square of two steps' difference in the Hessian's norm: what of it the objective can see."""
    apart = np.r_[(one.X - other.X)[1:].ravel(), one.tau - other.tau]
    return float(apart @ _hessian(model)[0] @ apart / 2)


def _hessian(model: Linearization) -> tuple[np.ndarray, np.ndarray]:
    K, n = model.coupling.shape
    size, S = 2 * n * K, len(model.gradient_tau)
    H = np.zeros((size + S, size + S))
    for k in range(K):
        Q, v = 2 * n * k + np.arange(n), 2 * n * k + n + np.arange(n)
        upper = model.positions[k + 1]
        H[np.ix_(Q, Q)] = upper + np.triu(upper, 1).T
        H[v, v] = model.velocities[k + 1]
        if k:
            H[v, v - 2 * n] = H[v - 2 * n, v] = model.coupling[k]
    H[:size, size:] = model.arrow[1:].reshape(size, S)
    H[size:, :size] = H[:size, size:].T
    H[size:, size:] = model.durations
    return H, np.r_[model.gradient[1:].ravel(), model.gradient_tau]


@dataclass(frozen=True)
class Optimality:
    """By how much the conditions of an optimum are missed at worst."""

    gaps: float
    limits: float
    gradient: float
    complementarity: float


def optimality(task: Task, found: QpSolution) -> Optimality:
    """Karush, Kuhn and Tucker's conditions, row by row."""
    (K, n), S, form = task.model.coupling.shape, len(task.point.tau), task.form
    model, limits, x = task.model, task.limits, np.r_[found.step.X[1:].ravel(), found.step.tau]
    H, c = _hessian(model)
    gaps = np.zeros((K * n, len(x)))
    for k in range(K):
        for i in range(n):
            row, Q = gaps[k * n + i], 2 * n * k + i
            row[Q], row[Q + n], row[2 * n * K :] = 1.0, model.gap_velocity[k, 1], model.gap_tau[k, i]
            if k:
                row[Q - 2 * n], row[Q - n] = -1.0, model.gap_velocity[k, 0]
    rows, low, high, z = [np.eye(len(x))], [], [], [found.X.ravel(), found.tau + _given(found, S)]
    low += [(limits.X_low - task.point.X[1:]).ravel(), limits.tau_low - task.point.tau]
    high += [(limits.X_high - task.point.X[1:]).ravel(), limits.tau_high - task.point.tau]
    for upto, lowest, highest, value in _sums(task, found):
        rows.append(np.r_[np.zeros(2 * n * K), np.arange(S) <= upto][None])
        low, high, z = [*low, [lowest]], [*high, [highest]], [*z, [value]]
    for s, values in model.end_derivatives.items():
        row, at = (
            np.zeros((form.stages[s].end_rows, len(x))),
            form.stages[s],
        )
        row[at.end_places[0], 2 * n * (form.grid.first_node[s + 1] - 1) + at.end_places[1]] = values
        rows.append(row)
        low, high = [*low, limits.ends[s][0] - model.at.ends[s]], [*high, limits.ends[s][1] - model.at.ends[s]]
        z.append(found.ends[s])
    for limit, side, value in _accelerations(task, found):
        rows.append(side)
        low, high, z = [*low, limit[0]], [*high, limit[1]], [*z, value]
    G, L, U, Z = np.vstack(rows), *(np.concatenate([np.ravel(piece) for piece in pieces]) for pieces in (low, high, z))
    value = G @ x
    room = np.where(Z > 0, np.abs(U - value), np.abs(value - L))
    return Optimality(
        gaps=float(np.abs(gaps @ x + model.at.gaps.ravel()).max()),
        limits=float(max((L - value).max(), (value - U).max())),
        gradient=float(np.abs(H @ x + c + gaps.T @ found.gaps.ravel() + G.T @ Z).max()),
        complementarity=float(np.where(np.abs(Z) > 1e-12, np.abs(Z) * np.minimum(room, 1e9), 0.0).max()),
    )


def _given(found: QpSolution, S: int) -> np.ndarray:
    """Multipliers of given durations, by duration."""
    values = np.zeros(S)
    values[list(found.shape.fixed)] = found.fixed
    return values


def _sums(task: Task, found: QpSolution) -> list[tuple[int, float, float, float]]:
    """Sums of durations up to a stage: their low, high and multiplier."""
    tau, S = task.point.tau, len(task.point.tau)
    given = [
        (s, task.limits.until[s] - tau[: s + 1].sum(), task.limits.until[s] - tau[: s + 1].sum(), float(value))
        for s, value in zip(found.shape.tied, found.until, strict=True)
    ]
    return [*given, (S - 1, -np.inf, task.limits.together - float(tau.sum()), found.together)] if S else []


def _accelerations(task: Task, found: QpSolution) -> list[tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]]:
    """WindowBounds on accelerations: low and high, rows, multipliers, once from below and once from above."""
    (K, n), S, form = task.model.coupling.shape, len(task.point.tau), task.form
    if not (found.shape.input_low or found.shape.input_high):
        return []
    share = form.interval_steps
    h, dv, pieces = form.steps(task.point, task.horizon), np.diff(task.point.X[:, n:], axis=0), []
    for limit, sign in ((task.limits.input_low, -1), (task.limits.input_high, 1)):
        finite = np.where(np.isfinite(limit), limit, 0.0)
        rows = np.zeros((K, n, 2 * n * K + S))
        for k in range(K):
            for i in range(n):
                rows[k, i, 2 * n * k + n + i] = 1.0
                rows[k, i, 2 * n * K :] = -finite[k, i] * share[k]
                if k:
                    rows[k, i, 2 * n * (k - 1) + n + i] = -1.0
        change, free = (h * limit - dv).ravel(), np.full(K * n, np.inf)
        both = (change, free) if sign < 0 else (-free, change)
        pieces.append((both, rows.reshape(K * n, -1), np.where(sign * found.inputs > 0, found.inputs, 0.0).ravel()))
    return pieces
