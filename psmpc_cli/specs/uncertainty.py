"""What the controller does not know: the real robot, what it measures, what disturbs it, what it carries."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema

from psmpc_cli.specs.fields import (
    Flag,
    NotNegative,
    Number,
    Positive,
    Size,
    Whole,
    number,
    number_alone_or_list,
    shape_of,
)
from psmpc_cli.specs.robot import Spec


def _lists(least: dict[str, Any]) -> WithJsonSchema:
    """Return the JSON Schema of a number with this bound, or a list of such numbers."""
    one = {"type": "number", **least}
    return WithJsonSchema({"anyOf": [one, {"type": "array", "items": one, "minItems": 1}]})


_Fraction = Annotated[float, Field(ge=0, lt=1), BeforeValidator(number)]
_Fractions = Annotated[
    Annotated[_Fraction, Tag("number")] | Annotated[Mapping[str, _Fraction], Tag("parts")], Discriminator(shape_of)
]
_Amounts = Annotated[
    Annotated[NotNegative, Tag("number")] | Annotated[Mapping[str, NotNegative], Tag("parts")], Discriminator(shape_of)
]
_Coefficients = Annotated[
    tuple[NotNegative, ...], BeforeValidator(number_alone_or_list), Field(min_length=1), _lists({"minimum": 0})
]
_Forces = Annotated[
    tuple[Positive, ...], BeforeValidator(number_alone_or_list), Field(min_length=1), _lists({"exclusiveMinimum": 0})
]
_ByArm = Annotated[
    Annotated[NotNegative, Tag("number")] | Annotated[Mapping[str, _Coefficients], Tag("parts")],
    Discriminator(shape_of),
]


class FrictionSpec(Spec):
    """Friction in the joints: the torque -viscous * rate - coulomb * tanh(rate / width)."""

    viscous: _ByArm = Field(0.0, description="one number or numbers by arm [N m s/rad]")
    coulomb: _ByArm = Field(0.0, description="one number or numbers by arm [N m]")
    width: Positive = Field(0.02, description="rate around 0 within which Coulomb friction turns over [rad/s]")


class NoiseSpec(Spec):
    """Standard deviations of what is measured, drawn anew for every coordinate at every tick."""

    position: NotNegative = Field(0.0, description="of the base's position [m]")
    angle: Size = Field(0.0, description="of the base's angle and the joints' [rad]")
    velocity: NotNegative = Field(0.0, description="of the base's velocity [m/s]")
    angular_velocity: Size = Field(0.0, description="of the rates of all angles [rad/s]")


class ImpulseSpec(Spec):
    """A blow to the base, even over one tick of the low-level loop."""

    at: NotNegative = Field(description="when it comes [s]")
    linear: tuple[Number, Number] = Field((0.0, 0.0), description="impulse of the force, [x, y] [N s]")
    angular: Number = Field(0.0, description="impulse of the torque [N m s]")


class PayloadSpec(Spec):
    """What the task's object weighs; while held, it is part of the last links of the arms."""

    mass: Positive = Field(description="mass [kg]")
    inertia: NotNegative = Field(description="inertia about its centre of mass [kg m^2]")
    known: Flag = Field(False, description="whether the low-level law counts it in while it is held")
    share: _Amounts | None = Field(
        None, description="what each gripper holds of it, one number or numbers by arm; default equal shares"
    )


class UncertaintySpec(Spec):
    """How the real robot differs from the one the controller knows; what is random is drawn from the task's seed."""

    mass: _Fractions = Field(0.0, description="largest relative error of a body's mass, one number or numbers by part")
    inertia: _Fractions = Field(0.0, description="the same of its inertia about the centre of mass")
    centre_of_mass: _Amounts = Field(
        0.0, description="largest offset of a body's centre of mass along either axis, one number or by part [m]"
    )
    friction: FrictionSpec = Field(FrictionSpec(), description="friction in the joints")
    noise: NoiseSpec = Field(NoiseSpec(), description="noise of the measurement")
    delay: Whole = Field(0, ge=0, description="samples after which a control reaches the robot")
    force_limits: Mapping[str, _Forces] = Field(
        {}, description="largest force and torques [Fx, Fy, torque] of the base, torques of arms, by part [N, N m]"
    )
    impulse: ImpulseSpec | None = Field(None, description="a blow to the base")
    payload: PayloadSpec | None = Field(None, description="what the task's object weighs")

    @property
    def measures_with_noise(self) -> bool:
        """Whether the controller sees another state than the true one."""
        return any(value > 0 for value in self.noise.model_dump().values())

    @property
    def is_random(self) -> bool:
        """Whether any of it depends on the seed."""
        return self.measures_with_noise or any(
            _largest(of) > 0 for of in (self.mass, self.inertia, self.centre_of_mass)
        )

    @property
    def changes_the_plant(self) -> bool:
        """Whether anything but what the controller reads, and when it acts, differs from what it knows."""
        drawn = (self.mass, self.inertia, self.centre_of_mass, self.friction.viscous, self.friction.coulomb)
        others = self.force_limits or self.impulse or self.payload
        return bool(others) or any(_largest(value) > 0 for value in drawn)

    @property
    def in_force(self) -> bool:
        """Whether there is any of it."""
        return self.changes_the_plant or self.measures_with_noise or self.delay > 0


def _largest(value: float | Mapping[str, float] | Mapping[str, tuple[float, ...]]) -> float:
    """Return the largest of one number or numbers by part."""
    if not isinstance(value, Mapping):
        return value
    lists = (given if isinstance(given, tuple) else (given,) for given in value.values())
    return max((number for numbers in lists for number in numbers), default=0.0)
