"""A window in the velocities, and its Gauss-Newton model: what a step of sequential quadratic programming minimizes.

Under joint input and a constant acceleration over each interval, `u = (Qdot+ - Qdot) / h` with h = tau_s / N_s, and of
(8) one bilinear row a coordinate is left, `Q+ - Q = h (Qdot + Qdot+) / 2` (explicit Euler: `h Qdot`). The unknowns are
Q and Qdot at the nodes and the durations: two thirds of the NLP's variables, and the same optimum.

The cost of the states is the square of a residual that carries `sqrt(omega_s tau_s / N_s / scale_s)`, so that the
durations enter it, and has the Gauss-Newton Hessian. The cost of the control, `|dQdot|^2 N_s / tau_s`, is convex in
velocities and duration together and has its exact one; the pending cost is linear. So the Hessian is positive
semidefinite. End conditions about poses are curved, see `VelocityForm.curved`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from psmpc_cli.ocp.constraints import IntervalRows, interval_rows, node_rows
from psmpc_cli.ocp.constraints.base import is_entry_of
from psmpc_cli.ocp.constraints.boxes import shares_of_time
from psmpc_cli.ocp.objective import ChangeFunctions, Intervals, force_residual, rate_residual, stage_functions
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.stage import cost_shape
from psmpc_cli.ocp.window import Parameters, Window, WindowShape, reference
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.motion import velocity_shares


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The unknowns of the velocity form, or a step of them: states x_k (K + 1, 2n) and free durations (S,) [s]."""

    X: np.ndarray
    tau: np.ndarray

    @cached_property
    def changes(self) -> np.ndarray:
        """x_k+1 - x_k, (K, 2n)."""
        return np.asarray(self.X[1:] - self.X[:-1])

    def moved(self, by: "Unknowns", step_length: float) -> "Unknowns":
        """Return the unknowns after a step of a length, 1 being the full one."""
        return Unknowns(self.X + step_length * by.X, self.tau + step_length * by.tau)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Objective and constraints at a point.

    Attributes:
        objective: J over the window's largest priority.
        costs: Normalized cost integral of each stage, without priorities, (S + 1,). Paper eq. (16).
        terminal: Normalized terminal cost of the last stage, times kappa.
        gaps: Q+ - Q - h (Qdot + Qdot+) / 2 by interval, (K, n).
        rows: Those of the constraints at nodes, by ascending nodes, (E,).
        interval_rows: Those of the constraints over intervals, by ascending intervals, (I,).
    """

    objective: float
    costs: np.ndarray
    terminal: float
    gaps: np.ndarray
    rows: np.ndarray
    interval_rows: np.ndarray


@dataclass(frozen=True, eq=False)
class Linearization:
    """Quadratic model at a point; derivatives by x_k and the free durations.

    Attributes:
        residuals: Objective and constraints there.
        gradient, gradient_tau: (K + 1, 2n), (S,).
        H_QQ: Upper triangle of the Hessian by Q_k, (K + 1, n, n).
        H_vv: Its diagonal by (Qdot_k, Qdot_k+1), (K, n): it is that of squares of Qdot_k+1 - Qdot_k.
        H_x_tau: By x_k and tau, (K + 1, 2n, S).
        H_tau_tau: By tau, (S, S).
        gap_velocity: Of the gaps by Qdot_k and Qdot_k+1, one number an interval, (K, 2).
        gap_tau: By tau, (K, n, S).
        node_rows: Which rows at nodes the model has, ascending, (F,).
        rows_by_x: Their derivatives by x there, (F, 2n).
        interval_rows: Which rows over intervals the model has, ascending, (J,); see `VelocityForm.interval_jacobian`.
        interval_rows_by: Their derivatives by x at both ends, tau, and the velocities where the interval before begins,
            (J, 4n + S + history); see `VelocityForm.history`.
    """

    residuals: Residuals
    gradient: np.ndarray
    gradient_tau: np.ndarray
    H_QQ: np.ndarray
    H_vv: np.ndarray
    H_x_tau: np.ndarray
    H_tau_tau: np.ndarray
    gap_velocity: np.ndarray
    gap_tau: np.ndarray
    node_rows: np.ndarray
    rows_by_x: np.ndarray
    interval_rows: np.ndarray
    interval_rows_by: np.ndarray


class VelocityForm:
    """The windows of one shape in the velocities.

    Attributes:
        grid: Intervals of the stages.
        costs: What the costs of the stages are made of.
        node_rows: The constraints at nodes.
        interval_rows: The constraints over intervals.
        nodes: N_s of each stage, (S + 1,).
        weights: Share of the velocity at either end of an interval in the change of position.
        row_node: Node of each row of these, ascending, (E,): rows are ordered by node, then as in `node_rows`.
        row_is_soft: Which of them may be violated at a cost, (E,).
        has_soft_rows: Whether any of them may.
        activation_distance: Distance from its bounds up to which a row is part of a program, (E,); infinite: always.
        permanent_rows, lazy_rows: Which of them are part of every program, and which only near their bounds, ascending.
        row_interval: Interval of each row over intervals, in an order alike, (I,).
        interval_row_is_over_time: Which of them have bounds of the rows over h, (I,).
        history: n where rows over intervals depend on the acceleration of the interval before, and so on the velocities
            where that begins; else 0.
        residuals_are_curved: The curvature of residuals counts: that of a robot without thrusters.
        curved: Programs have curvature besides that of the Gauss-Newton model, see `with_curvature`.
    """

    def __init__(self, model: RobotModel, shape: WindowShape) -> None:
        """Collect what costs and constrains the windows of a shape, and in which order its rows stand.

        Rows at nodes are constraints at single states. Rows over intervals depend on the states at both ends; some are
        no constraints but residuals, whose squares cost (forces, changes of acceleration).

        Args:
            model: The robot.
            shape: The structure of the windows: stages, numbers of intervals, which constraints there are.
        """
        # `stage_functions`, `node_rows` and `interval_rows` are built once for a robot and a shape.
        self.grid = Grid(model.n, shape.nodes)
        self.costs = [stage_functions(model, cost_shape(stage)) for stage in shape.stages]
        self.node_rows = node_rows(model, shape)
        self.interval_rows = [*interval_rows(model, shape), *_force_rows(model, shape), *_rate_rows(model, shape)]
        # Rows about changes of the acceleration also depend on the velocities where the interval before begins.
        self.history = model.n if shape.has_rates else 0
        self.nodes = np.array(shape.nodes)
        self.weights = velocity_shares(shape.discretization)
        self._index_node_rows()
        self._index_interval_rows()
        # Rows at nodes that determine some velocities by the others, with derivatives by these: `with_dependent_rates`.
        self._rows_with_dependent_rates = [
            (rows, rows.functions.solved_for, rows.functions.by_solved_for)
            for rows in self.node_rows
            if rows.functions.solved_for is not None and rows.functions.by_solved_for is not None
        ]
        # Rows that say that something (a momentum) does not change from one node to the next.
        self._change_rows = [
            (rows.functions, rows) for rows in self.interval_rows if isinstance(rows.functions, ChangeFunctions)
        ]
        # A base that nothing pushes, or that a mount holds.
        self.residuals_are_curved = any(
            is_entry_of("mobility", name) or is_entry_of("mount", name)
            for stage in shape.stages
            for name, _ in stage.constraints
        )
        rows_are_curved = any(rows.functions.curvature is not None for rows in self.node_rows)
        self.curved = rows_are_curved or self.residuals_are_curved

    def _index_node_rows(self) -> None:
        """Number the rows of all constraints at nodes in the order of the quadratic programs, and index them.

        A constraint gives its rows together, `count` rows at each of its nodes. In the programs all E rows are ordered
        by node. This sets the arrays that lead from one order to the other, and, for each of the E rows, its node, its
        constraint, at which of that one's nodes and as which of its rows there it stands, and whether it is soft.
        """
        constraints = self.node_rows
        # Node of each row (E,); and by constraint the numbers of its rows in the order of the programs.
        self._nodes_of_rows = [np.array(rows.nodes) for rows in constraints]
        self.row_node, self._places = _order_rows([np.repeat(rows.nodes, rows.functions.count) for rows in constraints])
        # The inverse: where row by row of the programs stands if constraints follow each other.
        self._node_order = np.argsort(np.concatenate([np.zeros(0, int), *self._places]))
        row_count = len(self.row_node)
        self.row_is_soft = np.zeros(row_count, bool)
        self.activation_distance = np.full(row_count, np.inf)
        self._row_constraint = np.zeros(row_count, int)  # which of `node_rows` has the row,
        self._row_place = np.zeros(row_count, int)  # at which of its nodes,
        self._row_number = np.zeros(row_count, int)  # and which of its rows there it is
        for i, (rows, places) in enumerate(zip(constraints, self._places, strict=True)):
            places_by_node = places.reshape(len(rows.nodes), rows.functions.count)
            self.row_is_soft[places] = rows.soft
            self.activation_distance[places] = rows.activation_distance
            self._row_constraint[places] = i
            self._row_place[places_by_node] = np.arange(len(rows.nodes))[:, None]
            self._row_number[places_by_node] = np.arange(rows.functions.count)
        # Bounds are the same at all nodes of a constraint, and come as (count,) of each constraint.
        first_bounds = np.cumsum([0, *(rows.functions.count for rows in constraints)])
        self._bound_of_row = first_bounds[self._row_constraint] + self._row_number
        self.has_soft_rows = bool(self.row_is_soft.any())
        self.permanent_rows = np.flatnonzero(np.isinf(self.activation_distance))
        self.lazy_rows = np.flatnonzero(np.isfinite(self.activation_distance))

    def _index_interval_rows(self) -> None:
        """Order the rows over intervals by interval, and note which of them have bounds over h."""
        self.row_interval, self._interval_places = _order_rows(
            [np.repeat(rows.intervals, rows.functions.count) for rows in self.interval_rows]
        )
        self.interval_row_is_over_time = np.ones(len(self.row_interval), bool)
        for rows, places in zip(self.interval_rows, self._interval_places, strict=True):
            self.interval_row_is_over_time[places] = rows.over_time
        self.permanent_interval_rows = self._permanent_interval_rows()

    @cached_property
    def stage_durations(self) -> np.ndarray:
        """Derivative of the durations of all stages by the free ones, (S + 1, S): the last stage takes what is left."""
        S = self.grid.switches
        return np.vstack([np.eye(S), -np.ones((1, S))])

    @cached_property
    def interval_steps(self) -> np.ndarray:
        """Derivative of h of each interval by the free durations, (K, S)."""
        return np.asarray((self.stage_durations / self.nodes[:, None])[self.grid.stage_of])

    @cached_property
    def node_shares(self) -> np.ndarray:
        """Derivative of the share of time that each node stands for by the free durations, (K + 1, S)."""
        return shares_of_time(self.interval_steps)

    @cached_property
    def activation_excess(self) -> np.ndarray:
        """Excess over its nearer bound above which each of `lazy_rows` is part of a program, negative."""
        return np.asarray(-self.activation_distance[self.lazy_rows])

    @cached_property
    def waiting(self) -> np.ndarray:
        """Number of stages that wait while each free duration runs, (S,)."""
        return np.arange(self.grid.switches, 0, -1, dtype=float)

    def intervals(self, s: int) -> slice:
        """Return the intervals of a stage; they begin at nodes of the same numbers."""
        return slice(self.grid.first_node[s], self.grid.first_node[s + 1])

    def durations(self, point: Unknowns, horizon: float) -> np.ndarray:
        """Return tau_s of all stages, (S + 1,) [s]."""
        durations = np.empty(len(point.tau) + 1)
        durations[:-1] = point.tau
        durations[-1] = horizon - point.tau.sum()
        return durations

    def steps(self, point: Unknowns, horizon: float) -> np.ndarray:
        """Return h of each interval, (K, 1) [s]."""
        return np.asarray((self.durations(point, horizon) / self.nodes)[self.grid.stage_of, None])

    def inputs(self, point: Unknowns, horizon: float) -> np.ndarray:
        """Return the accelerations over the intervals, (K, n)."""
        return np.asarray(point.changes[:, self.grid.n :] / self.steps(point, horizon))

    def residuals(self, point: Unknowns, p: Parameters[np.ndarray]) -> Residuals:
        """Evaluate objective and constraints of a window at a point, without derivatives.

        A line search compares them. `linearize` computes them with derivatives.

        Args:
            point: States at the nodes and free durations.
            p: The numbers of the window: target, weights, normalization of each stage; p.terminal is kappa, the weight
                of the terminal cost.
        """
        tau = self.durations(point, float(p.horizon))
        interval_values = self.interval_row_values(point, p)
        costs = self.interval_row_costs(interval_values, p)
        terminal = 0.0
        for s, (stage, N) in enumerate(zip(self.costs, self.grid.nodes, strict=True)):
            target_at_nodes, _ = reference(p, s, tau[s])
            X = point.X[self.intervals(s)]
            # Arguments of 0.0: control, its weights and load. What control and force cost is added apart.
            squared_error = stage.cost(X, 0.0, target_at_nodes[:N], p.weights[s], 0.0, 0.0, rows=N)[0]
            _, control_effort = self.control_effort(s, point, p, tau[s])
            costs[s] += _stage_cost(s, p, N, tau[s], squared_error, control_effort)
        if p.terminal:  # of the last stage, which the loop has left in `stage` and `s`, at the last node
            squared_error = stage.cost(point.X[-1], 0.0, target_at_nodes[-1], p.weights[s], 0.0, 0.0)[0]
            terminal = _terminal_cost(p, squared_error)
        return self._residuals(point, p, costs, terminal, self.row_values(point, p), interval_values)

    def _residuals(
        self,
        point: Unknowns,
        p: Parameters[np.ndarray],
        costs: np.ndarray,
        terminal: float,
        rows: np.ndarray,
        interval_values: np.ndarray,
    ) -> Residuals:
        """Return J over the largest priority from what the stages add to it, and the gaps. Cf. paper eq. (16)."""
        J = float(p.omega @ costs + p.omega[-1] * terminal + p.pending * (self.waiting @ point.tau))
        change = self.steps(point, float(p.horizon)) * self._mean_velocities(point)
        gaps = point.changes[:, : self.grid.n] - change
        return Residuals(J, costs, terminal, gaps, rows, interval_values)

    def _mean_velocities(self, point: Unknowns) -> np.ndarray:
        """Return the velocities by which the positions change over the intervals, (K, n)."""
        before, after = self.weights
        Qdot = point.X[:, self.grid.n :]
        return np.asarray(before * Qdot[:-1] + after * Qdot[1:])

    def control_effort(
        self, s: int, point: Unknowns, p: Parameters[np.ndarray], tau: float
    ) -> tuple[np.ndarray, float]:
        """Return what costs of the control of stage s are made of, the stage lasting tau [s].

        Returns:
            The change of velocity dQdot over each interval, (N_s, n), and the integral of the weighted square of the
            acceleration u = dQdot N_s / tau, which is N_s / tau sum |dQdot|^2_Wr.
        """
        dv = point.changes[self.intervals(s), self.grid.n :]
        W_r = p.control_weights[s][: self.grid.n]
        return dv, float((dv**2 @ W_r).sum() * self.grid.nodes[s] / tau)

    def row_values(self, point: Unknowns, p: Parameters[np.ndarray]) -> np.ndarray:
        """Return the rows of all constraints at nodes, (E,)."""
        values = [
            rows.functions.value(point.X[nodes], rows.argument(p), rows=len(nodes))[0]
            for rows, nodes in zip(self.node_rows, self._nodes_of_rows, strict=True)
        ]
        return self._by_node(values)

    def _by_node(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Return the rows of each constraint at its nodes, (nodes, rows) each, by ascending nodes, (E,)."""
        if not values:
            return np.zeros(0)
        return np.concatenate([rows.ravel() for rows in values])[self._node_order]

    def interval_row_values(self, point: Unknowns, p: Parameters[np.ndarray]) -> np.ndarray:
        """Return the rows of all constraints over intervals, (I,)."""
        values = np.zeros(len(self.row_interval))
        if not self.interval_rows:
            return values
        h = self.steps(point, float(p.horizon))
        for rows, at in zip(self.interval_rows, self._interval_places, strict=True):
            k = np.array(rows.intervals)
            values[at] = rows.functions.values(Intervals(point.X, h, p.before, k), rows.argument(p)).ravel()
        return values

    def rows(self, point: Unknowns, p: Parameters[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the rows of all constraints at nodes, and the derivatives of those that every program has.

        The rest, distances between bodies, are many and costly, and a quadratic program has only those near their
        bounds. They get their derivatives when a program is built that has them, see `with_node_rows`.

        Args:
            point: States at the nodes and free durations.
            p: The numbers of the window.

        Returns:
            Values of all rows, (E,); derivatives of `permanent_rows` by the state at their node, (F, 2n).
        """
        values = []
        by_x = np.zeros((len(self.permanent_rows), 2 * self.grid.n))
        for rows, nodes, places in zip(self.node_rows, self._nodes_of_rows, self._places, strict=True):
            X = point.X[nodes]
            argument = rows.argument(p)
            is_permanent = np.isinf(rows.activation_distance)
            if is_permanent:
                g, jacobian = rows.functions.with_jacobian(X, argument, rows=len(X))
                # `permanent_rows` is ascending: this is where the rows `places` stand among them
                by_x[np.searchsorted(self.permanent_rows, places)] = jacobian.reshape(len(places), -1)
            else:
                (g,) = rows.functions.value(X, argument, rows=len(X))
            values.append(g)
        return self._by_node(values), by_x

    def with_node_rows(
        self, model: Linearization, point: Unknowns, p: Parameters[np.ndarray], indices: np.ndarray
    ) -> Linearization:
        """Return the quadratic model at a point with more of the rows at nodes, and their derivatives.

        A model begins with the rows that every program has. Others, such as distances between bodies, are added when
        they come near their bounds.

        Args:
            model: The quadratic model, from `linearize` or from this function.
            point: The point about which the model is.
            p: The numbers of the window.
            indices: Numbers of the rows to add among all E rows, ascending; those that the model has already stay.
        """
        new_rows = indices[~mask(model.node_rows, len(self.row_node))[indices]]
        if not len(new_rows):
            return model
        constraint_of_new = self._row_constraint[new_rows]
        rows_by_x = np.empty((len(new_rows), 2 * self.grid.n))
        for i, rows in enumerate(self.node_rows):
            chosen = np.flatnonzero(constraint_of_new == i)
            if len(chosen):
                row = new_rows[chosen]
                argument = rows.argument(p)
                if argument.ndim > 1:  # a constraint that moves has an argument for each of its nodes
                    argument = argument[self._row_place[row]]
                X = point.X[self.row_node[row]]
                rows_by_x[chosen] = rows.functions.gradients(X, argument, self._row_number[row])
        if not len(model.node_rows):
            return replace(model, node_rows=new_rows, rows_by_x=rows_by_x)
        node_rows = np.concatenate([model.node_rows, new_rows])
        order = np.argsort(node_rows)
        return replace(model, node_rows=node_rows[order], rows_by_x=np.concatenate([model.rows_by_x, rows_by_x])[order])

    def with_dependent_rates(self, point: Unknowns, p: Parameters[np.ndarray]) -> Unknowns:
        """Return a point whose dependent rates meet the equations that determine them; itself if there are none.

        Dependent rates y are velocities that follow from the others, such as those of a base without thrusters from
        those of the arms. The rows g that determine them are linear in them, g(y) = G y + ..., and y - G^-1 g(y) solves
        g = 0. After this they hold at every iterate, as if y had been eliminated. Rows at nodes are solved first, then
        those rows over intervals that say that something, a momentum, does not change.

        Args:
            point: States at the nodes and free durations.
            p: The numbers of the window, which the rows take.
        """
        if not (self._rows_with_dependent_rates or self._change_rows):
            return point
        n = self.grid.n
        X = point.X.copy()
        for rows, rates, by_rates in self._rows_with_dependent_rates:
            nodes = list(rows.nodes)
            g, jacobian = by_rates(X[nodes], rows.argument(p), rows=len(nodes))
            G = jacobian.reshape(len(nodes), rows.functions.count, -1)
            X[nodes, n + rates.start : n + rates.stop] -= np.linalg.solve(G, g[..., None])[..., 0]
        for functions, rows_of_stage in self._change_rows:  # stage by stage: each goes on from the velocities before
            nodes_of_stage = slice(rows_of_stage.intervals[0], rows_of_stage.intervals[-1] + 2)
            X[nodes_of_stage] = functions.with_dependent_rates(X[nodes_of_stage], rows_of_stage.argument(p))
        return replace(point, X=X)

    def interval_jacobian(self, point: Unknowns, p: Parameters[np.ndarray], indices: np.ndarray) -> np.ndarray:
        """Evaluate the derivatives of some of the rows over intervals, those that a quadratic program has.

        Derivatives of all rows would cost several times what solving the program does, and a program has no rows far
        from their bounds. So only intervals with one of the wanted rows are evaluated.

        Args:
            point: States at the nodes and free durations.
            p: The numbers of the window.
            indices: Numbers of the J wanted rows among all I rows over intervals, (J,).

        Returns:
            (J, 4n + S + history): derivatives by the states at both ends of the row's interval, by the free durations,
            and, where `history` is n, by the velocities where the interval before begins.
        """
        n = self.grid.n
        if not len(indices):
            return np.zeros((0, 4 * n + self.grid.switches + self.history))
        # By both states, h, and with history by the velocities where the interval before begins and by its length.
        by_states_and_h = np.zeros((len(self.row_interval), 5 * n + 2 if self.history else 4 * n + 1))
        is_wanted = mask(indices, len(self.row_interval))
        h = self.steps(point, float(p.horizon))
        for rows, places in zip(self.interval_rows, self._interval_places, strict=True):
            places_by_interval = places.reshape(len(rows.intervals), -1)
            has_wanted_row = is_wanted[places_by_interval].any(axis=1)
            k = np.array(rows.intervals)[has_wanted_row]
            if len(k):
                jacobian = rows.functions.jacobian(Intervals(point.X, h, p.before, k), rows.argument(p))
                width = jacobian.shape[-1]  # without history where these rows do not depend on it
                by_states_and_h[places_by_interval[has_wanted_row].ravel(), :width] = jacobian.reshape(-1, width)
        interval = self.row_interval[indices]
        by_states, by_h, by_v_before, by_h_before = np.split(
            by_states_and_h[indices], [4 * n, 4 * n + 1, 4 * n + 1 + self.history], axis=1
        )
        by_tau = by_h * self.interval_steps[interval]
        if self.history:
            is_later = (interval > 0)[:, None]  # what was applied before the first interval is past
            by_tau = by_tau + is_later * by_h_before * self.interval_steps[interval - 1]
        return np.hstack([by_states, by_tau, by_v_before])

    def row_change(self, model: Linearization, step: Unknowns) -> np.ndarray:
        """Return by how much a step changes the rows over intervals of a model (J,)."""
        k = self.row_interval[model.interval_rows]
        steps = [step.X[k], step.X[k + 1], np.tile(step.tau, (len(k), 1))]
        if self.history:
            steps.append(np.where((k > 0)[:, None], step.X[k - 1, self.grid.n :], 0.0))
        return np.asarray((model.interval_rows_by * np.hstack(steps)).sum(axis=1))

    def _permanent_interval_rows(self) -> np.ndarray:
        """Return which rows over intervals are part of every program, ascending: residuals of the cost among them."""
        permanent = [
            at for rows, at in zip(self.interval_rows, self._interval_places, strict=True) if rows.is_permanent
        ]
        return np.sort(np.concatenate([np.zeros(0, int), *permanent]))

    def interval_weights(self, p: Parameters[np.ndarray]) -> np.ndarray:
        """Return what the squares of the rows over intervals cost, without priorities, (I,); 0 of constraints."""
        weights = np.zeros(len(self.row_interval))
        for rows, at in zip(self.interval_rows, self._interval_places, strict=True):
            if rows.weights is not None:
                weights[at] = np.tile(rows.weights(p), len(rows.intervals))
        return weights

    def interval_row_costs(self, interval_values: np.ndarray, p: Parameters[np.ndarray]) -> np.ndarray:
        """Return what the squares of the rows over intervals (I,) add to the cost of each stage, (S + 1,)."""
        costs = np.zeros(len(self.costs))
        if len(self.permanent_interval_rows):
            stage = self.grid.stage_of[self.row_interval]
            np.add.at(costs, stage, self.interval_weights(p) * interval_values**2)
        return costs

    def hessian_weights(self, p: Parameters[np.ndarray]) -> np.ndarray:
        """Return the weights of the rows over intervals in the Hessian of J, (I,): those of their squares, doubled."""
        if not len(self.permanent_interval_rows):
            return np.zeros(len(self.row_interval))
        omega = p.omega[self.grid.stage_of[self.row_interval]]
        return np.asarray(2 * omega * self.interval_weights(p))

    def interval_bounds(self, window: Window, switch_times: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return low and high (I,) of the rows over intervals; each over the length of its interval, or itself.

        Some depend on the switch times (S,) [s]; without these they are the widest.

        See `interval_row_is_over_time`.
        """
        low = np.zeros(len(self.row_interval))
        high = np.zeros(len(self.row_interval))
        for rows, at in zip(self.interval_rows, self._interval_places, strict=True):
            low_by_interval, high_by_interval = rows.bounds_by_interval(window, switch_times)
            low[at] = low_by_interval.ravel()
            high[at] = high_by_interval.ravel()
        return low, high

    def rows_at(self, x: np.ndarray, p: Parameters[np.ndarray]) -> np.ndarray:
        """Return the values (E,) of the rows of all constraints at nodes, each at one and the same state x (2n,)."""
        values = [
            rows.functions.value(x, rows.argument(p), rows=len(nodes))[0]
            for rows, nodes in zip(self.node_rows, self._nodes_of_rows, strict=True)
        ]
        return self._by_node(values)

    def row_bounds(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Return low and high (E,) of the rows of all constraints at nodes."""
        none = np.zeros(0)
        bounds = [rows.bounds(window) for rows in self.node_rows]
        low = np.concatenate([none, *(low_at_node for low_at_node, _ in bounds)])
        high = np.concatenate([none, *(high_at_node for _, high_at_node in bounds)])
        return low[self._bound_of_row], high[self._bound_of_row]

    def with_curvature(
        self, model: Linearization, point: Unknowns, p: Parameters[np.ndarray], multipliers: np.ndarray
    ) -> Linearization:
        """Return the model with second derivatives by positions that the Gauss-Newton model does not have.

        They are the second derivatives of the rows at nodes, each times its multiplier. Of the Lagrangian's second
        derivatives this is the part that matters: the multipliers of an end condition are as large as what a second of
        waiting costs, whatever the stage itself weighs. Without them steps overshoot in motions that hardly change the
        costs, more than twofold in places, and with one iteration a sample the commands chatter.

        For a robot whose base nothing pushes, the second derivatives of the residuals, 2 w sum_i W_i e_i d2e_i/dQ2, are
        added too. Such a robot drifts and cannot hold what is fixed in space: its residuals stay large, and without
        their curvature the iterations alternate about the optimum. The curvature of the terminal cost is left out.

        Args:
            model: The Gauss-Newton model.
            point: The point about which it is.
            p: The numbers of the window.
            multipliers: Multipliers of all rows at nodes, (E,).
        """
        H_QQ = model.H_QQ.copy()
        n = self.grid.n
        for rows, places in zip(self.node_rows, self._places, strict=True):
            curvature = rows.functions.curvature
            if curvature is not None:
                nodes = list(rows.nodes)
                multipliers_at_nodes = multipliers[places].reshape(len(nodes), -1)
                by_Q_Q = curvature(point.X[nodes], rows.argument(p), multipliers_at_nodes, rows=len(nodes))[0]
                H_QQ[nodes] += by_Q_Q.reshape(-1, n, n)
        if self.residuals_are_curved:
            self._add_residual_curvature(H_QQ, point, p)
        return replace(model, H_QQ=H_QQ)

    def _add_residual_curvature(self, H_QQ: np.ndarray, point: Unknowns, p: Parameters[np.ndarray]) -> None:
        """Add 2 w sum_i W_i e_i d2e_i/dQ2 at the nodes of each stage, w = omega tau / (N scale), to (K + 1, n, n)."""
        n = self.grid.n
        tau = self.durations(point, float(p.horizon))
        for s, (stage, N) in enumerate(zip(self.costs, self.grid.nodes, strict=True)):
            nodes = self.intervals(s)
            wanted, _ = reference(p, s, tau[s])
            curvature = stage.residual_curvature(point.X[nodes, :n], p.weights[s], wanted[:N], rows=N)[0]
            weight = float(p.omega[s] * tau[s] / N / p.scale[s])
            H_QQ[nodes] += 2 * weight * curvature.reshape(N, n, n)

    def linearize(self, point: Unknowns, p: Parameters[np.ndarray]) -> Linearization:
        """Return the quadratic model at a point: Gauss-Newton of the costs, constraints linearized.

        A step of sequential quadratic programming minimizes it. It has the rows that every program has; the others are
        added when they are near their bounds, see `with_node_rows`. Derivatives by the durations of all S + 1 stages
        become those by the S free ones through D = `stage_durations`, (S + 1, S), since the last stage takes what the
        others leave of the horizon.

        Args:
            point: States at the nodes and free durations.
            p: The numbers of the window.
        """
        D = self.stage_durations
        stage_of_interval = self.grid.stage_of
        cost = _CostModel(self, point, p)
        row_values, rows_by_x = self.rows(point, p)
        interval_values = self.interval_row_values(point, p)
        permanent = self.permanent_interval_rows
        permanent_by = self.interval_jacobian(point, p, permanent)
        gradient_tau = D.T @ cost.gradient_tau + p.pending * self.waiting
        if len(permanent):
            # Rows over intervals that are residuals r of the cost: w r^2 / 2 has the gradient w r dr/dx.
            by_unknowns = (self.hessian_weights(p) * interval_values)[permanent, None] * permanent_by
            gradient_tau += self._add_interval_gradient(cost.gradient, permanent, by_unknowns)
        costs = cost.costs + self.interval_row_costs(interval_values, p)
        # A gap is Q+ - Q - h times the mean velocity, h = tau_s / N_s.
        gaps_by_stage = -self._mean_velocities(point) / self.nodes[stage_of_interval, None]
        return Linearization(
            residuals=self._residuals(point, p, costs, cost.terminal, row_values, interval_values),
            gradient=cost.gradient,
            gradient_tau=gradient_tau,
            H_QQ=cost.H_QQ,
            H_vv=cost.H_vv,
            H_x_tau=cost.H_x_tau @ D,
            H_tau_tau=D.T @ (cost.H_tau_tau[:, None] * D),
            gap_velocity=-self.steps(point, float(p.horizon)) * np.array(self.weights),
            gap_tau=gaps_by_stage[:, :, None] * D[stage_of_interval][:, None, :],
            node_rows=self.permanent_rows,
            rows_by_x=rows_by_x,
            interval_rows=permanent,
            interval_rows_by=permanent_by,
        )

    def _add_interval_gradient(self, gradient: np.ndarray, rows: np.ndarray, by_unknowns: np.ndarray) -> np.ndarray:
        """Add the gradients of cost terms over intervals to that of the objective, in place.

        Args:
            gradient: Gradient of the objective by the states at all nodes, (K + 1, 2n); the terms are added to it.
            rows: Which rows over intervals the terms belong to, (J,).
            by_unknowns: Gradient of each term in the columns of `interval_jacobian`, (J, 4n + S + history).

        Returns:
            The sum of the gradients by the free durations, (S,), which the caller adds.
        """
        n = self.grid.n
        k = self.row_interval[rows]
        by_begin, by_end, by_tau, by_v_before = np.split(
            by_unknowns, [2 * n, 4 * n, 4 * n + self.grid.switches], axis=1
        )
        np.add.at(gradient, k, by_begin)
        np.add.at(gradient, k + 1, by_end)
        if self.history:
            is_later = k > 0  # what was applied before the first interval is past
            np.add.at(gradient[:, n:], k[is_later] - 1, by_v_before[is_later])
        return np.asarray(by_tau.sum(axis=0))


def mask(indices: np.ndarray, count: int) -> np.ndarray:
    """Return a boolean mask (count,) of these indices."""
    chosen = np.zeros(count, bool)
    chosen[indices] = True
    return chosen


def _force_rows(model: RobotModel, shape: WindowShape) -> Iterator[IntervalRows]:
    """Yield the residuals of what force costs, of the stages where it does."""
    first_node = Grid(model.n, shape.nodes).first_node
    nothing = np.full(model.n, np.inf)
    for s, stage in enumerate(shape.stages):
        if stage.force_load.weighs_force:
            yield IntervalRows(
                name="force",
                intervals=range(int(first_node[s]), int(first_node[s + 1])),
                functions=force_residual(model, stage.force_load),
                argument=partial(_anchor_and_load, stage_functions(model, cost_shape(stage)).anchor, s),
                bounds=lambda window: (-nothing, nothing),
                weights=partial(_force_weights, model.n, s),
            )


def _rate_rows(model: RobotModel, shape: WindowShape) -> Iterator[IntervalRows]:
    """Yield the residuals of what changes of the acceleration cost, of the stages where they do."""
    first_node = Grid(model.n, shape.nodes).first_node
    nothing = np.full(model.n, np.inf)
    for s, stage in enumerate(shape.stages):
        if stage.weighs_rate:
            yield IntervalRows(
                name="rate",
                intervals=range(int(first_node[s]), int(first_node[s + 1])),
                functions=rate_residual(model),
                argument=lambda p: np.zeros(0),
                bounds=lambda window: (-nothing, nothing),
                weights=partial(_rate_weights, s),
            )


def _anchor_and_load(at: slice, s: int, p: Parameters[np.ndarray]) -> np.ndarray:
    """Return the anchor of the chart (n_anchor,), which the numbers of a stage's target have, and those of its load."""
    return np.concatenate([p.targets[s][at], p.loads[s]])


def _force_weights(n: int, s: int, p: Parameters[np.ndarray]) -> np.ndarray:
    """Return the normalized weights of the force in a stage, (n,)."""
    return np.asarray(p.control_weights[s][n:] / p.scale[s])


def _rate_weights(s: int, p: Parameters[np.ndarray]) -> np.ndarray:
    """Return the normalized weights of the rate of the acceleration in a stage, (n,)."""
    return np.asarray(p.rate_weights[s] / p.scale[s])


def _order_rows(by_constraint: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Sort the rows of several constraints by node, or by interval.

    Args:
        by_constraint: Node, or interval, of each row of each constraint, (rows,) each.

    Returns:
        The same numbers of all rows, ascending; and by constraint where its rows stand in that order, (rows,) each.
    """
    positions = np.concatenate([np.zeros(0, int), *by_constraint])
    order = np.argsort(positions, kind="stable")
    places = np.empty(len(order), int)
    places[order] = np.arange(len(order))
    sizes = [len(nodes) for nodes in by_constraint]
    return positions[order], np.split(places, np.cumsum(sizes)[:-1]) if sizes else []


def _stage_cost(s: int, p: Parameters[np.ndarray], N: int, tau: float, L: np.ndarray, effort: float) -> float:
    """Return the cost integral of a stage of duration tau [s], L the weighted squares of its residual at nodes."""
    return float((tau * (L.sum() / N - p.offset[s]) + effort) / p.scale[s])


def _terminal_cost(p: Parameters[np.ndarray], L: np.ndarray) -> float:
    """Return kappa times the normalized cost of the last stage at the last node, L the square of its residual."""
    return float(p.terminal * (L.item() - p.offset[-1]) / p.scale[-1])


class _CostModel:
    """Value, gradient and Gauss-Newton Hessian of the stages' costs; derivatives by the durations of all stages.

    A stage of duration tau with N intervals costs, e being its residual at a node, W its weights and dv the change of
    the velocities over an interval,

        omega / scale (tau / N sum_k (e_k' W e_k - offset) + N / tau sum_k dv_k' W_r dv_k).

    Attributes:
        costs: Normalized cost integral of each stage, without priorities, (S + 1,).
        terminal: Normalized terminal cost of the last stage, times kappa.
        gradient: By x_k, (K + 1, 2n).
        gradient_tau: By the durations, (S + 1,).
        H_QQ: Upper triangle of the Hessian by Q_k, (K + 1, n, n).
        H_vv: Its diagonal by (Qdot_k, Qdot_k+1), (K, n).
        H_x_tau: By x_k and the durations, (K + 1, 2n, S + 1).
        H_tau_tau: Its diagonal by the durations, (S + 1,).
    """

    def __init__(self, form: VelocityForm, point: Unknowns, p: Parameters[np.ndarray]) -> None:
        """Sum up value, gradient and Hessian of the costs of all stages at a point, and of the terminal cost.

        A stage with N intervals of length tau / N weighs the squared error at each of its nodes but the last by
        omega / scale tau / N; the terminal cost weighs that of the last stage at the last node.

        Args:
            form: The windows of this shape as functions of states and durations.
            point: States at the nodes and free durations.
            p: The numbers of the window: targets, weights, priorities omega, normalization.
        """
        K = form.grid.K
        n = form.grid.n
        S = form.grid.switches
        self._form = form
        self._point = point
        self._p = p
        self._tau = form.durations(point, float(p.horizon))
        self.gradient = np.zeros((K + 1, 2 * n))
        self.gradient_tau = np.zeros(S + 1)
        self.H_QQ = np.zeros((K + 1, n, n))
        self.H_vv = np.zeros((K, n))
        self.H_x_tau = np.zeros((K + 1, 2 * n, S + 1))
        self.H_tau_tau = np.zeros(S + 1)
        self.costs = np.zeros(S + 1)
        self.terminal = 0.0
        for s, (N, tau) in enumerate(zip(form.grid.nodes, self._tau, strict=True)):
            weight_by_tau = p.omega[s] / p.scale[s] / N
            squared_error = self._add_residuals(
                s, form.intervals(s), slice(N), weight=weight_by_tau * tau, weight_by_tau=weight_by_tau
            )
            self.costs[s] = _stage_cost(s, p, N, tau, squared_error, self._add_control(s))
        if p.terminal:
            weight = p.terminal * p.omega[-1] / p.scale[-1]
            last_node = slice(K, K + 1)
            squared_error = self._add_residuals(S, last_node, slice(-1, None), weight=weight, weight_by_tau=0.0)
            self.terminal = _terminal_cost(p, squared_error)

    def _add_residuals(
        self, s: int, nodes: slice, nodes_of_stage: slice, weight: float, weight_by_tau: float
    ) -> np.ndarray:
        """Add weight times e' W e at some nodes to gradient and Hessian, and return e' W e at each of them.

        With w = weight(tau) the residual is r = sqrt(w) e. Errors e depend on Q, with E = de/dQ, and, where the target
        moves, on the stage's duration tau, with e_tau = de/dtau. So dr/dtau = sqrt(w) (e_tau + w' / (2 w) e), and the
        Gauss-Newton model is

            gradient by Q      2 w E' W e                    Hessian by Q, Q      2 w E' W E
            gradient by tau    2 w e' W e_tau + w' e' W e    Hessian by Q, tau    2 w E' W e_tau + w' E' W e
            Hessian by tau, tau    2 w e_tau' W e_tau + 2 w' e' W e_tau + w'^2 / (2 w) e' W e.

        Args:
            s: The stage.
            nodes: The nodes, of the whole window.
            nodes_of_stage: The same, counted from the stage's first node.
            weight: w.
            weight_by_tau: w', its derivative by the stage's duration.
        """
        p = self._p
        n = self._form.grid.n
        target, target_by_tau = reference(p, s, self._tau[s])  # one row where the target stands still
        Q = self._point.X[nodes, :n]
        # e' W e, e' W e_tau, e_tau' W e_tau, E' W e, E' W e_tau, E' W E
        eWe, eWe_tau, e_tauWe_tau, EWe, EWe_tau, EWE = self._form.costs[s].gauss_newton(
            Q, p.weights[s], target[nodes_of_stage], target_by_tau[nodes_of_stage], rows=len(Q)
        )
        self.gradient[nodes, :n] += 2 * weight * EWe
        self.H_QQ[nodes] += 2 * weight * EWE.reshape(-1, n, n)
        self.H_x_tau[nodes, :n, s] += 2 * weight * EWe_tau + weight_by_tau * EWe
        curvature = weight_by_tau**2 / (2 * weight) * eWe
        self.H_tau_tau[s] += (2 * weight * e_tauWe_tau + 2 * weight_by_tau * eWe_tau + curvature).sum()
        # The cost that is integrated is e' W e less the offset of the normalization.
        self.gradient_tau[s] += (weight_by_tau * (eWe - p.offset[s]) + 2 * weight * eWe_tau).sum()
        return np.asarray(eWe)

    def _add_control(self, s: int) -> float:
        """Add what the accelerations of a stage cost to gradient and Hessian, and return it without weight, E.

        Over intervals of length tau / N the acceleration is dv_k N / tau, dv_k = Qdot_k+1 - Qdot_k, and the integral of
        its weighted square is E = N / tau sum_k dv_k' W_r dv_k. The objective has omega / scale E. Its Hessian is
        exact: dE/dtau = -E / tau, d2E/dtau2 = 2 E / tau^2, and with b = 2 N / tau W_r dE/ddv = b dv, d2E/ddv2 = b,
        d2E/ddv dtau = -b dv / tau.
        """
        n = self._form.grid.n
        tau = self._tau[s]
        p = self._p
        begins = self._form.intervals(s)  # nodes where the stage's intervals begin, and where they end
        ends = slice(begins.start + 1, begins.stop + 1)
        dv, effort = self._form.control_effort(s, self._point, p, tau)
        weight = p.omega[s] / p.scale[s]
        b = 2 * weight * self._form.nodes[s] / tau * p.control_weights[s][:n]
        self.gradient[ends, n:] += b * dv
        self.gradient[begins, n:] -= b * dv
        self.H_vv[begins] -= b
        self.H_x_tau[ends, n:, s] -= b * dv / tau
        self.H_x_tau[begins, n:, s] += b * dv / tau
        self.H_tau_tau[s] += 2 * weight * effort / tau**2
        self.gradient_tau[s] -= weight * effort / tau
        return effort
