"""The solves that are timed: every window by every back-end, warm and cold, in an order without a pattern."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from psmpc_cli.ocp.transcription import Nlp
from psmpc_cli.solvers import Outcome, Solution, Solver, attempt, build_solver
from psmpc_cli.solvers.casadi_nlp import CasadiSolver
from psmpc_cli.solvers.ipopt import OUTCOMES
from psmpc_cli.specs.task import SolverSpec
from psmpc_cli.studies.bench_problems import Problem

WARM, COLD = "warm", "cold"
"""From the shifted plan with its multipliers, or from rest at the measured state."""

REFERENCE = "reference"
"""The reference way: CasADi with IPOPT as both come, from a cold start at each sample."""


@dataclass(frozen=True)
class Way:
    """One way to solve a window: a back-end by its name in a task, or the reference way, and where it starts."""

    solver: str
    start: str


@dataclass(frozen=True, eq=False)
class Solved:
    """What one way came to in one window, and how long each of its timed solves took.

    Attributes:
        index, nodes: Number of the window, and the mesh.
        stages: Number of stages in the window.
        outcome: How the solve ended.
        iterations: Iterations used.
        objective: J over the window's largest priority.
        instants: Switching instants (S,) [s].
        over_time: What its plan costs over time, see `cost_over_time`.
        violation: By how much a constraint is violated at worst [m, rad, m/s, rad/s, s].
        times: Wall times of the solves (repeats,) [s].
        busy: Processor time of all of them [s]; far less than their sum where the machine does something else.
    """

    index: int
    nodes: str
    stages: int
    way: Way
    outcome: Outcome
    iterations: int
    objective: float
    instants: np.ndarray
    over_time: float
    violation: float
    times: np.ndarray
    busy: float

    @property
    def failed(self) -> bool:
        """Whether its point may not be applied."""
        return not self.outcome.usable


def ways_with(solvers: Iterable[str]) -> tuple[Way, ...]:
    """Return all ways: each of the back-ends warm and cold, and the reference way."""
    return (*(Way(solver, start) for solver in solvers for start in (WARM, COLD)), Way(REFERENCE, COLD))


class _BackEnds:
    """The back-ends of one mesh, each built once for every NLP."""

    def __init__(self, spec: SolverSpec) -> None:
        self._spec = spec.model_copy(update={"deadline": None})
        self._built: dict[tuple[Nlp, str], Solver] = {}
        self._rows: dict[Nlp, ca.Function] = {}

    def solve(self, problem: Problem, way: Way) -> Solution:
        """Solve a problem one way."""
        key = problem.nlp, way.solver
        if key not in self._built:
            self._built[key] = self._build(*key)
        return attempt(self._built[key], problem.starts[way.start], problem.parameters, problem.bounds)

    def _build(self, nlp: Nlp, solver: str) -> Solver:
        if solver == REFERENCE:
            return CasadiSolver("ipopt", nlp, {"ipopt": {"print_level": 0, "sb": "yes"}}, OUTCOMES)
        return build_solver(nlp, self._spec.model_copy(update={"kind": solver}))

    def violation(self, problem: Problem, z: np.ndarray) -> float:
        """Return by how much a point violates a bound or a row at worst."""
        nlp, limits = problem.nlp, problem.bounds
        if nlp not in self._rows:
            self._rows[nlp] = ca.Function("rows", [nlp.x, nlp.p], [nlp.g])
        g = np.asarray(self._rows[nlp](z, problem.parameters)).ravel()
        past = (limits.lbx - z, z - limits.ubx, limits.lbg - g, g - limits.ubg)
        return float(max(piece.max(initial=0.0) for piece in past))


def time_solves(
    problems: Sequence[Problem],
    ways: Sequence[Way],
    spec: SolverSpec,
    repeat: int,
    seed: int,
    passed: Callable[[], None] = lambda: None,
) -> list[Solved]:
    """Return what every way comes to in every problem, each solved once untimed, then so many times.

    The first solves build what is built once. Then each round holds every pair of problem and way, newly shuffled, so
    that whatever else the machine does falls on all of them alike.

    Args:
        problems: Windows on one mesh.
        ways: The ways.
        spec: The task's own solver; its kind and deadline do not count.
        repeat: Timed solves of each pair.
        seed: Of the order.
        passed: Called after every solve.
    """
    back_ends, pairs = _BackEnds(spec), [(problem, way) for problem in problems for way in ways]
    first: list[Solution] = []
    for problem, way in pairs:
        first.append(back_ends.solve(problem, way))
        passed()
    times, busy = np.zeros((len(pairs), repeat)), np.zeros(len(pairs))
    generator = np.random.default_rng(seed)
    for turn in range(repeat):
        for k in generator.permutation(len(pairs)):
            began = time.process_time()
            times[k, turn] = back_ends.solve(*pairs[k]).wall_time
            busy[k] += time.process_time() - began
            passed()
    came_to = [_solved(*pair, solution, back_ends) for pair, solution in zip(pairs, first, strict=True)]
    return [replace(one, times=times[k], busy=float(busy[k])) for k, one in enumerate(came_to)]


def _solved(problem: Problem, way: Way, solution: Solution, back_ends: _BackEnds) -> Solved:
    """Return what a solve came to, before it is timed."""
    plan = problem.plan(solution.z)
    return Solved(
        index=problem.index,
        nodes=problem.nodes,
        stages=len(problem.window.stages),
        way=way,
        outcome=solution.outcome,
        iterations=solution.iterations,
        objective=solution.objective,
        instants=plan.instants,
        over_time=problem.over_time(plan),
        violation=back_ends.violation(problem, solution.z),
        times=np.zeros(0),
        busy=0.0,
    )
