"""What a mission is about, what it is judged by, and published runs of it."""

from collections.abc import Mapping
from typing import Literal

from pydantic import Field

from psmpc_cli.specs.fields import Angle, Coordinates, NotNegative, Number, Positive
from psmpc_cli.specs.robot import Spec


class ObjectSpec(Spec):
    """The target object."""

    shape: tuple[Positive, Positive] = Field(description="length and width, [l, w] [m]")
    pose: tuple[Number, Number, Angle] = Field(description="pose before it is taken, [x, y, angle] [m, rad]")
    taken_by: str = Field(description="the stage at whose end it is taken")
    let_go_by: str = Field(description="the stage at whose beginning it is let go")


class MonitorSpec(Spec):
    """A bound on a signal during a stage that decides whether the mission succeeded."""

    name: str = Field(min_length=1, description="what the bound means, such as object held")
    quantity: Literal["distance", "speed"] = Field(description="between two frames, or of one")
    of: Coordinates = Field(description="base or arms: two for a distance, one for a speed")
    during: str = Field(description="the stage in which it must hold")
    above_start_at_most: NotNegative | None = Field(None, description="rise above its value at the stage's start")
    below_start_at_most: NotNegative | None = Field(None, description="fall below its value at the stage's start")
    at_most: Number | None = Field(None, description="upper bound [m, m/s]")
    at_least: Number | None = Field(None, description="lower bound [m, m/s]")


class PublishedRun(Spec):
    """A published run to compare with."""

    switch_time: Mapping[str, Number] = Field({}, description="instants that end the stages, by name [s]")
    actual_start: Mapping[str, Number] = Field({}, description="actual starts of the stages, by name [s]")
