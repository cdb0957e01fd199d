"""Quadratic programs of a window's structure with random numbers."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from psmpc_cli.ocp.gauss_newton import Linearization, Residuals, Unknowns, VelocityForm
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.solvers.sqp_window import Evaluation, SqpWindow, WindowBounds, nodes_of_rows

COORDINATES = 2
END_ROWS = 2
INTERVAL_ROWS = 3


@dataclass(frozen=True, eq=False)
class Task:
    """One program, as both methods take it."""

    window: SqpWindow
    model: Linearization
    point: Unknowns

    @property
    def here(self) -> Evaluation:
        """The point with what stands there."""
        return self.window.evaluated(self.point, self.model.residuals)

    def with_bounds(self, **changes: Any) -> "Task":
        """The same program with other bounds."""
        return replace(self, window=replace(self.window, bounds=replace(self.window.bounds, **changes)))


def structure(nodes: tuple[int, ...], over_intervals: bool = False, has_history: bool = False) -> VelocityForm:
    """What of a velocity form the programs need: stages of few nodes, two end rows at each switch.

    And three rows over each interval but every fourth, where there are any; with a history they depend on the
    velocities where the interval before begins too.
    """

    class Form(VelocityForm):
        def __init__(self) -> None:
            self.grid, self.nodes, self.weights = Grid(COORDINATES, nodes), np.array(nodes), (0.5, 0.5)
            self.row_node = np.repeat(self.grid.first_node[1:-1], END_ROWS)
            self.row_is_soft = np.zeros(len(self.row_node), bool)
            self.lazy_rows = np.zeros(0, int)
            constrained = [k for k in range(self.grid.K) if over_intervals and k % 4 != 3]
            self.row_interval = np.repeat(np.array(constrained, int), INTERVAL_ROWS)
            self.history = COORDINATES if has_history else 0

        def hessian_weights(self, p: Any) -> np.ndarray:
            return np.zeros(len(self.row_interval))

    return Form()


def random_task(rng: np.random.Generator, nodes: tuple[int, ...], what: set[str]) -> Task:
    """A program that a random step meets; `what` names what it has besides bounds on states and durations."""
    has_history = "history" in what
    form, n, horizon = structure(nodes, has_history or "intervals" in what, has_history), COORDINATES, 2.0
    grid, S = form.grid, len(nodes) - 1
    point = Unknowns(rng.normal(size=(grid.K + 1, 2 * n)), np.full(S, horizon / (S + 1)))
    model = _random_model(rng, form, point, horizon)
    bounds = _bounds_about(rng, form, model, point, _random_step(rng, model, grid), what)
    return Task(SqpWindow(form, bounds, cast(Any, SimpleNamespace(horizon=horizon, x0=point.X[0]))), model, point)


def _random_model(rng: np.random.Generator, form: VelocityForm, point: Unknowns, horizon: float) -> Linearization:
    n, K, S = COORDINATES, form.grid.K, form.grid.switches
    h = form.steps(point, horizon)
    positions, arrow = np.zeros((K + 1, n, n)), np.zeros((K + 1, 2 * n, S))
    coupling, durations = np.zeros((K, n)), np.zeros((S, S))
    for k in range(K + 1):  # squares of residuals in positions and durations
        J, m = rng.normal(size=(1, n)), rng.normal(size=(1, S))
        positions[k], arrow[k, :n], durations = J.T @ J, J.T @ m, durations + m.T @ m
    for k in range(K):  # and in differences of velocities and durations
        b, e = 10 ** rng.uniform(-3, 1, n), rng.normal(size=(n, S))
        coupling[k] -= b
        arrow[k, n:] += b[:, None] * e
        arrow[k + 1, n:] -= b[:, None] * e
        durations = durations + e.T @ (b[:, None] * e)
    return Linearization(
        residuals=Residuals(
            objective=0.0,
            costs=np.zeros(S + 1),
            terminal=0.0,
            gaps=rng.normal(size=(K, n)) * 0.1,
            rows=rng.normal(size=END_ROWS * S),
            interval_rows=rng.normal(size=len(form.row_interval)),
        ),
        gradient=rng.normal(size=(K + 1, 2 * n)),
        gradient_tau=rng.normal(size=S),
        H_QQ=np.triu(positions),
        H_vv=coupling,
        H_x_tau=arrow,
        H_tau_tau=durations,
        gap_velocity=-h * np.array([0.5, 0.5]),
        gap_tau=rng.normal(size=(K, n, S)),
        node_rows=np.arange(END_ROWS * S),
        rows_by_x=rng.normal(size=(END_ROWS * S, 2 * n)),
        interval_rows=np.arange(len(form.row_interval)),
        interval_rows_by=rng.normal(size=(len(form.row_interval), 4 * n + S + form.history)),
    )


def _random_step(rng: np.random.Generator, model: Linearization, grid: Grid) -> Unknowns:
    """A step that closes the gaps."""
    n, X, tau = COORDINATES, np.zeros((grid.K + 1, 2 * COORDINATES)), 0.1 * rng.normal(size=grid.switches)
    X[1:, n:] = rng.normal(size=(grid.K, n))
    for k in range(grid.K):
        by_v, v = model.gap_velocity[k], X[:, n:]
        change = by_v[0] * v[k] + by_v[1] * v[k + 1] + model.gap_tau[k] @ tau + model.residuals.gaps[k]
        X[k + 1, :n] = X[k, :n] - change
    return Unknowns(X, tau)


def _bounds_about(
    rng: np.random.Generator, form: VelocityForm, model: Linearization, point: Unknowns, step: Unknowns, what: set[str]
) -> WindowBounds:
    n, S = COORDINATES, form.grid.switches
    X, tau = (point.X + step.X)[1:], point.tau + step.tau

    def around(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        below, above = (np.where(rng.random(value.shape) < 0.2, np.inf, rng.uniform(0, 0.5, value.shape)) for _ in "lh")
        return value - below, value + above

    X_low, X_high = around(X)
    if "free" in what:  # positions without limits
        X_low[:, :n], X_high[:, :n] = -np.inf, np.inf
    if "equal" in what:
        X_low[0, n], X_high[0, n] = X[0, n] - 1e-9, X[0, n] + 1e-9
    fixed = np.arange(S) == (0 if "fixed" in what else -1)
    tied = np.arange(S) == (S - 1 if "tied" in what else -1)
    end_low, end_high = around(model.residuals.rows + (model.rows_by_x * step.X[form.row_node]).sum(axis=1))
    none, together = np.full(S, np.inf), tau.cumsum()
    low = [X_low.ravel(), np.where(fixed, tau, tau - 0.3), np.where(tied, together, -none), end_low]
    high = [X_high.ravel(), np.where(fixed, tau, none), together + np.where(tied, 0.0, 0.05), end_high]
    h = form.steps(point, 2.0) + (form.interval_steps @ step.tau)[:, None]

    def over_h(values: np.ndarray) -> list[np.ndarray]:
        limits, free = around(values), np.full(values.size, np.inf)
        low.extend([np.where(np.isfinite(limits[0]), 0.0, -np.inf).ravel(), -free])
        high.extend([free, np.where(np.isfinite(limits[1]), 0.0, np.inf).ravel()])
        return [np.where(np.isfinite(limit), limit, 0.0) for limit in limits]

    intervals = over_h(interval_rows_after(form, model, step) / h[form.row_interval, 0])
    inputs = [np.zeros((0, n))] * 2
    if "inputs" in what:
        inputs = over_h(np.diff((point.X + step.X)[:, n:], axis=0) / h)
    rows, first = (np.concatenate(low), np.concatenate(high)), np.array([[-np.inf], [np.inf]]) * np.ones(2 * n)
    soft = np.zeros(len(rows[0]), bool)
    return WindowBounds(*rows, *intervals, *inputs, soft, nodes_of_rows(form, len(soft)), first)


def interval_rows_after(form: VelocityForm, model: Linearization, step: Unknowns) -> np.ndarray:
    """The rows over intervals after a step, without their bounds."""
    return model.residuals.interval_rows + form.row_change(model, step)


def soft_rows(task: Task, states: bool, node_rows: bool = False) -> np.ndarray:
    """Which rows of a program are soft: those of states, of constraints at nodes, or both."""
    window = task.window
    soft = np.zeros(len(window.bounds.low), bool)
    soft[: window.states] = states
    soft[window.states + 2 * len(task.point.tau) :][: len(window.form.row_node)] = node_rows
    return soft


def unattainable(task: Task) -> Task:
    """The same program with an end row that must lie apart from itself: its twin wants it 1 higher."""
    rows, ends = task.model.rows_by_x.copy(), task.model.residuals.rows.copy()
    rows[1], ends[:2] = rows[0], 0.0
    low, high, first = (
        task.window.bounds.low.copy(),
        task.window.bounds.high.copy(),
        task.window.states + 2 * len(task.point.tau),
    )
    low[first : first + 2], high[first : first + 2] = (0.0, 1.0), (0.1, 1.1)
    model = replace(task.model, residuals=replace(task.model.residuals, rows=ends), rows_by_x=rows)
    return replace(task, model=model).with_bounds(low=low, high=high)
