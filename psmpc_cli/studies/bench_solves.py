"""The solves that are timed: every window by every back-end, warm and cold, in an order without a pattern."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.ocp.problem import Problem as TaskProblem
from psmpc_cli.solvers import NlpSolver, Outcome, Solution, Solver, build_solver
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
    """The back-ends of one mesh, each built once."""

    def __init__(self, task: TaskProblem, spec: SolverSpec) -> None:
        self._task, self._spec = task, spec.model_copy(update={"deadline": None})
        self._built: dict[str, Solver] = {}
        self._judge = NlpSolver(task, self._of("fatrop"))

    def _of(self, kind: str) -> SolverSpec:
        return self._spec.model_copy(update={"kind": kind})

    def solve(self, problem: Problem, way: Way) -> Solution:
        """Solve a problem one way."""
        if way.solver not in self._built:
            self._built[way.solver] = self._build(way.solver)
        start = problem.starts[way.start]
        return self._built[way.solver].solve(problem.window, start.guess, start.previous)

    def _build(self, solver: str) -> Solver:
        if solver == REFERENCE:
            return NlpSolver(self._task, self._of("ipopt"), options={"print_level": 0, "sb": "yes"})
        return build_solver(self._task, self._of(solver))

    def violation(self, problem: Problem, solution: Solution) -> float:
        """Return by how much a solution violates a bound or a row at worst."""
        return self._judge.violation(problem.window, solution.plan)


def time_solves(
    task: TaskProblem,
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
        task: The task's problem.
        problems: Windows on one mesh.
        ways: The ways.
        spec: The task's own solver; its kind and deadline do not count.
        repeat: Timed solves of each pair.
        seed: Of the order.
        passed: Called after every solve.
    """
    back_ends, pairs = _BackEnds(task, spec), [(problem, way) for problem in problems for way in ways]
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
    plan = solution.plan
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
        violation=back_ends.violation(problem, solution),
        times=np.zeros(0),
        busy=0.0,
    )
