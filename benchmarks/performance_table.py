"""Measures what docs/performance.md says of solve times and writes its tables; on a machine that does nothing else.

    python benchmarks/performance_table.py            10 to 15 minutes

Each table is between two comments with its name; everything else on the page remains as it is.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy is loaded

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime

import numpy as np
from pages import write_between

from psmpc_cli.robot.model import build_model
from psmpc_cli.specs.document import Data, write
from psmpc_cli.specs.load import Task, load_robot, parse_task
from psmpc_cli.specs.robot import Arm, RobotSpec
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

PAGE = "performance.md"

QUIET = 1.1
"""Wall over processor time up to which times mean something."""

PATTERN = "planar_dual_arm"
"""The robot whose base, arm and limits the robots of other sizes have."""

ROBOTS = tuple((arms, joints) for arms in (1, 2, 3) for joints in (3, 5, 7))
"""Arms of each robot, and joints of each arm."""

BASE_GOAL, BENT = (1.0, 0.4, 0.3), 0.5
"""Goal of the base [m, rad], and the sum of the angles of an arm's joints at the goal [rad]."""


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return a table in Markdown."""
    return ["| " + " | ".join(line) + " |" for line in (headings, ["---"] * len(headings), *rows)]


def machine(bench: Bench) -> list[str]:
    """Return what the bench ran on."""
    busy = " **The machine was busy: times are too long, and do not compare from mesh to mesh.**"
    made = datetime.now(UTC).isoformat(timespec="seconds")
    return [f"{describe_machine(bench)}; {made}.{busy if bench.wall_over_busy > QUIET else ''}"]


def by_stages(bench: Bench) -> list[str]:
    """Return median times by the number of stages in the window."""
    counts = sorted({solve.stages for solves in bench.solves.values() for solve in solves})
    headings = ("nodes", "solver", "start", *(f"{count} stage{'s' * (count > 1)} [ms]" for count in counts))
    rows = [
        (*way, *(_number(1e3 * median_time(solves, count)) for count in counts)) for way, solves in bench.solves.items()
    ]
    return table(headings, rows)


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


def sized_task(arms: int, joints: int) -> Task:
    """Return a task of two stages for a robot with so many arms, whose joints share the length and mass of an arm."""
    robot, names = sized_robot(arms, joints), [f"arm_{k + 1}" for k in range(arms)]
    task: dict[str, Data] = {
        "robot": PATTERN,
        "initial": {"base": [0.0] * 3, **{name: [0.0] * joints for name in names}},
        "controller": {"horizon": 4.0, "nodes": 25},
        "solver": {"kind": "sqp"},
        "plant": {"kind": "ideal"},
        "log": {"shares": False},
        "skills": {
            "move": {"space": "joint", "weights": _weights([100.0, 100.0, 10.0], names, [100.0] * joints)},
            "reach": {"space": "task", "weights": _weights([100.0] * 3, names, [10.0, 10.0, 1.0])},
        },
        "stages": [
            {
                "name": "go",
                "skill": "move",
                "target": {"base": list(BASE_GOAL), **{name: [0.0] * joints for name in names}},
                "ends_when": {"coordinates": ["base"], "tolerance": 2e-3},
            },
            {
                "name": "reach",
                "skill": "reach",
                "priority": 100.0,
                "target": _poses(robot, arms, joints),
                "ends_when": {"coordinates": ["base"], "tolerance": 2e-3},
            },
        ],
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


def _weights(base: list[Data], names: list[str], arm: list[Data]) -> dict[str, Data]:
    return {"base": base, **dict.fromkeys(names, arm), "control": 0.03}


def _poses(robot: Mapping[str, Data], arms: int, joints: int) -> dict[str, Data]:
    """Return the poses of base and end-effectors with the base at its goal and the arms bent."""
    model = build_model(RobotSpec.model_validate(robot))
    xi = np.asarray(model.g(np.r_[BASE_GOAL, np.full(arms * joints, BENT / joints)])).ravel()
    return {part: [float(value) for value in xi[rows]] for part, rows in model.pose_rows.items()}


def main() -> None:
    """Measure, and write the tables."""
    bench = run_bench(load_bench("transport", ()), told=print)
    write_between(PAGE, "machine", machine(bench))
    write_between(PAGE, "meshes", table(HEADINGS, bench_rows(bench)))
    write_between(PAGE, "stages", by_stages(bench))
    nodes = {nodes: float(nodes) for nodes in NODES.split(",") if nodes != "auto"}
    headings = ("solver", "start", "stages", "exponent")
    write_between(PAGE, "growth with nodes", table(headings, growth(nodes, bench)))
    sized = {f"{arms} x {joints}": [sized_task(arms, joints)] for arms, joints in ROBOTS}
    robots = run_bench(sized, appends=1, told=print)
    freedom = {f"{arms} x {joints}": 3.0 + arms * joints for arms, joints in ROBOTS}
    write_between(PAGE, "growth with freedom", table(headings, growth(freedom, robots)))


if __name__ == "__main__":
    main()
