"""The back-ends that take a window as a flat nonlinear program: IPOPT and fatrop, both in the CasADi wheel.

Decision vectors z, parameter vectors p, bounds and multipliers in the order of the program exist in this module alone.
"""

import io
import re
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext, redirect_stdout
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import (
    PENALTY,
    SHORTEST,
    Window,
    WindowShape,
    end_tolerance,
    node_limits,
    plan_on_mesh,
    scaled_violations,
    shortest_durations,
    window_numbers,
    window_shape,
)
from psmpc_cli.solvers.base import FEASIBLE, Outcome, Solution, Solver
from psmpc_cli.solvers.transcription import Layout, Nlp
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
        shift = window.chart.rate_shift(guess.X)
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
        tolerance = end_tolerance(window.stages[s])
        lbg[rows], ubg[rows] = -tolerance, tolerance
    for rows, each in zip(nlp.kept_rows, window.kept, strict=True):
        lbg[rows], ubg[rows] = -each.bound.ravel() if each.bound.ndim else -np.inf, each.bound.ravel()
    if np.isfinite(window.cost_bound):
        lbg[-1], ubg[-1] = -np.inf, window.cost_bound
    return {"lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg}


def _violation(bounds: Mapping[str, np.ndarray], z: np.ndarray, g: np.ndarray) -> float:
    """Return by how much z and g(z) violate their bounds at worst."""
    past = (bounds["lbx"] - z, z - bounds["ubx"], bounds["lbg"] - g, g - bounds["ubg"])
    return float(max(piece.max(initial=0.0) for piece in past))
