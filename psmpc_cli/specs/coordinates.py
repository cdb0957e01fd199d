"""Names of coordinates as rows of vectors, numbers by part as vectors, and the limits in force."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.specs.fields import Pair
from psmpc_cli.specs.robot import PartLimits, RobotSpec
from psmpc_cli.specs.task import EndCondition, Parts, TrajectorySpec

Space = Literal["joint", "task", "point"]
Vector = NDArray[np.float64]

AXES = ("x", "y", "theta")
"""Coordinates of a pose in the plane."""

ARM_AXES: dict[Space, tuple[tuple[str, ...] | None, tuple[str, ...] | None]] = {
    "joint": (None, None),
    "task": (AXES, AXES),
    "point": (AXES[:2], ("direction",)),
}
"""For each space the names of an arm's numbers in a target, and of its rows in the error; None: its joints from 1.

Those of the base are always `AXES`. The rows of the error are those of Q (joint) or xi (task), and in the space point
the angle between the end-effector's x-axis and the line to the target's point.
"""

QUANTITIES = ("position", "velocity", "acceleration")


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of every coordinate in the order of Q, each (n,); +-inf where there is none.

    Attributes:
        position_low: Of Q [m, rad].
        position_high: Of Q [m, rad].
        velocity_low: Of Qdot [m/s, rad/s].
        velocity_high: Of Qdot [m/s, rad/s].
        acceleration_low: Of Qddot [m/s^2, rad/s^2].
        acceleration_high: Of Qddot [m/s^2, rad/s^2].
    """

    position_low: Vector
    position_high: Vector
    velocity_low: Vector
    velocity_high: Vector
    acceleration_low: Vector
    acceleration_high: Vector


def resolve_limits(robot: RobotSpec, *more: Mapping[str, PartLimits]) -> Limits:
    """Intersect the robot's limits with those in `more`, such as a task's and a skill's."""
    bounds: dict[str, Vector] = {}
    for quantity in QUANTITIES:
        layers = [
            [
                pair
                for part, size in robot.parts.items()
                for pair in limits_of_part(limits, part, quantity) or [(-np.inf, np.inf)] * size
            ]
            for limits in (robot.limits, *more)
        ]
        low, high = np.moveaxis(np.array(layers, dtype=np.float64), -1, 0)
        bounds[f"{quantity}_low"], bounds[f"{quantity}_high"] = low.max(axis=0), high.min(axis=0)
    return Limits(**bounds)


def limits_of_part(limits: Mapping[str, PartLimits], part: str, quantity: str) -> tuple[Pair, ...] | None:
    """Return the pairs that hold for a part, None if there are none; an arm's own take precedence over `arms`."""
    given = (getattr(limits[key], quantity) for key in (part, "arms") if key in limits and stands_for(key, part))
    return next((pairs for pairs in given if pairs is not None), None)


def stands_for(key: str, part: str) -> bool:
    """Tell whether a key of numbers by part means a part: itself, or any arm for `arms`."""
    return key == part or (key == "arms" and part != "base")


def target_axes(parts: Mapping[str, int], space: Space) -> dict[str, tuple[str, ...]]:
    """Return the names of the numbers of a target, by part; `parts` are the robot's."""
    return _axes(parts, ARM_AXES[space][0])


def error_axes(parts: Mapping[str, int], space: Space) -> dict[str, tuple[str, ...]]:
    """Return the names of the rows of the error, by part; `parts` are the robot's."""
    return _axes(parts, ARM_AXES[space][1])


def _axes(parts: Mapping[str, int], of_arm: tuple[str, ...] | None) -> dict[str, tuple[str, ...]]:
    joints = {part: tuple(str(joint + 1) for joint in range(size)) for part, size in parts.items()}
    return {part: AXES if part == "base" else of_arm or joints[part] for part in parts}


def sizes(robot: RobotSpec, space: Space) -> dict[str, int]:
    """Return how many numbers a target has for each part, in the order of Q or xi."""
    return {part: len(axes) for part, axes in target_axes(robot.parts, space).items()}


def labels(robot: RobotSpec, space: Space) -> tuple[str, ...]:
    """Return the name of every row of the error: `base.x`, `arm_1.2`."""
    return tuple(f"{part}.{axis}" for part, axes in error_axes(robot.parts, space).items() for axis in axes)


def names(parts: Mapping[str, int], space: Space) -> tuple[str, ...]:
    """Return every name that means rows of the error; `parts` are the robot's."""
    axes = error_axes(parts, space)
    return (*parts, "arms", "all", *(f"{part}.{axis}" for part in parts for axis in axes[part]))


def rows(chosen: Sequence[str], robot: RobotSpec, space: Space) -> tuple[int, ...]:
    """Return the rows of the error that names mean, sorted."""
    by_label = enumerate(labels(robot, space))
    split = [(row, label, label.rpartition(".")[0]) for row, label in by_label]
    return tuple(
        row for row, label, part in split if any(name in (label, "all") or stands_for(name, part) for name in chosen)
    )


def stack(parts: Parts, robot: RobotSpec, space: Space, missing: float = np.nan, *, of_error: bool = False) -> Vector:
    """Stack numbers by part into one vector (n,) or (m,) in the order of Q or xi.

    Args:
        parts: The numbers; `arms` means every arm that has none of its own. One alone stands for all of its part.
        robot: Whose parts they are.
        space: Which order.
        missing: The value for parts that are missing.
        of_error: Whether the numbers belong to the rows of the error (weights, tolerances), not to those of a target.
    """
    axes = (error_axes if of_error else target_axes)(robot.parts, space)
    given = {part: parts.get(part, (missing,) if part == "base" else parts.get("arms", (missing,))) for part in axes}
    return np.concatenate([np.broadcast_to(np.array(given[part], dtype=np.float64), len(axes[part])) for part in axes])


def stack_rows(trajectory: TrajectorySpec, robot: RobotSpec, space: Space) -> Vector:
    """Stack the rows of a trajectory (times, n) or (times, m) in the order of Q or xi."""
    moments = range(len(trajectory.times))
    return np.array([stack({part: rows[i] for part, rows in trajectory.parts.items()}, robot, space) for i in moments])


def tolerances(condition: EndCondition, robot: RobotSpec, space: Space) -> Vector:
    """Return the tolerance of every row that an end condition selects [m, rad], in the order of `rows`."""
    chosen = list(rows(condition.coordinates, robot, space))
    if not isinstance(condition.tolerance, Mapping):
        return np.full(len(chosen), condition.tolerance)
    return stack(condition.tolerance, robot, space, of_error=True)[chosen]
