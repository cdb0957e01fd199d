"""The back-ends that take a window as a flat nonlinear program: IPOPT and fatrop, both in the CasADi wheel.

Decision vectors z, parameter vectors p, bounds and multipliers in the order of the program exist in this module and in
`adjoint` alone: direct multiple shooting with the durations as constant states. The objective is that of
docs/formulation.md divided by the window's largest priority; variables and rows are ordered so that
structure-exploiting solvers apply. Nothing but the shape of a window is fixed in its program; all numbers are
parameters.
"""

import io
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, redirect_stdout
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli.errors import InputError
from psmpc_cli.ocp.constraints import IntervalRows, NodeRows, interval_rows, missing_row_violation, node_rows
from psmpc_cli.ocp.constraints.boxes import PENALTY, node_limits, scaled_violations, shift_limits
from psmpc_cli.ocp.end import SHORTEST
from psmpc_cli.ocp.objective import IntervalSymbols, rate_residual, stage_functions, weighted_square
from psmpc_cli.ocp.plan import Grid, Plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import (
    Parameters,
    Window,
    WindowShape,
    durations,
    plan_on_mesh,
    reference_at,
    shortest_durations,
    window_numbers,
    window_shape,
)
from psmpc_cli.progress import Spell
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.solvers.bounded import LONGEST_CALL, BoundedCalls
from psmpc_cli.specs.controller import SolverSpec

Report = Callable[[str], None]
"""Takes a line of a solver's table of iterations."""

ITERATION = re.compile(r"iter\s|\s*\d+[rRsS]?\s+[-+\d.]+e")
"""What the lines of a plug-in's table of iterations begin with."""

PRINT_LEVEL = 5
"""From this level on both plug-ins write a line an iteration."""

OUTCOMES: Mapping[object, Outcome] = {
    "Infeasible_Problem_Detected": Outcome.INFEASIBLE,
    "Restoration_Failed": Outcome.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Outcome.ITERATION_LIMIT,
    "Solved_To_Acceptable_Level": Outcome.ITERATION_LIMIT,
    "User_Requested_Stop": Outcome.DEADLINE,
    1: Outcome.ITERATION_LIMIT,
}
"""Outcomes by the return codes of IPOPT (texts) and fatrop (numbers)."""

INTERVAL_TOLERANCE = 1e-4
"""Least tolerance of fatrop with rows over intervals that nearly say the same at both ends of an interval.

Of the first window of `inspect` fatrop stops 8e-7 above the least J, and goes on for 200 iterations without 1e-5."""

BARRIER_START = 1e-4
"""fatrop: the first barrier parameter. The shifted plan is a good guess, and 1e-2 costs a third more iterations."""

WARM_START: Mapping[str, Any] = {
    "warm_start_init_point": "yes",
    "mu_init": 1e-6,
    **dict.fromkeys(
        (
            "warm_start_bound_push",
            "warm_start_bound_frac",
            "warm_start_slack_bound_push",
            "warm_start_slack_bound_frac",
            "warm_start_mult_bound_push",
        ),
        1e-6,
    ),
}
"""IPOPT: options of solves that start from multipliers too. Its iterates are then near the optimum already: a barrier
parameter of the size that multipliers have there, 1e-6, and points that are not pushed farther off their bounds."""

ProgramKey = tuple[WindowShape, bool]
"""What programs differ in: the shape of the window, and whether they have the rows that are rarely active."""

CompiledKey = tuple[ProgramKey, bool]
"""What compiled solvers differ in: the program, and whether their solves start from multipliers."""

NO_DUALS = np.zeros(0)
"""Multipliers of a solve that starts from a plan alone."""

LONGEST_COMPILATION = 600.0
"""Processor time after which the compilation of a program is ended [s]."""

Bound = Callable[[Window, np.ndarray, np.ndarray, np.ndarray], tuple[ArrayLike, ArrayLike]]
"""Low and high of rows, from a window, those of [Q; Qdot] at its nodes, (K + 1, 2n) each, and guessed switch times."""


class Nlp:
    """A window's NLP: min f(x, p) subject to bounds on x and g(x, p), for the windows of one shape.

    Paper eq. (20), with the departures of docs/formulation.md. The decision variables are x_0, u_0, x_1, u_1, ..., x_K,
    each x_k = [Q; Qdot; tau_0 .. tau_{S-1}]. Where costs of other stages are bounded, their sums so far follow on the
    durations in each x_k, and where changes of acceleration count, the acceleration over the interval before. Where
    limits are soft, rho times the violations of [Q; Qdot], e_k, follow on u_k, and on x_K; on these, rho times the
    violations of soft rows of constraints at the node.
    The rows of g are node by node: the gap to the next node first, then the path rows of the node.

    Args:
        model: The robot.
        shape: The shape.
        numbers: The parameters of one window of this shape.
        has_all_rows: It has the rows that are rarely active too.

    Attributes:
        shape: The windows' shape.
        has_all_rows: As given.
        grid: Intervals of the stages.
        problem: Decision variables x, parameters p, objective f and constraints g, as CasADi's solvers take them.
        sizes: N, and by node nx, nu and ng: sizes of state, of input with violations of soft limits, of path rows.
        pack: At the nodes states (2n, K + 1), durations (S, K + 1), sums (sums, K + 1), accelerations before (n, K + 1)
            or (0, K + 1), and rho times violations (2n, K + 1) or (0, K + 1), of soft rows of constraints node by node,
            then inputs of each stage (inputs, N_s) -> decision vector.
        unpack: The inverse.
    """

    def __init__(
        self, model: RobotModel, shape: WindowShape, parameters: Parameters[np.ndarray], has_all_rows: bool = False
    ) -> None:
        """Write the NLP as expressions of symbols: variables, then objective, then rows with their bounds.

        J is the weighted sum of the stages' cost integrals, delta times the time that stages wait for their turn, and
        the terminal cost of the last stage; violations of soft limits cost on top of it. Paper eq. (20).

        Args:
            model: The robot.
            shape: The structure of the windows: stages, numbers of intervals, which constraints there are.
            parameters: The numbers of one window of this shape, for their sizes.
            has_all_rows: It has the rows that are rarely active too.
        """
        self.shape = shape
        self.has_all_rows = has_all_rows
        self.grid = Grid(model.n, shape.nodes)
        self._node_rows = node_rows(model, shape)
        self._interval_rows = [rows for rows in interval_rows(model, shape) if has_all_rows or not rows.rarely_active]
        self.is_nearly_redundant = any(rows.functions.is_nearly_redundant for rows in self._interval_rows)
        self._functions = [stage_functions(model, stage) for stage in (*shape.stages, *shape.kept)]
        self._rate_residual = rate_residual(model)
        self._p = parameters.mapped(_symbol)
        x = self._define_variables(model)
        stage_costs, terminal = self._stage_costs()
        interval_costs_of_kept = self._interval_costs_of_kept()
        # A stage waits for all stages before it: the sum of their durations.
        waited = sum((ca.sum1(self._tau[:s, 0]) for s in range(1, self.grid.switches + 1)), ca.SX(0))
        p = self._p
        J = ca.dot(p.omega, ca.vertcat(*stage_costs)) + p.pending * waited + p.omega[-1] * terminal
        self._soft_cost = self._penalty()
        g = self._define_rows(interval_costs_of_kept, stage_costs[-1] + terminal)
        self.problem = {"x": x, "p": ca.vertcat(*map(ca.vec, p.pieces())), "f": J + self._soft_cost, "g": g}
        self._costs = ca.vertcat(*map(sum, interval_costs_of_kept), *stage_costs), terminal

    def _define_variables(self, model: RobotModel) -> ca.SX:
        """Define the decision variables as symbols, each by its meaning, and the functions `pack` and `unpack`.

        Variables that a shape does not need have no rows. Durations, and others that are the same at all nodes, are
        repeated at each of them, which solvers that use the structure of stages ask for.

        Returns:
            The decision vector x, node by node: state, input, violations of soft limits and of constraints' soft rows.
        """
        shape = self.shape
        K = self.grid.K
        self._X = ca.SX.sym("X", 2 * model.n, K + 1)
        self._tau = ca.SX.sym("tau", self.grid.switches, K + 1)
        # Costs up to a node of kept stages (earlier ones whose costs HTMPC bounds), and the acceleration before it.
        self._sums = ca.SX.sym("sum", 0 if shape.kept_errors else len(shape.kept), K + 1)
        self._u_before = ca.SX.sym("u_before", model.n if shape.has_rates else 0, K + 1)
        before = self._p.before
        self._applied, self._tick = ca.vertsplit(before, [0, self._u_before.shape[0], before.numel()])
        # rho times the violations of soft limits of states, and of soft rows of constraints.
        self._e = ca.SX.sym("e", 2 * model.n if shape.soft else 0, K + 1)
        self._row_e = [ca.SX.sym("row_e", sum(map(_soft_count, self._rows_at(k)))) for k in range(K + 1)]
        stage_inputs = [ca.SX.sym("u", self._functions[s].inputs, N) for s, N in enumerate(shape.nodes)]
        self._u = [*(u for of_stage in stage_inputs for u in ca.horzsplit(of_stage)), ca.SX(0, 1)]  # none at x_K
        self._node_states = ca.horzsplit(ca.vertcat(self._X, self._tau, self._sums, self._u_before))
        self._node_inputs = list(zip(self._u, ca.horzsplit(self._e), self._row_e, strict=True))
        nodes = zip(self._node_states, self._node_inputs, strict=True)
        x = ca.vertcat(*(ca.vertcat(state, *inputs) for state, inputs in nodes))
        variables = [self._X, self._tau, self._sums, self._u_before, self._e, ca.vertcat(*self._row_e), *stage_inputs]
        self.pack = ca.Function("pack", variables, [x])
        self.unpack = ca.Function("unpack", [x], variables)
        return x

    def _stage_costs(self) -> tuple[list[ca.SX], ca.SX]:
        """Return the normalized cost integral of each of the S + 1 stages, and the terminal cost, without priorities.

        The integrals include what changes of the acceleration cost. The weighted sum of that alone is stored as well,
        in `_rate_cost_of_all`: the adjoint solver differentiates it apart from the rest.
        """
        shape = self.shape
        p = self._p
        last = self.grid.switches
        costs = [ca.SX(0) for _ in shape.nodes]
        rate_costs = [ca.SX(0) for _ in shape.nodes]
        for k, s in enumerate(self.grid.stage_of):  # interval k is of stage s
            node_of_stage = k - int(self.grid.first_node[s])
            costs[s] += self._cost(int(s), node_of_stage, k)
            if shape.stages[s].weighs_rate:
                rate_costs[s] += self._rate_cost(int(s), k)
        self._rate_cost_of_all = ca.dot(p.omega, ca.vertcat(*rate_costs))
        costs = [cost + rate_cost for cost, rate_cost in zip(costs, rate_costs, strict=True)]
        no_input = ca.SX.zeros(self._functions[last].inputs)
        L_at_end = self._L(last, shape.nodes[last], self.grid.K, no_input, 0 * p.control_weights[last])
        return costs, p.terminal * L_at_end

    def _interval_costs_of_kept(self) -> list[list[ca.SX]]:
        """Return what each interval adds to the cost integral of each kept stage: lists of K.

        A kept stage is an earlier one, of more priority, whose cost HTMPC bounds over the whole window.
        """
        first = self.grid.switches + 1
        return [[self._kept_cost(first + i, k) for k in range(self.grid.K)] for i in range(len(self.shape.kept))]

    def _define_rows(self, interval_costs_of_kept: list[list[ca.SX]], last_cost: ca.SX) -> ca.SX:
        """Return the rows g, node by node: the gap to the next node, then the path rows; store bounds and sizes.

        A gap is by how much the state at the next node differs from where the interval leads, and is 0 in a solution.
        Path rows are all others. A structure-exploiting solver needs the sizes of both at each node.

        Args:
            interval_costs_of_kept: What each interval adds to the cost of each kept stage, whose cost HTMPC bounds.
            last_cost: Cost of the last stage with the terminal cost, which is bounded where the shape says so.
        """
        K = self.grid.K
        path_rows = [list(self._path(k)) for k in range(K + 1)]
        if self.shape.bounded:
            path_rows[-1].append((last_cost, lambda window, *_: (-np.inf, window.cost_bound)))
        gap_rows: list[list[tuple[ca.SX, Bound]]] = [[(self._gap(k, interval_costs_of_kept), _zero)] for k in range(K)]
        gap_rows.append([])  # no node follows the last one
        rows = [row for gap, paths in zip(gap_rows, path_rows, strict=True) for row in (*gap, *paths)]
        self._bounds = [(row.numel(), bound) for row, bound in rows]
        self.sizes: dict[str, Any] = {
            "N": K,
            "nx": [state.numel() for state in self._node_states],
            "nu": [sum(part.numel() for part in inputs) for inputs in self._node_inputs],
            "ng": [sum(row.numel() for row, _ in paths) for paths in path_rows],
        }
        return ca.vertcat(*(row for row, _ in rows))

    @cached_property
    def costs(self) -> ca.Function:
        """x, p -> normalized cost integrals without priorities, of kept stages, then (S + 1,); the terminal cost."""
        return ca.Function("costs", [self.problem[name] for name in "xp"], list(self._costs))

    @cached_property
    def rows(self) -> ca.Function:
        """x, p -> g."""
        return ca.Function("rows", [self.problem[name] for name in "xp"], [self.problem["g"]])

    def limits(self, window: Window, guess: Plan) -> tuple[np.ndarray, np.ndarray]:
        """Return low and high of [Q; Qdot] at the nodes, (K + 1, 2n) each; those of v in the chart about a guess."""
        low, high = node_limits(self.grid, window.stages)
        shift_limits(window, guess, low, high)
        return low, high

    def bounds(self, window: Window, guess: Plan, within: float) -> dict[str, np.ndarray]:
        """Return lbx, ubx, lbg, ubg, durations within so many seconds of the guess. Paper (14), (17), (18)."""
        low, high = self.limits(window, guess)
        limits = [stage.limits for stage in window.stages]
        tau = durations(guess.switch_times, window.start, window.horizon)[:-1]
        shortest = np.maximum(shortest_durations(window)[:-1], tau - within)
        rows = [(size, bound(window, low, high, guess.switch_times)) for size, bound in self._bounds]
        return {
            "lbx": self._box(-np.inf, low, shortest, 0.0, [of_stage.acceleration_low for of_stage in limits]),
            "ubx": self._box(np.inf, high, tau + within, np.inf, [of_stage.acceleration_high for of_stage in limits]),
            "lbg": np.concatenate([np.broadcast_to(low, size) for size, (low, _) in rows]),
            "ubg": np.concatenate([np.broadcast_to(high, size) for size, (_, high) in rows]),
        }

    @property
    def program(self) -> Mapping[str, Any]:
        """What an optimizer is given: here all of `problem`."""
        return self.problem

    @property
    def derivatives(self) -> Mapping[str, ca.Function]:
        """Derivatives of the program that the optimizer does not generate itself, by the names CasADi has for them."""
        return {}

    def arguments(self, x: np.ndarray, p: np.ndarray, bounds: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the arguments of the optimizer of the program, to start from decision variables x."""
        return {"x0": x, "p": p, **bounds}

    def point(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the decision variables x of a solution z of the program."""
        return z

    def _box(
        self, none: float, X: np.ndarray, tau: np.ndarray, violation: float, inputs: Sequence[np.ndarray]
    ) -> np.ndarray:
        """Return one side of the bounds of x, `none` where there is none; soft limits of states are rows."""
        states = np.full(X.shape, none)
        durations = np.full((len(tau), len(X)), none)
        durations[:, 0] = tau
        if not self.shape.soft:
            states[1:] = X[1:]
        rates = [
            np.tile(limit[:, None], N) if stage.input == "joint" else none
            for limit, N, stage in zip(inputs, self.shape.nodes, self.shape.stages, strict=True)
        ]
        return _array(self.pack(states.T, durations, none, none, violation, violation, *rates))

    def _rows_at(self, k: int) -> list[NodeRows]:
        """Return the rows of constraints at a node."""
        return [rows for rows in self._node_rows if k in rows.nodes]

    def row_violations(self, window: Window, plan: Plan, parameters: Parameters[np.ndarray]) -> np.ndarray:
        """Return rho times the violations of the soft rows of constraints along a plan, node by node."""
        violations = [np.zeros(0)]
        for k in range(self.grid.K + 1):
            for rows in self._rows_at(k):
                if rows.soft:
                    value = _array(rows.expression(k, plan.X[k], parameters))
                    violations.append(scaled_violations(value, *rows.bounds(window)))
        return np.concatenate(violations)

    def _L(self, s: int, node: int, k: int, u: ca.SX, control_weights: ca.SX) -> ca.SX:
        """Return the normalized cost of a stage, or of a kept one, at its own node, 0 to N_s, which is node k."""
        p = self._p
        S = self.grid.switches
        wanted = reference_at(p, s, node, self._duration(min(s, S), k))
        Lbar = self._functions[s].cost.function(self._X[:, k], u, wanted, p.weights[s], control_weights, p.loads[s])
        return (Lbar - p.offset[s]) / p.scale[s]

    def _cost(self, s: int, node: int, k: int) -> ca.SX:
        """Return what interval k adds to the cost integral of a stage, or of a kept one, at whose node it begins."""
        return self._L(s, node, k, self._u[k], self._p.control_weights[s]) * self._step(k, k)

    def _kept_cost(self, s: int, k: int) -> ca.SX:
        """Return what interval k adds to the cost integral of a kept stage."""
        cost = self._cost(s, k, k)
        kept = self.shape.kept[s - self.grid.switches - 1]
        return cost + self._rate_cost(s, k) if kept.weighs_rate else cost

    def _rate_cost(self, s: int, k: int) -> ca.SX:
        """Return what the change of acceleration to interval k costs by the weights of a stage, or of a kept one."""
        rate = self._rate_residual.expression(self._interval(k), ca.SX(0, 1))
        return weighted_square(rate, self._p.rate_weights[s] / self._p.scale[s])

    def _interval(self, k: int) -> IntervalSymbols:
        """Return interval k as rows over it take it; its first node has all of it."""
        return IntervalSymbols(
            x=self._X[:, k],
            x_next=self._led_to(k),
            h=self._step(k, k),
            u=self._acceleration(k),
            u_before=self._u_before[:, k],
            h_before=self._step(k - 1, k) if k else self._tick,
        )

    def _acceleration(self, k: int) -> ca.SX:
        """Return Qddot over interval k (n,)."""
        n = self.grid.n
        if self.shape.stages[int(self.grid.stage_of[k])].input == "joint":
            return self._u[k]
        return (self._led_to(k)[n:] - self._X[n:, k]) / self._step(k, k)

    def _duration(self, s: int, k: int) -> ca.SX:
        """Return tau_s of a stage as node k has it; the last stage takes what is left of the horizon."""
        tau = self._tau[:, k]
        return self._p.horizon - ca.sum1(tau) if s == self.grid.switches else tau[s]

    def _step(self, interval: int, k: int) -> ca.SX:
        """Return the length of an interval as node k at one of its ends has it."""
        s = int(self.grid.stage_of[interval])
        return self._duration(s, k) / self.grid.nodes[s]

    def _penalty(self) -> ca.SX:
        """Return what violated soft limits cost: rho times the integral of the violations, by the trapezoidal rule."""
        K = self.grid.K
        penalty = ca.SX(0)
        for k in range(K + 1):
            around = [self._step(interval, k) for interval in (k - 1, k) if 0 <= interval < K]
            penalty += sum(around) / 2 * (ca.sum1(self._e[:, k]) + ca.sum1(self._row_e[k]))
        return penalty

    def _led_to(self, k: int) -> ca.SX:
        """Return the state to which interval k leads, as its first node has it."""
        s = int(self.grid.stage_of[k])
        functions = self._functions[s]
        anchor = self._p.targets[s][functions.anchor]
        return ca.SX(functions.step(self.shape.discretization)(self._X[:, k], self._u[k], self._step(k, k), anchor))

    def _gap(self, k: int, interval_costs_of_kept: list[list[ca.SX]]) -> ca.SX:
        """Return by how much the state of the next node differs from where interval k leads."""
        led_to = self._led_to(k)
        sums = [self._sums[i, k] + interval_costs_of_kept[i][k] for i in range(self._sums.shape[0])]
        u_before = self._acceleration(k) if self.shape.has_rates else ca.SX(0, 1)
        return self._node_states[k + 1] - ca.vertcat(led_to, self._tau[:, k], *sums, u_before)

    def _path(self, k: int) -> Iterator[tuple[ca.SX, Bound]]:
        """Yield the path rows of node k, which are all rows there but the gap to the next node, each with its bounds.

        They are, in this order: the initial state and durations (at the first node), constraints at the node,
        constraints over the interval that begins there, bounds on the costs of kept stages (at the last node), and
        soft limits of the state. Of a soft row value - low >= 0 and high - value >= 0 stand apart, each loosened by the
        violation e / rho that the objective pays for.
        """
        X = self._X[:, k]
        if k == 0:
            yield from self._rows_of_first_node()
        first_e = 0
        for rows in self._rows_at(k):
            value = rows.expression(k, X, self._p)
            bounds = partial(_node_bounds, rows)
            if rows.soft:
                violation = self._row_e[k][first_e : first_e + rows.functions.count] / PENALTY
                first_e += rows.functions.count
                yield value + violation, lambda *args, bounds=bounds: (bounds(*args)[0], np.inf)
                yield value - violation, lambda *args, bounds=bounds: (-np.inf, bounds(*args)[1])
            else:
                yield value, bounds
        for over_interval in self._interval_rows:
            if k in over_interval.intervals:
                interval = self._interval(k)
                value = over_interval.functions.expression(interval, over_interval.argument(self._p))
                if over_interval.over_time:  # bounds are those of the row over the length of its interval
                    value /= interval.h
                yield value, partial(_interval_bounds, over_interval, k)
        if k == self.grid.K:
            for i in range(self._sums.shape[0]):
                yield self._sums[i, k], lambda window, *_, i=i: (-np.inf, window.kept[i].bound)
        if self.shape.soft:
            yield X + self._e[:, k] / PENALTY, lambda window, low, *_: (low[k], np.inf)
            yield X - self._e[:, k] / PENALTY, lambda window, _, high, *__: (-np.inf, high[k])

    def _rows_of_first_node(self) -> Iterator[tuple[ca.SX, Bound]]:
        """Yield the rows that the first node alone has: measured state, last duration, switches at fixed times."""
        tau = self._tau[:, 0]
        stages = self.shape.stages
        initial = ca.vertcat(self._X[:, 0] - self._p.x0, self._sums[:, 0], self._u_before[:, 0] - self._applied)
        yield initial, _zero
        if len(stages) > 1:
            yield self._duration(len(stages) - 1, 0), lambda *_: (SHORTEST, np.inf)
        for s, stage in enumerate(stages[:-1]):
            if stage.end.is_fixed:
                yield ca.sum1(tau[: s + 1]), partial(_fixed_end, s)


def _zero(*_: object) -> tuple[float, float]:
    return 0.0, 0.0


def _fixed_end(s: int, window: Window, *_: object) -> tuple[float, float]:
    end = window.stages[s].end
    return end.earliest - window.start, end.latest - window.start


def _soft_count(rows: NodeRows) -> int:
    """Return how many of some rows at a node may be violated at a cost."""
    return rows.functions.count if rows.soft else 0


def _node_bounds(rows: NodeRows, window: Window, *_: object) -> tuple[np.ndarray, np.ndarray]:
    low, high = rows.bounds(window)
    return low, high


def _interval_bounds(
    rows: IntervalRows, k: int, window: Window, low: np.ndarray, high: np.ndarray, switch_times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    low, high = rows.bounds_by_interval(window, switch_times)
    return low[rows.intervals.index(k)], high[rows.intervals.index(k)]


def _symbol(values: np.ndarray) -> ca.SX:
    return ca.SX.sym("p", *values.shape)


def _array(vector: ca.DM) -> np.ndarray:
    return np.asarray(vector).ravel()


class _Clock(ca.Callback):
    """Stops IPOPT with the iteration in which an instant passes.

    Attributes:
        stop_at: The instant, of `time.perf_counter` [s].
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        super().__init__()
        x, g, p = (problem[name].numel() for name in ("x", "g", "p"))
        self._sizes = {"x": x, "f": 1, "g": g, "lam_x": x, "lam_g": g, "lam_p": p}
        self.stop_at = np.inf
        self.construct("clock", {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return ca.nlpsol_out(i)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)])

    def eval(self, arg: Sequence[ca.DM]) -> list[int]:
        return [int(time.perf_counter() >= self.stop_at)]


class NlpSolver(Solver):
    """Windows by IPOPT or fatrop: one transcribed and compiled NLP for each shape, kept for all windows of that shape.

    Args:
        problem: The problem.
        spec: The back-end and its settings.
        report: Takes the lines of the table of iterations.
        options: Replace the options of the plug-in itself.
        has_duals: Solutions have their multipliers, and solves start from those of the sample before where the window
            has the same shape. IPOPT alone takes them: fatrop sets multipliers of bounds to 1 and computes the others.
    """

    def __init__(
        self,
        problem: Problem,
        spec: SolverSpec,
        report: Report | None = None,
        options: Mapping[str, Any] | None = None,
        has_duals: bool = False,
    ) -> None:
        """Choose the settings of IPOPT or fatrop for a problem; programs are built when a window needs them.

        They are compiled and solved in a copy of this process, since neither solver can be interrupted from outside.

        Args:
            problem: The problem.
            spec: Which of both, tolerance, deadline and the like.
            report: Takes the lines of the table of iterations, if there is one.
            options: Replace the options of the solver itself.
            has_duals: Solutions have their multipliers, and solves start from those of the sample before; IPOPT alone.
        """
        self._problem = problem
        self._spec = spec
        self._has_duals = has_duals and spec.kind == "ipopt"
        self._plugin = "fatrop" if spec.kind == "fatrop" else "ipopt"
        self._report = report
        settings: dict[str, Any] = {"print_level": 0, "tol": spec.tolerance, "max_iter": spec.max_iterations}
        if self._plugin == "ipopt":
            # no banner, a barrier for a good guess, and no end at the looser "acceptable" tolerance
            settings |= {"sb": "yes", "mu_init": 1e-2, "acceptable_iter": 0}
            self.deadline = np.inf if spec.deadline is None else spec.deadline
        else:
            settings["mu_init"] = BARRIER_START
        self._settings = settings if options is None else dict(options)
        self._nlps: dict[ProgramKey, Nlp] = {}
        self._compiled: dict[CompiledKey, ca.Function] = {}
        self._clocks: dict[CompiledKey, _Clock] = {}
        self._ready = set[CompiledKey]()  # those that the copy of the process has compiled
        self._solving = Spell(f"{self._plugin} compiles and solves a large window", "windows")
        self._calls = BoundedCalls(self._answer, self._solving.wait)

    def violation(self, window: Window, plan: Plan) -> float:
        """Return by how much a plan on the mesh of a window violates a constraint at worst."""
        nlp, x, p = self._posed(window, plan)
        return _violation(nlp.bounds(window, plan, np.inf), x, _array(nlp.rows(x, p)))

    def costs(self, window: Window, plan: Plan) -> np.ndarray:
        """Return what each stage adds to the objective at priority 1 along a plan on the mesh of a window, (S + 1,)."""
        nlp, x, p = self._posed(window, plan)
        costs, terminal = nlp.costs(x, p)
        return np.append(_array(costs)[:-1], float(costs[-1] + terminal))

    def _posed(self, window: Window, plan: Plan, has_all_rows: bool = False) -> tuple[Nlp, np.ndarray, np.ndarray]:
        """Return the NLP of a window, and a plan on the window's mesh as its start: decision vector x and parameters p.

        The NLP is transcribed when a window has its shape for the first time. Soft limits that the plan violates get as
        much violation as they need, so that the start meets their rows.

        Args:
            window: The window.
            plan: The plan, on the window's mesh.
            has_all_rows: The NLP has the rows that are rarely active too.
        """
        shape = window_shape(window)
        parameters = window_numbers(window, plan.switch_times)
        nlp = self._nlp((shape, has_all_rows), parameters)
        inputs = list[np.ndarray]()  # of each stage over its intervals: accelerations of Q, or of poses
        first_nodes = nlp.grid.first_node
        for stage, first, end in zip(window.stages, first_nodes, first_nodes[1:], strict=False):
            inputs.append(self._problem.costs.inputs(stage, plan.X[first:end], plan.u[first:end]).T)
        violations = scaled_violations(plan.X, *nlp.limits(window, plan)).T if shape.soft else 0.0
        tau = np.tile(np.diff(plan.switch_times, prepend=window.start)[:, None], nlp.grid.K + 1)
        row_violations = nlp.row_violations(window, plan, parameters)
        u_before = np.vstack([parameters.before[:-1], plan.u]).T if shape.has_rates else 0.0
        x = nlp.pack(plan.X.T, tau, 0.0, u_before, violations, row_violations, *inputs)
        return nlp, _array(x), np.concatenate([np.ravel(piece, order="F") for piece in parameters.pieces()])

    def _nlp(self, key: ProgramKey, parameters: Parameters[np.ndarray]) -> Nlp:
        """Return a program, transcribed on first use."""
        shape, has_all_rows = key
        if key not in self._nlps:
            if shape.bounded and self._plugin != "ipopt":
                raise InputError(f"found a bound on a cost and the solver {self._plugin}, expected ipopt")
            self._nlps[key] = self._transcribe(shape, parameters, has_all_rows)
        return self._nlps[key]

    def _transcribe(self, shape: WindowShape, parameters: Parameters[np.ndarray], has_all_rows: bool) -> Nlp:
        """Return the program of the windows of a shape."""
        return Nlp(self._problem.model, shape, parameters, has_all_rows)

    def _answer(self, method: str, *arguments: Any) -> Any:
        """Answer a call in the copy of the process, in which programs are compiled and solved."""
        return getattr(self, method)(*arguments)

    def _compile(self, key: CompiledKey, parameters: Parameters[np.ndarray]) -> None:
        """Have CasADi build the IPOPT or fatrop solver of a program, unless it is there.

        It runs in the copy of the process that can be ended: it may take a minute, during which no signal would be
        noticed.

        Args:
            key: Which program, and whether its solves start from multipliers.
            parameters: The parameters of one window of that shape, for their sizes.
        """
        if key in self._compiled:
            return
        program, is_warm = key
        nlp = self._nlp(program, parameters)
        options: dict[str, Any] = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False}
        settings = {**self._settings, **(WARM_START if is_warm else {})}
        if self._plugin == "fatrop":  # it has to be told which variables and rows are of which node
            options |= {"structure_detection": "manual", **nlp.sizes}
            if nlp.is_nearly_redundant:  # a smaller tolerance would not be reached
                settings = {**settings, "tol": max(settings.get("tol", 0.0), INTERVAL_TOLERANCE)}
        if np.isfinite(self.deadline):
            self._clocks[key] = options["iteration_callback"] = _Clock(nlp.program)
        printed = {} if self._report is None else {"print_level": PRINT_LEVEL}
        options[self._plugin] = {**settings, **printed}
        self._compiled[key] = ca.nlpsol("window", self._plugin, nlp.program, {**options, **nlp.derivatives})

    def _call(
        self, key: CompiledKey, arguments: Mapping[str, np.ndarray], stop_at: float
    ) -> tuple[dict[str, np.ndarray], dict[str, Any], float, str]:
        """Solve a program with the solver that `_compile` has built, in the copy of the process.

        Args:
            key: Which solver.
            arguments: Its arguments by CasADi's names, such as x0 and p.
            stop_at: When it has to stop, an instant of `time.perf_counter` [s]. IPOPT alone looks at it.

        Returns:
            Solution, objective, constraints and multipliers by CasADi's names (x, f, g, lam_x, lam_g); whether and how
            it succeeded, and its iterations; the wall time [s]; what it printed, empty unless that is reported.
        """
        if key in self._clocks:
            self._clocks[key].stop_at = stop_at
        began = time.perf_counter()
        with redirect_stdout(io.StringIO()) if self._report else nullcontext(io.StringIO()) as text:
            result = self._compiled[key](**arguments)
        wall_time = time.perf_counter() - began
        vectors = {name: _array(result[name]) for name in ("x", "f", "g", "lam_x", "lam_g")}
        stats = self._compiled[key].stats()
        counted = {name: stats[name] for name in ("success", "return_status", "iter_count")}
        return vectors, counted, wall_time, text.getvalue()

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        duals = NO_DUALS
        if self._has_duals and previous is not None and window_shape(previous.window) == window_shape(window):
            duals = previous.duals
        solution = self._solved(window, guess, guess, within, has_all_rows=False, duals=duals)
        if solution.outcome.usable and missing_row_violation(self._problem.model, window, solution.plan) > FEASIBLE:
            complete = self._solved(window, guess, solution.plan, within, has_all_rows=True)
            iterations = solution.iterations + complete.iterations
            wall_time = solution.wall_time + complete.wall_time
            solution = replace(complete, iterations=iterations, wall_time=wall_time)
        return replace(solution, warm=previous is not None)

    def _solved(
        self,
        window: Window,
        guess: Plan,
        start: Plan,
        within: float,
        has_all_rows: bool,
        duals: np.ndarray = NO_DUALS,
    ) -> Solution:
        """Solve a window's NLP in the process that may be ended, compiled there when its shape is first met.

        Args:
            window: The window.
            guess: The plan about which limits of rates and durations are: all solves of a window share it.
            start: The plan that the iterations start from, most often the guess.
            within: Durations are kept within so many seconds of those of the guess.
            has_all_rows: The NLP has all rows of constraints, not only those that were near their bounds.
            duals: Multipliers to start from, of bounds and rows; (0,) for none.

        Returns:
            The solution; where the deadline has passed, the last iterate, which counts if it is feasible.
        """
        nlp, x0, p = self._posed(window, start, has_all_rows)
        is_warm = len(duals) > 0
        key = (nlp.shape, has_all_rows), is_warm
        bounds = nlp.bounds(window, guess, within)
        try:
            with self._solving:
                if key not in self._ready:
                    self._calls(LONGEST_COMPILATION, "_compile", key, window_numbers(window, start.switch_times))
                    self._ready.add(key)
                stop_at = self.stop_time(time.perf_counter())
                arguments = nlp.arguments(x0, p, bounds)
                if is_warm:
                    arguments["lam_x0"], arguments["lam_g0"] = np.split(duals, [len(arguments["x0"])])
                result, stats, wall_time, written = self._calls(LONGEST_CALL, "_call", key, arguments, stop_at)
        except BaseException:
            self._ready.clear()  # the copy has ended with what it had compiled
            raise
        if self._report is not None:
            for line in filter(ITERATION.match, written.splitlines()):
                self._report(line)
        z = nlp.point(result["x"], p)
        outcome = Outcome.OPTIMAL if stats["success"] else OUTCOMES.get(stats["return_status"], Outcome.FAILED)
        stepped = outcome is Outcome.DEADLINE and stats["iter_count"] > 0  # else this is the guess
        if not np.isfinite(z).all():
            outcome = Outcome.FAILED
        elif stepped and _violation(bounds, z, _array(nlp.rows(z, p))) <= FEASIBLE:
            outcome = Outcome.FEASIBLE
        costs, terminal = nlp.costs(z, p)
        plan, violations = _unpacked(nlp, window, z)
        return Solution(
            outcome=outcome,
            plan=plan,
            objective=float(result["f"][0]),
            iterations=int(stats["iter_count"]),
            wall_time=wall_time,
            window=window,
            guess=guess,
            costs=_array(costs),
            terminal=float(terminal),
            violations=violations,
            duals=np.concatenate([result["lam_x"], result["lam_g"]]) if self._has_duals else NO_DUALS,
            guess_duals=duals,
            bound_multiplier=float(result["lam_g"][-1]) if np.isfinite(window.cost_bound) else np.nan,
        )


def _unpacked(nlp: Nlp, window: Window, z: np.ndarray) -> tuple[Plan, np.ndarray]:
    """Return the plan of a decision vector, and by how much its nodes violate soft limits at worst."""
    X, tau, _, _, violations, _, *inputs = (np.ascontiguousarray(component.full().T) for component in nlp.unpack(z))
    n = nlp.grid.n
    first = nlp.grid.first_node
    plan = plan_on_mesh(window, X, np.zeros((nlp.grid.K, n)), tau[0])
    for s, stage in enumerate(window.stages):
        nodes = slice(first[s], first[s + 1] + 1)
        means = np.diff(X[nodes, n:], axis=0) / np.diff(plan.times[nodes])[:, None]
        plan.u[first[s] : first[s + 1]] = inputs[s] if stage.input == "joint" else means
    return plan, violations[1:].max(axis=0) / PENALTY


def _violation(bounds: Mapping[str, np.ndarray], z: np.ndarray, g: np.ndarray) -> float:
    """Return by how much z and g(z) violate their bounds at worst."""
    past = (bounds["lbx"] - z, z - bounds["ubx"], bounds["lbg"] - g, g - bounds["ubg"])
    return float(max(piece.max(initial=0.0) for piece in past))
