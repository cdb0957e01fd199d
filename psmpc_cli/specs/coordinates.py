"""Names of coordinates as rows of vectors, numbers by part as vectors, and the limits in force."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.specs.parts import QUANTITIES, Space, error_axes, stands_for, target_axes
from psmpc_cli.specs.robot import PartLimits, RobotSpec, limits_of_part
from psmpc_cli.specs.task import EndCondition, Parts, TrajectorySpec

Vector = NDArray[np.float64]


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

    @cached_property
    def state_low(self) -> Vector:
        """Lower bounds of [Q; Qdot] (2n,)."""
        return np.concatenate([self.position_low, self.velocity_low])

    @cached_property
    def state_high(self) -> Vector:
        """Upper bounds of [Q; Qdot] (2n,)."""
        return np.concatenate([self.position_high, self.velocity_high])


def resolve_limits(robot: RobotSpec, *more: Mapping[str, PartLimits]) -> Limits:
    """Intersect the robot's limits with those in `more`, such as a task's and a skill's."""
    bounds: dict[str, Vector] = {}
    for quantity in QUANTITIES:
        layers = [
            [
                pair or (-np.inf, np.inf)
                for part, size in robot.parts.items()
                for pair in limits_of_part(limits, part, quantity) or [(-np.inf, np.inf)] * size
            ]
            for limits in (robot.limits, *more)
        ]
        low, high = np.moveaxis(np.array(layers, dtype=np.float64), -1, 0)
        bounds[f"{quantity}_low"], bounds[f"{quantity}_high"] = low.max(axis=0), high.min(axis=0)
    return Limits(**bounds)


def labels(robot: RobotSpec, space: Space, *, of_error: bool = True) -> tuple[str, ...]:
    """Return the name of every row of the error, or of a target: `base.x`, `arm_1.2`."""
    axes = (error_axes if of_error else target_axes)(robot.parts, space)
    return tuple(f"{part}.{axis}" for part in axes for axis in axes[part])


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
