"""What a robot is: a free-floating base and arms of revolute joints and rigid links. Plain validated data."""

from collections.abc import Mapping

from pydantic import Field

from psmpc_cli.specs.fields import Angle, Interval, Name, NotNegative, Part, Positive, Rate, Spec, Vector2


class Base(Spec):
    """The base body."""

    mass: Positive = Field(description="mass [kg]")
    inertia: Positive = Field(description="inertia about the centre of mass [kg m^2]")


class Mount(Spec):
    """Where an arm's first joint sits on the base."""

    position: Vector2 = Field(description="position of the shoulder in the base frame, [x, y] [m]")
    angle: Angle = Field(0.0, description="direction of the arm in the base frame [rad]")


class Link(Spec):
    """One rigid link."""

    mass: Positive = Field(description="mass [kg]")
    inertia: Positive = Field(description="inertia about the centre of mass [kg m^2]")
    a: NotNegative = Field(description="joint to centre of mass [m]")
    b: NotNegative = Field(description="centre of mass to the next joint or the tip [m]")


class Tool(Spec):
    """The end-effector frame."""

    angle: Angle = Field(0.0, description="angle against the last link [rad]")


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


class RobotSpec(Spec):
    """A space robot. Paper Table I. `limits` is keyed by `base`, `arms` (every arm) or an arm's name."""

    name: Name = Field(description="name of the robot")
    description: str = Field("", description="what it is, for people")
    base: Base = Field(description="the base body")
    arms: Mapping[Name, Arm] = Field(min_length=1, description="the arms by name, in the order of Q")
    limits: Mapping[Part, PartLimits] = Field({}, description="limits of base, arms (every arm) or an arm by name")

    @property
    def parts(self) -> dict[str, int]:
        """Names and numbers of generalized coordinates of the parts, in the order of `Q = [p_b; q]`."""
        return {"base": 3, **{name: len(arm.links) for name, arm in self.arms.items()}}
