"""Measures what docs/performance.md says of times and prints its tables; on a machine that does nothing else.

python benchmarks/performance_table.py runs [NODES]     whole runs of the transport task; a minute
python benchmarks/performance_table.py tasks [TASK ...] what every built-in task takes; three minutes
python benchmarks/performance_table.py windows          solves of single windows by every back-end; 10 to 15 minutes
python benchmarks/performance_table.py freedom          how solve times grow with the robot; some minutes
python benchmarks/performance_table.py space [REPEAT]   a spatial robot beside the planar one; two minutes
python benchmarks/performance_table.py forces [REPEAT]  what limits of forces cost; two minutes
python benchmarks/performance_table.py derivatives [REPEAT]  forces with their derivatives, beside Pinocchio; a minute
python benchmarks/performance_table.py overhead [NODES] what a sample costs besides its solve
python benchmarks/performance_table.py parallel         what a second process brings a sweep
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy is loaded

import gc
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

import casadi as ca
import numpy as np
from pages import as_csv, command_line, markdown, run_psmpc, write_long_tables

import psmpc_cli as psmpc
from psmpc_cli.control import Command
from psmpc_cli.logs import write as log
from psmpc_cli.native.functions import BatchFunction, tape_library
from psmpc_cli.ocp.constraints.forces import ForceStructure, force_rows
from psmpc_cli.ocp.loads import LoadKind
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.run import build_experiment, closed_loop
from psmpc_cli.solvers import Solution, build_solver
from psmpc_cli.specs.document import Data, write
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import Task, load_robot, load_task, parse_task
from psmpc_cli.specs.robots.robot import PlanarRobot, SpatialRobot
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
from psmpc_cli.studies.runner import compute

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

QUIET = 1.1
"""Wall over processor time up to which times mean something."""

PATTERN = "planar_dual_arm"
"""The robot whose base, arm and limits the robots of other sizes have."""

ROBOTS = tuple(product((1, 2, 3), (3, 5, 7)))
"""Arms of each robot, and joints of each arm."""

SHOWN = {
    *product(("25", "100", "auto"), ("sqp", "fatrop", "ipopt"), ("warm",)),
    *product(("25", "100", "auto"), ("reference",), ("cold",)),
}
"""Meshes, back-ends and starts of the solves that a page shows."""

PLANAR, SPATIAL = "transport", "servicing"
"""The tasks whose windows are solved in turn."""

MESHES = ("25", "100", "auto")

WINDOWS = 20
"""Windows of each task and mesh."""

PARTS = ("solve", "counterfactual solves", "plant", "log", "rest", "whole sample")

ITEMS, ADDITIONS, ROUNDS = 16, 40_000_000, 3
"""Calls of a loop of pure arithmetic, additions in each, and how often everything is timed."""

BASE_GOAL, BENT = [1.0, 0.4, 0.3], 0.5
"""Goal of the base [m, rad], and the sum of the angles of an arm's joints at the goal [rad]."""


def runs(nodes: str = "100") -> Iterator[str]:
    """Yield the tables of whole runs: solve times and wall time by setting; first and later runs on a machine."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        os.environ["PSMPC_CACHE"] = str(folder / "cache")

        def wall_time(*words: str) -> float:
            began = perf_counter()
            line = f"psmpc simulate transport -q --force -o run.h5 --set controller.nodes={nodes}"
            run_psmpc(shlex.join([*line.split(), *words]), folder, check=True)
            return perf_counter() - began

        names = "first run on a machine: compilation and figures", "later runs, with figures"
        with_figures = [(name, f"{wall_time('--figures'):.1f}") for name in names]
        rows, first = [], math.nan
        for name, changes in RUNS.items():
            taken = wall_time("--no-figures", *(word for change in changes for word in ("--set", change)))
            summary = psmpc.read_run(folder / "run.h5").summary()
            some, every = summary.switching_solves, summary.solves
            first = some.median if math.isnan(first) else first
            rows.append(
                {
                    "`psmpc simulate transport --no-figures`": name,
                    "windows with a switch: median, p99, max [ms]": _ms(some.median, some.p99, some.largest),
                    "over the first row": _number(some.median / first),
                    "all windows: median, p99 [ms]": _ms(every.median, every.p99),
                    "solves over 100 ms": summary.missed,
                    "failed solves": summary.failed_solves,
                    "ends of the stages [s]": ", ".join(f"{stage.switch_time:.2f}" for stage in summary.stages),
                    "wall time [s]": f"{taken:.1f}",
                }
            )
    yield from markdown(rows)
    yield ""
    yield from markdown(with_figures, "`psmpc simulate transport`", "wall time [s]")


def _ms(*times: float) -> str:
    """Write times [s] in ms."""
    return ", ".join(_number(1e3 * time) for time in times)


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"


def _tell(line: str) -> None:
    sys.stderr.write(f"{line}\n")


def windows() -> Iterator[str]:
    """Yield the machine, the solves of single windows that a page shows, growth with N_s, and the files with all."""
    bench = run_bench(load_bench("transport", ()), watch=_tell)
    yield f"{describe_machine(bench)}; {datetime.now(UTC).isoformat(timespec='seconds')}."
    if bench.wall_over_busy > QUIET:
        yield "**The machine was busy: times are too long, and those of different meshes cannot be compared.**"
    yield ""
    solves = [dict(zip(HEADINGS, row, strict=True)) for row in bench_rows(bench)]
    yield from markdown(row for row in solves if (row["nodes"], row["solver"], row["start"]) in SHOWN)
    yield from ("", "The exponent p of time ~ N_s^p, by least squares of the logarithms of the medians:", "")
    yield from markdown(growth({nodes: float(nodes) for nodes in NODES.split(",") if nodes != "auto"}, bench))
    yield from ("", "All back-ends, starts and meshes, and the medians by the number of stages in the window:", "")
    counts = sorted({solve.stages for each in bench.solves.values() for solve in each})
    medians = [
        dict(zip(HEADINGS[:3], way, strict=True))
        | {f"{_stages(count)} [ms]": _ms(median_time(each, count)) for count in counts}
        for way, each in bench.solves.items()
    ]
    yield from write_long_tables({"speed-windows.csv": as_csv(solves), "speed-windows-by-stages.csv": as_csv(medians)})


def _stages(count: int) -> str:
    return f"{count} stage{'s' * (count > 1)}"


def freedom() -> Iterator[str]:
    """Yield the table of how solve times grow with the degrees of freedom."""
    tasks = {f"{arms} x {joints}": [sized_task(arms, joints)] for arms, joints in ROBOTS}
    sizes = {f"{arms} x {joints}": 3.0 + arms * joints for arms, joints in ROBOTS}
    return markdown(growth(sizes, run_bench(tasks, appends=1, watch=_tell)))


def growth(sizes: Mapping[str, float], bench: Bench) -> Iterator[dict[str, str]]:
    """Yield the exponent p of time ~ size^p for each back-end and start, by number of stages; least squares of logs."""
    for solver, start in dict.fromkeys((solver, start) for _, solver, start in bench.solves):
        mine = {size: bench.solves[nodes, solver, start] for nodes, size in sizes.items()}
        row = {"solver": solver, "start": start}
        for count in sorted({solve.stages for solves in mine.values() for solve in solves}):
            times = {size: median_time(solves, count) for size, solves in mine.items()}
            known = [(size, time) for size, time in times.items() if np.isfinite(time)]
            x, y = np.log(np.array(known)).reshape(-1, 2).T
            if len(np.unique(x)) > 1:
                row[f"exponent, {_stages(count)}"] = _number(float(np.polyfit(x, y, 1)[0]))
        yield row


def sized_task(arms: int, joints: int) -> Task:
    """Build a task of two stages for a robot with so many arms around its base, each as long and heavy as one pattern.

    The joints of an arm share its length and mass as equal, even rods.
    """
    pattern, names = load_robot(PATTERN), [f"arm_{k + 1}" for k in range(arms)]
    arm = next(iter(pattern.arms.values()))
    length = sum(link.a + link.b for link in arm.links) / joints
    mass, shoulder = sum(link.mass for link in arm.links) / joints, math.hypot(*arm.mount.position)
    rod = {"mass": mass, "inertia": mass * length**2 / 12, "a": length / 2, "b": length / 2}
    mounts = {}
    for k, name in enumerate(names):
        angle = 2 * math.pi * k / arms
        mounts[name] = {"position": [shoulder * math.cos(angle), shoulder * math.sin(angle)], "angle": angle}
    robot: dict[str, Data] = {
        "name": f"arms_{arms}_joints_{joints}",
        "base": {"mass": pattern.base.mass, "inertia": pattern.base.inertia},
        "arms": {name: {"mount": at, "links": [dict(rod) for _ in range(joints)]} for name, at in mounts.items()},
        "limits": {"base": {"velocity": [0.2] * 3}, "arms": {"velocity": [0.15] * joints}},
    }
    model = RobotModel(PlanarRobot.model_validate(robot))
    xi = np.asarray(model.g(np.r_[BASE_GOAL, np.full(arms * joints, BENT / joints)])).ravel()
    straight = dict.fromkeys(names, [0.0] * joints)
    ends = {"ends_when": {"coordinates": ["base"], "tolerance": 2e-3}}
    move = {"base": [100.0, 100.0, 10.0], **{name: [100.0] * joints for name in names}, "control": 0.03}
    reach = {"base": [100.0] * 3, **{name: [10.0, 10.0, 1.0] for name in names}, "control": 0.03}
    poses = {part: xi[rows].tolist() for part, rows in model.pose_rows.items()}
    task: dict[str, Data] = {
        "robot": PATTERN,
        "initial": {"base": [0.0] * 3, **straight},
        "controller": {"horizon": 4.0, "nodes": 25},
        "solver": {"kind": "sqp"},
        "plant": {"kind": "ideal"},
        "log": {"shares": False},
        "skills": {"move": {"space": "joint", "weights": move}, "reach": {"space": "task", "weights": reach}},
        "stages": [
            {"name": "go", "skill": "move", "target": {"base": BASE_GOAL, **straight}, **ends},
            {"name": "reach", "skill": "reach", "priority": 100.0, "target": poses, **ends},
        ],
    }
    return parse_task(write(task), write(robot), str(robot["name"]))


def timed(subject: object, name: str) -> list[float]:
    """Return a list [s] into which a method of an object puts the time of each of its calls from now on."""
    spent, method = list[float](), getattr(subject, name)

    def call(*arguments: Any, **named: Any) -> Any:
        began = perf_counter()
        result = method(*arguments, **named)
        spent.append(perf_counter() - began)
        return result

    setattr(subject, name, call)
    return spent


Warm = Sequence[tuple[Solution, Solution]]
"""Solves of windows with two stages that started from the one before, and these."""


def space(repeat: str = "5") -> Iterator[str]:
    """Yield the table of a robot in space: its windows beside the planar robot's."""
    cells = {(name, nodes): _whole_run(name, nodes) for nodes, name in product(MESHES, (PLANAR, SPATIAL))}
    times, wall_over_busy = _solved_in_turn(cells, int(repeat))
    if wall_over_busy > QUIET:
        yield f"**The machine was busy: wall over processor time {wall_over_busy:.2f}.**\n"
    names = [f"{name}, n = {cells[name, '25'][0].model.n} [ms]" for name in (PLANAR, SPATIAL)]
    rows = []
    for nodes in MESHES:
        planar, spatial = (float(np.median(times[name, nodes])) for name in (PLANAR, SPATIAL))
        rows.append((nodes, _ms(planar), _ms(spatial), _number(spatial / planar)))
    yield from markdown(rows, "nodes", *names, "over planar")


def forces(repeat: str = "5") -> Iterator[str]:
    """Yield the table of what limits of forces cost: whole runs in turn, medians over the rounds."""
    tasks = {name: build() for name, build in FORCED.items()}
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in tasks}
    for _ in range(int(repeat)):
        for name, task in tasks.items():
            solves = psmpc.simulate(task).summary().solves
            found[name].append((solves.median, solves.largest))
    medians = {name: np.median([median for median, _ in each]) for name, each in found.items()}
    largest = {name: np.median([most for _, most in each]) for name, each in found.items()}
    first, second, *_ = medians
    ratios = {second: f"{medians[second] / medians[first]:.2f}"}
    rows = ((name, _ms(medians[name]), ratios.get(name, ""), _ms(largest[name])) for name in tasks)
    yield from markdown(rows, "run", "median solve [ms]", "over the first", "longest solve, median of the rounds [ms]")


JOINTS_OF_ARMS = (1, 7, 17)
"""Joints of each arm of the robots whose derivatives are timed: that of one is planar and has two."""

HELD = {"mass": 20.0, "inertia": 2.0, "stiffness": (1e5, 1e4)}
"""A load in two hands [kg, kg m^2, N/m, N m/rad]."""

ROWS = 16
"""Rows evaluated at once: a block of a tape."""


def derivatives(repeat: str = "50") -> Iterator[str]:
    """Yield the table of what forces with all their derivatives take a row, in turn, medians over the rounds."""
    tape_library().compile()
    rows = []
    for model in (two_armed(joints) for joints in JOINTS_OF_ARMS):
        hands = tuple(model.spec.arms)
        calls = dict[str, Callable[[], object]]()
        counts = dict[str, int]()
        derived = dict[str, int]()
        for name, kind in (("free", LoadKind(False, ())), ("held", LoadKind(False, hands))):
            rows_of_force = force_rows(model, ForceStructure(tuple(range(model.n)), kind))
            value, jacobian = rows_of_force.prepare()
            jacobian.prepare()
            counts[name] = jacobian.function.n_instructions()
            derived[name] = casadi_instructions(value.function)
            arguments = random_rows(model, kind)
            interpreted = BatchFunction(jacobian.function)
            calls[name] = partial(jacobian, *arguments, rows=ROWS)
            calls[f"{name}, interpreted"] = partial(interpreted, *arguments, rows=ROWS)
        calls["Pinocchio"] = derivatives_in_pinocchio(model)
        times = medians_in_turn(calls, int(repeat))
        free, held = times["free"], times["held"]
        operations = [", ".join(f"{each[name] / 1e3:.1f}" for name in ("free", "held")) for each in (counts, derived)]
        over_free = (times["free, interpreted"], times["Pinocchio"], held)
        over_held = (times["held, interpreted"], times["Pinocchio"])
        ratios = (*(each / free for each in over_free), *(each / held for each in over_held))
        rows.append((model.n, *operations, f"{1e6 * free / ROWS:.1f}", *(f"{ratio:.2f}" for ratio in ratios)))
    yield from markdown(
        rows,
        "n",
        "length of the tape, free and held [1000 instructions]",
        "the same of CasADi's derivatives [1000]",
        "free: time of the tape [us]",
        "free: CasADi's interpreter / tape",
        "free: Pinocchio / tape",
        "tapes: held / free",
        "held: CasADi's interpreter / tape",
        "Pinocchio on the free robot / tape with the load",
    )


def casadi_instructions(value: ca.Function) -> int:
    """Return how many instructions CasADi's derivatives of a function have, by all arguments but the last."""
    arguments = value.sx_in()
    jacobian = ca.jacobian(value(*arguments), ca.vertcat(*arguments[:-1]))
    return int(ca.Function("derived", arguments, [ca.densify(jacobian)]).n_instructions())


def two_armed(joints: int) -> RobotModel:
    """Return a spatial robot with two arms of so many joints; for a single one the planar robot with two each."""
    if joints == 1:
        return RobotModel(sized_task(2, 2).robot)
    arms = {}
    for name, side in (("left", 1.0), ("right", -1.0)):
        links = [
            {
                "joint": {
                    "axis": [0, 0, 1] if k % 2 else [0, 1, 0],
                    "position": [0, side * 0.5 * (k == 0), 0.3 * (k > 0)],
                },
                "mass": 4.0,
                "centre_of_mass": [0.01, 0.02, 0.15],
                "inertia": [0.06, 0.05, 0.02, 0.001, 0.002, 0.003],
            }
            for k in range(joints)
        ]
        arms[name] = {"links": links, "tool": {"position": [0, 0, 0.2]}}
    base = {"mass": 150.0, "inertia": [25.0, 25.0, 25.0, 0.5, 0.4, 0.3]}
    return RobotModel(SpatialRobot.model_validate({"name": f"arms_of_{joints}", "base": base, "arms": arms}))


def random_rows(model: RobotModel, kind: LoadKind) -> tuple[np.ndarray, ...]:
    """Return arguments of the rows of forces: states, changes of velocity, lengths, and the load's numbers."""
    space = model.space
    rng = np.random.default_rng(0)
    X = 0.3 * rng.standard_normal((ROWS, 2 * model.n))
    dv = 0.1 * rng.standard_normal((ROWS, model.n))
    grasp = [*space.neutral[: space.n_pose], *HELD["stiffness"]]
    load = [HELD["mass"], *[HELD["inertia"]] * space.n_principal, *grasp * len(kind.grippers)]
    return X, dv, np.full((ROWS, 1), 0.2), np.array([*model.neutral[space.attitude], *load[: kind.count(model)]])


def derivatives_in_pinocchio(model: RobotModel) -> Callable[[], object]:
    """Return what computes the derivatives of the free robot's inverse dynamics at as many states by Pinocchio."""
    import pinocchio as pin

    engine = pin.Model()
    planar = model.dimension == 2
    kind = pin.JointModelPlanar() if planar else pin.JointModelFreeFlyer()
    numbers = [engine.addJoint(0, kind, pin.SE3.Identity(), "base")]
    for k, joint in enumerate(model.spec.joints):
        at = pin.SE3(pin.exp3(np.array(joint.at.rotation)), np.array(joint.at.position))
        axis = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        numbers.append(engine.addJoint(numbers[joint.at.body], axis, at, f"joint {k}"))
    for number, body in zip(numbers, model.spec.bodies, strict=True):
        xx, yy, zz, xy, xz, yz = body.inertia
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        engine.appendBodyToJoint(number, pin.Inertia(body.mass, np.array(body.centre), moments), pin.SE3.Identity())
    data = engine.createData()
    rng = np.random.default_rng(0)
    q = [pin.integrate(engine, pin.neutral(engine), 0.3 * rng.standard_normal(model.n)) for _ in range(ROWS)]
    v, a = 0.3 * rng.standard_normal((2, ROWS, model.n))

    def compute() -> None:
        for k in range(ROWS):
            pin.computeRNEADerivatives(engine, data, q[k], v[k], a[k])

    return compute


def medians_in_turn(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the median time of each call [s], all made in turn, after one that is not timed."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(rounds):
        for name, call in calls.items():
            began = perf_counter()
            call()
            times[name].append(perf_counter() - began)
    return {name: float(np.median(each)) for name, each in times.items()}


FLOATING = {
    "robot": "dual_arm_servicer",
    "mobility": "free-floating",
    "initial": {
        "base": {"position": [0, 0, 0]},
        "left": [0, 0.6, 0, -1.2, 0, 0.6, 0],
        "right": [0, -0.6, 0, 1.2, 0, -0.6, 0],
    },
    "controller": {"nodes": "auto"},
    "skills": {
        "reach": {"space": "task", "weights": {"arms": [100, 100, 100, 10, 10, 10], "control": 0.1}},
        "fold": {"space": "joint", "weights": {"arms": [10] * 7, "control": 0.1}},
    },
    "log": {"shares": False},
}
"""Both hands of the servicer, whose thrusters are off, to poses, then its arms home."""

REACHED = [0.4, 0.3, 0.2, 0.4, -0.2, 0.3, 0.1]
"""By how much the joints of the left arm are turned where the hands are to be, those of the right arm the other way."""


def floating() -> Task:
    """Return the task of 20 degrees of freedom without thrusters."""
    model = psmpc.load_robot("dual_arm_servicer")
    home = {arm: np.array(FLOATING["initial"][arm]) for arm in ("left", "right")}
    Q = np.r_[model.neutral[: model.space.joint_coordinates.start], home["left"] + REACHED, home["right"] - REACHED]
    hands = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    poses = {
        arm: {"position": hands[arm][:3].tolist(), "attitude": {"quaternion": hands[arm][3:].tolist()}} for arm in home
    }
    ends = {"ends_when": {"coordinates": ["arms"], "tolerance": 5e-3}}
    folded = {arm: joints.tolist() for arm, joints in home.items()}
    stages = [
        {"name": "reach", "skill": "reach", "target": poses, **ends},
        {"name": "fold", "skill": "fold", "priority": 0.1, "target": folded, **ends},
    ]
    return load_task({**FLOATING, "stages": stages})


FORCED: Mapping[str, Callable[[], Task]] = {
    "`transport`, N_s = 25": lambda: load_task("transport", ["controller.nodes=25", "log.shares=false"]),
    "the same with limits, base 20 N and 6 N m, joints 56, 28 and 12 N m": lambda: load_task(
        "transport",
        [
            "controller.nodes=25",
            "log.shares=false",
            "limits.base.force=[20, 20, 6]",
            "limits.arms.force=[56, 28, 12]",
        ],
    ),
    "20 degrees of freedom, free-floating, joints 100 N m, nodes auto": floating,
}
"""Tasks with and without limits of forces."""


def deadlines() -> Iterator[str]:
    """Yield the table of samples whose solves share a deadline: of whole decisions, the largest wall times."""
    rows = []
    for name, nodes, solver in DEADLINES:
        free, cut = (_decisions(name, nodes, solver, deadline) for deadline in ("null", "0.03"))
        several = sum(command.solution.wall_time > 0.03 for command in free[0])
        ended = cut[0][-1].sequence.first == free[0][-1].sequence.first
        largest = (_ms(max(times)) for _, times in (free, cut))
        over = sum(time > 0.04 for time in cut[1])
        rows.append((name, nodes, solver, len(cut[0]), several, *largest, over, "yes" if ended else "no"))
    headings = (
        "task",
        "nodes",
        "solver",
        "samples, with deadline",
        "solves over 30 ms, run without deadline",
        "largest, without deadline [ms]",
    )
    more = ("largest, with deadline [ms]", "over 40 ms, with deadline", "as many stages done")
    return markdown(rows, *headings, *more)


DEADLINES = (
    ("transport", "25", "sqp"),
    ("transport", "100", "sqp"),
    ("transport", "auto", "sqp"),
    ("servicing", "auto", "sqp"),
    ("transport", "25", "ipopt"),
)
"""Tasks, nodes and solvers whose samples are timed with and without a deadline."""


def _decisions(name: str, nodes: str, solver: str, deadline: str) -> tuple[list[Command], list[float]]:
    """Run a closed loop and return its commands and the wall times of their decisions [s]."""
    settings = [f"controller.nodes={nodes}", f"solver.kind={solver}", f"solver.deadline={deadline}", "log.shares=false"]
    experiment = build_experiment(load_task(name, settings))
    gc.collect()
    gc.freeze()  # what other runs have left is no matter of this one
    spent = timed(experiment.controller, "step")
    commands = [sample.command for sample in closed_loop(experiment)]
    _tell(f"{name}, nodes {nodes}, {solver}, deadline {deadline}: {len(commands)} samples")
    return commands, spent[: len(commands)]


def _whole_run(name: str, nodes: str) -> tuple[Problem, Warm]:
    """Run a closed loop; return its problem and its warm windows."""
    experiment = build_experiment(load_task(name, [f"controller.nodes={nodes}", "log.shares=false"]))
    commands = [sample.command for sample in closed_loop(experiment)]
    solutions = [command.solution for command in commands]
    warm = [
        (solution, before)
        for before, solution in pairwise(solutions)
        if solution.warm and solution.outcome.usable and len(solution.window.stages) == 2
    ]
    _tell(f"{name}, nodes {nodes}: {len(commands)} samples, {len(warm)} warm windows of two stages")
    return experiment.problem, warm


def _solved_in_turn(
    cells: Mapping[tuple[str, str], tuple[Problem, Warm]], repeat: int
) -> tuple[Mapping[tuple[str, str], list[float]], float]:
    """Solve windows of all tasks and meshes again: once untimed, then repeatedly, in a new random order each time.

    Returns:
        Wall times by task and mesh [s]; wall time of all over their processor time.
    """
    calls = []
    for (name, nodes), (problem, warm) in cells.items():
        solver = build_solver(problem, problem.spec.solver.model_copy(update={"deadline": None}))
        chosen = np.linspace(0, len(warm) - 1, WINDOWS).astype(int)
        calls += [((name, nodes), solver, *warm[k]) for k in chosen]
    for _, solver, solution, before in calls:
        solver.solve(solution.window, solution.guess, before)
    times: dict[tuple[str, str], list[float]] = {}
    generator, began = np.random.default_rng(0), (perf_counter(), process_time())
    for k in (k for _ in range(repeat) for k in generator.permutation(len(calls))):
        key, solver, solution, before = calls[k]
        times.setdefault(key, []).append(solver.solve(solution.window, solution.guess, before).wall_time)
    return times, (perf_counter() - began[0]) / (process_time() - began[1])


def overhead(nodes: str = "25") -> Iterator[str]:
    """Yield the table of what a sample costs: times are the least of three runs, which are equal sample by sample.

    The rest is all but the solve behind the command, counterfactual solves, plant and log. Measuring samples and
    reading their rows, done of many together, counts with its mean; medians leave out writing the file.
    """
    together = timed(log, "rows_of"), timed(log, "measure_together")
    both = [load_task("transport", {"controller.nodes": int(nodes), "log.shares": shares}) for shares in (False, True)]
    runs = [np.min([_sample_parts(task, together) for _ in range(3)], 0) for task in both]
    columns = [1e3 * np.median(times, axis=0) for times in runs]
    rows = [(name, *(f"{times[i]:.2f}" for times in columns)) for i, name in enumerate(PARTS)]
    solve, *_, rest, whole = columns[0]
    rows.append(("rest over solve", f"{rest / solve:.2f}", ""))
    rows.append(("whole sample over solve", f"{whole / solve:.2f}", ""))
    return markdown(rows, f"median of a sample, N_s = {nodes} [ms]", "without shares", "with shares")


def tasks(*names: str) -> Iterator[str]:
    """Yield the table of whole runs of tasks, by default the built-in ones: late decisions, and what takes time."""
    measured = timed(log, "measure_together")
    rows = []
    for name in names or built_ins("task"):
        task = load_task(name)
        decisions = list[float]()
        measured.clear()
        parts = _parts_of_samples(task, decisions)
        solve, counterfactuals, plant, written, rest, whole = parts.sum(axis=0)
        period = task.spec.controller.sample_time
        late = sum(time > period for time in decisions)
        seconds = (solve, counterfactuals, plant, sum(measured), written - sum(measured), rest)
        speed = f"{len(parts) * period / whole:.1f}"
        times = _ms(*np.quantile(decisions, [0.5, 0.99, 1.0]).tolist())
        rows.append(
            (
                f"`{Path(name).stem}`",
                len(parts),
                times,
                late,
                speed,
                *(f"{round(each, 1) + 0.0:.1f}" for each in seconds),
            )
        )
        _tell(f"{name}: {len(parts)} samples")
    headings = ("task", "samples", "decisions: median, p99, max [ms]", "late", "times real time")
    parts_of_run = ("solves", "counterfactual solves", "plant", "measurements", "log", "rest")
    return markdown(rows, *headings, *(f"{part} [s]" for part in parts_of_run))


def _sample_parts(task: Task, together: Sequence[list[float]]) -> np.ndarray:
    """Return what the parts of each sample took (K, parts) [s]; `together` follows rows, then measurements in them."""
    for times in together:
        times.clear()
    found = _parts_of_samples(task)
    read, measured = (sum(times) / len(found) for times in together)
    return np.asarray(np.add(found, [0.0, 0.0, 0.0, read - measured, measured, read]))


def _parts_of_samples(task: Task, decisions: list[float] | None = None) -> np.ndarray:
    """Run a task and return what the parts of each sample took (K, parts) [s]; `decisions` gets those of decisions."""
    experiment = build_experiment(task)
    counterfactuals, found = experiment.counterfactuals, list[list[float]]()
    steps = timed(experiment.controller, "step")
    spent = [timed(counterfactuals, "presence"), timed(counterfactuals, "shares"), timed(experiment.plant, "advance")]
    with TemporaryDirectory() as folder, log.LogWriter(Path(folder) / "run.h5", header(experiment)) as writer:
        spent.append(timed(writer, "write"))
        began = perf_counter()
        for sample in closed_loop(experiment):
            writer.write(sample)
            whole = perf_counter() - began
            presence, shared, plant, written = map(sum, spent)
            parts = [sample.command.solve_time, presence + shared, plant, written]
            found.append([*parts, whole - sum(parts), whole])
            for times in spent:
                times.clear()
            began = perf_counter()
    if decisions is not None:
        decisions += steps[: len(found)]
    return np.array(found)


def parallel() -> Iterator[str]:
    """Yield the table of what a second process brings; all is timed in turn, so that other load falls on all alike."""
    priorities = {f"stages.{name}.priority": np.geomspace(0.1, 100, 4).tolist() for name in ("approach", "capture")}
    calls: dict[str, Callable[[int], object]] = {
        "a loop of arithmetic": lambda jobs: list(compute(sum, dict.fromkeys(range(ITEMS), range(ADDITIONS)), jobs)),
        "16 runs of a sweep that share nothing": lambda jobs: psmpc.sweep("approach_capture", priorities, jobs=jobs),
    }
    times: dict[tuple[str, int], list[float]] = {(name, jobs): [] for name in calls for jobs in (1, 2)}
    psmpc.sweep("approach_capture", priorities, jobs=2)  # whatever is compiled is compiled now
    for (name, jobs), spent in [*times.items()] * ROUNDS:
        began = perf_counter()
        calls[name](jobs)
        spent.append(perf_counter() - began)
    rows = []
    for name in calls:
        one, two = (float(np.median(times[name, jobs])) for jobs in (1, 2))
        rows.append((name, f"{one:.1f}", f"{two:.1f}", f"{one / two / 2:.2f}"))
    return markdown(rows, "", "one process [s]", "two [s]", "efficiency of two")


if __name__ == "__main__":
    command_line(runs, tasks, windows, freedom, space, overhead, deadlines, parallel, forces, derivatives)
