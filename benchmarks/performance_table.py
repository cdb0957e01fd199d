"""Measures what docs/performance.md says of times and prints its tables; on a machine that does nothing else.

python benchmarks/performance_table.py runs [NODES]     whole runs of the transport task; a minute
python benchmarks/performance_table.py windows          solves of single windows by every back-end; 10 to 15 minutes
python benchmarks/performance_table.py freedom          how solve times grow with the robot; some minutes
python benchmarks/performance_table.py space [REPEAT]   a robot in space beside the planar one; two minutes
python benchmarks/performance_table.py overhead [NODES] what a sample costs besides its solve
python benchmarks/performance_table.py parallel         what a second process brings a sweep; docs/sweeps.md
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy is loaded

import math
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np
from pages import PSMPC, markdown

from psmpc_cli.logs.run import read_run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import build_experiment, closed_loop, header
from psmpc_cli.solvers import Solution, build_solver
from psmpc_cli.specs.document import Data, write
from psmpc_cli.specs.load import Task, load_robot, load_task, parse_task
from psmpc_cli.specs.robot import Arm, PlanarRobot
from psmpc_cli.studies.bench import (
    HEADINGS,
    NODES,
    Bench,
    bench_rows,
    describe_machine,
    load_bench,
    median_time,
    run_bench,
)
from psmpc_cli.studies.runner import compute, run_study
from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, parse_sampling, weight_study

RUNS: Mapping[str, Sequence[str]] = {
    "as shipped": (),
    "without our C kernel, `solver.compiled=false`": ("solver.compiled=false",),
    "`controller.nodes=auto`": ("controller.nodes=auto",),
    "`controller.nodes=25`": ("controller.nodes=25",),
    "`controller.kind=smpc`": ("controller.kind=smpc",),
    "`controller.kind=hard`": ("controller.kind=hard",),
    "converged, `solver=fatrop`": ("solver=fatrop",),
}
"""Keys that are changed in each run of the transport task."""

RUN_HEADINGS = (
    "`psmpc simulate transport --no-figures`",
    "windows with a switch: median, p99, max [ms]",
    "over the first row",
    "all windows: median, p99 [ms]",
    "solves over 100 ms",
    "failed solves",
    "ends of the stages [s]",
    "wall time [s]",
)

QUIET = 1.1
"""Wall over processor time up to which times mean something."""

PATTERN = "planar_dual_arm"
"""The robot whose base, arm and limits the robots of other sizes have."""

ROBOTS = tuple((arms, joints) for arms in (1, 2, 3) for joints in (3, 5, 7))
"""Arms of each robot, and joints of each arm."""

SPACES = {"move": "joint", "reach": "task"}

GROWTH = ("solver", "start", "stages", "exponent")

PLANAR, SPATIAL = "transport", "servicing"
"""The tasks whose windows are solved in turn."""

PARTS = ("solve", "counterfactual solves", "plant", "log", "rest", "whole sample")

ITEMS, ADDITIONS, ROUNDS = 16, 40_000_000, 3
"""Calls of a loop of pure arithmetic, additions in each, and how often everything is timed."""

MESHES = {"25": 6, "100": 6, "auto": 0}
"""Meshes of these windows, and how many of the spatial ones IPOPT solves."""

WINDOWS = 20
"""Windows of each task and mesh."""

BASE_GOAL, BENT = (1.0, 0.4, 0.3), 0.5
"""Goal of the base [m, rad], and the sum of the angles of an arm's joints at the goal [rad]."""


def runs(nodes: str = "100") -> Iterator[str]:
    """Yield the tables of whole runs: solve times and wall time by setting; first and later runs on a machine."""
    rows, first, mesh = [], math.nan, f"controller.nodes={nodes}"
    with TemporaryDirectory() as folder:
        os.environ["PSMPC_CACHE"] = str(Path(folder) / "cache")
        log = Path(folder) / "run.h5"
        times = {"first run on a machine: compilation and figures": _wall_time(log, "--figures", mesh)}
        times["later runs, with figures"] = _wall_time(log, "--figures", mesh)
        for name, changes in RUNS.items():
            wall_time = _wall_time(log, "--no-figures", mesh, *changes)
            summary = read_run(log).summary()
            first = summary.switching_solves.median if math.isnan(first) else first
            rows.append((name, *_solves(summary, first), f"{wall_time:.1f}"))
    yield from markdown(RUN_HEADINGS, rows)
    yield ""
    named = [(name, f"{taken:.1f}") for name, taken in times.items()]
    yield from markdown(("`psmpc simulate transport`", "wall time [s]"), named)


def _wall_time(log: Path, option: str, *changes: str) -> float:
    """Return how long the command takes for a run of the transport task, a process of its own [s]."""
    settings = [word for change in changes for word in ("--set", change)]
    began = perf_counter()
    subprocess.run([*PSMPC, "simulate", "transport", "-q", "--force", "-o", log, option, *settings], check=True)
    return perf_counter() - began


def _solves(summary: Summary, first: float) -> Iterator[str]:
    """Yield the cells of a run's solves; `first` is the median of the first row [s]."""
    switching, all_of_them = summary.switching_solves, summary.solves
    times = (switching.median, switching.p99, switching.largest)
    yield ", ".join(_number(1e3 * time) for time in times)
    yield _number(switching.median / first)
    yield f"{_number(1e3 * all_of_them.median)}, {_number(1e3 * all_of_them.p99)}"
    yield str(summary.missed)
    yield str(summary.failed_solves)
    yield ", ".join(f"{stage.switch_time:.2f}" for stage in summary.stages)


def windows() -> Iterator[str]:
    """Yield the machine, and the tables of solves of single windows: by mesh, by number of stages, growth with N_s."""
    bench = run_bench(load_bench("transport", ()), told=_tell)
    made = datetime.now(UTC).isoformat(timespec="seconds")
    yield f"{describe_machine(bench)}; {made}."
    if bench.wall_over_busy > QUIET:
        yield "**The machine was busy: times are too long, and those of different meshes cannot be compared.**"
    yield ""
    yield from markdown(HEADINGS, bench_rows(bench))
    yield from ("", "Medians by the number of stages in the window:", "")
    yield from by_stages(bench)
    yield from ("", "The exponent p of time ~ N_s^p, by least squares of the logarithms of these medians:", "")
    nodes = {nodes: float(nodes) for nodes in NODES.split(",") if nodes != "auto"}
    yield from markdown(GROWTH, growth(nodes, bench))


def freedom() -> Iterator[str]:
    """Yield the table of how solve times grow with the degrees of freedom."""
    sized = {f"{arms} x {joints}": [sized_task(arms, joints)] for arms, joints in ROBOTS}
    robots = run_bench(sized, appends=1, told=_tell)
    yield from markdown(GROWTH, growth({f"{arms} x {joints}": 3.0 + arms * joints for arms, joints in ROBOTS}, robots))


def timed(subject: object, names: Sequence[str], clock: Callable[[], float] = perf_counter) -> list[float]:
    """Let methods of an object put the time that each call takes into a list [s], and return the list."""
    spent: list[float] = []

    def timing(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            began = clock()
            result = method(*arguments, **named)
            spent.append(clock() - began)
            return result

        return call

    for name in names:
        setattr(subject, name, timing(getattr(subject, name)))
    return spent


class WholeRun(NamedTuple):
    """A closed loop.

    Attributes:
        problem: Its task made computable.
        warm: Solves of windows with two stages that started from the one before, and these.
        times: Of each sample, wall time of its solves and processor time of the whole decision (K, 2) [s].
    """

    problem: Problem
    warm: list[tuple[Solution, Solution]]
    times: np.ndarray


def space(repeat: str = "5") -> Iterator[str]:
    """Yield the tables of a robot in space: its windows beside the planar robot's, and the solves of a whole run."""
    cells = {(name, nodes): _whole_run(name, nodes) for nodes in MESHES for name in (PLANAR, SPATIAL)}
    times, wall_over_busy = _solved_in_turn(cells, int(repeat))
    if wall_over_busy > QUIET:
        yield f"**The machine was busy: wall over processor time {wall_over_busy:.2f}.**\n"
    sizes = [cells[name, "25"].problem.model.n for name in (PLANAR, SPATIAL)]
    names = [f"{name}, n = {n} [ms]" for name, n in zip((PLANAR, SPATIAL), sizes, strict=True)]
    rows = []
    for nodes in MESHES:
        planar, spatial, ipopt = (
            1e3 * np.median(times.get(key, [np.nan]))
            for key in ((PLANAR, nodes, "sqp"), (SPATIAL, nodes, "sqp"), (SPATIAL, nodes, "ipopt"))
        )
        rows.append([nodes, *map(_number, (planar, spatial, spatial / planar, ipopt, ipopt / spatial))])
    yield from markdown(("nodes", *names, "over planar", f"{SPATIAL}, IPOPT [ms]", "IPOPT over sqp"), rows)
    yield ""
    each = cells[SPATIAL, "auto"].times
    spent = {"solves, wall time": each[:, 0], "whole decisions, processor time": each[:, 1]}
    heads = (f"whole run of {SPATIAL}, nodes auto", "median [ms]", "p99 [ms]", "max [ms]", "over 100 ms", "samples")
    yield from markdown(heads, [(name, *_spread(found)) for name, found in spent.items()])


def _whole_run(name: str, nodes: str) -> WholeRun:
    experiment = build_experiment(load_task(name, [f"controller.nodes={nodes}", "log.shares=false"]))
    busy = timed(experiment.controller, ["step"], process_time)
    warm, times = list[tuple[Solution, Solution]](), list[tuple[float, float]]()
    before = None
    for sample in closed_loop(experiment):
        solution = sample.command.solution
        times.append((sample.command.solve_time, busy[-1]))
        if before is not None and solution.warm and solution.outcome.usable and len(solution.window.stages) == 2:
            warm.append((solution, before))
        before = solution
    _tell(f"{name}, nodes {nodes}: {len(times)} samples, {len(warm)} warm windows of two stages")
    return WholeRun(experiment.problem, warm, np.array(times))


def _solved_in_turn(
    cells: Mapping[tuple[str, str], WholeRun], repeat: int
) -> tuple[Mapping[tuple[str, str, str], list[float]], float]:
    """Solve windows of all tasks and meshes again: once untimed, then repeatedly, in a new random order each time.

    Returns:
        Wall times by task, mesh and back-end [s]; wall time of all over their processor time.
    """
    calls = []
    for (name, nodes), run in cells.items():
        kinds = {"sqp": WINDOWS, "ipopt": MESHES[nodes] if name == SPATIAL else 0}
        for kind, count in kinds.items():
            spec = run.problem.spec.solver.model_copy(update={"kind": kind, "deadline": None})
            solver, chosen = build_solver(run.problem, spec), np.linspace(0, len(run.warm) - 1, count).astype(int)
            calls += [((name, nodes, kind), solver, *run.warm[k]) for k in chosen]
    for _, solver, solution, before in calls:
        solver.solve(solution.window, solution.guess, before)
    times: dict[tuple[str, str, str], list[float]] = {}
    generator, began = np.random.default_rng(0), (perf_counter(), process_time())
    for _ in range(repeat):
        for k in generator.permutation(len(calls)):
            key, solver, solution, before = calls[k]
            times.setdefault(key, []).append(solver.solve(solution.window, solution.guess, before).wall_time)
    return times, (perf_counter() - began[0]) / (process_time() - began[1])


def _spread(times: np.ndarray) -> Iterator[str]:
    yield from (_number(1e3 * float(value)) for value in (np.median(times), np.percentile(times, 99), times.max()))
    yield from (str(int((times > 0.1).sum())), str(len(times)))


def _tell(line: str) -> None:
    sys.stderr.write(f"{line}\n")


def by_stages(bench: Bench) -> Iterator[str]:
    """Return median times by the number of stages in the window."""
    counts = sorted({solve.stages for solves in bench.solves.values() for solve in solves})
    headings = ("nodes", "solver", "start", *(f"{count} stage{'s' * (count > 1)} [ms]" for count in counts))
    rows = [
        (*way, *(_number(1e3 * median_time(solves, count)) for count in counts)) for way, solves in bench.solves.items()
    ]
    return markdown(headings, rows)


def growth(sizes: Mapping[str, float], bench: Bench) -> Iterator[Sequence[str]]:
    """Give the exponent p of time ~ size^p for each back-end, start and number of stages, by least squares of logs."""
    for solver, start in dict.fromkeys((solver, start) for _, solver, start in bench.solves):
        mine = {size: bench.solves[nodes, solver, start] for nodes, size in sizes.items()}
        for count in sorted({solve.stages for solves in mine.values() for solve in solves}):
            times = {size: median_time(solves, count) for size, solves in mine.items()}
            known = [(size, time) for size, time in times.items() if np.isfinite(time)]
            x, y = np.log(np.array(known)).reshape(-1, 2).T
            if len(np.unique(x)) > 1:
                yield solver, start, str(count), _number(float(np.polyfit(x, y, 1)[0]))


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"


def overhead(nodes: str = "25") -> Iterator[str]:
    """Yield the table of what a sample costs: times are the least of three runs, which are equal sample by sample.

    The rest is all but the solve behind the command, counterfactual solves, plant and log.
    """
    runs = [np.min([_sample_parts(int(nodes), shares) for _ in range(3)], axis=0) for shares in (False, True)]
    columns = [1e3 * np.median(times, axis=0) for times in runs]
    rows = [(name, *(f"{times[i]:.2f}" for times in columns)) for i, name in enumerate(PARTS)]
    solve, rest, whole = (columns[0][PARTS.index(name)] for name in ("solve", "rest", "whole sample"))
    rows.append(("rest over solve, at most 0.4", f"{rest / solve:.2f}", ""))
    rows.append(("whole sample over solve, at most 1.8", f"{whole / solve:.2f}", ""))
    return markdown((f"median of a sample, N_s = {nodes} [ms]", "without shares", "with shares"), rows)


def _sample_parts(nodes: int, shares: bool) -> np.ndarray:
    """Return what the parts of each sample of a run took (K, parts) [s]."""
    experiment = build_experiment(load_task("transport", {"controller.nodes": nodes, "log.shares": shares}))
    spent = timed(experiment.counterfactuals, ["presence", "shares"]), timed(experiment.plant, ["advance"])
    found: list[list[float]] = []
    with TemporaryDirectory() as folder, LogWriter(Path(folder) / "run.h5", header(experiment)) as writer:
        began = perf_counter()
        for sample in closed_loop(experiment):
            decided = perf_counter()
            writer.append(sample)
            ended = perf_counter()
            parts = [sample.command.solve_time, *map(sum, spent), ended - decided]
            found.append([*parts, ended - began - sum(parts), ended - began])
            for times in spent:
                times.clear()
            began = perf_counter()
    return np.array(found)


def parallel() -> Iterator[str]:
    """Yield the table of what a second process brings; all is timed in turn, so that other load falls on all alike."""
    timings: dict[str, Callable[[int], float]] = {
        "a loop of arithmetic": _loop_time,
        "16 runs of a sweep that share nothing": _sweep_time,
    }
    times: dict[tuple[str, int], list[float]] = {(name, jobs): [] for name in timings for jobs in (1, 2)}
    _sweep_time(2)  # whatever is compiled is compiled now
    for _ in range(ROUNDS):
        for name, jobs in times:
            times[name, jobs].append(timings[name](jobs))
    rows = []
    for name in timings:
        one, two = (float(np.median(times[name, jobs])) for jobs in (1, 2))
        rows.append((name, f"{one:.1f}", f"{two:.1f}", f"{one / two / 2:.2f}"))
    return markdown(("", "one process [s]", "two [s]", "efficiency of two"), rows)


def _loop_time(jobs: int) -> float:
    """Return how long loops of arithmetic take in so many processes [s]."""
    began = perf_counter()
    list(compute(sum, [range(ADDITIONS)] * ITEMS, jobs))
    return perf_counter() - began


def _sweep_time(jobs: int) -> float:
    """Return how long a sweep of runs that share nothing takes in so many processes [s]."""
    study = weight_study(load_sweep_task(DEFAULT_TASK), (0, 1), parse_sampling("4x4", (1e-1, 1e2)), every_cell=True)
    began = perf_counter()
    run_study(study, None, jobs)
    return perf_counter() - began


def sized_task(arms: int, joints: int) -> Task:
    """Return a task of two stages for a robot with so many arms, whose joints share the length and mass of an arm."""
    robot, names = sized_robot(arms, joints), [f"arm_{k + 1}" for k in range(arms)]
    straight = dict.fromkeys(names, [0.0] * joints)
    weights = {
        "move": {"base": [100.0, 100.0, 10.0], **{name: [100.0] * joints for name in names}, "control": 0.03},
        "reach": {"base": [100.0] * 3, **{name: [10.0, 10.0, 1.0] for name in names}, "control": 0.03},
    }
    go = {"name": "go", "skill": "move", "target": {"base": list(BASE_GOAL), **straight}}
    reach = {"name": "reach", "skill": "reach", "priority": 100.0, "target": _poses(robot, arms, joints)}
    task: dict[str, Data] = {
        "robot": PATTERN,
        "initial": {"base": [0.0] * 3, **straight},
        "controller": {"horizon": 4.0, "nodes": 25},
        "solver": {"kind": "sqp"},
        "plant": {"kind": "ideal"},
        "log": {"shares": False},
        "skills": {name: {"space": SPACES[name], "weights": each} for name, each in weights.items()},
        "stages": [{**stage, "ends_when": {"coordinates": ["base"], "tolerance": 2e-3}} for stage in (go, reach)],
    }
    return parse_task(write(task), write(robot), str(robot["name"]))


def sized_robot(arms: int, joints: int) -> dict[str, Data]:
    """Return a robot as YAML has it, its arms around the base."""
    pattern = load_robot(PATTERN)
    arm = next(iter(pattern.arms.values()))
    shoulder = math.hypot(*arm.mount.position)
    angles = [2 * math.pi * k / arms for k in range(arms)]
    return {
        "name": f"arms_{arms}_joints_{joints}",
        "base": {"mass": pattern.base.mass, "inertia": pattern.base.inertia},
        "arms": {
            f"arm_{k + 1}": {
                "mount": {"position": [shoulder * math.cos(angle), shoulder * math.sin(angle)], "angle": angle},
                "links": _links(arm, joints),
            }
            for k, angle in enumerate(angles)
        },
        "limits": {"base": {"velocity": [0.2] * 3}, "arms": {"velocity": [0.15] * joints}},
    }


def _links(arm: Arm, joints: int) -> list[Data]:
    """Return equal, even rods that are together as long and as heavy as an arm."""
    length = sum(link.a + link.b for link in arm.links) / joints
    mass = sum(link.mass for link in arm.links) / joints
    rod = {"mass": mass, "inertia": mass * length**2 / 12, "a": length / 2, "b": length / 2}
    return [dict(rod) for _ in range(joints)]


def _poses(robot: Mapping[str, Data], arms: int, joints: int) -> dict[str, Data]:
    """Return the poses of base and end-effectors with the base at its goal and the arms bent."""
    model = RobotModel(PlanarRobot.model_validate(robot))
    xi = np.asarray(model.g(np.r_[BASE_GOAL, np.full(arms * joints, BENT / joints)])).ravel()
    return {part: [float(value) for value in xi[rows]] for part, rows in model.pose_rows.items()}


TABLES = {each.__name__: each for each in (runs, windows, freedom, space, overhead, parallel)}

if __name__ == "__main__":
    print("\n".join(TABLES[sys.argv[1]](*sys.argv[2:])))
