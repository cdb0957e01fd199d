"""The conditions of a quadratic program's optimum, written out dense and row by row."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigvalsh, null_space

from psmpc_cli.ocp.gauss_newton import Linearization, Unknowns
from psmpc_cli.solvers.quadratic import QpSolution

from .random_programs import Task, interval_rows_after


def flat(step: Unknowns) -> np.ndarray:
    """A step as one vector, that of x_0 left out."""
    return np.r_[step.X[1:].ravel(), step.tau]


def objective(model: Linearization, step: Unknowns) -> float:
    """The objective's change by the quadratic model."""
    gradient, x = np.r_[model.gradient[1:].ravel(), model.gradient_tau], flat(step)
    return float(gradient @ x + x @ hessian(model) @ x / 2)


def energy(model: Linearization, one: Unknowns, other: Unknowns) -> float:
    """Half the square of two steps' difference in the Hessian's norm: what of it the objective can see."""
    apart = flat(one) - flat(other)
    return float(apart @ hessian(model) @ apart / 2)


def hessian(model: Linearization) -> np.ndarray:
    """The Hessian by x_1 .. x_K and the durations."""
    K, n = model.H_vv.shape
    size, S = 2 * n * K, len(model.gradient_tau)
    H = np.zeros((size + S, size + S))
    for k in range(K):
        Q, v = 2 * n * k + np.arange(n), 2 * n * k + n + np.arange(n)
        upper = model.H_QQ[k + 1]
        H[np.ix_(Q, Q)] = upper + np.triu(upper, 1).T
        H[v, v] -= model.H_vv[k]
        if k:
            H[v - 2 * n, v - 2 * n] -= model.H_vv[k]
            H[v, v - 2 * n] = H[v - 2 * n, v] = model.H_vv[k]
    H[:size, size:] = model.H_x_tau[1:].reshape(size, S)
    H[size:, :size] = H[:size, size:].T
    H[size:, size:] = model.H_tau_tau
    return H


@dataclass(frozen=True)
class Optimality:
    """By how much the conditions of an optimum are missed at worst."""

    gaps: float
    limits: float
    gradient: float
    complementarity: float


def optimality(task: Task, found: QpSolution) -> Optimality:
    """Karush, Kuhn and Tucker's conditions, row by row: gaps, rows with bounds."""
    model, bounds, x = task.model, task.window.bounds, flat(found.step)
    rows = rows_after(task, found.step.moved(found.step, -1.0))
    G, gaps = jacobians(task)
    low, high, value, z = bounds.low - rows, bounds.high - rows, G @ x, found.rows
    gradient = hessian(model) @ x + np.r_[model.gradient[1:].ravel(), model.gradient_tau]
    gradient += gaps.T @ found.gaps.ravel() + G.T @ z
    room = np.where(z > 0, np.abs(high - value), np.abs(value - low))
    return Optimality(
        gaps=float(np.abs(gaps @ x + model.residuals.gaps.ravel()).max()),
        limits=float(max((low - value).max(), (value - high).max())),
        gradient=float(np.abs(gradient).max()),
        complementarity=float(np.where(np.abs(z) > 1e-12, np.abs(z) * np.minimum(room, 1e9), 0.0).max()),
    )


def jacobians(task: Task) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of the rows with bounds and of the gaps, by x_1 .. x_K and the durations."""
    size = task.point.X[1:].size + len(task.point.tau)
    none, *steps = (_step(task.point, column) for column in np.vstack([np.zeros(size), np.eye(size)]))
    rows = rows_after(task, none)
    G = np.column_stack([rows_after(task, step) - rows for step in steps])
    return G, np.column_stack([_change_of_gaps(task.model, step).ravel() for step in steps])


def curvatures(task: Task, held: np.ndarray) -> np.ndarray:
    """The eigenvalues of the Hessian, ascending, on the steps that close the gaps and change none of the rows held."""
    G, gaps = jacobians(task)
    Z = null_space(np.vstack([gaps, G[held]]))
    return np.asarray(eigvalsh(Z.T @ hessian(task.model) @ Z)) if Z.shape[1] else np.zeros(1)  # no such step


def _step(point: Unknowns, x: np.ndarray) -> Unknowns:
    K, size = len(point.X) - 1, point.X.shape[1]
    return Unknowns(np.vstack([np.zeros(size), x[: K * size].reshape(K, size)]), x[K * size :])


def rows_after(task: Task, step: Unknowns) -> np.ndarray:
    """The rows with bounds after a step: all but those of constraints are linear."""
    residuals, form = task.model.residuals, task.window.form
    ends = residuals.rows + (task.model.rows_by_x * step.X[form.row_node]).sum(axis=1)
    over_intervals = interval_rows_after(form, task.model, step)
    after = task.point.moved(step, 1.0)
    h = form.steps(after, task.window.horizon)
    return task.window.rows(after, replace(residuals, rows=ends, interval_rows=over_intervals), h)


def _change_of_gaps(model: Linearization, step: Unknowns) -> np.ndarray:
    n, v = model.H_vv.shape[1], step.X[:, model.H_vv.shape[1] :]
    by_velocity = model.gap_velocity[:, :1] * v[:-1] + model.gap_velocity[:, 1:] * v[1:]
    return np.asarray(np.diff(step.X[:, :n], axis=0) + by_velocity + model.gap_tau @ step.tau)
