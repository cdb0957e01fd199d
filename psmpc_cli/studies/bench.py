"""The bench: windows of real runs solved again by every back-end, timed against CasADi with IPOPT and its defaults."""

import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.solvers import NlpSolver, Outcome, Solution, Solver, build_solver
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.task import SolverSpec

CONTROLLERS = ("psmpc", "smpc")
"""The controllers whose runs give the windows: with the task's priorities, and with all of them 1."""

SOLVERS: Mapping[str, Mapping[str, object]] = {
    "sqp": {"kind": "sqp"},
    "piqp": {"kind": "sqp", "compiled": False},
    "fatrop": {"kind": "fatrop"},
    "ipopt": {"kind": "ipopt"},
}
"""What each name that a bench knows changes in the solver of the task; piqp: sqp with `solver.compiled: false`."""

OWN = ("solver", "solver.kind", "solver.compiled", "controller", "controller.kind", "controller.nodes")
"""Keys of the task that a bench sets itself."""

REFERENCE = "reference"
"""CasADi with IPOPT as both come, cold at each sample."""

TIGHT = {"kind": "fatrop", "tolerance": 1e-10, "max_iterations": 2000, "deadline": None}
POLISH = {"tol": 1e-12, "max_iter": 2000, "mu_init": 1e-6, "bound_relax_factor": 0.0, "acceptable_iter": 0}
"""The solver of the optimum that all others are compared with, and the options of IPOPT, which continues from there.

By default both relax the bounds by 1e-8, which changes J by more than `sqp` is off.
"""

PLAIN = {"print_level": 0, "sb": "yes"}
"""IPOPT with its defaults, without its output."""

RESTING_NODES = 100
"""Intervals of the plan without control from which a cold start begins."""

HEADINGS = (
    "nodes",
    "solver",
    "start",
    "median [ms]",
    "p95",
    "times faster",
    "iterations",
    "J off, median",
    "worst",
    "switch times off [s]",
    "violation",
    "failed",
)
"""Columns of the table."""

NOTE = (
    "times faster: than the reference, CasADi with IPOPT and its default options from a cold start\n"
    "off: from a tightly converged optimum, relative in J; switch times and violation of a constraint [m, rad, m/s, "
    "rad/s, s]: the worst\n"
    "failed: windows without a solution; they count in no other column"
)

Told = Callable[[str], None]


@dataclass(frozen=True)
class Choices:
    """What is measured.

    Attributes:
        nodes: Meshes, as `controller.nodes` has them.
        solvers: Names from `SOLVERS`.
        repeat: Timed solves of each window by each back-end and start.
        appends: Number of appends of each run that give windows; None for all.
    """

    nodes: tuple[str, ...] = ("25", "50", "100", "200", "auto")
    solvers: tuple[str, ...] = tuple(SOLVERS)
    repeat: int = 3
    appends: int | None = None


QUICK = Choices(nodes=("25", "50"), repeat=1, appends=2)
"""A bench that takes less than a minute."""


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
class Recorded:
    """A solve of a run: its window, the guessed plan, and the solution of the sample before, if it is usable."""

    window: Window
    guess: Plan
    previous: Solution | None

    @property
    def key(self) -> tuple[float, tuple[int, ...], bytes, bytes]:
        """The same for windows that are one problem: only the ratios of priorities count."""
        window = self.window
        indices = tuple(stage.index for stage in window.stages)
        return window.start, indices, window.x0.tobytes(), (window.omega / window.omega.max()).tobytes()


def record_windows(task: Task, appends: int | None, passed: Callable[[], None]) -> tuple[Problem, list[Recorded]]:
    """Run the closed loop of a task and return its problem with the solves before, at and after so many appends.

    `passed` is called after every sample.
    """
    experiment, solves = build_experiment(task), list[Recorded]()
    previous: Solution | None = None
    around: list[Recorded] = []
    for sample in closed_loop(experiment):
        passed()
        solution = sample.command.solution
        if solution.outcome.usable:
            solves.append(Recorded(solution.window, solution.guess, previous))
            lasts = [solve.window.stages[-1].index for solve in solves[-3:]]
            if len(lasts) == 3 and lasts[1] > lasts[0]:
                around += solves[-3:]
        previous = solution
        if appends is not None and len(around) >= 3 * appends:
            break
    return experiment.problem, around


@dataclass(frozen=True, eq=False)
class Timed:
    """What a back-end came to from one kind of start in all windows of a mesh (W,).

    Attributes:
        nodes, solver, start: The mesh, the back-end, and `warm` or `cold`.
        stages: Number of stages in each window.
        usable: Whether the solve has a solution.
        iterations: Iterations used.
        gap: J over that of the optimum, less 1; negative where constraints are violated.
        late: Largest difference of a switch time from that of the optimum [s].
        violation: Largest violation of a constraint [m, rad, m/s, rad/s, s].
        times: Wall times of the timed solves (W, repeat) [s].
        busy: Processor time of those of each window (W,) [s].
    """

    nodes: str
    solver: str
    start: str
    stages: np.ndarray
    usable: np.ndarray
    iterations: np.ndarray
    gap: np.ndarray
    late: np.ndarray
    violation: np.ndarray
    times: np.ndarray
    busy: np.ndarray

    def median(self, stages: int | None = None) -> float:
        """Return the median time of the solves with a solution [s], of windows with so many stages; NaN without one."""
        chosen = self.usable & (True if stages is None else self.stages == stages)
        return float(np.median(self.times[chosen])) if chosen.any() else np.nan


@dataclass(frozen=True, eq=False)
class Bench:
    """What was measured: all solves, the number of windows of each mesh, and whether sqp ran as compiled C."""

    timed: tuple[Timed, ...]
    windows: Mapping[str, int]
    compiled: bool

    @property
    def wall_over_busy(self) -> float:
        """Wall time of all solves over their processor time: 1 on a machine that does nothing else."""
        return float(sum(one.times.sum() for one in self.timed) / sum(one.busy.sum() for one in self.timed))


def load_bench(reference: str, changes: Sequence[str], choices: Choices) -> dict[str, list[Task]]:
    """Load the tasks whose runs give the windows, by mesh, one for each controller.

    Raises:
        InputError: A change is of a key that a bench sets itself.
        SpecError: The task, a change or a mesh does not hold.
    """
    for change in changes:
        if change.partition("=")[0].strip() in OWN:
            raise InputError(
                f"--set {change}: a bench runs psmpc and smpc with sqp; choose back-ends with --solvers, meshes with "
                "--nodes"
            )
    fixed = (*changes, "solver.kind=sqp", "log.shares=false")
    tasks = {
        nodes: [
            load_task(reference, [*fixed, f"controller.kind={kind}", f"controller.nodes={nodes}"])
            for kind in CONTROLLERS
        ]
        for nodes in choices.nodes
    }
    ensure_feasible(next(iter(tasks.values()))[0])
    return tasks


def run_bench(
    tasks: Mapping[str, Sequence[Task]],
    choices: Choices,
    told: Told = lambda line: None,
    passed: Callable[[], None] = lambda: None,
) -> Bench:
    """Record windows and solve them again, on one mesh after the other.

    Args:
        tasks: As `load_bench` returns them.
        choices: What is measured.
        told: Called with a line when a mesh is done.
        passed: Called after every sample and every solve.

    Raises:
        RunError: The runs give no windows.
    """
    timed: list[Timed] = []
    windows, compiled = {}, True
    for nodes, variants in tasks.items():
        recorded: dict[object, Recorded] = {}
        for task in variants:
            problem, found = record_windows(task, choices.appends, passed)
            recorded |= {each.key: each for each in found}
        if not recorded:
            raise RunError(
                f"{problem.spec.name}: in no sample of its runs a stage entered the window, expected a task of several "
                "stages whose first one ends"
            )
        timed += time_solves(nodes, problem, list(recorded.values()), choices, passed)
        windows[nodes] = len(recorded)
        compiled = compiled and build_experiment(variants[0]).compiled
        told(f"nodes {nodes}: {len(recorded)} windows done")
    return Bench(tuple(timed), windows, compiled)


def time_solves(
    nodes: str, problem: Problem, recorded: Sequence[Recorded], choices: Choices, passed: Callable[[], None]
) -> list[Timed]:
    """Solve windows of one mesh by every back-end, warm and cold: once untimed, then repeatedly.

    The first solves build what is built once. Each round then holds every pair of window and back-end in a new random
    order, so that other load on the machine is spread over all of them.
    """
    ways = [(name, start) for name in choices.solvers for start in ("warm", "cold")] + [(REFERENCE, "cold")]
    spec = problem.spec.solver
    solvers: dict[str, Solver] = {
        name: build_solver(problem, _changed(spec, {**SOLVERS[name], "deadline": None})) for name in choices.solvers
    }
    ipopt = _changed(spec, {"kind": "ipopt"})
    solvers[REFERENCE] = NlpSolver(problem, ipopt, options=PLAIN)
    tight, polisher = NlpSolver(problem, _changed(spec, TIGHT)), NlpSolver(problem, ipopt, options={**PLAIN, **POLISH})
    optima = [_optimum(each, tight, polisher) for each in recorded]
    calls = [_call(solvers[name], each, start, name == "sqp") for name, start in ways for each in recorded]
    solutions: list[Solution] = []
    for call in calls:
        solutions.append(call())
        passed()
    times, busy = np.zeros((len(calls), choices.repeat)), np.zeros(len(calls))
    generator = np.random.default_rng(problem.spec.seed)
    for turn in range(choices.repeat):
        for k in generator.permutation(len(calls)):
            began = time.process_time()
            times[k, turn] = calls[k]().wall_time
            busy[k] += time.process_time() - began
            passed()
    found, W = [], len(recorded)
    stages = np.array([len(each.window.stages) for each in recorded])
    for i, (name, start) in enumerate(ways):
        mine = slice(i * W, (i + 1) * W)
        compared = np.array([_compared(*pair, tight) for pair in zip(solutions[mine], optima, strict=True)])
        usable, iterations, gap, late, violation = compared.T
        numbers = (iterations, gap, late, violation, times[mine], busy[mine])
        found.append(Timed(nodes, name, start, stages, usable.astype(bool), *numbers))
    return found


def _changed(spec: SolverSpec, changes: Mapping[str, object]) -> SolverSpec:
    return spec.model_copy(update=dict(changes))


def _call(solver: Solver, recorded: Recorded, start: str, own: bool) -> Callable[[], Solution]:
    """Return a solve: cold, or warm from the solution of the sample before by the same back-end (`own`: the run's)."""
    window, guess, previous = recorded.window, recorded.guess, recorded.previous
    if start == "cold":
        resting = resting_plan(window.start, window.horizon, RESTING_NODES, window.x0)
        guess, previous = replace(resting, instants=guess.instants), None
    elif previous is not None and not own:
        previous = solver.solve(previous.window, previous.guess)
    return lambda: solver.solve(window, guess, previous)


def _optimum(recorded: Recorded, tight: NlpSolver, polisher: NlpSolver) -> Solution:
    """Return the optimum of a window."""
    found = tight.solve(recorded.window, recorded.guess)
    polished = polisher.solve(recorded.window, found.plan)
    return polished if polished.outcome is Outcome.OPTIMAL else found


def _compared(solution: Solution, optimum: Solution, judge: NlpSolver) -> tuple[float, ...]:
    """Return whether a solution is usable, its iterations, gaps in J and in the switch times, and its violation."""
    known = optimum.outcome is Outcome.OPTIMAL
    gap = (solution.objective - optimum.objective) / abs(optimum.objective) if known else np.nan
    late = float(np.abs(solution.plan.instants - optimum.plan.instants).max(initial=0.0)) if known else np.nan
    return solution.outcome.usable, solution.iterations, gap, late, judge.violation(solution.window, solution.plan)


def bench_rows(bench: Bench) -> Iterator[tuple[str, ...]]:
    """Give the rows of the table, in the order of `HEADINGS`."""
    references = {one.nodes: one.median() for one in bench.timed if one.solver == REFERENCE}
    for one in bench.timed:
        good = one.usable
        times = one.times[good].ravel() if good.any() else np.array([np.nan])
        gap, late, violation = np.abs(one.gap[good]), one.late[good], one.violation[good]
        texts = (
            f"{1e3 * one.median():.2f}",
            f"{1e3 * np.percentile(times, 95):.2f}",
            f"{references[one.nodes] / one.median():.1f}",
            f"{_over(np.median, one.iterations[good]):.0f}",
            f"{_over(np.median, gap):.0e}",
            *(f"{_over(np.max, values):.0e}" for values in (gap, late, violation)),
        )
        shown = ("-" if text == "nan" else text for text in texts)
        yield one.nodes, one.solver, one.start, *shown, f"{int(np.sum(~good))} of {len(good)}"


def _over(function: Callable[[np.ndarray], np.floating], values: np.ndarray) -> float:
    """Return a statistic of the values that are known; NaN without one."""
    known = values[np.isfinite(values)]
    return float(function(known)) if len(known) else np.nan


def describe_machine(bench: Bench) -> str:
    """Return what a bench ran on, and whether it had the machine to itself."""
    versions = ", ".join(f"{name} {version(name)}" for name in ("psmpc", "casadi", "numpy", "piqp"))
    return (
        f"{_processor()}, {os.cpu_count()} cores; sqp {'compiled' if bench.compiled else 'interpreted'}; wall over "
        f"processor time {bench.wall_over_busy:.2f}; {platform.system()} {platform.machine()}; python "
        f"{platform.python_version()}, {versions}"
    )


def _processor(listed: Path = Path("/proc/cpuinfo")) -> str:
    """Return the name of the processor, which Linux alone lists."""
    lines = listed.read_text(encoding="utf-8", errors="replace").splitlines() if listed.is_file() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next((name for name in names if name), platform.processor() or "unknown processor")
