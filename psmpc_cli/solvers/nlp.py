"""The back-ends that take a window as a flat nonlinear program: IPOPT and fatrop, both in the CasADi wheel.

Decision vectors z, parameter vectors p, bounds and multipliers in the order of the program exist in this module alone:
direct multiple shooting with the durations as constant states. The objective is that of docs/formulation.md divided by
the window's largest priority; variables and rows are ordered so that structure-exploiting solvers apply. Nothing but
the shape of a window is fixed in its program; all numbers are parameters.
"""

import io
import re
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext, redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.plan import Grid, Plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import (
    PENALTY,
    SHORTEST,
    Parameters,
    Window,
    WindowShape,
    node_limits,
    plan_on_mesh,
    scaled_violations,
    shortest_durations,
    window_numbers,
    window_shape,
)
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.specs.task import SolverSpec

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
    "Maximum_WallTime_Exceeded": Outcome.DEADLINE,
    1: Outcome.ITERATION_LIMIT,
}
"""Outcomes by the return codes of IPOPT (texts) and fatrop (numbers)."""

BARRIER_START = 1e-4
"""fatrop: the first barrier parameter. The shifted plan is a good guess, and 1e-2 costs a third more iterations."""


@dataclass(frozen=True)
class Layout(Grid):
    """Offsets of the decision variables x_0, u_0, x_1, u_1, ..., x_K, each x_k = [Q; Qdot; tau_0 .. tau_{S-1}].

    Where costs of other stages are bounded, their sums so far follow on the durations in each x_k. Where limits are
    soft, rho times the violations of [Q; Qdot], e_k, follow on u_k, and on x_K.

    Attributes:
        inputs: Inputs of each stage.
        soft: Limits on the states may be violated.
        sums: Number of sums of costs.
    """

    inputs: tuple[int, ...]
    soft: bool = False
    sums: int = 0

    @property
    def nx(self) -> int:
        """Size of x_k, durations and sums included."""
        return 2 * self.n + self.switches + self.sums

    @property
    def durations(self) -> slice:
        """Where the durations are in x_k."""
        return slice(2 * self.n, 2 * self.n + self.switches)

    @cached_property
    def offsets(self) -> np.ndarray:
        """Offset of x_k in the decision vector, (K + 1,)."""
        sizes = [self.nx + self.inputs[s] + self.violations for s in self.stage_of]
        return np.concatenate([[0], np.cumsum(sizes)]).astype(int)

    @property
    def size(self) -> int:
        """Size of the decision vector."""
        return int(self.offsets[-1]) + self.nx + self.violations

    @property
    def violations(self) -> int:
        """Number of violations e_k at a node: 0 where limits are hard."""
        return 2 * self.n if self.soft else 0

    @cached_property
    def state_index(self) -> np.ndarray:
        """Indices of [Q; Qdot] at each node, (K + 1, 2n)."""
        return self.offsets[:, None] + np.arange(2 * self.n)[None, :]

    @cached_property
    def duration_index(self) -> np.ndarray:
        """Indices of the durations at each node, (K + 1, S)."""
        return self.offsets[:, None] + 2 * self.n + np.arange(self.switches)[None, :]

    @cached_property
    def violation_index(self) -> np.ndarray:
        """Indices of the violations e_k at the nodes, (K + 1, 2n); (K + 1, 0) where limits are hard."""
        inputs = np.array([*(self.inputs[s] for s in self.stage_of), 0])
        return np.asarray((self.offsets + self.nx + inputs)[:, None] + np.arange(self.violations))

    @cached_property
    def input_index(self) -> tuple[np.ndarray, ...]:
        """Indices of the inputs of each stage's intervals, (N_s, inputs)."""
        first = [self.offsets[a:b] for a, b in pairwise(self.first_node)]
        return tuple(k[:, None] + self.nx + np.arange(inputs) for k, inputs in zip(first, self.inputs, strict=True))


class Nlp:
    """A window's NLP: min f(x, p) subject to bounds on x and g(x, p), for the windows of one shape.

    Paper eq. (20), with the departures of docs/formulation.md. The rows of g are node by node: the gap to the next node
    first, then the path rows of the node.

    Attributes:
        shape: The window's shape.
        layout: Offsets of the decision variables.
        problem: Decision variables x, parameters p, objective f and constraints g, as CasADi's solvers take them.
        nx, nu, ng: Sizes of state, of input with violations of soft limits, and of path rows at each node, (K + 1,).
        x0_rows: Rows that fix the initial state, (2n,).
        last_duration_row: Row with the last stage's duration, None with one stage.
        instant_rows: Row with the cumulated duration to the end of a stage with a fixed switching time, by stage.
        end_rows: Rows with the end condition, error rows first, then rates, by stage of the window.
        limit_rows: Rows of soft limits at the nodes, below and above, (2, K + 1, 2n); (2, K + 1, 0) if hard.
        kept_rows: Rows with the cost integral of each kept stage, or with its errors at the nodes after the first.
    """

    def __init__(self, model: RobotModel, shape: WindowShape) -> None:
        self._functions = [stage_functions(model, stage) for stage in (*shape.stages, *shape.kept)]
        inputs = tuple(functions.inputs for functions in self._functions[: len(shape.stages)])
        sums = 0 if shape.kept_errors else len(shape.kept)
        self.shape, self.layout = shape, Layout(model.n, shape.nodes, inputs, shape.soft, sums)
        layout, self._p = self.layout, self._symbolic_parameters()
        xs = [ca.SX.sym(f"x{k}", layout.nx) for k in range(layout.K + 1)]
        us = [ca.SX.sym(f"u{k}", layout.inputs[layout.stage_of[k]]) for k in range(layout.K)]
        es = [ca.SX.sym(f"e{k}", layout.violations) for k in range(layout.K + 1)]
        x = ca.vertcat(*(v for node in zip(xs, [*us, ca.SX(0, 1)], es, strict=True) for v in node))
        costs, S = [ca.SX(0) for _ in layout.nodes], layout.switches
        for k, s in enumerate(layout.stage_of):
            costs[s] += self._L(int(s), k - int(layout.first_node[s]), xs[k], us[k]) * self._step(k, xs[k])
        kept = [
            [self._L(S + 1 + i, k, xs[k], us[k]) * self._step(k, xs[k]) for k in range(layout.K)]
            for i in range(len(shape.kept))
        ]
        terminal = self._p.terminal * self._L(S, layout.nodes[S], xs[-1], ca.SX.zeros(layout.inputs[S]))
        pending = sum((ca.sum1(xs[0][layout.durations][:s]) for s in range(1, S + 1)), ca.SX(0))
        J = ca.dot(self._p.omega, ca.vertcat(*costs)) + self._p.pending * pending + self._p.omega[-1] * terminal
        self._added, self.count = list[ca.SX](), 0
        ng = self._write_rows(xs, us, es, kept)
        if shape.bounded:
            self._add(costs[-1] + terminal)
            ng[-1] += 1
        self.nx, self.ng = (layout.nx,) * (layout.K + 1), tuple(ng)
        self.nu = tuple(inputs + layout.violations for inputs in (*(layout.inputs[s] for s in layout.stage_of), 0))
        numbers = ca.vertcat(*(ca.vec(piece) for piece in self._p.pieces()))
        self.problem = {"x": x, "p": numbers, "f": J + self._penalty(xs, es), "g": ca.vertcat(*self._added)}
        self._costs = ca.vertcat(*map(sum, kept), *costs), terminal

    @cached_property
    def costs(self) -> ca.Function:
        """x, p -> normalized cost integrals without priorities, of kept stages, then (S + 1,); the terminal cost."""
        return ca.Function("costs", [self.problem[name] for name in "xp"], list(self._costs))

    @cached_property
    def rows(self) -> ca.Function:
        """x, p -> g."""
        return ca.Function("rows", [self.problem[name] for name in "xp"], [self.problem["g"]])

    def _add(self, row: ca.SX) -> np.ndarray:
        """Add rows to g and return their indices."""
        self._added.append(row)
        self.count += row.shape[0]
        return np.arange(self.count - row.shape[0], self.count)

    def _L(self, s: int, node: int, x: ca.SX, u: ca.SX) -> ca.SX:
        """Return the normalized cost of a stage, or of a kept one, at one of its nodes, 0 to N_s."""
        p, n, S = self._p, self.layout.n, self.layout.switches
        wanted = self._reference(s, node, self._duration(min(s, S), x))
        Lbar = self._functions[s].cost(x[: 2 * n], u, wanted, p.weights[s], p.control_weights[s])
        return (Lbar - p.offset[s]) / p.scale[s]

    def _duration(self, s: int, x: ca.SX) -> ca.SX:
        """Return tau_s of a stage from a node's state; the last stage takes what is left of the horizon."""
        tau = x[self.layout.durations]
        return self._p.horizon - ca.sum1(tau) if s == self.layout.switches else tau[s]

    def _step(self, k: int, x: ca.SX) -> ca.SX:
        """Return the length of an interval from the state at one of its ends."""
        s = int(self.layout.stage_of[k])
        return self._duration(s, x) / self.layout.nodes[s]

    def _reference(self, s: int, node: int, tau: ca.SX) -> ca.SX:
        """Return what a stage's cost follows at one of its nodes if the stage lasts tau [s]."""
        path, nodes = self._p.paths[s], self._p.paths[s].shape[1] // 2
        return path[:, node] + path[:, nodes + node] * tau if nodes else self._p.targets[s]

    def _penalty(self, xs: list[ca.SX], es: list[ca.SX]) -> ca.SX:
        """Return what violated soft limits cost: rho times the integral of the violations, by the trapezoidal rule."""
        before, after = ([self._step(k, xs[k + i]) for k in range(self.layout.K)] for i in (1, 0))
        none = [ca.SX(0)]
        shares = [(one + other) / 2 for one, other in zip(none + before, after + none, strict=True)]
        return sum((share * ca.sum1(e) for share, e in zip(shares, es, strict=True)), ca.SX(0))

    def _write_rows(self, xs: list[ca.SX], us: list[ca.SX], es: list[ca.SX], kept: list[list[ca.SX]]) -> list[int]:
        """Write the constraints node by node and return the number of path rows at each."""
        layout, stages, ng = self.layout, self.shape.stages, []
        limits, size = [], 2 * layout.n
        self.end_rows: dict[int, np.ndarray] = {}
        kept_rows: list[list[np.ndarray]] = [[] for _ in kept]
        for k, (x, e) in enumerate(zip(xs, es, strict=True)):
            if k < layout.K:
                self._add(self._gap(k, xs, us, kept))
            before = self.count
            if k == 0:
                self._write_start(x)
            elif k in layout.first_node[1:-1]:
                s = int(layout.stage_of[k - 1])
                if stages[s].end_rows:
                    self.end_rows[s] = self._add(self._functions[s].end(x[:size], self._p.targets[s]))
            for i, rows in enumerate(kept_rows):
                if self.shape.kept_errors and k:
                    s = len(stages) + i
                    wanted = self._reference(s, k, self._p.horizon)
                    rows.append(self._add(self._functions[s].residual(x[: layout.n], wanted)))
                elif layout.sums and k == layout.K:
                    rows.append(self._add(x[layout.durations.stop + i]))
            violated = x[: layout.violations], e / PENALTY
            limits.append([self._add(violated[0] + violated[1]), self._add(violated[0] - violated[1])])
            ng.append(self.count - before)
        self.limit_rows = np.array(limits, int).transpose(1, 0, 2)
        self.kept_rows = [np.concatenate(rows) for rows in kept_rows]
        return ng

    def _write_start(self, x: ca.SX) -> None:
        layout = self.layout
        measured = ca.vertcat(self._p.x0, ca.SX.zeros(layout.sums))
        self.x0_rows = self._add(ca.vertcat(x[: 2 * layout.n], x[layout.durations.stop :]) - measured)
        self.last_duration_row: int | None = None
        if layout.switches:
            self.last_duration_row = int(self._add(self._duration(layout.switches, x))[0])
        tau, fixed = x[layout.durations], [s for s, stage in enumerate(self.shape.stages[:-1]) if stage.fixed_end]
        self.instant_rows = {s: int(self._add(ca.sum1(tau[: s + 1]))[0]) for s in fixed}

    def _gap(self, k: int, xs: list[ca.SX], us: list[ca.SX], kept: list[list[ca.SX]]) -> ca.SX:
        layout, s = self.layout, int(self.layout.stage_of[k])
        step = self._functions[s].step(self.shape.discretization)
        after = step(xs[k][: 2 * layout.n], us[k], self._step(k, xs[k]))
        sums = [xs[k][layout.durations.stop + i] + kept[i][k] for i in range(layout.sums)]
        return xs[k + 1] - ca.vertcat(after, xs[k][layout.durations], *sums)

    def _symbolic_parameters(self) -> Parameters[ca.SX]:
        """Return the parameters as symbols."""
        shape, each = self.shape, list(enumerate(self._functions))
        shapes, nodes = (*shape.stages, *shape.kept), (*shape.nodes, *(self.layout.K for _ in shape.kept))
        columns = [2 * (N + 1) if stage.moving else 0 for stage, N in zip(shapes, nodes, strict=True)]
        return Parameters(
            x0=ca.SX.sym("x0", 2 * self.layout.n),
            horizon=ca.SX.sym("T_h"),
            pending=ca.SX.sym("delta"),
            terminal=ca.SX.sym("kappa"),
            omega=ca.SX.sym("omega", len(shape.stages)),
            offset=ca.SX.sym("offset", len(each)),
            scale=ca.SX.sym("scale", len(each)),
            weights=tuple(ca.SX.sym(f"W_{s}", stage.rows) for s, stage in each),
            control_weights=tuple(ca.SX.sym(f"W_r_{s}", stage.inputs) for s, stage in each),
            targets=tuple(ca.SX.sym(f"target_{s}", stage.numbers) for s, stage in each),
            paths=tuple(ca.SX.sym(f"path_{s}", stage.numbers, columns[s]) for s, stage in each),
        )


def _outcome(stats: Mapping[str, object], z: np.ndarray) -> Outcome:
    if not np.all(np.isfinite(z)):
        return Outcome.FAILED
    if stats["success"]:
        return Outcome.OPTIMAL
    return OUTCOMES.get(stats["return_status"], Outcome.FAILED)


class NlpSolver(Solver):
    """Windows by IPOPT or fatrop: one transcribed and compiled NLP for each shape, kept for all windows of that shape.

    Args:
        problem: The problem.
        spec: The back-end and its settings.
        report: Takes the lines of the table of iterations.
        options: Replace the options of the plug-in itself.
    """

    def __init__(
        self,
        problem: Problem,
        spec: SolverSpec,
        report: Report | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self._problem, self._plugin, self._report = problem, spec.kind, report
        settings: dict[str, Any] = {"print_level": 0, "tol": spec.tolerance, "max_iter": spec.max_iterations}
        if spec.kind == "ipopt":
            settings |= {"sb": "yes", "mu_init": 1e-2, "acceptable_iter": 0}
            settings |= {} if spec.deadline is None else {"max_wall_time": spec.deadline}
        else:
            settings["mu_init"] = BARRIER_START
        self._settings = settings if options is None else dict(options)
        self._nlps: dict[WindowShape, Nlp] = {}
        self._compiled: dict[WindowShape, ca.Function] = {}

    def nlp(self, window: Window) -> Nlp:
        """Return the NLP of a window, transcribed on first use."""
        shape = window_shape(window)
        if shape not in self._nlps:
            if shape.bounded and self._plugin != "ipopt":
                raise InputError(f"found a bound on a cost and the solver {self._plugin}, expected ipopt")
            self._nlps[shape] = Nlp(self._problem.model, shape)
        return self._nlps[shape]

    def violation(self, window: Window, plan: Plan) -> float:
        """Return by how much a plan on the mesh of a window violates a constraint at worst."""
        nlp, z = self.nlp(window), self._pack(window, plan)
        g = nlp.rows(z, _flat(window, plan.instants))
        return _violation(_bounds(nlp, window, plan, np.inf), z, np.asarray(g).ravel())

    def costs(self, window: Window, plan: Plan) -> np.ndarray:
        """Return what each stage adds to the objective at priority 1 along a plan on the mesh of a window, (S + 1,)."""
        nlp = self.nlp(window)
        costs, terminal = nlp.costs(self._pack(window, plan), _flat(window, plan.instants))
        return np.append(np.asarray(costs).ravel()[:-1], float(costs[-1] + terminal))

    def _function(self, nlp: Nlp) -> ca.Function:
        """Return the compiled solver of a program."""
        if nlp.shape not in self._compiled:
            options: dict[str, Any] = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False}
            if self._plugin == "fatrop":
                sizes = {"N": len(nlp.nu) - 1, "nx": nlp.nx, "nu": nlp.nu, "ng": nlp.ng}
                options |= {"structure_detection": "manual", **sizes}
            loud = {} if self._report is None else {"print_level": PRINT_LEVEL}
            options[self._plugin] = {**self._settings, **loud}
            self._compiled[nlp.shape] = ca.nlpsol("window", self._plugin, nlp.problem, options)
        return self._compiled[nlp.shape]

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        nlp = self.nlp(window)
        solver, bounds = self._function(nlp), _bounds(nlp, window, guess, within)
        p, began = _flat(window, guess.instants), time.perf_counter()
        with redirect_stdout(io.StringIO()) if self._report else nullcontext(io.StringIO()) as written:
            result = solver(x0=self._pack(window, guess), p=p, **bounds)
        wall_time = time.perf_counter() - began
        if self._report is not None:
            for line in filter(ITERATION.match, written.getvalue().splitlines()):
                self._report(line)
        found, stats = {name: np.asarray(values).ravel() for name, values in result.items()}, solver.stats()
        z, layout = found["x"], nlp.layout
        outcome, iterations = _outcome(stats, z), int(stats["iter_count"])
        stepped = outcome is Outcome.DEADLINE and iterations > 0  # else this is the guess
        if stepped and _violation(bounds, z, found["g"]) <= FEASIBLE:
            outcome = Outcome.FEASIBLE
        costs, terminal = nlp.costs(z, p)
        return Solution(
            outcome=outcome,
            plan=_unpack(layout, window, z),
            objective=found["f"].item(),
            iterations=iterations,
            wall_time=wall_time,
            window=window,
            guess=guess,
            warm=previous is not None,
            costs=np.asarray(costs).ravel(),
            terminal=float(terminal),
            violations=z[layout.violation_index[1:]].max(axis=0) / PENALTY,
            bound_multiplier=float(found["lam_g"][-1]) if np.isfinite(window.cost_bound) else np.nan,
        )

    def _pack(self, window: Window, plan: Plan) -> np.ndarray:
        """Return the decision vector of a plan on the mesh of a window."""
        layout = self.nlp(window).layout
        z, u = np.zeros(layout.size), plan.u
        z[layout.state_index] = plan.X
        z[layout.duration_index] = np.diff(plan.instants, prepend=window.start)
        for s, stage in enumerate(window.stages):
            at = slice(layout.first_node[s], layout.first_node[s + 1])
            joint = stage.input == "joint"
            z[layout.input_index[s]] = u[at] if joint else self._problem.costs.task_acceleration(plan.X[at], u[at])
        if layout.soft:
            z[layout.violation_index] = scaled_violations(plan.X, *_state_limits(layout, window, plan))
        return z


def _state_limits(layout: Layout, window: Window, guess: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return low and high of [Q; Qdot] at the nodes, (K + 1, 2n) each; those of v in the chart about a guess."""
    low, high = node_limits(layout, window.stages)
    if window.chart.spatial:
        n = layout.n
        shift = window.shift_of_limits(guess)
        low[:, n:] += shift
        high[:, n:] += shift
    return low, high


def _unpack(layout: Layout, window: Window, z: np.ndarray) -> Plan:
    """Return the plan of a decision vector."""
    u = np.zeros((layout.K, layout.n))
    plan = plan_on_mesh(window, z[layout.state_index], u, z[layout.duration_index[0]])
    for s, stage in enumerate(window.stages):
        first, last = layout.first_node[s], layout.first_node[s + 1]
        if stage.input == "joint":
            u[first:last] = z[layout.input_index[s]]
        else:
            times, velocities = plan.times[first : last + 1], plan.X[first : last + 1, layout.n :]
            u[first:last] = np.diff(velocities, axis=0) / np.diff(times)[:, None]
    return plan


def _flat(window: Window, instants: np.ndarray) -> np.ndarray:
    """Return the parameter vector of a window, its instants guessed at (S,) [s]."""
    return np.concatenate([np.ravel(piece, order="F") for piece in window_numbers(window, instants).pieces()])


def _bounds(nlp: Nlp, window: Window, guess: Plan, within: float) -> dict[str, np.ndarray]:
    """Return lbx, ubx, lbg, ubg of a window, durations within so many seconds of the guess. Paper (14), (17), (18)."""
    layout = nlp.layout
    lbx, ubx = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    lbg, ubg = np.zeros(nlp.count), np.zeros(nlp.count)
    low, high = _state_limits(layout, window, guess)
    for s, stage in enumerate(window.stages):
        if stage.input == "joint":
            inputs = layout.input_index[s]
            lbx[inputs], ubx[inputs] = stage.limits.acceleration_low, stage.limits.acceleration_high
    tau = np.diff(guess.instants, prepend=window.start)
    lbx[layout.duration_index[0]] = np.maximum(shortest_durations(window)[:-1], tau - within)
    ubx[layout.duration_index[0]] = tau + within
    if layout.soft:
        lbx[layout.violation_index] = 0.0
        lbg[nlp.limit_rows], ubg[nlp.limit_rows] = [low, np.full_like(low, -np.inf)], [np.full_like(high, np.inf), high]
    else:
        lbx[layout.state_index[1:]], ubx[layout.state_index[1:]] = low[1:], high[1:]
    if nlp.last_duration_row is not None:
        lbg[nlp.last_duration_row], ubg[nlp.last_duration_row] = SHORTEST, np.inf
    for s, row in nlp.instant_rows.items():
        at = window.stages[s].at
        lbg[row] = ubg[row] = (0.0 if at is None else at) - window.start
    for s, rows in nlp.end_rows.items():
        tolerance, drift = window.stages[s].end_tolerance, window.stages[s].end_drift
        lbg[rows], ubg[rows] = drift - tolerance, drift + tolerance
    for rows, each in zip(nlp.kept_rows, window.kept, strict=True):
        lbg[rows], ubg[rows] = -each.bound.ravel() if each.bound.ndim else -np.inf, each.bound.ravel()
    if np.isfinite(window.cost_bound):
        lbg[-1], ubg[-1] = -np.inf, window.cost_bound
    return {"lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg}


def _violation(bounds: Mapping[str, np.ndarray], z: np.ndarray, g: np.ndarray) -> float:
    """Return by how much z and g(z) violate their bounds at worst."""
    past = (bounds["lbx"] - z, z - bounds["ubx"], bounds["lbg"] - g, g - bounds["ubg"])
    return float(max(piece.max(initial=0.0) for piece in past))
