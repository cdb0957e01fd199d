"""A recorded window on a mesh: the numbers every back-end is given, and the optimum they are held against."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.window_solver import WindowSolver
from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.node_counts import Along, node_counts
from psmpc_cli.ocp.plan import Plan, resting_plan, shift
from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.ocp.window import SHORTEST, Bounds, Window, bounds, pack_guess, unpack_plan
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Guess, Outcome, Solution, Solver
from psmpc_cli.solvers.casadi_nlp import CasadiSolver
from psmpc_cli.solvers.ipopt import OUTCOMES
from psmpc_cli.specs.task import TaskSpec
from psmpc_cli.studies.bench_cost import cost_over_time
from psmpc_cli.studies.bench_windows import Recorded

TIGHT, POLISHED = 1e-10, 1e-12
"""Tolerances of the optimum that all others are held against: of fatrop's, and of what IPOPT makes of that.

A barrier leaves J too high by about its tolerance times the number of bounds: at 1e-10 and N_s = 100 by 1e-9 to 1e-8.
"""

PATIENT = 2000
"""Iterations it may take."""

RESTING_NODES = 100
"""Intervals of the plan that a cold start knows: no control, so any number of them says the same."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """What a window's NLP comes to.

    Attributes:
        objective: J over the window's largest priority.
        instants: Switching instants (S,) [s].
        over_time: What its plan costs over time, see `cost_over_time`.
        apart: How far fatrop's and IPOPT's are apart, relative in J: what it is worth that fatrop moves bounds by 1e-8.
            NaN where one of them did not converge.
    """

    objective: float
    instants: np.ndarray
    over_time: float
    apart: float


@dataclass(frozen=True, eq=False)
class Problem:
    """A recorded window on a mesh.

    Attributes:
        index: Number of the window.
        nodes: The mesh, as `controller.nodes` has it.
        window: The window, with the nodes of its stages.
        nlp: Its NLP, which all windows of its shape share.
        parameters, bounds: Its numbers.
        starts: Where a solve starts, by warm and cold.
        optimum: What it comes to; None where neither back-end converged.
        costs: The errors of the robot.
    """

    index: int
    nodes: str
    window: Window
    nlp: Nlp
    parameters: np.ndarray
    bounds: Bounds
    starts: Mapping[str, Guess]
    optimum: Optimum | None
    costs: StageCosts

    def plan(self, z: np.ndarray) -> Plan:
        """Return the plan a decision vector stands for."""
        return unpack_plan(self.nlp, self.window, z)

    def over_time(self, plan: Plan) -> float:
        """Return what a plan costs over time."""
        return cost_over_time(self.window, plan, self.costs)


class Mesh:
    """Prepares recorded windows on one mesh, each by what the sample before comes to there."""

    def __init__(self, task: TaskSpec, experiment: Experiment) -> None:
        self.spec, self.costs = task.controller, experiment.costs
        self._windows = WindowSolver(_tight(task), experiment.model, experiment.costs)
        self._polishers: dict[Nlp, Solver] = {}

    def prepare(self, index: int, recorded: Recorded) -> Problem:
        """Return a recorded window on this mesh."""
        before, had = recorded.before, self._on_it(recorded.before.window, recorded.before.plan, {})
        last = self._windows.solve(had, before.plan, before.plan.instants)
        previous = last if last.solution.outcome.usable else None
        plan = before.plan if previous is None else previous.plan
        prediction = shift(plan, recorded.window.start, recorded.window.horizon, recorded.window.x0)
        instants = _instants(recorded, had, plan)
        counts = {stage.index: N for stage, N in zip(had.stages, had.nodes, strict=True)}
        window = self._on_it(recorded.window, replace(prediction, instants=instants), counts)
        solved = self._windows.solve(window, prediction, instants, previous)
        nlp, _ = self._windows.compiled_for(window)
        problem = Problem(
            index=index,
            nodes=str(self.spec.nodes),
            window=window,
            nlp=nlp,
            parameters=solved.parameters,
            bounds=bounds(nlp, window),
            starts={"warm": solved.guess, "cold": self._cold(nlp, window, instants)},
            optimum=None,
            costs=self.costs,
        )
        return replace(problem, optimum=self._optimum(problem, solved.solution))

    def _on_it(self, window: Window, plan: Plan, had: Mapping[int, int]) -> Window:
        """Return a window with the nodes its stages get, predicted by a plan; `had` are those of stages before."""
        spec = self.spec
        if spec.nodes != "auto":
            return replace(window, nodes=(spec.nodes,) * len(window.stages))
        along = Along(plan, self.costs, spec.sample_time)
        return replace(window, nodes=node_counts(window, plan.instants, along, spec.mesh_tolerance, had))

    def _cold(self, nlp: Nlp, window: Window, instants: np.ndarray) -> Guess:
        """Return where a solve starts that knows the measured state and the guessed instants (S,) [s] alone."""
        resting = resting_plan(window.start, window.horizon, RESTING_NODES, window.x0)
        return Guess(pack_guess(nlp, window, resting, instants, self.costs))

    def _optimum(self, problem: Problem, found: Solution) -> Optimum | None:
        """Return what IPOPT makes of fatrop's optimum, which itself where IPOPT does not converge."""
        if problem.nlp not in self._polishers:
            self._polishers[problem.nlp] = _polisher(problem.nlp)
        start = Guess(found.z if found.outcome.usable else problem.starts["warm"].z)
        polished = self._polishers[problem.nlp].solve(start, problem.parameters, problem.bounds)
        converged = [each for each in (polished, found) if each.outcome is Outcome.OPTIMAL]
        if not converged:
            return None
        best, plan = converged[0], problem.plan(converged[0].z)
        apart = abs(relative(found.objective, polished.objective)) if len(converged) > 1 else np.nan
        return Optimum(best.objective, plan.instants, problem.over_time(plan), apart)


def relative(value: float, to: float) -> float:
    """Return by how much a value is above another one, over that."""
    return (value - to) / max(abs(to), np.finfo(float).tiny)


def _tight(task: TaskSpec) -> TaskSpec:
    solver = task.solver.model_copy(
        update={"kind": "fatrop", "tolerance": TIGHT, "max_iterations": PATIENT, "deadline": None}
    )
    return task.model_copy(update={"solver": solver})


def _polisher(nlp: Nlp) -> Solver:
    """Return IPOPT with a tight tolerance and bounds as they are: by default it moves them by 1e-8."""
    options = {"print_level": 0, "sb": "yes", "tol": POLISHED, "max_iter": PATIENT, "mu_init": 1e-6}
    exact = {"bound_relax_factor": 0.0, "acceptable_iter": 0}
    return CasadiSolver("ipopt", nlp, {"ipopt": {**options, **exact}}, OUTCOMES)


def _instants(recorded: Recorded, before: Window, plan: Plan) -> np.ndarray:
    """Return the guessed instants (S,) [s]: those of the plan before, by stage, and of a new stage the detected one."""
    ends = dict(zip((stage.index for stage in before.stages), plan.instants, strict=False))
    guessed = zip(recorded.window.stages, recorded.instants, strict=False)
    instants = np.array([ends.get(stage.index, detected) for stage, detected in guessed])
    earliest = recorded.window.start + SHORTEST * np.arange(1, len(instants) + 1)
    return np.asarray(np.maximum(instants, earliest))
