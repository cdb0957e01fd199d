"""The bench: windows of real runs solved again by every back-end, timed against CasADi with IPOPT and its defaults."""

import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli.errors import InputError, RunError
from psmpc_cli.native.library import describe_processor
from psmpc_cli.ocp.feasibility.checks import ensure_feasible
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.progress import Watch, Work
from psmpc_cli.simulation.run import Experiment, build_experiment, closed_loop
from psmpc_cli.solvers import NlpSolver, Outcome, Solution, Solver, build_solver
from psmpc_cli.solvers.bounded import processor_time
from psmpc_cli.specs.load import Task, load_task

CONTROLLERS = ("psmpc", "smpc")
"""The controllers whose runs give the windows: with the task's priorities, and with all of them 1."""

SOLVERS: Mapping[str, Mapping[str, object]] = {
    "sqp": {"kind": "sqp"},
    "piqp": {"kind": "sqp", "compiled": False},
    "fatrop": {"kind": "fatrop"},
    "ipopt": {"kind": "ipopt"},
}
"""What each name that a bench knows changes in the solver of the task; piqp: sqp with `solver.compiled: false`."""

RESERVED_KEYS = ("solver", "solver.kind", "solver.compiled", "controller", "controller.kind", "controller.nodes")
"""Keys of the task that a bench sets itself."""

NODES = "25,50,100,200,auto"

Case = tuple[str, str, str]
"""A mesh, a back-end, and `warm` or `cold`."""

RecordedSolve = tuple[Solution, Solution | None]
"""A solve of a run, and the one at the sample before it."""

REFERENCE = "reference"
"""CasADi with IPOPT as both come, cold at each sample."""

TIGHT = {"kind": "fatrop", "tolerance": 1e-10, "max_iterations": 2000, "deadline": None}
POLISH = {"tol": 1e-12, "max_iter": 2000, "mu_init": 1e-6, "bound_relax_factor": 0.0, "acceptable_iter": 0}
"""The solver of the optimum that all others are compared with, and the options of IPOPT, which continues from there.

By default both relax the bounds by 1e-8, which changes J by more than `sqp` is off.
"""

COLD_INTERVALS = 100
"""Intervals of the plan without control from which a cold start begins."""

PLAIN = {"print_level": 0, "sb": "yes"}
"""IPOPT with its defaults, without its output."""

COLUMNS: Mapping[str, tuple[Callable[[np.ndarray], np.floating], str, str]] = {
    "iterations": (np.median, "iterations", ".0f"),
    "J off, median": (np.median, "gap", ".0e"),
    "worst": (np.max, "gap", ".0e"),
    "switch times off [s]": (np.max, "switch_error", ".0e"),
    "violation": (np.max, "violation", ".0e"),
}
"""Columns of the table besides the times: statistic, what it is of, and format."""

HEADINGS = ("nodes", "solver", "start", "median [ms]", "p95", "times faster", *COLUMNS, "failed")

NOTE = (
    "times faster: than the reference, CasADi with IPOPT and its default options from a cold start\n"
    "off: from a tightly converged optimum, relative in J; switch times and violation of a constraint [m, rad, m/s, "
    "rad/s, s]: the worst\n"
    "failed: windows without a solution; they count in no other column"
)


class TimedSolve(NamedTuple):
    """A window solved by a back-end from one kind of start.

    Attributes:
        stages: Number of stages in the window.
        usable: Whether the solve has a solution.
        iterations: Iterations used.
        gap: J over that of the optimum, less 1; negative where constraints are violated; NaN without an optimum.
        switch_error: Largest difference of a switch time from that of the optimum [s].
        violation: Largest violation of a constraint [m, rad, m/s, rad/s, s].
        times: Wall times of the timed solves (repeat,) [s].
    """

    stages: int
    usable: bool
    iterations: int
    gap: float
    switch_error: float
    violation: float
    times: np.ndarray


@dataclass(frozen=True, eq=False)
class Bench:
    """What was measured.

    Attributes:
        solves: All solves by mesh, back-end and kind of start.
        compiled: Whether sqp ran as compiled C.
        wall_over_busy: Wall time of the solves over their processor time: 1 on a machine that does nothing else.
    """

    solves: Mapping[Case, Sequence[TimedSolve]]
    compiled: bool
    wall_over_busy: float


def median_time(solves: Sequence[TimedSolve], stages: int | None = None) -> float:
    """Return the median time of the solves with a solution [s], of windows with so many stages; NaN without one."""
    return _statistic_of_known(
        np.median, [each.times for each in solves if each.usable and stages in (None, each.stages)]
    )


def _entries_of_list(text: str) -> list[str]:
    """Return the entries of a text that is a list between commas, each once."""
    return list(dict.fromkeys(part.strip() for part in text.split(",")))


def load_bench(reference: str, changes: Sequence[str], nodes: str = NODES) -> dict[str, list[Task]]:
    """Load a task in several variants, whose closed loops give the windows that solvers are then timed on.

    A window is the optimization problem of one sample. Variants differ in the mesh of a window and in the controller,
    `psmpc` or `smpc`: the only ones whose windows have several stages. Shares, solves for the log alone, are left out.

    Args:
        reference: The task, its file or the name of a built-in one.
        changes: Keys to change in it, each `path=value`.
        nodes: Meshes between commas: how many nodes a stage has, such as 25, or auto.

    Returns:
        For each mesh, by its text, the task under each controller of `CONTROLLERS`.

    Raises:
        InputError: A change is of a key that a bench sets itself.
        SpecError: The task, a change or a mesh is not valid.
    """
    for change in changes:
        if change.partition("=")[0].strip() in RESERVED_KEYS:
            raise InputError(
                f"--set {change}: a bench runs psmpc and smpc with sqp; choose back-ends with --solvers, meshes with "
                "--nodes"
            )
    common_changes = (*changes, "solver.kind=sqp", "log.shares=false")
    tasks = {}
    for mesh in _entries_of_list(nodes):
        # messages about this change are to name what the user has written
        change_of_mesh = (f"--nodes {mesh}", f"controller.nodes={mesh}")
        tasks[mesh] = [
            load_task(reference, [*common_changes, change_of_mesh, f"controller.kind={kind}"]) for kind in CONTROLLERS
        ]
    # neither mesh nor controller changes what the robot can reach: to check one variant is enough
    ensure_feasible(next(iter(tasks.values()))[0])
    return tasks


def run_bench(
    tasks: Mapping[str, Sequence[Task]],
    solvers: str = ",".join(SOLVERS),
    repeat: int = 3,
    appends: int | None = None,
    watch: Watch = lambda progress: None,
    raise_if_cancelled: Callable[[], None] = lambda: None,
) -> Bench:
    """Compare back-ends (solvers of the optimization) by their times on the same windows, one mesh after the other.

    The windows (optimization problems of a sample) are recorded in closed loops of the tasks. Each is then solved
    again, several times, by each back-end from a warm and from a cold start, and by the reference from a cold start.

    Args:
        tasks: By mesh, as `load_bench` returns them.
        solvers: Names of back-ends from `SOLVERS` between commas.
        repeat: How often each window is solved by each back-end and from each start while the time is taken.
        appends: At how many appends of each run windows are recorded; None for all. An append is a sample at which a
            stage enters the window, where solves are hardest.
        watch: Called with the progress over the meshes and, on each of them, over its timed solves.
        raise_if_cancelled: Called after every sample and every timed solve; it may raise to end the bench.

    Returns:
        All solves with their times and their differences from the optimum.

    Raises:
        InputError: A back-end is unknown.
        RunError: At no sample of the runs a stage entered the window.
    """
    solver_names = _entries_of_list(solvers)
    if unknown := [name for name in solver_names if name not in SOLVERS]:
        raise InputError(f"--solvers: found {unknown[0]!r}, expected some of {', '.join(SOLVERS)}")
    cases = [(name, start) for name in solver_names for start in ("warm", "cold")] + [(REFERENCE, "cold")]
    timed: dict[Case, list[TimedSolve]] = {(nodes, *case): [] for nodes in tasks for case in cases}
    compiled = True
    wall_time = 0.0
    busy_time = 0.0
    meshes = Work("meshes", len(tasks), watch)
    for nodes, tasks_of_mesh in tasks.items():
        experiments = [build_experiment(task) for task in tasks_of_mesh]
        recorded = [
            solve
            for experiment in experiments
            for solve in _solves_around_entries(experiment, appends, raise_if_cancelled)
        ]
        problem = experiments[0].problem
        if not recorded:
            raise RunError(
                f"{problem.spec.name}: in no sample of its runs a stage entered the window, expected a task of several "
                "stages whose first one ends"
            )
        wall_begin = time.perf_counter()
        processor_begin = processor_time()
        solves = Work("solves", len(recorded) * len(cases) * repeat, watch, f"{nodes} nodes a stage", small_parts=True)

        def count_solve(solves: Work = solves) -> None:
            solves.advance()
            raise_if_cancelled()

        for case, solve in _timed_solves(problem, recorded, cases, repeat, count_solve):
            timed[nodes, *case].append(solve)
        wall_time += time.perf_counter() - wall_begin
        busy_time += processor_time() - processor_begin
        compiled &= all(experiment.compiled for experiment in experiments)
        meshes.advance(f"{nodes} nodes a stage, {len(recorded)} windows")
    return Bench(timed, compiled, wall_time / busy_time)


def _solves_around_entries(
    experiment: Experiment, appends: int | None, raise_if_cancelled: Callable[[], None]
) -> list[RecordedSolve]:
    """Run a closed loop and collect solves to be timed: those around each sample at which a stage enters the window.

    A window (the stages that one optimization plans over) is hardest to solve when a further stage enters it. For each
    such sample three solves are kept: its own, the last usable one before it, and the first usable one after it.

    Args:
        experiment: The task, ready to be run.
        appends: After how many such samples the loop is stopped; None to run it to its end.
        raise_if_cancelled: Called after every sample; it may raise to end the run.

    Returns:
        Three pairs for each such sample: a solution, and that of the sample before, from which its solve started (None
        at the first sample).
    """
    solves = list[RecordedSolve]()  # all usable ones so far
    recorded = list[RecordedSolve]()
    previous: Solution | None = None
    for sample in closed_loop(experiment):
        raise_if_cancelled()
        solution = sample.command.solution
        if solution.outcome.usable:
            solves.append((solution, previous))
            last_stages = [solve.window.stages[-1].index for solve, _ in solves[-3:]]
            # the second of the last three solves is the first with a further stage
            if len(last_stages) == 3 and last_stages[1] > last_stages[0]:
                recorded += solves[-3:]
        previous = solution
        if appends is not None and len(recorded) >= 3 * appends:
            break
    return recorded


def _timed_solves(
    problem: Problem,
    recorded: Sequence[RecordedSolve],
    cases: Sequence[tuple[str, str]],
    repeat: int,
    after_solve: Callable[[], None],
) -> Iterator[tuple[tuple[str, str], TimedSolve]]:
    """Solve recorded windows of one mesh in each case, time this, and compare the solutions with the true optima.

    A case is a back-end and its kind of start. Each window is first solved once in each case without taking the time,
    which builds whatever is built only once. Then come rounds, in each of which every window is solved in every case,
    in a new random order, so that other load on the machine is spread over all of them. The true optimum of a window is
    that of a solver with tight tolerances.

    Args:
        problem: The problem of the mesh.
        recorded: Solves of a closed loop, each with that of the sample before it.
        cases: Names of back-ends from `SOLVERS` or `REFERENCE`, each with `warm`, to start from the solution of the
            sample before, or `cold`, to start from the plan without control.
        repeat: Number of rounds, and so of timed solves of a window in a case.
        after_solve: Called after every timed solve; it may raise to end the bench.

    Yields:
        Pairs of a case and one window's solve in it. All cases of the first window come first.
    """
    spec = problem.spec.solver
    settings = {name: spec.model_copy(update={**changes, "deadline": None}) for name, changes in SOLVERS.items()}
    solvers: dict[str, Solver] = {name: build_solver(problem, settings[name]) for name, _ in cases if name in SOLVERS}
    solvers[REFERENCE] = NlpSolver(problem, settings["ipopt"], options=PLAIN)
    # the closed loops ran with sqp, which can so go on from their own solutions
    calls = [
        _solve_to_time(solvers[name], *solve, start, is_own_solver=name == "sqp")
        for name, start in cases
        for solve in recorded
    ]
    solutions = [call() for call in calls]
    times = _times_in_rounds(calls, repeat, problem.spec.seed, after_solve)
    tight_solver = NlpSolver(problem, spec.model_copy(update=TIGHT))
    polishing_solver = NlpSolver(problem, settings["ipopt"], options={**PLAIN, **POLISH})
    for window_number, (window, guess) in enumerate(
        (solve.window.about(solve.guess), solve.guess) for solve, _ in recorded
    ):
        optimum = tight_solver.solve(window, guess)
        # IPOPT goes on from there to the last digits, where that succeeds
        polished = polishing_solver.solve(window, optimum.plan)
        optimum = polished if polished.outcome is Outcome.OPTIMAL else optimum
        # calls are by case and, within a case, by window
        for call_number, case in zip(range(window_number, len(calls), len(recorded)), cases, strict=True):
            solution = solutions[call_number]
            violation = tight_solver.violation(window, solution.plan)
            yield case, _beside_optimum(solution, optimum, violation, times[call_number])


def _times_in_rounds(
    calls: Sequence[Callable[[], Solution]], repeat: int, seed: int, after_solve: Callable[[], None]
) -> np.ndarray:
    """Make every call once in each of some rounds, in a new random order in each, and return their times.

    The order spreads other load on the machine over all calls.

    Args:
        calls: Functions that solve a window.
        repeat: Number of rounds.
        seed: Seed of the random orders.
        after_solve: Called after every call.

    Returns:
        Wall times of the solves (calls, rounds) [s].
    """
    times = np.zeros((len(calls), repeat))
    generator = np.random.default_rng(seed)
    for round_number in range(repeat):
        for call_number in generator.permutation(len(calls)):
            times[call_number, round_number] = calls[call_number]().wall_time
            after_solve()
    return times


def _beside_optimum(solution: Solution, optimum: Solution, violation: float, times: np.ndarray) -> TimedSolve:
    """Compare a solution of a window with its true optimum.

    Args:
        solution: The solution of a back-end.
        optimum: The optimum, if its outcome says so; otherwise there is nothing to compare with, and differences are
            NaN.
        violation: Largest violation of a constraint by the solution.
        times: Wall times that the back-end took (repeat,) [s].
    """
    one_if_known = 1.0 if optimum.outcome is Outcome.OPTIMAL else np.nan
    switch_errors = np.abs(solution.plan.switch_times - optimum.plan.switch_times)
    return TimedSolve(
        stages=len(solution.window.stages),
        usable=solution.outcome.usable,
        iterations=solution.iterations,
        gap=one_if_known * (solution.objective - optimum.objective) / abs(optimum.objective),
        switch_error=one_if_known * switch_errors.max(initial=0.0),
        violation=violation,
        times=times,
    )


def _solve_to_time(
    solver: Solver, recorded: Solution, previous: Solution | None, start: str, is_own_solver: bool
) -> Callable[[], Solution]:
    """Prepare the solve of a recorded window by a back-end, so that only the solve itself is timed.

    Args:
        solver: The back-end.
        recorded: The solve of the closed loop, with the window and the guess that it started from.
        previous: The solve of the sample before; None at the first sample.
        start: `cold`, from the plan that applies no control, or `warm`, from the guess of the closed loop and the
            multipliers of the sample before.
        is_own_solver: Whether the closed loop itself ran with this back-end. For another one the sample before is
            solved again here, since multipliers of one back-end are of no use to another.

    Returns:
        A function that solves the window.
    """
    window = recorded.window.about(recorded.guess)
    guess = recorded.guess
    if start == "cold":
        resting = resting_plan(window.start, window.horizon, COLD_INTERVALS, window.x0, window.chart)
        guess = replace(resting, switch_times=guess.switch_times)
        previous = None
    elif previous is not None and not is_own_solver:
        previous = solver.solve(previous.window, previous.guess)
    return lambda: solver.solve(window, guess, previous)


def bench_rows(bench: Bench) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table, in the order of `HEADINGS`."""
    for case, solves in bench.solves.items():
        good = [solve for solve in solves if solve.usable]
        median = median_time(good)
        p95 = _statistic_of_known(partial(np.percentile, q=95), [solve.times for solve in good])
        faster = median_time(bench.solves[case[0], REFERENCE, "cold"]) / median
        times = f"{1e3 * median:.2f}", f"{1e3 * p95:.2f}", f"{faster:.1f}"
        values = (
            f"{_statistic_of_known(statistic, np.abs([getattr(solve, name) for solve in good])):{form}}"
            for statistic, name, form in COLUMNS.values()
        )
        shown = ("-" if text == "nan" else text for text in (*times, *values))
        yield *case, *shown, f"{len(solves) - len(good)} of {len(solves)}"


def _statistic_of_known(function: Callable[[np.ndarray], np.floating], values: ArrayLike) -> float:
    """Return a statistic of the values that are known; NaN without one."""
    numbers = np.asarray(values, float)
    known = numbers[np.isfinite(numbers)]
    return float(function(known)) if len(known) else np.nan


def describe_machine(bench: Bench) -> str:
    """Return what a bench ran on, and whether it had the machine to itself."""
    versions = ", ".join(f"{name} {version(name)}" for name in ("psmpc", "casadi", "numpy", "piqp"))
    return (
        f"{describe_processor()}, {os.cpu_count()} cores; sqp {'compiled' if bench.compiled else 'interpreted'}; "
        f"wall over processor time {bench.wall_over_busy:.2f}; {platform.system()} {platform.machine()}; python "
        f"{platform.python_version()}, {versions}"
    )
