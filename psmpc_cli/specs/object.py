"""The target object of a task: a body with mass, where it goes, and how grippers hold it. docs/capture.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import (
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from psmpc_cli.specs import fields
from psmpc_cli.specs.document import mapping, quoted
from psmpc_cli.specs.fields import (
    Fields,
    RuleErrors,
    Spec,
    expected,
    is_pose,
    listed,
    one_of,
    unit_errors,
    validated_by,
)
from psmpc_cli.specs.parts import ERROR_AXES, TARGET_AXES, Context, by_dimension, units_of


def _units_of_pose(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for numbers of a pose, or of its error, with the unit of another coordinate, or lacking one."""
    axes = next((axes for axes in (*TARGET_AXES.values(), *ERROR_AXES.values()) if len(axes) == len(written)), ())
    for i, (axis, number) in enumerate(zip(axes, written, strict=False)):
        unit = units_of("base", axis, ()).position
        yield from (((i,), error) for _, error in unit_errors(number, unit, turns=axis == "theta"))


PoseNumbers = Annotated[
    tuple[fields.Coordinate, ...],
    by_dimension(len(TARGET_AXES[2]), len(TARGET_AXES[3])),
    validated_by(_units_of_pose, as_written=True),
    fields.or_pose,
]
"""A pose: (x, y, angle) [m, rad], or in space position and unit quaternion w, x, y, z."""


def _of_some_body(moments: tuple[float, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for principal moments of inertia that no body has: the sum of two is at least the third."""
    if len(moments) == 3 and 2 * max(moments) > sum(moments):
        yield (), expected("none larger than the sum of the other two", "moments that no body has")


Moments = Annotated[fields.OneOrMore[fields.Positive], by_dimension(1, 3), validated_by(_of_some_body)]
"""Inertia of a body about its centre of mass: one number in the plane, three in space."""

_Duration = Annotated[fields.Seconds, fields.ensure(lambda duration: duration > 0, "a time longer than 0 s")]
_Extent = Annotated[tuple[fields.Positive, ...], by_dimension(2, 3)]
_StageName = Annotated[str, one_of(lambda context: context.stages)]
_Gripper = Annotated[str, one_of(lambda context: mapping(context.file.value(("object", "grasp", "at"))))]


class OnObject(Spec):
    """A pose relative to the task's object, for a part of a target: the object's predicted pose counts."""

    object: Annotated[
        Annotated[_Gripper, Tag("gripper")] | Annotated[PoseNumbers, Tag("pose")],
        Discriminator(lambda value: "gripper" if isinstance(value, str) else "pose"),
    ] = Field(description="a gripper of the object's grasp, or a pose in the object's frame")
    met_in: fields.Sparse[_Duration | None] = Field(
        None, description="how long the robot floats after the stage, before it meets the object [s]"
    )


def is_on_object(value: object) -> bool:
    """Tell whether a part of a target, written or valid, is relative to the object."""
    return isinstance(value, OnObject) or (isinstance(value, Mapping) and not is_pose(value))


class MotionSpec(Spec):
    """How the object moves before it is taken."""

    linear: Annotated[tuple[float, ...], by_dimension(2, 3)] = Field(
        description="velocity of its centre of mass in the inertial frame [m/s]"
    )
    angular: Annotated[fields.OneOrMore[fields.Angle], by_dimension(1, 3)] = Field(
        description="angular velocity, in space about its own axes [rad/s]"
    )

    @property
    def moves(self) -> bool:
        """Whether it moves at all."""
        return any(self.linear) or any(self.angular)


class DestinationSpec(Spec):
    """Where the object has to be when it leaves the grippers, and how slow."""

    pose: PoseNumbers = Field(description="pose, as the object's")
    tolerance: Annotated[
        tuple[fields.CoordinateWidth, ...],
        by_dimension(len(ERROR_AXES[2]), len(ERROR_AXES[3])),
        validated_by(_units_of_pose, as_written=True),
    ] = Field(description="how near, one number for each row of the pose's error [m, rad]")
    speed: fields.Positive = Field(description="largest speed of its centre of mass [m/s]")


class EnvelopeSpec(Spec):
    """How near its grasp, and how much at rest relative to it, a gripper must be to close."""

    position: fields.Positive = Field(description="largest distance [m]")
    angle: fields.Width = Field(description="largest angle [rad]")
    velocity: fields.Positive = Field(description="largest relative velocity [m/s]")
    angular_velocity: fields.Width = Field(description="largest relative angular velocity [rad/s]")


GRASP_LOADS = {"pull": "N", "shear": "N", "moment": "N m"}
"""What a grasp bears, in the order of its arrays, with its units: outwards from the object's centre of mass, across
that direction, and the moment about the gripper."""


def _bounds_a_load(strength: "StrengthSpec", earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a strength that bounds nothing."""
    if np.isinf(strength.of_loads).all():
        yield (), expected(f"at least one of {', '.join(GRASP_LOADS)}", "none", at_key=True)


WIDEST_BAND = (1e-3, 2e-3)
"""By how much plans let hands move against each other where grasps would bear more [m, rad]."""


class StrengthSpec(Spec):
    """What a grasp holds: it is lost when a filtered load exceeds this. What is not given is not limited."""

    pull: fields.Sparse[fields.Positive | None] = Field(
        None, description="largest filtered pull on the object, outwards from its centre of mass [N]"
    )
    shear: fields.Sparse[fields.Positive | None] = Field(
        None, description="largest filtered force across that direction [N]"
    )
    moment: fields.Sparse[fields.Positive | None] = Field(
        None, description="largest filtered moment, about the gripper [N m]"
    )
    filter: fields.Positive = Field(0.2, description="time constant of the loads' low-pass filter [s]")

    @property
    def of_loads(self) -> np.ndarray:
        """The largest loads (3,) in the order of `GRASP_LOADS`; infinite where there is no limit."""
        largest_loads = (getattr(self, load) for load in GRASP_LOADS)
        return np.array([np.inf if largest is None else largest for largest in largest_loads])


def _ordered(at: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
    """Return grasps in the order of the robot's arms."""
    valid = handler(at)
    order = list(info.context.sizes) if info.context else list(valid)
    return {arm: valid[arm] for arm in sorted(valid, key=lambda arm: order.index(arm) if arm in order else len(order))}


_in_order_of_arms = WrapValidator(_ordered)


class GraspSpec(Spec):
    """Grippers on the object: a linear bushing between each of them and the object while it is closed."""

    at: Annotated[Mapping[fields.ArmName, PoseNumbers], Field(min_length=1), _in_order_of_arms] = Field(
        description="poses of the grippers in the object's frame, by arm"
    )
    envelope: EnvelopeSpec = Field(description="what a gripper needs to close")
    stiffness: Annotated[tuple[fields.Positive, fields.Positive], listed("2 entries", 2)] = Field(
        description="stiffness against displacement and against turning [N/m, N m/rad]"
    )
    damping_ratio: fields.NotNegative = Field(1.0, description="damping over the critical one of the two bodies")
    strength: Annotated[StrengthSpec, validated_by(_bounds_a_load)] | None = Field(
        None, description="what it holds; default anything"
    )
    known: fields.Known = Field(
        False,
        description="whether the low-level law knows the load and the closed chain; estimated: it estimates the load",
    )
    band: fields.Sparse[Annotated[tuple[fields.Positive, fields.Positive], listed("2 entries", 2)] | None] = Field(
        None,
        description="by how much hands that hold the object may move against each other over a horizon [m, rad]; "
        "default the deflection of a grasp under half of its strength, at most [1e-3, 2e-3]",
    )

    @property
    def is_estimated(self) -> bool:
        """Whether the controller finds out what the grippers hold."""
        return self.known == fields.ESTIMATED

    @property
    def half_widths(self) -> tuple[float, float]:
        """By how much plans let hands move and turn against each other [m, rad].

        A relative displacement d strains the two bushings by d / 2 each, which is a load of stiffness times d / 2.
        """
        if self.band is not None:
            return self.band
        force, moment = np.minimum.reduceat(self.largest_loads, [0, 2])
        linear, angular = self.stiffness
        return min(force / (2 * linear), WIDEST_BAND[0]), min(moment / (2 * angular), WIDEST_BAND[1])

    @property
    def largest_loads(self) -> np.ndarray:
        """The filtered loads that a grasp holds (3,), see `GRASP_LOADS`; infinite where there is no limit."""
        return np.full(len(GRASP_LOADS), np.inf) if self.strength is None else self.strength.of_loads


class ObjectSpec(Spec):
    """The target object. With a mass it is a body that moves freely until grippers close on it."""

    shape: _Extent = Field(description="length and width, [l, w]; in space with the height [m]")
    pose: PoseNumbers = Field(description="pose at the start: [x, y, angle] [m, rad]; in space position and attitude")
    taken_by: _StageName = Field(description="the stage at whose end it is taken")
    let_go_by: fields.Sparse[_StageName | None] = Field(
        None, description="the stage at whose beginning it is let go; default it is held to the end"
    )
    mass: fields.Sparse[fields.Positive | None] = Field(None, description="mass; without one it is drawn alone [kg]")
    inertia: fields.Sparse[Moments | None] = Field(
        None, description="inertia about its centre of mass, in space about its axes [kg m^2]"
    )
    motion: fields.Sparse[MotionSpec | None] = Field(
        None, description="how it moves before it is taken; default not at all"
    )
    destination: fields.Sparse[DestinationSpec | None] = Field(
        None, description="where it has to be when it leaves the grippers"
    )
    grasp: fields.Sparse[GraspSpec | None] = Field(None, description="how grippers hold it")

    @property
    def body(self) -> "ObjectBody":
        """The object as a rigid body; `NO_BODY`, of mass 0, where it is only drawn."""
        if self.mass is None or self.inertia is None or self.grasp is None:
            return NO_BODY
        still = MotionSpec.model_construct(linear=(0.0,) * len(self.shape), angular=(0.0,) * len(self.inertia))
        return ObjectBody(
            shape=self.shape,
            pose=self.pose,
            mass=self.mass,
            inertia=self.inertia,
            motion=self.motion or still,
            destination=self.destination,
            grasp=self.grasp,
        )

    def held_stages(self, names: Sequence[str]) -> range:
        """Return the stages in which grippers hold it, of a task's stages by name.

        It is taken where the stage before the first of them ends, and let go where the last one ends. An object that
        is held to the end is held in what follows the last stage too, whose index is the number of stages.
        """
        end = len(names) + 1 if self.let_go_by is None else names.index(self.let_go_by)
        return range(names.index(self.taken_by) + 1, end)


@dataclass(frozen=True)
class ObjectBody:
    """The object as a rigid body: it moves freely until grippers close on it. Of mass 0 there is none to take.

    Attributes:
        shape: Length and width, in space with the height [m].
        pose: At the start, (3,) or (7,).
        mass: [kg].
        inertia: Principal moments, (1,) or (3,) [kg m^2].
        motion: Before it is taken.
        destination: Where it has to be when it leaves the grippers; None where that is not judged.
        grasp: How grippers hold it.
    """

    shape: tuple[float, ...]
    pose: tuple[float, ...]
    mass: float
    inertia: tuple[float, ...]
    motion: MotionSpec
    destination: DestinationSpec | None
    grasp: GraspSpec

    @property
    def grippers(self) -> tuple[str, ...]:
        """The arms whose grippers hold it, in the order of the robot's arms."""
        return tuple(self.grasp.at)

    @property
    def pose_after_release(self) -> tuple[float, ...]:
        """Where it is to be when grippers have let it go: at its destination, without one where it was at the start."""
        return self.pose if self.destination is None else self.destination.pose

    @property
    def holder(self) -> str:
        """The gripper that the object moves with in windows, the first."""
        return self.grippers[0]


_NEVER = EnvelopeSpec.model_construct(position=0.0, angle=0.0, velocity=0.0, angular_velocity=0.0)
_NO_GRASP = GraspSpec.model_construct(at={}, envelope=_NEVER, stiffness=(0.0, 0.0))
NO_BODY = ObjectBody(
    shape=(),
    pose=(),
    mass=0.0,
    inertia=(),
    motion=MotionSpec.model_construct(linear=(), angular=()),
    destination=None,
    grasp=_NO_GRASP,
)
"""Of a task without an object that has a mass."""


def complete(target_object: ObjectSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for an object that nothing holds between taking it and letting it go, or that is half a body."""
    let_go_by = target_object.let_go_by
    if context.stages and let_go_by and not target_object.held_stages(context.stages):
        wanted = f"a later stage than the one after {quoted(target_object.taken_by)}, so that a stage holds the object"
        yield ("let_go_by",), expected(wanted, quoted(let_go_by))
    given = target_object.model_dump(exclude_none=True)
    if "mass" in given:
        yield from _of_a_body(given, earlier_fields)
        return
    for key in ("inertia", "motion", "destination", "grasp"):
        if key in given:
            yield (key,), expected('also "mass": an object without one is drawn alone', "no mass", at_key=True)


def _of_a_body(given: Mapping[str, Any], earlier_fields: Fields) -> RuleErrors:
    """Yield errors for what an object with a mass lacks."""
    missing = " and ".join(quoted(key) for key in ("inertia", "grasp") if key not in given)
    if missing:
        yield ("mass",), expected(f"also {missing}", "a mass alone", at_key=True)
    plant = earlier_fields.get("plant")
    if plant and not plant.traits.has_forces:
        yield ("mass",), expected(plant.alternatives, f"a mass with plant {plant.kind}", at_key=True)
