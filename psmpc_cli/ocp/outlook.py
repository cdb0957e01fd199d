"""What can be said of a task before anything is solved: how far targets are, and how long stages take at least."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.ocp.stages import Stage, build_stages
from psmpc_cli.robot.model import build_model
from psmpc_cli.robot.reach import Reach, reach_of
from psmpc_cli.specs.coordinates import Limits, stack
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robot import PartLimits, RobotSpec

Vector = NDArray[np.float64]

BASE = slice(0, 3)
"""Rows of the base pose in Q and xi."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """One stage, looked at beforehand.

    Attributes:
        stage: The stage.
        reaches: By arm, how far its target is with the base at its own, under the limits in force; empty in joint
            space, and for arms (or with a base) whose place neither weights nor the end condition ask for. Of a
            trajectory, the last row's.
        earliest_end: Time before which the stage cannot end [s]: from velocity limits, dwells and fixed times.
        stuck: Rows of Q that its end condition wants elsewhere but velocity limits let not move that way.
    """

    stage: Stage
    reaches: Mapping[str, Reach]
    earliest_end: float
    stuck: tuple[int, ...] = ()


@dataclass(frozen=True)
class _Known:
    """A coordinate was at `value` within `tolerance` [m, rad] at the end of stage `index`, not before `time` [s]."""

    value: float
    tolerance: float
    index: int
    time: float


def look_ahead(task: Task) -> tuple[Outlook, ...]:
    """Return the outlook of every stage of a task."""
    stages = build_stages(task.spec, task.robot, build_model(task.robot))
    ends = earliest_ends(stages, stack(task.spec.initial, task.robot, "joint"))
    reaches = (reaches_of(stage, task.robot, stage.target) for stage in stages)
    return tuple(Outlook(stage, reach, *end) for stage, reach, end in zip(stages, reaches, ends, strict=True))


def earliest_ends(stages: Sequence[Stage], Q: Vector) -> tuple[tuple[float, tuple[int, ...]], ...]:
    """Return for every stage a lower bound on the time at which it ends [s], starting from Q (n,), and its stuck rows.

    A coordinate that one stage leaves at its target, and a later one must have at another, takes at least their
    distance over its largest velocity in between; the tolerances are taken off the distance.
    """
    known = {row: _Known(float(value), 0.0, -1, 0.0) for row, value in enumerate(Q)}
    ends: list[tuple[float, tuple[int, ...]]] = []
    for stage in stages:
        asked = {row: tolerance for row, tolerance in end_tolerances(stage).items() if is_coordinate(stage, row)}
        arrivals = {row: _arrival(stages, stage, row, tolerance, known[row]) for row, tolerance in asked.items()}
        possible = [time for time in arrivals.values() if np.isfinite(time)]
        end = max([(ends[-1][0] if ends else 0.0) + stage.dwell, *possible])
        end = stage.at if stage.at is not None else end
        known |= {row: _Known(float(stage.target[row]), asked[row], stage.index, end) for row in asked}
        ends.append((end, tuple(row for row, time in arrivals.items() if np.isinf(time))))
    return tuple(ends)


def end_tolerances(stage: Stage) -> dict[int, float]:
    """Return the tolerance of every row of the end condition [m, rad]."""
    return dict(zip(stage.end_rows, stage.tolerance.tolist(), strict=True))


def is_coordinate(stage: Stage, row: int) -> bool:
    """Tell whether a row of the stage's target is one of Q: all in joint space, the base's in task space."""
    return stage.space == "joint" or row < BASE.stop


def counts(stage: Stage, rows: slice) -> bool:
    """Tell whether weights or the end condition ask for all of some rows of the target."""
    inside = range(rows.start, rows.stop)
    return all(stage.weights[row] > 0 or row in stage.end_rows for row in inside)


def under(robot: RobotSpec, limits: Limits) -> RobotSpec:
    """Return the robot with other position limits of its arms."""
    bounded, first = {}, 0
    for part, size in robot.parts.items():
        rows = slice(first, first + size)
        pairs = zip(limits.position_low[rows].tolist(), limits.position_high[rows].tolist(), strict=True)
        bounded[part] = PartLimits.model_construct(position=tuple(pairs))
        first += size
    return robot.model_copy(update={"limits": bounded})


def pose_rows(robot: RobotSpec, arm: str) -> slice:
    """Return the rows of an arm's pose in xi."""
    first = BASE.stop * (1 + list(robot.arms).index(arm))
    return slice(first, first + BASE.stop)


def reach_with(robot: RobotSpec, arm: str, limits: Limits, xi: Vector, base: Vector | None = None) -> Reach:
    """Return how far an arm's pose in xi (m,) is, with the base (3,) at its own or elsewhere, under some limits."""
    base = xi[BASE] if base is None else base
    return reach_of(under(robot, limits), arm, base.tolist(), xi[pose_rows(robot, arm)].tolist())


def reaches_of(stage: Stage, robot: RobotSpec, xi: Vector) -> dict[str, Reach]:
    """Return how far poses xi (m,) of a stage's target are, of the arms whose poses count."""
    if stage.space == "joint" or not counts(stage, BASE):
        return {}
    arms = [arm for arm in robot.arms if counts(stage, pose_rows(robot, arm))]
    return {arm: reach_with(robot, arm, stage.limits, xi) for arm in arms}


def _arrival(stages: Sequence[Stage], stage: Stage, row: int, tolerance: float, before: _Known) -> float:
    """Return the time before which a coordinate cannot be at the stage's target [s]; inf if it cannot move there."""
    way = float(stage.target[row]) - before.value
    limits = [passed.limits for passed in stages[before.index + 1 : stage.index + 1]]
    rate = max(float(limit.velocity_high[row] if way > 0 else -limit.velocity_low[row]) for limit in limits)
    distance = abs(way) - tolerance - before.tolerance
    if distance <= 0:
        return before.time
    return before.time + distance / rate if rate > 0 else np.inf
