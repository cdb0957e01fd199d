"""A window in the velocity form as its quadratic programs need it: bounds, violations, penalties.

What has a bound is a row: states at nodes 1 .. K, durations, their sums up to each, rows at nodes,
rows over intervals, less their bounds times h, accelerations as velocities, `Qdot+ - Qdot - h u_low` and
`Qdot+ - Qdot - h u_high`. Violations, the programs and their multipliers share
the order.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from psmpc_cli.ocp.constraints.boxes import (
    NARROWEST_SOFT,
    PENALTY,
    acceleration_limits,
    moved_apart,
    node_limits,
    scaled_violations,
    shares_of_time,
    shift_limits,
)
from psmpc_cli.ocp.gauss_newton import Linearization, Point, Residuals, VelocityForm, marked
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import SHORTEST, Parameters, Window, shortest_durations
from psmpc_cli.solvers.base import FEASIBLE

NEAR_BOUND = 0.5
"""Rows over intervals are in a program from this share of their bounds on, or where the step would violate them."""


@dataclass(frozen=True, eq=False)
class WindowBounds:
    """The bounds of one window.

    Attributes:
        low, high: Of the rows, (R,); where they are equal, or cross, the row is an equation.
        interval_low, interval_high: Of the rows over intervals, each over h, (I,), 0 where there is none.
        input_low, input_high: Of the accelerations, (K, n), 0 where there is none; (0, n) where none has one.
        soft: Which rows may be violated at a cost, (R,).
        first: Low and high of x_0, which count where those of states are soft, (2, 2n); infinite where they are hard.
    """

    low: np.ndarray
    high: np.ndarray
    interval_low: np.ndarray
    interval_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    soft: np.ndarray
    first: np.ndarray


def fixed_bounds(form: VelocityForm, window: Window) -> WindowBounds:
    """Return the bounds that windows of one shape and limits share, those of durations and rows at nodes left open."""
    grid = form.grid
    stages = window.stages
    S = form.grid.switches
    low, high = node_limits(grid, stages)
    first = np.array([low[0], high[0]]) if window.soft else np.array([[-np.inf], [np.inf]]) * np.ones(low.shape[1])
    low, high = moved_apart(low[1:], high[1:]) if window.soft else (low[1:], high[1:])
    of_window = np.full(2 * S + len(form.row_node), np.inf)  # durations, and rows at nodes
    lows = [low.ravel(), -of_window]
    highs = [high.ravel(), of_window]
    interval_low, interval_high = _over_h(*form.interval_bounds(window), lows, highs)
    inputs = acceleration_limits(grid, stages)
    if np.isfinite(inputs).any():
        input_low, input_high = _over_h(*inputs, lows, highs)
    else:
        input_low = input_high = np.zeros((0, grid.n))
    row_low = np.concatenate(lows)
    soft = np.zeros(len(row_low), bool)
    soft[: 2 * grid.n * grid.K] = window.soft
    soft[2 * grid.n * grid.K + 2 * S :][: len(form.row_node)] = form.row_is_soft
    return WindowBounds(
        low=row_low,
        high=np.concatenate(highs),
        interval_low=interval_low,
        interval_high=interval_high,
        input_low=input_low,
        input_high=input_high,
        soft=soft,
        first=first,
    )


def _over_h(
    low: np.ndarray, high: np.ndarray, lows: list[np.ndarray], highs: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Append the bounds of the rows g - low h >= 0, then of g - high h <= 0, and return low and high, 0 where none."""
    none = np.full(low.size, np.inf)
    lows += [np.where(np.isfinite(low), 0.0, -np.inf).ravel(), -none]
    highs += [none, np.where(np.isfinite(high), 0.0, np.inf).ravel()]
    return np.where(np.isfinite(low), low, 0.0), np.where(np.isfinite(high), high, 0.0)


def window_bounds(
    form: VelocityForm, shared: WindowBounds, window: Window, guess: Plan, tau: np.ndarray, within: float
) -> WindowBounds:
    """Return the bounds of a window about a guess, durations within so many seconds of guessed ones (S,) [s]."""
    S = len(tau)
    first = len(window.x0) * window.K  # the durations stand after the states
    low = shared.low.copy()
    high = shared.high.copy()
    at_nodes = (window.K, len(window.x0))
    shift_limits(window, guess, low[:first].reshape(at_nodes), high[:first].reshape(at_nodes))
    if form.node_rows:
        at = slice(first + 2 * S, first + 2 * S + len(form.row_node))
        low[at], high[at] = form.row_bounds(window)
    low[first : first + S] = np.maximum(shortest_durations(window)[:-1], tau - within)
    high[first : first + S] = tau + within
    if S:
        high[first + 2 * S - 1] = window.horizon - SHORTEST
    for s, stage in enumerate(window.stages[:-1]):
        if stage.at is not None:
            low[first + S + s] = high[first + S + s] = stage.at - window.start
    return replace(shared, low=low, high=high)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A point of a window, with objective, constraints and violations there.

    Attributes:
        point: The point.
        at: Objective, with the penalty of violations, and constraints.
        rows: The rows with bounds, (R,).
        violation: The largest of a gap, an end condition or a hard limit [m, rad, m/s, rad/s, s].
        shares: The share of time that each node stands for, (K + 1,) [s]; (0,) where no row is soft.
        penalties: rho times the violations of the soft rows, ascending.
    """

    point: Point
    at: Residuals
    rows: np.ndarray
    violation: float
    shares: np.ndarray
    penalties: np.ndarray


@dataclass(frozen=True, eq=False)
class SqpWindow:
    """One window: its numbers and its bounds.

    Attributes:
        form: The window's velocity form.
        bounds: Its bounds.
        p: Its numbers.
    """

    form: VelocityForm
    bounds: WindowBounds
    p: Parameters[np.ndarray]

    @cached_property
    def horizon(self) -> float:
        """T_h [s]."""
        return float(self.p.horizon)

    @property
    def leaves_rows_out(self) -> bool:
        """Whether programs have those rows alone, of some constraints, that are near their bounds."""
        return len(self.form.sometimes) > 0 or len(self.form.row_interval) > 0

    @cached_property
    def _near(self) -> np.ndarray:
        """How near their bounds the rows at nodes that are not in all programs are part of one."""
        return np.asarray(self.form.row_near[self.form.sometimes])

    @property
    def states(self) -> int:
        """Number of the rows of states, the first of all."""
        return 2 * self.form.grid.n * self.form.grid.K

    def with_given_rates(self, point: Point) -> Point:
        """Return a point with the rates that rows at nodes determine."""
        return self.form.with_given_rates(point, self.p)

    @cached_property
    def elastic(self) -> "SqpWindow":
        """The same window with all rows at nodes soft, but for those that are equations, or nearly."""
        rows = slice(self._first_node_row, self._first_interval_row)
        soft = self.bounds.soft.copy()
        soft[rows] |= self.bounds.high[rows] - self.bounds.low[rows] >= NARROWEST_SOFT
        return replace(self, bounds=replace(self.bounds, soft=soft))

    @property
    def _first_node_row(self) -> int:
        """Index of the first of the rows at nodes."""
        return self.states + 2 * self.form.grid.switches

    @property
    def _first_interval_row(self) -> int:
        """Index of the first of the rows over intervals less low h; those less high h follow."""
        return self._first_node_row + len(self.form.row_node)

    @cached_property
    def interval_weights(self) -> np.ndarray:
        """What the squares of the rows over intervals add to the Hessian, (I,); 0 of constraints."""
        return self.form.hessian_weights(self.p)

    def rows_in_program(self, model: Linearization) -> np.ndarray | slice:
        """Return the indices of the rows that the program of a model has, ascending."""
        first = self._first_interval_row
        count = len(self.form.row_interval)
        if not self.leaves_rows_out:
            return slice(None)
        of_nodes = self._first_node_row + model.node_rows
        of_intervals = first + model.interval_rows
        after = np.arange(first + 2 * count, len(self.bounds.low))
        return np.concatenate([np.arange(self._first_node_row), of_nodes, of_intervals, of_intervals + count, after])

    def _interval_rows_beyond(self, point: Point, values: np.ndarray, share: float, excess: float) -> np.ndarray:
        """Return which rows over intervals (I,), of these values, exceed a share of their bounds by more than that."""
        first = self._first_interval_row
        count = len(values)
        h = self.form.steps(point, self.horizon)[self.form.row_interval, 0]
        has_low = np.isfinite(self.bounds.low[first : first + count])
        has_high = np.isfinite(self.bounds.high[first + count : first + 2 * count])
        below = values < share * self.bounds.interval_low * h - excess
        above = values > share * self.bounds.interval_high * h + excess
        return np.flatnonzero((has_low & below) | (has_high & above))

    def _node_rows_beyond(self, values: np.ndarray, apart: np.ndarray | float) -> np.ndarray:
        """Return which rows at nodes that are not in all programs, of values (E,), are nearer to a bound than that."""
        low, high = self._bounds_of_sometimes
        of_these = values[self.form.sometimes]
        near = (of_these < low + apart) | (of_these > high - apart)
        return np.asarray(self.form.sometimes[near])

    @cached_property
    def _bounds_of_sometimes(self) -> tuple[np.ndarray, np.ndarray]:
        """Low and high of the rows at nodes that are not in all programs."""
        which = self._first_node_row + self.form.sometimes
        return self.bounds.low[which], self.bounds.high[which]

    def missed_rows(self, model: Linearization, reached: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows at nodes and those over intervals that a model does not have and a point violates, ascending.

        With them those that the point brings near their bounds: one more program then is enough, most often.
        """
        of_nodes = np.zeros(0, int)
        of_intervals = np.zeros(0, int)
        if len(self.form.sometimes):
            violated = self._node_rows_beyond(reached.at.rows, -FEASIBLE)
            if not marked(model.node_rows, len(reached.at.rows))[violated].all():
                of_nodes = self._node_rows_beyond(reached.at.rows, self._near)
        if len(self.form.row_interval):
            values = reached.at.interval_rows
            violated = self._interval_rows_beyond(reached.point, values, 1.0, FEASIBLE)
            if not marked(model.interval_rows, len(values))[violated].all():
                of_intervals = self._interval_rows_beyond(reached.point, values, NEAR_BOUND, 0.0)
        return of_nodes, of_intervals

    def with_rows(
        self, model: Linearization, point: Point, of_nodes: np.ndarray, of_intervals: np.ndarray
    ) -> Linearization:
        """Return the model at a point with some more rows at nodes and over intervals."""
        model = self.form.with_node_rows(model, point, self.p, of_nodes)
        if not len(of_intervals):
            return model
        of_model = np.union1d(model.interval_rows, of_intervals)
        derivatives = self.form.interval_jacobian(point, self.p, of_model)
        return replace(model, interval_rows=of_model, interval_rows_by=derivatives)

    def rows(self, point: Point, at: Residuals) -> np.ndarray:
        """Return the rows at a point, (R,)."""
        rows = [point.X[1:].ravel(), point.tau, point.tau.cumsum(), at.rows]
        has_rows_over_intervals = len(self.form.row_interval) or len(self.bounds.input_low)
        if not has_rows_over_intervals:
            return np.concatenate(rows)
        h = self.form.steps(point, self.horizon)
        if len(self.form.row_interval):
            h_of_rows = h[self.form.row_interval, 0]
            rows += [
                at.interval_rows - h_of_rows * bound for bound in (self.bounds.interval_low, self.bounds.interval_high)
            ]
        if len(self.bounds.input_low):
            dv = np.diff(point.X[:, self.form.grid.n :], axis=0)
            rows += [(dv - h * bound).ravel() for bound in (self.bounds.input_low, self.bounds.input_high)]
        return np.concatenate(rows)

    def evaluation(self, point: Point) -> Evaluation:
        """Evaluate the window at a point."""
        return self.evaluated(point, self.form.residuals(point, self.p))

    def evaluated(self, point: Point, at: Residuals) -> Evaluation:
        """Return the evaluation of a point with these residuals, the penalty of violations added to the objective."""
        rows = self.rows(point, at)
        violation = self._violation(at, rows)
        if not len(self._soft_rows):
            return Evaluation(point, at, rows, violation, np.zeros(0), np.zeros(0))
        shares = shares_of_time(self.form.steps(point, self.horizon))[:, 0]
        penalties = self._soft_penalties(rows)
        penalty = float(shares @ self._penalty_by_node(point, penalties))
        at = replace(at, objective=at.objective + penalty)
        return Evaluation(point, at, rows, violation, shares, penalties)

    def _violation(self, at: Residuals, rows: np.ndarray) -> float:
        """Return by how much a gap, an end condition or a hard limit is violated at worst.

        In natural units: m, rad, m/s, rad/s, s. A limit on an acceleration counts by the velocity it costs in its
        interval.
        """
        bounds = self.bounds
        hard = ~bounds.soft
        every = np.concatenate([np.abs(at.gaps).ravel(), (bounds.low - rows)[hard], (rows - bounds.high)[hard]])
        return float(max(every.max(), 0.0))

    @cached_property
    def _soft_rows(self) -> np.ndarray:
        """Indices of the rows that may be violated at a cost."""
        return np.flatnonzero(self.bounds.soft)

    @cached_property
    def _soft_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Low and high of the soft rows."""
        return self.bounds.low[self._soft_rows], self.bounds.high[self._soft_rows]

    @cached_property
    def _soft_node(self) -> np.ndarray:
        """Nodes of the soft rows, which are of states or of constraints at nodes."""
        node = 1 + self._soft_rows // (2 * self.form.grid.n)
        is_constraint = self._soft_rows >= self.states
        node[is_constraint] = self.form.row_node[self._soft_rows[is_constraint] - self._first_node_row]
        return node

    def _soft_penalties(self, rows: np.ndarray) -> np.ndarray:
        """Return rho times the violations of the soft ones of rows (R,) with these values."""
        return scaled_violations(rows[self._soft_rows], *self._soft_bounds)

    @cached_property
    def _penalty_of_first(self) -> float:
        """The sum of rho times the violations of x_0."""
        return float(scaled_violations(self.p.x0, *self.bounds.first).sum())

    def _penalty_by_node(self, point: Point, penalties: np.ndarray) -> np.ndarray:
        """Return the sum of the soft penalties at each node, (K + 1,); of x_0 those of its state."""
        by_node = np.bincount(self._soft_node, penalties, minlength=len(point.X))
        by_node[0] = self._penalty_of_first
        return by_node

    def state_violations(self, point: Point) -> np.ndarray:
        """Return by how much nodes violate limits of states at worst, (2n,) [m, rad, m/s, rad/s]."""
        low = self.bounds.low[: self.states].reshape(point.X[1:].shape)
        high = self.bounds.high[: self.states].reshape(point.X[1:].shape)
        return np.asarray(scaled_violations(point.X[1:], low, high).max(axis=0) / PENALTY)

    def keeps_soft_limits(self, reached: Evaluation) -> bool:
        """Tell whether soft limits are violated no further than the measured state violates them."""
        form = self.form
        x0 = reached.point.X[0]
        own = np.zeros(len(reached.rows))
        own[: self.states] = np.tile(scaled_violations(x0, *self.bounds.first), form.grid.K)
        at_first = np.where(np.isfinite(reached.rows), reached.rows, 0.0)
        at_first[self._first_node_row :][: len(form.row_node)] = form.rows_at(x0, self.p)
        own[self.states :] = scaled_violations(at_first, self.bounds.low, self.bounds.high)[self.states :]
        excess = reached.penalties - own[self._soft_rows]
        return bool((excess <= PENALTY * FEASIBLE).all())

    def row_penalties(self, here: Evaluation, which: np.ndarray | slice) -> np.ndarray:
        """Return what a unit of violation of some rows costs, 0 of hard ones."""
        penalties = np.zeros(len(self.bounds.low))
        if len(self._soft_rows):
            penalties[self._soft_rows] = PENALTY * here.shares[self._soft_node]
        return np.asarray(penalties[which])

    def linearize(self, point: Point) -> tuple[Evaluation, Linearization]:
        """Return the evaluation of a point, and the model there, violations weighted with the durations they last.

        What a step changes of the violations is left to the program, which knows it exactly. Of the rows over
        intervals it has those that are near their bounds, of rows at nodes too where these say so.
        """
        model = self.form.linearize(point, self.p)
        if self.leaves_rows_out:
            of_nodes = self._node_rows_beyond(model.at.rows, self._near)
            of_intervals = self._interval_rows_beyond(point, model.at.interval_rows, NEAR_BOUND, 0.0)
            model = self.with_rows(model, point, of_nodes, of_intervals)
        here = self.evaluated(point, model.at)
        if not len(self._soft_rows):
            return here, model
        by_tau = self._penalty_by_node(point, here.penalties) @ self.form.node_shares
        return here, replace(model, gradient_tau=model.gradient_tau + by_tau)

    def foreseen(self, here: Evaluation, model: Linearization, step: Point) -> np.ndarray:
        """Return the values of the rows (R,) that the model at a point has after a step, as long as durations stay.

        Of rows that the model does not have, and of those over intervals, it is their value at the point.
        """
        rows = here.rows.copy()
        rows[: self.states] += step.X[1:].ravel()
        node = self.form.row_node[model.node_rows]
        rows[self._first_node_row + model.node_rows] += (model.rows_by_x * step.X[node]).sum(axis=1)
        return rows

    def bent_rows(self, foreseen: np.ndarray, reached: Evaluation) -> float:
        """Return by how much soft rows at nodes are violated further than their foreseen values, at worst."""
        if not self.form.row_is_soft.any():
            return 0.0
        excess = reached.penalties - self._soft_penalties(foreseen)
        return float(max(excess[self._soft_rows >= self.states].max(), 0.0) / PENALTY)

    def change_of_penalty(self, here: Evaluation, foreseen: np.ndarray) -> float:
        """Return what the penalty at foreseen values of the rows is more than at a point."""
        if not len(self._soft_rows):
            return 0.0
        return float(here.shares[self._soft_node] @ (self._soft_penalties(foreseen) - here.penalties))
