"""What the controller does not know: inertial parameters, friction, noise, delay, impulse, payload."""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from psmpc_cli.specs import fields
from psmpc_cli.specs.document import counted
from psmpc_cli.specs.fields import Fields, RuleErrors, Spec, expected, validated_by
from psmpc_cli.specs.parts import Context, by_dimension, in_joint_space
from psmpc_cli.specs.robots.robot import RobotSpec, Vector

_Fractions = fields.OrByPart[fields.Fraction, fields.Part, fields.Fraction]
_Shares = fields.OrByPart[fields.Positive, fields.Part, fields.OneOrMore[fields.Positive]]
_ByArm = fields.OrByPart[fields.NotNegative, fields.ArmName, fields.OneOrMore[fields.NotNegative]]


class FrictionSpec(Spec):
    """Friction in the joints: the torque -viscous * rate - coulomb * tanh(rate / width), of sliding joints a force."""

    viscous: Annotated[_ByArm, in_joint_space(one_suffices=True)] = Field(
        0.0, description="one number or numbers by arm, of sliding joints in N s/m [N m s/rad]"
    )
    coulomb: Annotated[_ByArm, in_joint_space(one_suffices=True)] = Field(
        0.0, description="one number or numbers by arm, of sliding joints in N [N m]"
    )
    width: fields.Positive = Field(
        0.02, description="rate around 0 within which Coulomb friction turns over, of sliding joints in m/s [rad/s]"
    )


class StateNoiseSpec(Spec):
    """Standard deviations of what is measured of the robot, independent at every sample and tick."""

    position: fields.NotNegative = Field(
        0.0, description="of the base's position, along each axis, and of sliding joints [m]"
    )
    angle: fields.Size = Field(0.0, description="of the base's angle, in space about each axis, and the joints' [rad]")
    velocity: fields.NotNegative = Field(0.0, description="of the velocities of what position is about [m/s]")
    angular_velocity: fields.Size = Field(0.0, description="of the rates of what angle is about [rad/s]")

    @property
    def of_state(self) -> bool:
        """Whether the robot's state is measured with noise."""
        return _any(self.model_dump(include=set(StateNoiseSpec.model_fields)))


class NoiseSpec(StateNoiseSpec):
    """Standard deviations of what is measured, drawn anew for every coordinate at every tick."""

    object_position: fields.Sparse[fields.NotNegative] = Field(0.0, description="of the object's position [m]")
    object_angle: fields.Sparse[fields.Size] = Field(0.0, description="of the object's attitude [rad]")


class ImpulseSpec(Spec):
    """A blow to the base, even over one tick of the low-level loop."""

    at: fields.NotNegative = Field(description="when it comes [s]")
    linear: Annotated[fields.OneOrMore[fields.Number], by_dimension(2, 3)] = Field(
        (0.0,), description="impulse of the force, [x, y] or [x, y, z] [N s]"
    )
    angular: Annotated[fields.OneOrMore[fields.Number], by_dimension(1, 3)] = Field(
        (0.0,), description="impulse of the torque; in space about the base's axes x, y, z [N m s]"
    )


def _whole(share: float | Mapping[str, float] | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for shares of a payload whose sum over the arms is not 1, but for rounding."""
    arms = [part for part in context.sizes if part != "base"]
    by_arm = share if isinstance(share, Mapping) else {"arms": share}
    own = [by_arm.get(arm, by_arm.get("arms")) for arm in arms]
    shares = [each for each in own if each is not None]
    if arms and len(shares) == len(arms) and abs(sum(shares) - 1) > 1e-6:
        found = f"shares whose sum is {sum(shares):g}"
        yield (), expected(f"1 over the {len(arms)} arms", found, at_key=True)


class PayloadSpec(Spec):
    """What the task's object weighs; while held, it is part of the last links of the arms."""

    mass: fields.Positive = Field(description="mass [kg]")
    inertia: fields.NotNegative = Field(description="inertia about its centre of mass [kg m^2]")
    known: fields.Known = Field(
        False, description="whether the low-level law counts it in while it is held; estimated: it estimates it"
    )
    share: Annotated[
        fields.OrByPart[fields.NotNegative, fields.ArmName, fields.NotNegative] | None, validated_by(_whole)
    ] = Field(None, description="what each gripper holds of it, one number or numbers by arm; default equal shares")

    @property
    def is_told(self) -> bool:
        """Whether the controller knows mass and inertia as they are."""
        return self.known is True

    @property
    def is_estimated(self) -> bool:
        """Whether the controller finds out what the grippers hold."""
        return self.known == fields.ESTIMATED

    def shares(self, arms: Sequence[str]) -> list[float]:
        """Return the share of each gripper, (arms,); they sum to 1."""
        given = 1 / len(arms) if self.share is None else self.share
        by_arm = given if isinstance(given, Mapping) else {"arms": given}
        return [by_arm.get(arm, by_arm.get("arms", 0.0)) for arm in arms]


NO_PAYLOAD = PayloadSpec.model_construct(mass=0.0, inertia=0.0)
"""Of a task whose object weighs nothing."""


class ObjectErrorSpec(Spec):
    """How the object differs from what the task says of it, which is all the controller knows before it sees it."""

    mass: fields.Fraction = Field(0.0, description="largest relative error of its mass, and of its inertia")
    linear: fields.NotNegative = Field(0.0, description="largest error of its velocity along each axis [m/s]")
    angular: fields.Size = Field(0.0, description="largest error of its angular velocity about each axis [rad/s]")


def _all_one(shares: float | Mapping[str, tuple[float, ...]]) -> bool:
    """Tell whether every share is 1."""
    return shares == 1 or (isinstance(shares, Mapping) and all(each == 1 for row in shares.values() for each in row))


def _in_seconds(delay: object, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a delay without a unit, which once was a number of samples."""
    if isinstance(delay, int | float) and not isinstance(delay, bool) and delay > 0:
        sample_time = context.file.value(("controller", "sample_time"))
        length = sample_time if isinstance(sample_time, int | float) else 0.1
        in_samples = (
            f"{delay * length:g} s for {counted(int(delay), 'sample', 'samples')}, or " if delay % 1 == 0 else ""
        )
        yield (), expected(f"seconds with their unit: {in_samples}{delay:g} s", f"{delay:g} without a unit")


class UncertaintySpec(Spec):
    """How the real robot differs from the one the controller knows; what is random is drawn from the task's seed."""

    @property
    def carried(self) -> PayloadSpec:
        """What the object weighs; of mass 0 where that is not given."""
        return self.payload or NO_PAYLOAD

    replaced_keys: ClassVar[Mapping[str, str]] = {
        "force_limits": "limits: {PART: {force: ...}} in the robot or the task, and uncertainty.force_share of them"
    }

    mass: _Fractions = Field(0.0, description="largest relative error of a body's mass, one number or numbers by part")
    inertia: _Fractions = Field(0.0, description="the same of its inertia about the centre of mass")
    centre_of_mass: fields.OrByPart[fields.NotNegative, fields.Part, fields.NotNegative] = Field(
        0.0, description="largest offset of a body's centre of mass along each axis, one number or by part [m]"
    )
    friction: FrictionSpec = Field(FrictionSpec(), description="friction in the joints")
    noise: NoiseSpec = Field(NoiseSpec(), description="noise of the measurement")
    delay: Annotated[fields.Seconds, validated_by(_in_seconds, as_written=True)] = Field(
        0.0, description="after how long a command reaches the robot, with its unit, such as 0.13 s [s]"
    )
    jitter: fields.Sparse[fields.Seconds] = Field(
        0.0, description="standard deviation of each command's delay; commands arrive in order [s]"
    )
    force_share: Annotated[_Shares, in_joint_space(one_suffices=True)] = Field(
        1.0,
        exclude_if=_all_one,
        description="the true limits of forces over the declared ones, one number or numbers by part",
    )
    impulse: ImpulseSpec | None = Field(None, description="a blow to the base")
    payload: PayloadSpec | None = Field(None, description="what the task's object weighs")
    object: fields.Sparse[ObjectErrorSpec | None] = Field(
        None, description="how an object with a mass differs from the task's"
    )

    @property
    def measures_with_noise(self) -> bool:
        """Whether the controller sees another state than the true one."""
        return self.noise.of_state

    @property
    def is_random(self) -> bool:
        """Whether any of it depends on the seed."""
        return _any(self.model_dump(include={"noise", "mass", "inertia", "centre_of_mass", "object", "jitter"}))

    @property
    def changes_the_plant(self) -> bool:
        """Whether anything but what the controller reads, and when it acts, differs from what it knows."""
        return _any(
            self.model_dump(
                exclude={"noise": True, "delay": True, "jitter": True, "object": True, "friction": {"width"}}
            )
        )

    @property
    def in_force(self) -> bool:
        """Whether there is any of it."""
        return _any(self.model_dump(exclude={"friction": {"width"}}))


def standard_deviations(noise: StateNoiseSpec, robot: RobotSpec) -> Vector:
    """Return the deviation of every measured coordinate and velocity of a robot (2n,) [m, rad, m/s, rad/s]."""
    d = robot.dimension
    joints = [joint.prismatic for joint in robot.joints]
    slides = [*[True] * d, *[False] * (robot.parts["base"] - d), *joints]
    of_coordinates = [noise.position if each else noise.angle for each in slides]
    of_velocities = [noise.velocity if each else noise.angular_velocity for each in slides]
    return np.array([*of_coordinates, *of_velocities])


def _any(value: object) -> bool:
    """Tell whether there is a number other than 0 in plain data."""
    if isinstance(value, Mapping | tuple):
        return any(map(_any, value.values() if isinstance(value, Mapping) else value))
    return bool(value)
