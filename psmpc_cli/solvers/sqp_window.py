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
    node_limits,
    scaled_violations,
    shares_of_time,
    shift_limits,
    widened,
)
from psmpc_cli.ocp.end import SHORTEST
from psmpc_cli.ocp.gauss_newton import Linearization, Residuals, Unknowns, VelocityForm, mask
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Parameters, Window, shortest_durations
from psmpc_cli.solvers.base import FEASIBLE

NEAR_BOUND = 0.5
"""Rows over intervals are in a program from this share of their bounds on, or where the step would violate them."""

NEARER = 0.2
"""By what that share is multiplied each time a program is solved again for rows that it missed."""


@dataclass(frozen=True, eq=False)
class WindowBounds:
    """The bounds of one window.

    Attributes:
        low, high: Of the rows, (R,); where they are equal, or cross, the row is an equation.
        interval_low, interval_high: Of the rows over intervals, each over h, (I,), 0 where there is none, or none over
            h.
        input_low, input_high: Of the accelerations, (K, n), 0 where there is none; (0, n) where none has one.
        soft: Which rows may be violated at a cost, (R,).
        node: Node that each row is of, (R,); -1 of rows that are of none.
        first: Low and high of x_0, which count where those of states are soft, (2, 2n); infinite where they are hard.
    """

    low: np.ndarray
    high: np.ndarray
    interval_low: np.ndarray
    interval_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    soft: np.ndarray
    node: np.ndarray
    first: np.ndarray


def fixed_bounds(form: VelocityForm, window: Window) -> WindowBounds:
    """Return the bounds that windows of one shape and limits share, those of durations and rows at nodes left open."""
    grid = form.grid
    stages = window.stages
    S = form.grid.switches
    low, high = node_limits(grid, stages)
    first = np.array([low[0], high[0]]) if window.soft else np.array([[-np.inf], [np.inf]]) * np.ones(low.shape[1])
    low, high = widened(low[1:], high[1:]) if window.soft else (low[1:], high[1:])
    of_window = np.full(2 * S + len(form.row_node), np.inf)  # durations, and rows at nodes
    lows = [low.ravel(), -of_window]
    highs = [high.ravel(), of_window]
    over_time = form.interval_row_is_over_time
    interval_low, interval_high = _over_h(*form.interval_bounds(window, None), lows, highs, over_time)
    inputs = acceleration_limits(grid, stages)
    if np.isfinite(inputs).any():
        input_low, input_high = _over_h(*inputs, lows, highs)
    else:
        input_low = np.zeros((0, grid.n))
        input_high = np.zeros((0, grid.n))
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
        node=nodes_of_rows(form, len(row_low)),
        first=first,
    )


def nodes_of_rows(form: VelocityForm, count: int) -> np.ndarray:
    """Return the node that each of so many rows is of, (R,); -1 of durations and of rows over intervals."""
    grid = form.grid
    states = 2 * grid.n * grid.K
    node = np.full(count, -1)
    node[:states] = np.repeat(np.arange(1, grid.K + 1), 2 * grid.n)
    node[states + 2 * grid.switches :][: len(form.row_node)] = form.row_node
    return node


def _over_h(
    low: np.ndarray,
    high: np.ndarray,
    lows: list[np.ndarray],
    highs: list[np.ndarray],
    is_over_time: np.ndarray | bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Append the bounds of the rows g - low h >= 0, then of g - high h <= 0, and return low and high, 0 where none.

    Rows that are not over time are bounded by low and high themselves, and have 0 over h. Where these are equal, the
    first row is an equation, and the second has no bounds.
    """
    none = np.full(low.size, np.inf)
    is_equation = np.equal(low, high) & ~np.broadcast_to(is_over_time, low.shape)
    low_over_h, high_over_h = (_finite(bound, is_over_time) for bound in (low, high))
    lows += [(low - low_over_h).ravel(), -none]
    highs += [
        np.where(is_equation.ravel(), high.ravel(), none),
        np.where(is_equation, np.inf, high - high_over_h).ravel(),
    ]
    return low_over_h, high_over_h


def _finite(bound: np.ndarray, is_over_time: np.ndarray | bool) -> np.ndarray:
    """Return bounds of rows over h; 0 where there is none, or none over h."""
    return np.where(np.isfinite(bound) & is_over_time, bound, 0.0)


def window_bounds(
    form: VelocityForm, shared: WindowBounds, window: Window, guess: Plan, tau: np.ndarray, within: float
) -> WindowBounds:
    """Return the bounds of a window about a guess, durations within so many seconds of guessed ones (S,) [s]."""
    S = len(tau)
    if any(constraint.over_intervals for stage in window.stages for constraint in stage.constraints.values()):
        over_time = form.interval_row_is_over_time
        interval_low, interval_high = (
            _finite(bound, over_time) for bound in form.interval_bounds(window, guess.switch_times)
        )
        shared = replace(shared, interval_low=interval_low, interval_high=interval_high)
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
        low[first + S : first + 2 * S] = [stage.end.earliest - window.start for stage in window.stages[:-1]]
        high[first + S : first + 2 * S] = [stage.end.latest - window.start for stage in window.stages[:-1]]
        high[first + 2 * S - 1] = min(high[first + 2 * S - 1], window.horizon - SHORTEST)
    return replace(shared, low=low, high=high)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A point of a window, with objective, constraints and violations there.

    Attributes:
        point: The point.
        at: Objective without the penalty of violations, and constraints.
        objective: With the penalty.
        rows: The rows with bounds, (R,).
        excess: By how much each of them is beyond its nearer bound, negative inside, (R,).
        violation: The largest of a gap, an end condition or a hard limit [m, rad, m/s, rad/s, s].
        shares: The share of time that each node stands for, (K + 1,) [s]; (0,) where no row is soft.
        penalties: rho times the violations of the soft rows, ascending.
    """

    point: Unknowns
    at: Residuals
    objective: float
    rows: np.ndarray
    excess: np.ndarray
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
        return len(self.form.lazy_rows) > 0 or len(self.form.row_interval) > 0

    @property
    def states(self) -> int:
        """Number of the rows of states, the first of all."""
        return 2 * self.form.grid.n * self.form.grid.K

    def with_dependent_rates(self, point: Unknowns) -> Unknowns:
        """Return a point with the rates that rows at nodes determine."""
        return self.form.with_dependent_rates(point, self.p)

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
        if not self.leaves_rows_out:
            return slice(None)
        first = self._first_interval_row
        count = len(self.form.row_interval)
        is_in = np.ones(len(self.bounds.low), bool)
        is_in[self._first_node_row : first + 2 * count] = False
        is_in[self._first_node_row + model.node_rows] = True
        if count:
            is_in[first + model.interval_rows] = True
            is_in[first + count + model.interval_rows] = True
        return np.flatnonzero(is_in)

    def _interval_rows_beyond(self, point: Unknowns, values: np.ndarray, share: float, excess: float) -> np.ndarray:
        """Return which rows over intervals (I,), of these values, exceed a share of their bounds by more than that.

        Only bounds over h have shares.
        """
        first = self._first_interval_row
        count = len(values)
        if not count:
            return np.zeros(0, int)
        h = self.form.steps(point, self.horizon)[self.form.row_interval, 0]
        low = share * self.bounds.interval_low * h + self.bounds.low[first : first + count]
        high = share * self.bounds.interval_high * h + self.bounds.high[first + count : first + 2 * count]
        return np.flatnonzero((values < low - excess) | (values > high + excess))

    def _node_rows_beyond(self, excess: np.ndarray, limit: np.ndarray | float) -> np.ndarray:
        """Return which rows at nodes that are not in all programs exceed their bounds, by `excess` (R,), by more."""
        return np.asarray(self.form.lazy_rows[excess[self._lazy_node_rows] > limit])

    @cached_property
    def _lazy_node_rows(self) -> np.ndarray:
        """Indices of the rows at nodes that are not in all programs."""
        return np.asarray(self._first_node_row + self.form.lazy_rows)

    def missed_rows(
        self, model: Linearization, reached: Evaluation, near: float = NEAR_BOUND
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows at nodes and those over intervals that a model does not have and a point violates, ascending.

        With them those that the point brings near their bounds, rows over intervals beyond the share `near` of them:
        one more program then is enough, most often.
        """
        of_nodes = np.zeros(0, int)
        of_intervals = np.zeros(0, int)
        if len(self.form.lazy_rows):
            violated = self._node_rows_beyond(reached.excess, FEASIBLE)
            if len(violated) and not mask(model.node_rows, len(reached.at.rows))[violated].all():
                of_nodes = self._node_rows_beyond(reached.excess, self.form.activation_excess)
        if len(self.form.row_interval):
            values = reached.at.interval_rows
            violated = self._interval_rows_beyond(reached.point, values, 1.0, FEASIBLE)
            if not mask(model.interval_rows, len(values))[violated].all():
                of_intervals = self._interval_rows_beyond(reached.point, values, near, 0.0)
        return of_nodes, of_intervals

    def with_rows(
        self, model: Linearization, point: Unknowns, of_nodes: np.ndarray, of_intervals: np.ndarray
    ) -> Linearization:
        """Return the model at a point with some more rows at nodes and over intervals."""
        model = self.form.with_node_rows(model, point, self.p, of_nodes)
        if not len(of_intervals):
            return model
        of_model = np.union1d(model.interval_rows, of_intervals)
        derivatives = self.form.interval_jacobian(point, self.p, of_model)
        return replace(model, interval_rows=of_model, interval_rows_by=derivatives)

    def rows(self, point: Unknowns, at: Residuals, h: np.ndarray) -> np.ndarray:
        """Return the rows at a point whose intervals have the lengths h (K, 1) [s], (R,)."""
        rows = [point.X[1:].ravel(), point.tau, point.tau.cumsum(), at.rows]
        if len(self.form.row_interval):
            h_of_rows = h[self.form.row_interval, 0]
            rows += [
                at.interval_rows - h_of_rows * bound for bound in (self.bounds.interval_low, self.bounds.interval_high)
            ]
        if len(self.bounds.input_low):
            dv = point.changes[:, self.form.grid.n :]
            rows += [(dv - h * bound).ravel() for bound in (self.bounds.input_low, self.bounds.input_high)]
        return np.concatenate(rows)

    def evaluation(self, point: Unknowns) -> Evaluation:
        """Evaluate the window at a point."""
        return self.evaluated(point, self.form.residuals(point, self.p))

    def evaluated(self, point: Unknowns, at: Residuals) -> Evaluation:
        """Return the evaluation of a point with these residuals.

        The violation is in natural units, m, rad, m/s, rad/s, s. A limit on an acceleration counts by the velocity it
        costs in its interval.
        """
        h = self.form.steps(point, self.horizon)
        rows = self.rows(point, at, h)
        excess = self._excess(rows)
        violation = float(np.maximum(np.abs(at.gaps).max(), excess[self._hard_rows].max(initial=0.0)))
        if not len(self._soft_rows):
            return Evaluation(point, at, at.objective, rows, excess, violation, np.zeros(0), np.zeros(0))
        shares = shares_of_time(h)[:, 0]
        penalties = self._soft_penalties(excess)
        penalty = float(shares[self._soft_node] @ penalties + shares[0] * self._penalty_of_first)
        return Evaluation(point, at, at.objective + penalty, rows, excess, violation, shares, penalties)

    def _excess(self, rows: np.ndarray) -> np.ndarray:
        """Return by how much rows (R,) with these values are beyond their nearer bounds, negative inside."""
        return np.asarray(np.maximum(self.bounds.low - rows, rows - self.bounds.high))

    @cached_property
    def _hard_rows(self) -> np.ndarray:
        """Indices of the rows that must not be violated."""
        return np.flatnonzero(~self.bounds.soft)

    @cached_property
    def _soft_rows(self) -> np.ndarray:
        """Indices of the rows that may be violated at a cost."""
        return np.flatnonzero(self.bounds.soft)

    @cached_property
    def _soft_node(self) -> np.ndarray:
        """Nodes of the soft rows, which are of states or of constraints at nodes."""
        return np.asarray(self.bounds.node[self._soft_rows])

    def _soft_penalties(self, excess: np.ndarray) -> np.ndarray:
        """Return rho times the violations of the soft ones of rows (R,) that exceed their bounds by so much."""
        return np.asarray(PENALTY * np.maximum(excess[self._soft_rows], 0.0))

    @cached_property
    def _penalty_of_first(self) -> float:
        """The sum of rho times the violations of x_0; 0 where the rows of states, the first of all, are hard."""
        if not self.bounds.soft[0]:
            return 0.0
        return float(scaled_violations(self.p.x0, *self.bounds.first).sum())

    def state_violations(self, point: Unknowns) -> np.ndarray:
        """Return by how much nodes violate limits of states at worst, (2n,) [m, rad, m/s, rad/s]."""
        low = self.bounds.low[: self.states].reshape(point.X[1:].shape)
        high = self.bounds.high[: self.states].reshape(point.X[1:].shape)
        return np.asarray(scaled_violations(point.X[1:], low, high).max(axis=0) / PENALTY)

    def keeps_soft_limits(self, reached: Evaluation) -> bool:
        """Tell whether soft limits are violated no further than the measured state violates them."""
        form = self.form
        x0 = reached.point.X[0]
        initial = np.zeros(len(reached.rows))
        initial[: self.states] = np.tile(scaled_violations(x0, *self.bounds.first), form.grid.K)
        at_first = np.where(np.isfinite(reached.rows), reached.rows, 0.0)
        at_first[self._first_node_row :][: len(form.row_node)] = form.rows_at(x0, self.p)
        initial[self.states :] = scaled_violations(at_first, self.bounds.low, self.bounds.high)[self.states :]
        excess = reached.penalties - initial[self._soft_rows]
        return bool((excess <= PENALTY * FEASIBLE).all())

    def row_penalties(self, here: Evaluation, which: np.ndarray | slice) -> np.ndarray:
        """Return what a unit of violation of some rows costs, 0 of hard ones."""
        is_soft = self.bounds.soft[which]
        if not len(self._soft_rows):
            return np.zeros(len(is_soft))
        return np.where(is_soft, PENALTY * here.shares[self.bounds.node[which]], 0.0)

    def linearize(self, point: Unknowns, before: Linearization | None = None) -> tuple[Evaluation, Linearization]:
        """Return the evaluation of a point, and the model there, violations weighted with the durations they last.

        What a step changes of the violations is left to the program, which knows it exactly. Of the rows over
        intervals it has those that are near their bounds, and those that the model `before` had: what one iterate
        misses, the next one would miss again. Of rows at nodes it has those near their bounds where these say so.
        """
        model = self.form.linearize(point, self.p)
        here = self.evaluated(point, model.at)
        if self.leaves_rows_out:
            of_nodes = self._node_rows_beyond(here.excess, self.form.activation_excess)
            of_intervals = self._interval_rows_beyond(point, model.at.interval_rows, NEAR_BOUND, 0.0)
            if before is not None:
                of_intervals = np.union1d(of_intervals, before.interval_rows)
            model = self.with_rows(model, point, of_nodes, of_intervals)
        if not (len(self._soft_rows) and len(point.tau)):
            return here, model
        node_shares = self.form.node_shares
        by_tau = here.penalties @ node_shares[self._soft_node] + self._penalty_of_first * node_shares[0]
        return here, replace(model, gradient_tau=model.gradient_tau + by_tau)

    def foreseen(self, here: Evaluation, model: Linearization, step: Unknowns) -> np.ndarray:
        """Return the values of the rows (R,) that the model at a point has after a step.

        Of rows that the model does not have, and of those of durations and accelerations, it is their value at the
        point.
        """
        rows = here.rows.copy()
        rows[: self.states] += step.X[1:].ravel()
        node = self.form.row_node[model.node_rows]
        rows[self._first_node_row + model.node_rows] += (model.rows_by_x * step.X[node]).sum(axis=1)
        which = model.interval_rows
        if len(which):
            k = self.form.row_interval[which]
            change = self.form.row_change(model, step)
            h = self.form.interval_steps[k] @ step.tau
            first = self._first_interval_row
            rows[first + which] += change - h * self.bounds.interval_low[which]
            first += len(self.form.row_interval)
            rows[first + which] += change - h * self.bounds.interval_high[which]
        return rows

    def corrected(
        self, here: Evaluation, model: Linearization, step: Unknowns, reached: Evaluation
    ) -> tuple[Evaluation, Linearization]:
        """Return a point and a model whose program has the step nearest to one that meets the constraints after it.

        With c the rows and gaps and A their derivatives at the point x, the program has c(x + d) - A d in place of
        c(x), so that its step meets the constraints to the third order of d, not to the second, and for its objective
        the square of its distance from d: with that of the window it would go far along flat directions, where rows are
        curved in other ways.

        Source: Waechter, Biegler: On the implementation of an interior-point filter line-search algorithm for
        large-scale nonlinear programming (2006), section 2.4; Fletcher: Second order corrections for
        non-differentiable optimization (1982).
        """
        n = self.form.grid.n
        rows = here.rows.copy()
        curved = slice(self._first_node_row, self._first_interval_row + 2 * len(self.form.row_interval))
        rows[curved] += (reached.rows - self.foreseen(here, model, step))[curved]
        before, after = np.hsplit(model.gap_velocity, 2)
        foreseen_gaps = step.changes[:, :n] + before * step.X[:-1, n:] + after * step.X[1:, n:]
        gaps = reached.at.gaps - foreseen_gaps - model.gap_tau @ step.tau
        gradient = np.zeros_like(model.gradient)
        gradient[:, :n] = -step.X[:, :n]
        gradient[1:, n:] -= step.changes[:, n:]
        gradient[:-1, n:] += step.changes[:, n:]
        nearest = replace(
            model,
            at=replace(model.at, gaps=gaps),
            gradient=gradient,
            gradient_tau=-step.tau,
            H_QQ=np.broadcast_to(np.eye(n), model.H_QQ.shape),
            H_vv=-np.ones_like(model.H_vv),
            H_x_tau=np.zeros_like(model.H_x_tau),
            H_tau_tau=np.eye(len(step.tau)),
        )
        return replace(here, rows=rows), nearest

    def unpredicted_violation(
        self, here: Evaluation, foreseen: np.ndarray, step_length: float, reached: Evaluation
    ) -> float:
        """Return the largest violation of soft rows at nodes beyond the model's prediction after a step.

        Args:
            here: Where the step begins.
            foreseen: Values of the rows (R,) after the full step.
            step_length: Fraction of the step that was taken.
            reached: The point there.
        """
        if not self.form.has_soft_rows:
            return 0.0
        violated = self._soft_rows[reached.penalties > 0]
        violated = violated[violated >= self.states]
        before = here.rows[violated]
        after = before + step_length * (foreseen[violated] - before)
        excess = np.maximum(self.bounds.low[violated] - after, after - self.bounds.high[violated])
        return float((reached.excess[violated] - np.maximum(excess, 0.0)).max(initial=0.0))

    def change_of_penalty(self, here: Evaluation, foreseen: np.ndarray) -> float:
        """Return what the penalty at foreseen values of the rows is more than at a point."""
        if not len(self._soft_rows):
            return 0.0
        penalties = self._soft_penalties(self._excess(foreseen))
        return float(here.shares[self._soft_node] @ (penalties - here.penalties))
