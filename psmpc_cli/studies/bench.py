"""The bench: windows recorded from real runs, solved again by every back-end on several meshes, timed."""

import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.task import SolverSpec, TaskSpec
from psmpc_cli.studies.bench_problems import Mesh, Optimum, Problem
from psmpc_cli.studies.bench_solves import Solved, time_solves, ways_with
from psmpc_cli.studies.bench_windows import RECORDED, Recorded, distinct, record_windows

CONTROLLERS = ("psmpc", "smpc")
"""Whose runs give the windows: with the task's priorities, and with all of them 1."""

SOLVERS = ("sqp", "fatrop", "ipopt")
"""The back-ends, the fastest first."""

OWN = ("solver", "solver.kind", "controller", "controller.kind")
"""Keys of the task that a bench sets itself."""

Told = Callable[[str], None]


@dataclass(frozen=True)
class Choices:
    """What is measured.

    Attributes:
        nodes: Meshes, as `controller.nodes` has them.
        solvers: Back-ends by their names in a task.
        repeat: Timed solves of each window by each way.
        appends: At most so many appends of each run give windows; None for all.
    """

    nodes: tuple[str, ...] = ("25", "50", "100", "200", "auto")
    solvers: tuple[str, ...] = SOLVERS
    repeat: int = 3
    appends: int | None = None


QUICK = Choices(nodes=("25", "50"), repeat=1, appends=2)
"""What a try in less than a minute measures."""


@dataclass(frozen=True, eq=False)
class Posed:
    """A window on a mesh, without its NLP.

    Attributes:
        counts: Intervals of its stages.
        variables: Decision variables of its NLP.
        optimum: What it comes to; None where neither back-end converged.
    """

    counts: tuple[int, ...]
    variables: int
    optimum: Optimum | None


@dataclass(frozen=True, eq=False)
class Bench:
    """What was measured.

    Attributes:
        loaded: The task.
        choices: What was asked for.
        compiled: Whether sqp ran as compiled C.
        windows: The windows.
        posed: Each window on each mesh, by its number and the mesh.
        solved: What each way came to in each of them.
    """

    loaded: Task
    choices: Choices
    compiled: bool
    windows: tuple[Recorded, ...]
    posed: Mapping[tuple[int, str], Posed]
    solved: tuple[Solved, ...]


def parse_nodes(text: str) -> tuple[str, ...]:
    """Return the meshes of a list such as 25,50,auto, each once.

    Raises:
        InputError: One is neither a number nor auto.
    """
    found = [part.strip() for part in text.split(",")]
    for part in found:
        if not (part.isascii() and part.isdigit()) and part != "auto":
            raise InputError(f"--nodes: found {part!r}, expected numbers of intervals or auto, such as 25,50,auto")
    return tuple(dict.fromkeys(found))


def parse_solvers(text: str) -> tuple[str, ...]:
    """Return the back-ends of a list such as sqp,fatrop, each once.

    Raises:
        InputError: One is unknown.
    """
    found = [part.strip() for part in text.split(",")]
    for part in found:
        if part not in SOLVERS:
            raise InputError(f"--solvers: found {part!r}, expected some of {', '.join(SOLVERS)}")
    return tuple(dict.fromkeys(found))


@dataclass(frozen=True, eq=False)
class BenchTasks:
    """The tasks of a bench.

    Attributes:
        choices: What is measured.
        recorded: Those whose runs give the windows, one a controller.
        meshes: What each mesh makes of the task, by its nodes.
    """

    choices: Choices
    recorded: tuple[Task, ...]
    meshes: Mapping[str, TaskSpec]


def load_bench(reference: str, changes: Sequence[str], choices: Choices) -> BenchTasks:
    """Load the tasks of a bench; everything wrong with them is found here.

    Raises:
        InputError: A change is about what a bench sets itself.
        SpecError: The task, a change or a mesh does not hold.
    """
    for change in changes:
        if change.partition("=")[0].strip() in OWN:
            raise InputError(f"--set {change}: a bench runs psmpc and smpc with sqp; choose back-ends with --solvers")
    load = partial(load_task, reference)
    recorded = tuple(load([*changes, *RECORDED, f"controller.kind={kind}"]) for kind in CONTROLLERS)
    ensure_feasible(recorded[0])
    first = [*changes, *RECORDED, f"controller.kind={CONTROLLERS[0]}"]
    meshes = {nodes: load([*first, f"controller.nodes={nodes}"]).spec for nodes in choices.nodes}
    return BenchTasks(choices, recorded, meshes)


def run_bench(tasks: BenchTasks, told: Told = lambda line: None, passed: Callable[[], None] = lambda: None) -> Bench:
    """Record the windows, then solve them on one mesh after the other.

    Args:
        tasks: The tasks.
        told: Told when the windows are there and when a mesh is done.
        passed: Called after every sample and every solve.

    Raises:
        RunError: The runs give no windows.
    """
    experiment, windows = _record(tasks, told, passed)
    posed: dict[tuple[int, str], Posed] = {}
    solved: list[Solved] = []
    for number, (nodes, task) in enumerate(tasks.meshes.items(), start=1):
        problems = pose(windows, task, experiment, passed)
        posed |= {
            (problem.index, nodes): Posed(problem.window.nodes, problem.variables, problem.optimum)
            for problem in problems
        }
        spec, choices = solver_in_force(task, experiment), tasks.choices
        solved += time_solves(
            experiment.problem, problems, ways_with(choices.solvers), spec, choices.repeat, task.seed, passed
        )
        del problems
        gc.collect()  # the NLPs of a fine mesh take a gigabyte
        told(f"nodes {nodes} done, {number} of {len(tasks.meshes)}")
    return Bench(tasks.recorded[0], tasks.choices, experiment.compiled, tuple(windows), posed, tuple(solved))


def _record(tasks: BenchTasks, told: Told, passed: Callable[[], None]) -> tuple[Experiment, list[Recorded]]:
    """Return the windows of all runs, and the experiment of the last one."""
    windows: list[Recorded] = []
    for loaded in tasks.recorded:
        experiment, found = record_windows(loaded, tasks.choices.appends, passed)
        windows += found
        told(f"{loaded.spec.controller.kind}: {len(found)} windows recorded")
    if not windows:
        raise RunError(
            f"{loaded.spec.name}: in no sample of its runs a stage entered the window, expected a task of several "
            "stages whose first one ends"
        )
    return experiment, distinct(windows)


def pose(windows: list[Recorded], task: TaskSpec, experiment: Experiment, passed: Callable[[], None]) -> list[Problem]:
    """Return recorded windows on a task's mesh."""
    mesh, problems = Mesh(task, experiment), []
    for index, recorded in enumerate(windows):
        problems.append(mesh.prepare(index, recorded))
        passed()
    return problems


def solver_in_force(task: TaskSpec, experiment: Experiment) -> SolverSpec:
    """Return a task's solver, compiled where it can be."""
    return task.solver.model_copy(update={"compiled": experiment.compiled})
