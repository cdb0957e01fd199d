"""Quadratic programs of a window's structure with random numbers."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, Point, Residuals, VelocityForm
from psmpc_cli.ocp.objective import StageFunctions
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.solvers.sqp_window import WindowBounds

COORDINATES = 2
END_ROWS = 2


@dataclass(frozen=True, eq=False)
class Task:
    """One program, as both methods take it."""

    form: VelocityForm
    model: Linearization
    limits: WindowBounds
    point: Point
    horizon: float


def structure(nodes: tuple[int, ...]) -> VelocityForm:
    """What of a velocity form the programs need: stages of few nodes, two end rows at each switch."""
    n, S = COORDINATES, len(nodes) - 1
    every, row = np.triu_indices(n), np.repeat(np.arange(END_ROWS), 2 * n)
    dense = (row, np.tile(np.arange(2 * n), END_ROWS))

    class Form(VelocityForm):
        def __init__(self) -> None:
            self.grid, self.nodes, self.weights, self.curved_stages = Grid(n, nodes), np.array(nodes), (0.5, 0.5), ()
            ends = [END_ROWS if s < S else 0 for s in range(S + 1)]
            stages = [SimpleNamespace(end_rows=rows, end_places=dense, hessian_places=every) for rows in ends]
            self.stages = cast(list[StageFunctions], stages)

    return Form()


def random_task(rng: np.random.Generator, nodes: tuple[int, ...], what: set[str]) -> Task:
    """A program that a random step meets; `what` names what it has besides bounds on states and durations."""
    form, n, horizon = structure(nodes), COORDINATES, 2.0
    grid, S = form.grid, len(nodes) - 1
    point = Point(rng.normal(size=(grid.K + 1, 2 * n)), np.full(S, horizon / (S + 1)))
    model = _random_model(rng, form, point, horizon)
    step = _random_step(rng, model, grid)
    return Task(form, model, _limits_about(rng, form, model, point, step, what), point, horizon)


def _random_model(rng: np.random.Generator, form: VelocityForm, point: Point, horizon: float) -> Linearization:
    n, K, S = COORDINATES, form.grid.K, form.grid.switches
    h = form.steps(point, horizon)
    positions, arrow = np.zeros((K + 1, n, n)), np.zeros((K + 1, 2 * n, S))
    velocities, coupling, durations = np.zeros((K + 1, n)), np.zeros((K, n)), np.zeros((S, S))
    for k in range(K + 1):  # squares of residuals in positions and durations
        J, m = rng.normal(size=(1, n)), rng.normal(size=(1, S))
        positions[k], arrow[k, :n], durations = J.T @ J, J.T @ m, durations + m.T @ m
    for k in range(K):  # and in differences of velocities and durations
        b, e = 10 ** rng.uniform(-3, 1, n), rng.normal(size=(n, S))
        velocities[k] += b
        velocities[k + 1] += b
        coupling[k] -= b
        arrow[k, n:] += b[:, None] * e
        arrow[k + 1, n:] -= b[:, None] * e
        durations = durations + e.T @ (b[:, None] * e)
    ends = {s: rng.normal(size=END_ROWS) for s in range(S)}
    return Linearization(
        at=Residuals(0.0, np.zeros(S + 1), 0.0, rng.normal(size=(K, n)) * 0.1, ends),
        gradient=rng.normal(size=(K + 1, 2 * n)),
        gradient_tau=rng.normal(size=S),
        positions=np.triu(positions),
        velocities=velocities,
        coupling=coupling,
        arrow=arrow,
        durations=durations,
        gap_velocity=-h * np.array([0.5, 0.5]),
        gap_tau=rng.normal(size=(K, n, S)),
        end_derivatives={s: rng.normal(size=END_ROWS * 2 * n) for s in range(S)},
    )


def _random_step(rng: np.random.Generator, model: Linearization, grid: Grid) -> Point:
    """A step that closes the gaps."""
    n, X, tau = COORDINATES, np.zeros((grid.K + 1, 2 * COORDINATES)), 0.1 * rng.normal(size=grid.switches)
    X[1:, n:] = rng.normal(size=(grid.K, n))
    for k in range(grid.K):
        by_v, v = model.gap_velocity[k], X[:, n:]
        change = by_v[0] * v[k] + by_v[1] * v[k + 1] + model.gap_tau[k] @ tau + model.at.gaps[k]
        X[k + 1, :n] = X[k, :n] - change
    return Point(X, tau)


def _limits_about(
    rng: np.random.Generator, form: VelocityForm, model: Linearization, point: Point, step: Point, what: set[str]
) -> WindowBounds:
    n, K, S = COORDINATES, form.grid.K, form.grid.switches
    X, tau = (point.X + step.X)[1:], point.tau + step.tau

    def around(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        below, above = (np.where(rng.random(value.shape) < 0.2, np.inf, rng.uniform(0, 0.5, value.shape)) for _ in "lh")
        return value - below, value + above

    X_low, X_high = around(X)
    if "equal" in what:
        X_low[0, n], X_high[0, n] = X[0, n] - 1e-9, X[0, n] + 1e-9
    ends = {
        s: around(model.at.ends[s] + model.end_derivatives[s].reshape(END_ROWS, -1) @ X_step)
        for s, X_step in _at_ends(form, step)
    }
    tau_low, tau_high = tau - 0.3, np.full(S, np.inf)
    if "fixed" in what and S:
        tau_low[0] = tau_high[0] = tau[0]
    share = form.interval_steps
    h = form.steps(point, 2.0) + (share @ step.tau)[:, None]
    u = np.diff((point.X + step.X)[:, n:], axis=0) / h
    low, high = around(u) if "inputs" in what else (np.full((K, n), -np.inf), np.full((K, n), np.inf))
    return WindowBounds(
        X_low=X_low,
        X_high=X_high,
        tau_low=tau_low,
        tau_high=tau_high,
        together=float(tau.sum() + 0.05),
        until={S - 1: float(tau.sum())} if "tied" in what and S else {},
        ends=ends,
        input_low=low,
        input_high=high,
        bounded_inputs=_finite(low, high),
    )


def _finite(low: np.ndarray, high: np.ndarray) -> tuple[tuple[int, ...], tuple[int, ...]]:
    below, above = (tuple(np.flatnonzero(np.isfinite(bound)).tolist()) for bound in (low, high))
    return below, above


def _at_ends(form: VelocityForm, step: Point) -> list[tuple[int, np.ndarray]]:
    return [(s, step.X[form.grid.first_node[s + 1]]) for s in range(form.grid.switches)]


def unattainable(task: Task) -> Task:
    """The same program with an end row that must lie apart from itself: its twin wants it 1 higher."""
    derivatives = task.model.end_derivatives[0].reshape(END_ROWS, -1).copy()
    derivatives[1] = derivatives[0]
    at = {**task.model.at.ends, 0: np.zeros(END_ROWS)}
    model = replace(task.model, at=replace(task.model.at, ends=at))
    model = replace(model, end_derivatives={**model.end_derivatives, 0: derivatives.ravel()})
    ends = {**task.limits.ends, 0: (np.array([0.0, 1.0]), np.array([0.1, 1.1]))}
    return replace(task, model=model, limits=replace(task.limits, ends=ends))
