"""The limits in force: the robot's, tightened by a task and a skill."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.specs.robot import Pair, PartLimits, RobotSpec

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


def resolve(robot: RobotSpec, *more: Mapping[str, PartLimits]) -> Limits:
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
