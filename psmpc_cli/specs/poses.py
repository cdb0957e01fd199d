"""Poses of spatial robots as tasks write them, `{position: ..., attitude: ...}`, and as the numbers they stand for."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from psmpc_cli.specs.document import Data, Document, put
from psmpc_cli.specs.fields import Angles3, Axis, Direction, Number, Spec, Vector3, expected, listed
from psmpc_cli.specs.messages import Fault, Path

KEYS = ("position", "attitude")
ROOTS = (("initial",), ("stages",), ("object",))


def _not_zero(value: tuple[float, ...]) -> tuple[float, ...]:
    if np.linalg.norm(value) < 1e-6:
        raise expected("a quaternion w, x, y, z that is not 0")
    return value


class Attitude(Spec):
    """An attitude, in one of three ways."""

    rpy: Angles3 | None = Field(None, description="angles about the fixed axes x, y, z, in this order [rad]")
    quaternion: (
        Annotated[tuple[Number, Number, Number, Number], listed("4 entries", 4), AfterValidator(_not_zero)] | None
    ) = Field(None, description="quaternion w, x, y, z of any length")
    axis: Axis | None = Field(None, description="unit vector about which `angle` turns")
    angle: Direction | None = Field(None, description="turn about `axis` [rad]")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = [self.rpy is not None, self.quaternion is not None, self.axis is not None or self.angle is not None]
        if sum(ways) != 1 or (self.axis is None) != (self.angle is None):
            raise expected("either rpy, or quaternion, or axis and angle")
        return self

    @property
    def numbers(self) -> list[float]:
        """The unit quaternion w, x, y, z."""
        if self.quaternion is not None:
            return [float(part) for part in np.array(self.quaternion) / np.linalg.norm(self.quaternion)]
        if self.rpy is not None:
            turn = Rotation.from_euler("xyz", self.rpy)
        else:
            turn = Rotation.from_rotvec((self.angle or 0.0) * np.array(self.axis))
        x, y, z, w = turn.as_quat().tolist()
        return [w, x, y, z]


class Pose(Spec):
    """A pose in space."""

    position: Vector3 = Field(description="x, y, z [m]")
    attitude: Attitude = Field(Attitude(quaternion=(1, 0, 0, 0)), description="attitude, by default none")

    @property
    def numbers(self) -> list[float]:
        """Position and unit quaternion."""
        return [*self.position, *self.attitude.numbers]


def with_numbers(task: Document) -> Document:
    """Return a task with the numbers of its poses in their place; its faults have what is wrong with them."""
    faults = list(task.faults)
    for path in list(_poses(task.data, ())):
        try:
            numbers: Data = list(Pose.model_validate(task.value(path)).numbers)
            task = put(task, path, numbers, {(): task.origin(path)})
        except ValidationError as error:
            for detail in error.errors(include_url=False):
                at, context = (*path, *detail["loc"]), detail["ctx"]
                found = context["found"] or task.found(at)
                faults.append(Fault(at, f"found {found}{context['tail']}", context["at_key"]))
            task = put(task, path, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], {(): task.origin(path)})
    return replace(task, faults=tuple(faults))


def _poses(data: Any, path: Path) -> Iterator[Path]:
    """Give the paths of all poses of a task: mappings that have one of a pose's keys, but a grasp's envelope."""
    if isinstance(data, dict) and any(key in data for key in KEYS) and path[:1] in ROOTS and path[-1] != "envelope":
        yield path
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _poses(value, (*path, key))
