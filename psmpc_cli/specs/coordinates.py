"""Names of coordinates as rows of Q or xi, and numbers by part as vectors in that order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.fields import Pair
from psmpc_cli.specs.messages import choice
from psmpc_cli.specs.robot import PartLimits, RobotSpec
from psmpc_cli.specs.task import EndCondition, Parts, TrajectorySpec

Vector = NDArray[np.float64]

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
    """Return what is allowed by the robot and by everything in `more`, such as a task's and a skill's limits."""
    bounds: dict[str, Vector] = {}
    for quantity in QUANTITIES:
        layers = [_layer(robot, limits, quantity) for limits in (robot.limits, *more)]
        bounds[f"{quantity}_low"] = np.max([low for low, _ in layers], axis=0)
        bounds[f"{quantity}_high"] = np.min([high for _, high in layers], axis=0)
    return Limits(**bounds)


def of_part(limits: Mapping[str, PartLimits], part: str, quantity: str) -> tuple[Pair, ...] | None:
    """Return the pairs that hold for a part; an arm's own come before those of `arms`."""
    keys = (part,) if part == "base" else (part, "arms")
    given = (getattr(limits[key], quantity) for key in keys if key in limits)
    return next((pairs for pairs in given if pairs is not None), None)


def _layer(robot: RobotSpec, limits: Mapping[str, PartLimits], quantity: str) -> tuple[Vector, Vector]:
    """Return low and high (n,) of one set of limits."""
    pairs = [
        pair
        for part, size in robot.parts.items()
        for pair in of_part(limits, part, quantity) or [(-np.inf, np.inf)] * size
    ]
    low, high = np.array(pairs, dtype=np.float64).T
    return low, high


Space = Literal["joint", "task"]

AXES = ("x", "y", "theta")
"""Coordinates of a pose in the plane."""


def sizes(robot: RobotSpec, space: Space) -> dict[str, int]:
    """Return how many coordinates every part has, in the order of Q (joint) or xi (task)."""
    return robot.parts if space == "joint" else dict.fromkeys(robot.parts, len(AXES))


def labels(robot: RobotSpec, space: Space) -> tuple[str, ...]:
    """Return the name of every row of Q or xi: `base.x`, `arm_1.2`."""
    return tuple(
        f"{part}.{axis}"
        for part, size in sizes(robot, space).items()
        for axis in (AXES if part == "base" or space == "task" else range(1, size + 1))
    )


def names(robot: RobotSpec, space: Space) -> tuple[str, ...]:
    """Return every name that stands for coordinates."""
    return (*robot.parts, "arms", "all", *labels(robot, space))


def rows(chosen: Sequence[str], robot: RobotSpec, space: Space) -> tuple[int, ...]:
    """Return the rows of Q (joint) or xi (task) that names stand for, sorted.

    Raises:
        SpecError: A name stands for none.
    """
    found: set[int] = set()
    for name in chosen:
        selected = [row for row, label in enumerate(labels(robot, space)) if _stands_for(name, label)]
        if not selected:
            raise SpecError(f'found the coordinate "{name}"{choice(name, names(robot, space))}')
        found.update(selected)
    return tuple(sorted(found))


def stack(parts: Parts, robot: RobotSpec, space: Space, missing: float | None = None) -> Vector:
    """Return numbers by part as one vector (n,) or (m,) in the order of Q or xi; `arms` stands for every arm.

    Args:
        parts: The numbers.
        robot: Whose parts they are.
        space: Which order.
        missing: What a part that is not there counts as; None if all must be there.

    Raises:
        SpecError: A part is missing or has the wrong length.
    """
    return np.concatenate([_part(parts, part, size, missing) for part, size in sizes(robot, space).items()])


def stack_rows(trajectory: TrajectorySpec, robot: RobotSpec, space: Space) -> Vector:
    """Return the rows of a trajectory (times, n) or (times, m) in the order of Q or xi.

    Raises:
        SpecError: A part is missing, or a row has the wrong length.
    """
    moments = range(len(trajectory.times))
    return np.array([stack({part: rows[i] for part, rows in trajectory.parts.items()}, robot, space) for i in moments])


def tolerances(condition: EndCondition, robot: RobotSpec, space: Space) -> Vector:
    """Return the tolerance of every row that an end condition selects [m, rad], in the order of `rows`."""
    chosen = list(rows(condition.coordinates, robot, space))
    if not isinstance(condition.tolerance, Mapping):
        return np.full(len(chosen), condition.tolerance)
    spread = {
        part: values * size if len(values) == 1 else values
        for part, size in sizes(robot, space).items()
        if (values := _values(condition.tolerance, part)) is not None
    }
    found = stack(spread, robot, space, missing=np.nan)[chosen]
    if np.isnan(found).any():
        absent = [labels(robot, space)[row] for row, value in zip(chosen, found, strict=True) if np.isnan(value)]
        raise SpecError(f"found no tolerance of {', '.join(absent)}, expected one of every coordinate of the condition")
    return found


def _stands_for(name: str, label: str) -> bool:
    """Tell whether a name stands for the coordinate of a label."""
    part = label.rpartition(".")[0]
    return name in (label, part, "all") or (name == "arms" and part != "base")


def _values(parts: Parts, part: str) -> tuple[float, ...] | None:
    """Return the numbers of a part; an arm's own come before those of `arms`."""
    return parts.get(part, None if part == "base" else parts.get("arms"))


def _part(parts: Parts, part: str, size: int, missing: float | None) -> Vector:
    """Return the numbers of one part (size,)."""
    values = _values(parts, part)
    if values is None and missing is not None:
        return np.full(size, missing)
    if values is None or len(values) != size:
        raise SpecError(f"found {'none' if values is None else len(values)} of the numbers of {part}, expected {size}")
    return np.asarray(values, dtype=np.float64)
