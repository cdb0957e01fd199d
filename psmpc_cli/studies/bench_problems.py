"""A recorded window on a mesh: the numbers every back-end is given, and the optimum they are held against."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.node_counts import Along, node_counts
from psmpc_cli.ocp.plan import Plan, resting_plan, shift
from psmpc_cli.ocp.window import SHORTEST, Window
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import NlpSolver, Outcome, Solution
from psmpc_cli.specs.task import SolverSpec, TaskSpec
from psmpc_cli.studies.bench_cost import cost_over_time
from psmpc_cli.studies.bench_windows import Recorded

TIGHT, POLISHED = 1e-10, 1e-12
"""Tolerances of the optimum that all others are held against: of fatrop's, and of what IPOPT makes of that.

A barrier leaves J too high by about its tolerance times the number of bounds: at 1e-10 and N_s = 100 by 1e-9 to 1e-8.
"""

PATIENT = 2000
"""Iterations it may take."""

POLISHING = {
    "print_level": 0,
    "sb": "yes",
    "tol": POLISHED,
    "max_iter": PATIENT,
    "mu_init": 1e-6,
    "bound_relax_factor": 0.0,
    "acceptable_iter": 0,
}
"""Options of IPOPT: a tight tolerance, and bounds as they are: by default it moves them by 1e-8."""

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
class Start:
    """Where a solve starts: a plan, and the solution of the sample before if there is one."""

    guess: Plan
    previous: Solution | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """A recorded window on a mesh.

    Attributes:
        index: Number of the window.
        nodes: The mesh, as `controller.nodes` has it.
        window: The window, with the nodes of its stages.
        variables: Decision variables of its NLP.
        starts: Where a solve starts, by warm and cold.
        optimum: What it comes to; None where neither back-end converged.
        costs: The errors of the robot.
    """

    index: int
    nodes: str
    window: Window
    variables: int
    starts: Mapping[str, Start]
    optimum: Optimum | None
    costs: StageCosts

    def over_time(self, plan: Plan) -> float:
        """Return what a plan costs over time."""
        return cost_over_time(self.window, plan, self.costs)


class Mesh:
    """Prepares recorded windows on one mesh, each by what the sample before comes to there."""

    def __init__(self, task: TaskSpec, experiment: Experiment) -> None:
        self.spec, self.costs = task.controller, experiment.costs
        self._solver = NlpSolver(experiment.problem, _tight(task.solver, "fatrop"))
        self._polisher = NlpSolver(experiment.problem, _tight(task.solver, "ipopt"), options=POLISHING)

    def prepare(self, index: int, recorded: Recorded) -> Problem:
        """Return a recorded window on this mesh."""
        before, had = recorded.before, self._on_it(recorded.before.window, recorded.before.plan, {})
        last = self._solver.solve(had, before.plan)
        previous = last if last.outcome.usable else None
        plan = before.plan if previous is None else previous.plan
        prediction = shift(plan, recorded.window.start, recorded.window.horizon, recorded.window.x0)
        instants = _instants(recorded, had, plan)
        counts = {stage.index: N for stage, N in zip(had.stages, had.nodes, strict=True)}
        guess = replace(prediction, instants=instants)
        window = self._on_it(recorded.window, guess, counts)
        resting = resting_plan(window.start, window.horizon, RESTING_NODES, window.x0)
        problem = Problem(
            index=index,
            nodes=str(self.spec.nodes),
            window=window,
            variables=self._solver.nlp(window).layout.size,
            starts={"warm": Start(guess, previous), "cold": Start(replace(resting, instants=instants))},
            optimum=None,
            costs=self.costs,
        )
        return replace(problem, optimum=self._optimum(problem, self._solver.solve(window, guess, previous)))

    def _on_it(self, window: Window, plan: Plan, had: Mapping[int, int]) -> Window:
        """Return a window with the nodes its stages get, predicted by a plan; `had` are those of stages before."""
        spec = self.spec
        if spec.nodes != "auto":
            return replace(window, nodes=(spec.nodes,) * len(window.stages))
        along = Along(plan, self.costs, spec.sample_time)
        return replace(window, nodes=node_counts(window, plan.instants, along, spec.mesh_tolerance, had))

    def _optimum(self, problem: Problem, found: Solution) -> Optimum | None:
        """Return what IPOPT makes of fatrop's optimum, which itself where IPOPT does not converge."""
        start = found.plan if found.outcome.usable else found.guess
        polished = self._polisher.solve(problem.window, start)
        converged = [each for each in (polished, found) if each.outcome is Outcome.OPTIMAL]
        if not converged:
            return None
        best = converged[0]
        apart = abs(relative(found.objective, polished.objective)) if len(converged) > 1 else np.nan
        return Optimum(best.objective, best.plan.instants, problem.over_time(best.plan), apart)


def relative(value: float, to: float) -> float:
    """Return by how much a value is above another one, over that."""
    return (value - to) / max(abs(to), np.finfo(float).tiny)


def _tight(solver: SolverSpec, kind: str) -> SolverSpec:
    return solver.model_copy(update={"kind": kind, "tolerance": TIGHT, "max_iterations": PATIENT, "deadline": None})


def _instants(recorded: Recorded, before: Window, plan: Plan) -> np.ndarray:
    """Return the guessed instants (S,) [s]: those of the plan before, by stage, and of a new stage the detected one."""
    ends = dict(zip((stage.index for stage in before.stages), plan.instants, strict=False))
    guessed = zip(recorded.window.stages, recorded.instants, strict=False)
    instants = np.array([ends.get(stage.index, detected) for stage, detected in guessed])
    earliest = recorded.window.start + SHORTEST * np.arange(1, len(instants) + 1)
    return np.asarray(np.maximum(instants, earliest))
