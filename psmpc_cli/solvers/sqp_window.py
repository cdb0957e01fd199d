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
    """Return the bounds of rows that all windows of one shape with the same limits share.

    They are made once; `window_bounds` completes them for each window. The rows stand in this order: states, durations
    of stages, sums of durations, rows at nodes, rows g over intervals as g - low h, then as g - high h, h being the
    length of the interval, and accelerations as dv - low h, then as dv - high h. Durations, sums and rows at nodes are
    left without bounds here (infinite).

    Args:
        form: The velocity form of the windows of this shape.
        window: Any of these windows.
    """
    grid = form.grid
    stages = window.stages
    S = form.grid.switches
    state_count = 2 * grid.n * grid.K
    node_low, node_high = node_limits(grid, stages)
    first = np.array([[-np.inf], [np.inf]]) * np.ones(2 * grid.n)  # of x_0, which is measured
    state_low = node_low[1:]
    state_high = node_high[1:]
    if window.soft:
        first = np.array([node_low[0], node_high[0]])
        state_low, state_high = widened(state_low, state_high)
    left_open = np.full(2 * S + len(form.row_node), np.inf)
    lows = [state_low.ravel(), -left_open]
    highs = [state_high.ravel(), left_open]
    is_over_time = form.interval_row_is_over_time
    interval_low, interval_high = _append_over_h(*form.interval_bounds(window, None), lows, highs, is_over_time)
    inputs = acceleration_limits(grid, stages)
    if np.isfinite(inputs).any():
        input_low, input_high = _append_over_h(*inputs, lows, highs)
    else:
        input_low = np.zeros((0, grid.n))
        input_high = np.zeros((0, grid.n))
    row_low = np.concatenate(lows)
    soft = np.zeros(len(row_low), bool)
    soft[:state_count] = window.soft
    soft[state_count + 2 * S :][: len(form.row_node)] = form.row_is_soft
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


def _append_over_h(
    low: np.ndarray,
    high: np.ndarray,
    lows: list[np.ndarray],
    highs: list[np.ndarray],
    is_over_time: np.ndarray | bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Append the bounds of rows g with low h <= g <= high h, as two rows each: g - low h >= 0 and g - high h <= 0.

    h is the length of the row's interval and an unknown of the programs, so that a bound over h is not a number: it
    moves into the row. Rows that are not over time have bounds low and high that are numbers, and stay: for these
    low h and high h are 0 in the rows. Where such bounds are equal, the first row is an equation and the second has
    no bounds.

    Args:
        low: Lower bounds over h, or themselves; infinite where there is none. Of any shape, M in all.
        high: Upper bounds alike.
        lows: Lower bounds of all rows so far, an array for each group: those of g - low h (M,) are appended, then those
            of g - high h (M,).
        highs: Upper bounds alike.
        is_over_time: Which bounds are over h, broadcasts to their shape.

    Returns:
        What is multiplied with h in the rows: low and high, 0 where there is no bound, or none over h.
    """
    no_bound = np.full(low.size, np.inf)
    is_equation = np.equal(low, high) & ~np.broadcast_to(is_over_time, low.shape)
    low_over_h = _bounds_over_h(low, is_over_time)
    high_over_h = _bounds_over_h(high, is_over_time)
    # Rows g - low h: bounded below; rows g - high h: bounded above. The difference is 0 where the bound is over h.
    lows += [(low - low_over_h).ravel(), -no_bound]
    highs += [
        np.where(is_equation.ravel(), high.ravel(), no_bound),
        np.where(is_equation, np.inf, high - high_over_h).ravel(),
    ]
    return low_over_h, high_over_h


def _bounds_over_h(bound: np.ndarray, is_over_time: np.ndarray | bool) -> np.ndarray:
    """Return bounds of rows over h; 0 where there is none, or none over h."""
    return np.where(np.isfinite(bound) & is_over_time, bound, 0.0)


def window_bounds(
    form: VelocityForm, shared: WindowBounds, window: Window, guess: Plan, tau: np.ndarray, within: float
) -> WindowBounds:
    """Return the bounds of all rows of one window, from those that windows of its shape share.

    Set here are the bounds that differ from window to window: of velocities, whose limits depend on the chart about the
    guess, of rows at nodes, of durations and of switch times.

    Args:
        form: The velocity form of windows of this shape.
        shared: What `fixed_bounds` returned for it.
        window: The window.
        guess: The guessed plan.
        tau: Durations of the guess, of all stages but the last, (S,) [s].
        within: Durations stay within so many seconds of these.
    """
    S = len(tau)
    if any(constraint.over_intervals for stage in window.stages for constraint in stage.constraints.values()):
        interval_low, interval_high = form.interval_bounds(window, guess.switch_times)
        shared = replace(
            shared,
            interval_low=_bounds_over_h(interval_low, form.interval_row_is_over_time),
            interval_high=_bounds_over_h(interval_high, form.interval_row_is_over_time),
        )
    low = shared.low.copy()
    high = shared.high.copy()
    # Rows stand in this order: states, durations, their sums (the switch times from the window's start), rows at nodes.
    state_count = len(window.x0) * window.K
    of_states = slice(state_count)
    of_durations = slice(state_count, state_count + S)
    of_switches = slice(state_count + S, state_count + 2 * S)
    of_node_rows = slice(state_count + 2 * S, state_count + 2 * S + len(form.row_node))
    nodes_by_states = (window.K, len(window.x0))
    shift_limits(window, guess, low[of_states].reshape(nodes_by_states), high[of_states].reshape(nodes_by_states))
    if form.node_rows:
        low[of_node_rows], high[of_node_rows] = form.row_bounds(window)
    low[of_durations] = np.maximum(shortest_durations(window)[:-1], tau - within)
    high[of_durations] = tau + within
    if S:
        low[of_switches] = [stage.end.earliest - window.start for stage in window.stages[:-1]]
        latest_switches = np.array([stage.end.latest - window.start for stage in window.stages[:-1]])
        latest_switches[-1] = min(latest_switches[-1], window.horizon - SHORTEST)  # the last stage has some time left
        high[of_switches] = latest_switches
    return replace(shared, low=low, high=high)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A point of a window, with objective, constraints and violations there.

    Attributes:
        point: The point.
        residuals: Objective without the penalty of violations, and constraints.
        objective: With the penalty.
        rows: The rows with bounds, (R,).
        excess: By how much each of them is beyond its nearer bound, negative inside, (R,).
        violation: The largest of a gap, an end condition or a hard limit [m, rad, m/s, rad/s, s].
        shares: The share of time that each node stands for, (K + 1,) [s]; (0,) where no row is soft.
        penalties: rho times the violations of the soft rows, ascending.
    """

    point: Unknowns
    residuals: Residuals
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
        """Return which rows the program of a model left out although the point that its step leads to violates them.

        Not all rows are in every program, only those near their bounds. If some row left out is violated, all left-out
        rows that are near their bounds at the new point are returned too, so that one more program is enough, most
        often.

        Args:
            model: The model, with the indices of the rows that it has.
            reached: The point after its full step.
            near: Rows over intervals count as near from this fraction of their bounds on; smaller: more rows.

        Returns:
            Indices of rows at nodes, and of rows over intervals, ascending; both empty where nothing was missed.
        """
        missed_node_rows = np.zeros(0, int)
        missed_interval_rows = np.zeros(0, int)
        if len(self.form.lazy_rows):
            violated = self._node_rows_beyond(reached.excess, FEASIBLE)
            is_in_model = mask(model.node_rows, len(reached.residuals.rows))
            if not is_in_model[violated].all():
                missed_node_rows = self._node_rows_beyond(reached.excess, self.form.activation_excess)
        if len(self.form.row_interval):
            values = reached.residuals.interval_rows
            violated = self._interval_rows_beyond(reached.point, values, 1.0, FEASIBLE)
            is_in_model = mask(model.interval_rows, len(values))
            if not is_in_model[violated].all():
                missed_interval_rows = self._interval_rows_beyond(reached.point, values, near, 0.0)
        return missed_node_rows, missed_interval_rows

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

    def rows(self, point: Unknowns, residuals: Residuals, h: np.ndarray) -> np.ndarray:
        """Return the values (R,) of all rows at a point whose intervals have the lengths h (K, 1) [s]."""
        rows = [point.X[1:].ravel(), point.tau, point.tau.cumsum(), residuals.rows]
        if len(self.form.row_interval):
            h_of_rows = h[self.form.row_interval, 0]
            for bound in (self.bounds.interval_low, self.bounds.interval_high):
                rows.append(residuals.interval_rows - h_of_rows * bound)
        if len(self.bounds.input_low):
            dv = point.changes[:, self.form.grid.n :]
            rows += [(dv - h * bound).ravel() for bound in (self.bounds.input_low, self.bounds.input_high)]
        return np.concatenate(rows)

    def evaluation(self, point: Unknowns) -> Evaluation:
        """Evaluate the window at a point."""
        return self.evaluated(point, self.form.residuals(point, self.p))

    def evaluated(self, point: Unknowns, residuals: Residuals) -> Evaluation:
        """Return a point with all that the line search compares: objective with penalties, values of rows, violations.

        The violation is the largest of all gaps, defects of the motion over an interval, and hard rows, each in its own
        unit: m, rad, m/s, rad/s or s. A limit on an acceleration counts by the change of velocity over its interval.

        Args:
            point: The point.
            residuals: Objective and constraints there.
        """
        h = self.form.steps(point, self.horizon)
        rows = self.rows(point, residuals, h)
        excess = self._excess(rows)
        violation = float(np.maximum(np.abs(residuals.gaps).max(), excess[self._hard_rows].max(initial=0.0)))
        objective = residuals.objective
        shares = np.zeros(0)
        penalties = np.zeros(0)
        if len(self._soft_rows):
            # A soft row costs rho times its violation, for as long as its node stands for.
            shares = shares_of_time(h)[:, 0]
            penalties = self._soft_penalties(excess)
            objective += float(shares[self._soft_node] @ penalties + shares[0] * self._penalty_of_first)
        return Evaluation(
            point=point,
            residuals=residuals,
            objective=objective,
            rows=rows,
            excess=excess,
            violation=violation,
            shares=shares,
            penalties=penalties,
        )

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
        """Return the evaluation of a point, and the quadratic model there whose step the iteration takes.

        Of the many rows over intervals and lazy rows at nodes (distances) it has those that are near their bounds, and
        of rows over intervals also those that the model before had: what one iterate misses, the next one would miss
        again. Violations of soft rows cost rho times the time that they last, so durations change that cost: this is
        added to the gradient. How steps change the violations themselves is in the programs exactly.

        Args:
            point: The point.
            before: The model of the iterate before, if there is one.
        """
        model = self.form.linearize(point, self.p)
        here = self.evaluated(point, model.residuals)
        if self.leaves_rows_out:
            near_node_rows = self._node_rows_beyond(here.excess, self.form.activation_excess)
            near_interval_rows = self._interval_rows_beyond(point, model.residuals.interval_rows, NEAR_BOUND, 0.0)
            if before is not None:
                near_interval_rows = np.union1d(near_interval_rows, before.interval_rows)
            model = self.with_rows(model, point, near_node_rows, near_interval_rows)
        if len(self._soft_rows) and len(point.tau):
            share_by_tau = self.form.node_shares  # derivative of each node's share of time, (K + 1, S)
            penalty_by_tau = here.penalties @ share_by_tau[self._soft_node] + self._penalty_of_first * share_by_tau[0]
            model = replace(model, gradient_tau=model.gradient_tau + penalty_by_tau)
        return here, model

    def predicted_rows(self, here: Evaluation, model: Linearization, step: Unknowns) -> np.ndarray:
        """Return the values (R,) of all rows that the model at a point predicts after a full step.

        Rows that the model does not have, and those of durations and accelerations, keep their values at the point.

        Args:
            here: The point, with the values of its rows.
            model: The model there, with derivatives of the rows that it has.
            step: The step.
        """
        rows = here.rows.copy()
        rows[: self.states] += step.X[1:].ravel()
        node = self.form.row_node[model.node_rows]
        rows[self._first_node_row + model.node_rows] += (model.rows_by_x * step.X[node]).sum(axis=1)
        in_model = model.interval_rows
        if len(in_model):
            change = self.form.row_change(model, step)
            # A row over an interval stands twice, less its lower and less its upper bound times h.
            change_of_h = self.form.interval_steps[self.form.row_interval[in_model]] @ step.tau
            less_low = self._first_interval_row + in_model
            less_high = less_low + len(self.form.row_interval)
            rows[less_low] += change - change_of_h * self.bounds.interval_low[in_model]
            rows[less_high] += change - change_of_h * self.bounds.interval_high[in_model]
        return rows

    def corrected(
        self, here: Evaluation, model: Linearization, step: Unknowns, reached: Evaluation
    ) -> tuple[Evaluation, Linearization]:
        """Return point and model whose quadratic program gives a second-order correction of a step.

        A step that meets linearized constraints leaves the constraints themselves by their curvature; the corrected one
        nearly does not.

        With c the rows and gaps, A their derivatives at the point x, and d the step, the program has c(x + d) - A d in
        place of c(x), so that its step meets the constraints to the third order of d, not to the second. Its objective
        is the squared distance from d: with that of the window it would go far along flat directions, where rows are
        curved in other ways.

        Args:
            here: The point x, with the values of its rows.
            model: The model there.
            step: The full step d of its program.
            reached: The point x + d.

        Source: Waechter, Biegler: On the implementation of an interior-point filter line-search algorithm for
        large-scale nonlinear programming (2006), section 2.4; Fletcher: Second order corrections for
        non-differentiable optimization (1982).
        """
        n = self.form.grid.n
        rows = here.rows.copy()
        curved = slice(self._first_node_row, self._first_interval_row + 2 * len(self.form.row_interval))
        rows[curved] += (reached.rows - self.predicted_rows(here, model, step))[curved]
        by_v, by_v_next = np.hsplit(model.gap_velocity, 2)
        gap_change_by_states = step.changes[:, :n] + by_v * step.X[:-1, n:] + by_v_next * step.X[1:, n:]
        gaps = reached.residuals.gaps - gap_change_by_states - model.gap_tau @ step.tau
        # The squared distance from d, half of it: of positions, of changes of velocity, and of durations.
        gradient = np.zeros_like(model.gradient)
        gradient[:, :n] = -step.X[:, :n]
        gradient[1:, n:] -= step.changes[:, n:]
        gradient[:-1, n:] += step.changes[:, n:]
        nearest = replace(
            model,
            residuals=replace(model.residuals, gaps=gaps),
            gradient=gradient,
            gradient_tau=-step.tau,
            H_QQ=np.broadcast_to(np.eye(n), model.H_QQ.shape),
            H_vv=-np.ones_like(model.H_vv),
            H_x_tau=np.zeros_like(model.H_x_tau),
            H_tau_tau=np.eye(len(step.tau)),
        )
        return replace(here, rows=rows), nearest

    def unpredicted_violation(
        self, here: Evaluation, predicted_rows: np.ndarray, step_length: float, reached: Evaluation
    ) -> float:
        """Return how much further than predicted a step violates soft rows at nodes, at worst: how wrong the model was.

        Args:
            here: Where the step begins.
            predicted_rows: Values (R,) that the model predicts for the rows after the full step.
            step_length: Fraction of the step that was taken.
            reached: The point after it.

        Returns:
            The largest violation beyond its prediction [m, rad, m/s, rad/s]; 0 where no row is soft.
        """
        if not self.form.has_soft_rows:
            return 0.0
        violated = self._soft_rows[reached.penalties > 0]
        violated = violated[violated >= self.states]  # rows of states are linear: the model is right about them
        before = here.rows[violated]
        predicted = before + step_length * (predicted_rows[violated] - before)
        predicted_excess = np.maximum(self.bounds.low[violated] - predicted, predicted - self.bounds.high[violated])
        return float((reached.excess[violated] - np.maximum(predicted_excess, 0.0)).max(initial=0.0))

    def change_of_penalty(self, here: Evaluation, predicted_rows: np.ndarray) -> float:
        """Return by how much the penalty of soft rows rises from a point to predicted values of the rows, (R,)."""
        if not len(self._soft_rows):
            return 0.0
        penalties = self._soft_penalties(self._excess(predicted_rows))
        return float(here.shares[self._soft_node] @ (penalties - here.penalties))
