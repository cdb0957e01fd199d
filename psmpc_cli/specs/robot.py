"""What a robot is: a free-floating base and arms of revolute joints and rigid links. Plain validated data."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator, Field

from psmpc_cli.specs.fields import (
    Direction,
    Interval,
    Name,
    NotNegative,
    Pair,
    Part,
    Positive,
    Rate,
    Spec,
    Vector2,
    flaw,
    holds_as_written,
)
from psmpc_cli.specs.messages import quoted
from psmpc_cli.specs.parts import RESERVED, misfit_limits, stands_for


class Base(Spec):
    """The base body."""

    mass: Positive = Field(description="mass [kg]")
    inertia: Positive = Field(description="inertia about the centre of mass [kg m^2]")


class Mount(Spec):
    """Where an arm's first joint sits on the base."""

    position: Vector2 = Field(description="position of the shoulder in the base frame, [x, y] [m]")
    angle: Direction = Field(0.0, description="direction of the arm in the base frame [rad]")


class Link(Spec):
    """One rigid link."""

    mass: Positive = Field(description="mass [kg]")
    inertia: Positive = Field(description="inertia about the centre of mass [kg m^2]")
    a: NotNegative = Field(description="joint to centre of mass [m]")
    b: NotNegative = Field(description="centre of mass to the next joint or the tip [m]")


class Tool(Spec):
    """The end-effector frame."""

    angle: Direction = Field(0.0, description="angle against the last link [rad]")


class Arm(Spec):
    """A chain of revolute joints and links, from the base outward."""

    mount: Mount = Field(description="where the arm's first joint sits on the base")
    links: tuple[Link, ...] = Field(min_length=1, description="the links, from the base outward")
    tool: Tool = Field(Tool(), description="the end-effector frame")


class PartLimits(Spec):
    """Bounds of one part's coordinates, each a (low, high) pair per coordinate; None where there is none."""

    position: tuple[Interval, ...] | None = Field(None, description="one [low, high] a coordinate [m, rad]")
    velocity: tuple[Rate, ...] | None = Field(
        None, description="one [low, high] a coordinate, or one number for both ways [m/s, rad/s]"
    )
    acceleration: tuple[Rate, ...] | None = Field(
        None, description="one [low, high] a coordinate, or one number for both ways [m/s^2, rad/s^2]"
    )


LimitsByPart = Annotated[Mapping[Part, PartLimits], holds_as_written(misfit_limits)]
"""Limits keyed by `base`, `arms` (every arm) or an arm's name."""


def limits_of_part(limits: Mapping[str, PartLimits], part: str, quantity: str) -> tuple[Pair, ...] | None:
    """Return the pairs that hold for a part, None if there are none; an arm's own take precedence over `arms`."""
    given = (getattr(limits[key], quantity) for key in (part, "arms") if key in limits and stands_for(key, part))
    return next((pairs for pairs in given if pairs is not None), None)


def _not_reserved(name: str) -> str:
    if name in RESERVED:
        raise flaw(f", expected none of {', '.join(RESERVED)}", f"the reserved name {quoted(name)}", at_key=True)
    return name


class RobotSpec(Spec):
    """A space robot. Paper Table I."""

    name: Name = Field(description="name of the robot")
    description: str = Field("", description="what it is, for people")
    base: Base = Field(description="the base body")
    arms: Mapping[Annotated[Name, AfterValidator(_not_reserved)], Arm] = Field(
        min_length=1, description="the arms by name, in the order of Q"
    )
    limits: LimitsByPart = Field({}, description="limits of base, arms (every arm) or an arm by name")

    @property
    def parts(self) -> dict[str, int]:
        """Names and numbers of generalized coordinates of the parts, in the order of `Q = [p_b; q]`."""
        return {"base": 3, **{name: len(arm.links) for name, arm in self.arms.items()}}
