"""What acts on the base of a robot: thrusters, with their plumes and pulses, and reaction wheels. Validated data."""

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from psmpc_cli.specs import fields
from psmpc_cli.specs.fields import Fields, RuleErrors, Spec, ensure, expected, validated_by


class Plume(Spec):
    """The cone that leaves the nozzle of a thruster, against the force on the base."""

    angle: Annotated[
        fields.Width,
        ensure(lambda angle: angle < np.pi / 2, "an angle between 0 and 90 deg, with its unit: 30 deg"),
    ] = Field(description="angle between its axis and its edge, half of what it opens [rad]")
    length: fields.Length = Field(description="how far from the nozzle it reaches [m]")


class Thruster(Spec):
    """A thruster on the base."""

    position: tuple[float, ...]
    direction: tuple[float, ...]
    force: fields.Positive = Field(description="largest force [N]")
    smallest_force: fields.Positive | None = Field(
        None,
        exclude_if=lambda value: value is None,
        description="smallest force of one that can be throttled, others are on or off [N]; by default `force`",
    )
    shortest_pulse: fields.Sparse[fields.Seconds] = Field(0.0, description="shortest time for which it fires [s]")
    specific_impulse: fields.Positive | None = Field(
        None,
        exclude_if=lambda value: value is None,
        description="specific impulse, from which the mass of the propellant follows [s]",
    )
    plume: fields.Sparse[Plume | None] = Field(
        None, description="cone that stages with `plumes: avoided` keep off objects and obstacles"
    )

    @property
    def wrench(self) -> tuple[float, ...]:
        """Force and torque about the base's origin for a thrust of 1 N, along the base's axes (3,) or (6,) [1, m]."""
        along = np.array(self.direction) / np.linalg.norm(self.direction)
        if len(along) == 2:
            return (*along.tolist(), float(self.position[0] * along[1] - self.position[1] * along[0]))
        return (*along.tolist(), *np.cross(self.position, along).tolist())


THRUST_POSITION = "where its force acts on the base, in the base frame [m]"
THRUST_DIRECTION = (
    "direction of its force on the base, in the base frame, of any length; the plume leaves the other way"
)


class PlanarThruster(Thruster):
    """A thruster on the base of a planar robot."""

    position: fields.Vector2 = Field(description=THRUST_POSITION)
    direction: fields.Vector2 = Field(description=THRUST_DIRECTION)


class SpatialThruster(Thruster):
    """A thruster on the base of a spatial robot."""

    position: fields.Vector3 = Field(description=THRUST_POSITION)
    direction: fields.Vector3 = Field(description=THRUST_DIRECTION)


def _can_fire(thrusters: tuple[Thruster, ...], earlier_fields: Fields, context: Any) -> RuleErrors:
    """Yield errors for thrusters without a direction, and those whose smallest force is above the largest."""
    for i, thruster in enumerate(thrusters):
        if not any(thruster.direction):
            yield (i, "direction"), expected("a direction, at least one number other than 0")
        if (thruster.smallest_force or 0.0) > thruster.force:
            yield (i, "smallest_force"), expected(f"at most its force, {thruster.force:g} N")


THRUSTERS = "thrusters on the base, which limit the wrench that a free-flying base can have"
PULSE_PERIOD = "time in which each thruster fires at most one pulse [s]; by default the controller's sample time"

PlanarThrusters = Annotated[tuple[PlanarThruster, ...], validated_by(_can_fire, always=True)]
SpatialThrusters = Annotated[tuple[SpatialThruster, ...], validated_by(_can_fire, always=True)]


def _has_room(period: float | None, earlier_fields: Fields, context: Any) -> RuleErrors:
    """Yield errors for a period of pulses that none fits into, and one of a robot without thrusters."""
    thrusters: tuple[Thruster, ...] = earlier_fields.get("thrusters", ())
    if period is None or "thrusters" not in earlier_fields:
        return
    if not thrusters:
        yield (), expected("none: the robot has no thrusters", at_key=True)
    longest = max((thruster.shortest_pulse for thruster in thrusters), default=0.0)
    if period < longest or period == 0.0:
        yield (), expected(f"at least the longest shortest_pulse, {longest:g} s" if longest else "a time above 0")


PulsePeriod = Annotated[fields.Seconds | None, validated_by(_has_room, always=True)]


class Wheel(Spec):
    """A reaction wheel on the base. Its mass, and its inertia when it is locked, are part of the base's."""

    inertia: fields.Positive = Field(description="moment of inertia about its axis [kg m^2]")
    torque: fields.Positive = Field(description="largest torque of its motor [N m]")
    momentum: fields.Positive = Field(
        description="largest angular momentum that it may store, that of its spin and of the base's turn about its "
        "axis together [N m s]"
    )
    initial: fields.Sparse[fields.Number] = Field(0.0, description="angular momentum that it stores at first [N m s]")
    unloading: fields.Sparse[fields.NotNegative] = Field(
        0.0,
        description="torque with which it is brought back to `initial` while thrusters push the base [N m]; by default "
        "it coasts",
    )

    @property
    def direction(self) -> tuple[float, ...]:
        """Its axis along the components of the base's turn, (1,) or (3,), of any length."""
        return (1.0,)


class SpatialWheel(Wheel):
    """A reaction wheel on the base of a spatial robot."""

    axis: fields.Vector3 = Field(description="its axis in the base frame, of any length")

    @property
    def direction(self) -> tuple[float, ...]:
        """Its axis."""
        return self.axis


def _can_turn(wheels: tuple[Wheel, ...], earlier_fields: Fields, context: Any) -> RuleErrors:
    """Yield errors for wheels without an axis, initial momenta beyond the largest, and unloading beyond the torque."""
    for i, wheel in enumerate(wheels):
        if not any(wheel.direction):
            yield (i, "axis"), expected("a direction, at least one number other than 0")
        if abs(wheel.initial) > wheel.momentum:
            yield (i, "initial"), expected(f"a number from {-wheel.momentum:g} to {wheel.momentum:g}, its momentum")
        if wheel.unloading > wheel.torque:
            yield (i, "unloading"), expected(f"at most its torque, {wheel.torque:g} N m")


WHEELS = "reaction wheels on the base, which turn a base that nothing pushes (mobility attitude)"

Wheels = Annotated[tuple[Wheel, ...], validated_by(_can_turn, always=True)]
SpatialWheels = Annotated[tuple[SpatialWheel, ...], validated_by(_can_turn, always=True)]
