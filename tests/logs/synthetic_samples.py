"""Made-up samples of a robot with three coordinates in a task with four stages, as the rows they leave in a log."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from psmpc_cli.logs import conditions
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import MOMENTUM, layout
from psmpc_cli.logs.write import Header

COORDINATES, POSES, STAGES = ("base.x", "base.y", "arm_1.1"), ("base.x", "base.y", "base.theta"), ("a", "b", "c", "d")
TICKS = 5
SAMPLE = 0.1

HEADER = Header(
    attributes={"psmpc_version": "0.1.0", "controller": "psmpc", "task_name": "made up"}
    | {"task_yaml": "not: a task", "robot_yaml": "not: a robot"},
    values={
        "coordinate": COORDINATES,
        "pose_coordinate": POSES,
        "stage": STAGES,
        "momentum": MOMENTUM[2],
        "stages/epsilon": (1e-3, 1e-1),
        "stages/name": STAGES,
        "stages/priority": (1.0, 100.0, 1.0, 0.01),
        "monitors/name": ("object held", "größte Geschwindigkeit"),
        "uncertainty/body": ("base",),
        "uncertainty/axis": ("x", "y"),
    },
    has=frozenset({conditions.ALWAYS, conditions.TICKS, conditions.PLANS}),
)

LEAN = replace(HEADER, has=frozenset({conditions.ALWAYS}))

NOT_RECORDED = (
    conditions.LOAD,
    conditions.MASSES,
    conditions.OBJECT,
    conditions.OBJECT_AT_TICKS,
    conditions.CLEARANCE,
    conditions.THRUSTERS,
    conditions.PLUMES,
    conditions.THRUSTERS_AT_TICKS,
    conditions.WHEELS,
    conditions.WHEELS_AT_TICKS,
)
"""Conditions of datasets that no sample here has."""

EVENTS = ("appended", "postponed", "solve_failed", "braking")

Row = dict[str, np.ndarray | float | str]


def record(k: int, first: int = 0, count: int = 1, length: int = 7, multipliers: int = 0) -> Row:
    """Return what sample k leaves, all its numbers different, with `count` stages in the window."""
    numbers = iter(k + np.arange(1, 100_000) / 100_000)

    def draw(*shape: int) -> np.ndarray:
        return np.array([next(numbers) for _ in range(int(np.prod(shape)))]).reshape(shape)

    def placed(first: int, values: np.ndarray) -> np.ndarray:
        row = np.full(len(STAGES), np.nan)
        row[first : first + len(values)] = values
        return row

    sizes = {"coordinate": len(COORDINATES), "pose_coordinate": len(POSES), "stage": len(STAGES), "momentum": 3}
    row: Row = {}
    for column in layout(False):
        if column.value is None or column.only in NOT_RECORDED:
            continue
        if column.dims[0] == "ticks/tick":
            row[column.path] = draw(TICKS, *(sizes[dim] for dim in column.dims[1:]))
        elif column.ragged:
            row[column.path] = draw(length)
        else:
            values = draw(*(sizes[dim] for dim in column.dims[1:]))
            row[column.path] = values if column.dtype == "S16" else values.astype(column.dtype)
    return row | {
        "time": SAMPLE * k,
        "window/first": first,
        "window/count": count,
        "window/instants": placed(first, draw(count - 1)),
        "window/cost": placed(first, draw(count)),
        "window/nodes": placed(first, 10.0 + np.arange(count)),
        "window/presence": placed(first + 1, draw(1)) if count > 1 else np.full(len(STAGES), np.nan),
        "normalization/nadir": placed(first, draw(count)),
        **{f"events/{name}": k >> bit & 1 for bit, name in enumerate(EVENTS)},
        "events/unmeasured": 0,
        "solver/status": ("optimal", "iteration_limit")[k % 2],
        "plan/guess_multipliers": draw(multipliers),
        "plan/parameters": draw(length + 1),
        "ticks/time": SAMPLE * (k + np.arange(TICKS) / TICKS),
        "ticks/tick": k * TICKS + np.arange(TICKS),
    }


FINAL = {"final/end_time": 0.3, "final/Q": np.zeros(3)}
"""What ends a log."""


def read_all(logs: dict[str, Path]) -> dict[str, Run]:
    """Return the runs of logs."""
    return {name: read_run(path) for name, path in logs.items()}
