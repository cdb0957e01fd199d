"""What a robot is: a base and arms of joints and rigid links, in plane or space. Validated data.

And the order of its coordinates: their names, numbers by part as vectors, and the limits in force.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from psmpc_cli.specs import fields
from psmpc_cli.specs.document import choice, mapping, quoted
from psmpc_cli.specs.fields import (
    Fields,
    RuleErrors,
    Spec,
    expected,
    flaw,
    listed,
    one_of,
    unit_errors,
    validated_by,
)
from psmpc_cli.specs.geometry import GEOMETRY, PlacedShape, ShapesByBody
from psmpc_cli.specs.parts import (
    ANGLE,
    ERROR_AXES,
    FREE_FLYING,
    LENGTH,
    MOBILITIES,
    MOBILITY,
    QUANTITIES,
    RESERVED,
    AsWritten,
    Context,
    CoordinateUnits,
    Mobility,
    MobilityTraits,
    Space,
    axes_of,
    length_errors,
    stands_for,
    units_of,
)
from psmpc_cli.specs.robots.actuators import (
    PULSE_PERIOD,
    THRUSTERS,
    WHEELS,
    PlanarThrusters,
    PulsePeriod,
    SpatialThrusters,
    SpatialWheels,
    Thruster,
    Wheels,
)

Vector = NDArray[np.float64]
Parts = Mapping[str, tuple[float, ...]]
"""Numbers keyed by part name (`base`, then each arm's name, or `arms` for every arm)."""

Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Attachment:
    """A frame on a body.

    Attributes:
        body: Number of the body that carries it.
        position: Of its origin in the body's frame (3,) [m].
        rotation: Rotation vector from the body's frame (3,) [rad].
    """

    body: int
    position: Triple
    rotation: Triple


@dataclass(frozen=True)
class Joint:
    """The joint through which a body is carried.

    Attributes:
        at: The joint's frame on the body that carries it.
        axis: Unit vector in that frame (3,).
        prismatic: Whether the body slides along the axis, or turns about it.
        armature: Inertia of the rotor that drives it, as the joint feels it [kg m^2], of a prismatic joint [kg].
    """

    at: Attachment
    axis: Triple = (0.0, 0.0, 1.0)
    prismatic: bool = False
    armature: float = 0.0


@dataclass(frozen=True)
class Body:
    """A rigid body, whose frame is that of its joint.

    Attributes:
        name: `base`, or `<arm>.<number>`.
        mass: [kg].
        centre: Centre of mass (3,) [m].
        inertia: About the centre of mass: xx, yy, zz, xy, xz, yz (6,) [kg m^2]; of a planar robot's bodies zz counts.
    """

    name: str
    mass: float
    centre: Triple
    inertia: Six


class Base(Spec):
    """The base body."""

    mass: fields.PositiveOrNone = Field(description="mass; only a fixed base may have 0 [kg]")
    inertia: fields.PositiveOrNone = Field(
        description="inertia about the centre of mass; only a fixed base may have 0 [kg m^2]"
    )

    @property
    def centre_of_mass(self) -> Triple:
        """In the body's frame [m]."""
        return (0.0, 0.0, 0.0)


class Mount(Spec):
    """Where an arm's first joint sits on the base."""

    position: fields.Vector2 = Field(description="position of the shoulder in the base frame, [x, y] [m]")
    angle: fields.Direction = Field(0.0, description="direction of the arm in the base frame [rad]")


class Link(Base):
    """One rigid link."""

    mass: fields.Positive = Field(description="mass [kg]")
    inertia: fields.Positive = Field(description="inertia about the centre of mass [kg m^2]")
    a: fields.NotNegative = Field(description="joint to centre of mass [m]")
    b: fields.NotNegative = Field(description="centre of mass to the next joint or the tip [m]")

    @property
    def centre_of_mass(self) -> Triple:
        """In the body's frame [m]."""
        return (self.a, 0.0, 0.0)


class Tool(Spec):
    """The end-effector frame."""

    angle: fields.Direction = Field(0.0, description="angle against the last link [rad]")


class Arm(Spec):
    """A chain of revolute joints and links, from the base outward."""

    mount: Mount = Field(description="where the arm's first joint sits on the base")
    links: tuple[Link, ...] = Field(min_length=1, description="the links, from the base outward")
    tool: Tool = Field(Tool(), description="the end-effector frame")

    @property
    def frames(self) -> list[tuple[Triple, Triple]]:
        """Position and rotation vector of each joint's frame, then of the tool's, on the body before it."""
        positions = [(*self.mount.position, 0.0), *((link.a + link.b, 0.0, 0.0) for link in self.links)]
        angles = [self.mount.angle, *(0.0 for _ in self.links[1:]), self.tool.angle]
        return [(position, (0.0, 0.0, angle)) for position, angle in zip(positions, angles, strict=True)]


def _is_an_inertia(value: Six) -> Six:
    """Check that a rigid body can have an inertia: positive, and no principal moment above the sum of the others."""
    xx, yy, zz, xy, xz, yz = value
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if moments[0] <= 0:
        raise expected(f"positive principal moments, not {', '.join(f'{m:.3g}' for m in moments)} kg m^2")
    if moments[2] > (moments[0] + moments[1]) * (1 + 1e-6):
        raise expected(f"no principal moment above the sum of the others, not {', '.join(f'{m:.3g}' for m in moments)}")
    return value


_Terms = Annotated[
    tuple[fields.Number, fields.Number, fields.Number, fields.Number, fields.Number, fields.Number],
    listed("3 principal moments, or 6 numbers: xx, yy, zz, xy, xz, yz", 6),
    BeforeValidator(lambda value: [*value, 0, 0, 0] if isinstance(value, list | tuple) and len(value) == 3 else value),
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 6}),
]
Inertia = Annotated[_Terms, AfterValidator(_is_an_inertia)]
InertiaOrNone = Annotated[_Terms, AfterValidator(lambda value: _is_an_inertia(value) if any(value) else value)]


class SpatialBase(Spec):
    """The base body of a spatial robot."""

    mass: fields.PositiveOrNone = Field(description="mass; only a fixed base may have 0 [kg]")
    inertia: InertiaOrNone = Field(
        description="inertia about the centre of mass, xx, yy, zz (, xy, xz, yz); only a fixed base may have 0 [kg m^2]"
    )
    centre_of_mass: fields.Vector3 = Field((0.0, 0.0, 0.0), description="in the body's frame [m]")


class SpatialTool(Spec):
    """The end-effector frame of a spatial arm on its last link."""

    position: fields.Vector3 = Field((0.0, 0.0, 0.0), description="of the frame's origin on the body before it [m]")
    rpy: fields.Angles3 = Field((0.0, 0.0, 0.0), description="its angles about the fixed axes x, y, z [rad]")


class SpatialJoint(SpatialTool):
    """A joint, and where its frame is on the body before it."""

    kind: Literal["revolute", "prismatic"] = Field("revolute", description="revolute or prismatic")
    axis: fields.Axis = Field(description="unit vector in the joint's frame")


class SpatialLink(SpatialBase):
    """One rigid link of a spatial arm; its frame is that of its joint."""

    mass: fields.Positive = Field(description="mass [kg]")
    inertia: Inertia = Field(description="inertia about the centre of mass, xx, yy, zz (, xy, xz, yz) [kg m^2]")
    joint: SpatialJoint = Field(description="the joint that carries it")


class SpatialArm(Spec):
    """A chain of joints and links, from the base or from a link of another arm outward."""

    mount: str = Field("base", description="what carries it: base, or the link of an arm before it, such as arm_1.2")
    links: tuple[SpatialLink, ...] = Field(min_length=1, description="the links, from the base outward")
    tool: SpatialTool = Field(SpatialTool(), description="the end-effector frame")

    @property
    def frames(self) -> list[tuple[Triple, Triple]]:
        """Position and rotation vector of each joint's frame, then of the tool's, on the body before it."""
        frames = (*(link.joint for link in self.links), self.tool)
        return [(frame.position, _rotation_vector(frame.rpy)) for frame in frames]


def _rotation_vector(rpy: Triple) -> Triple:
    """Compute the rotation vector [rad] of fixed-axis angles about x, y and z [rad]."""
    from scipy.spatial.transform import Rotation

    x, y, z = Rotation.from_euler("xyz", rpy).as_rotvec().tolist()
    return x, y, z


class PartLimits(Spec):
    """Bounds of one part's coordinates, each a (low, high) pair per coordinate; null where there is none."""

    position: tuple[fields.Interval | None, ...] | None = Field(
        None, description="one [low, high] a coordinate [m, rad]"
    )
    velocity: tuple[fields.Velocity | None, ...] | None = Field(
        None, description="one [low, high] a coordinate, or one number for both ways [m/s, rad/s]"
    )
    acceleration: tuple[fields.Acceleration | None, ...] | None = Field(
        None, description="one [low, high] a coordinate, or one number for both ways [m/s^2, rad/s^2]"
    )
    jerk: fields.Sparse[tuple[fields.Jerk | None, ...] | None] = Field(
        None, description="one [low, high] a coordinate, or one number for both ways [m/s^3, rad/s^3]"
    )
    force: fields.Sparse[tuple[fields.Force | None, ...] | None] = Field(
        None,
        description="one [low, high] a coordinate, or one number for both ways; the base's along its own axes [N, N m]",
    )


def _limit_faults(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of limits by part, in a robot's file, a task or a skill.

    Parts have to exist, lists to have an entry for each coordinate, and large angles to have a unit. A base without
    thrusters has no limit of a force, and an attitude in space none of its position.

    Args:
        written: The limits by part and quantity, as they are written.
        earlier_fields: The valid keys before it; in a robot's file its arms.
        context: What is known of the robot; in a robot's file its text alone.

    Yields:
        Path of the value from `limits` on, and its error.
    """
    sizes = context.sizes
    sliding = context.sliding
    mobility: str | None = context.mobility
    if "arms" in earlier_fields:  # a robot's own file, whose parts no context knows yet
        robot = mapping(context.file.data)
        sliding = _sliding(earlier_fields["arms"])
        sizes = _parts(len(ERROR_AXES[3 if "space" in robot else 2]), earlier_fields["arms"])
        mobility = str(robot.get("mobility", FREE_FLYING))
    axes = axes_of(sizes, "joint")
    yield from _faults_of_unknown_parts(written, sizes)
    without_force = {name for name, traits in MOBILITIES.items() if not traits.is_turned}
    turned_elsewhere = any(traits.is_turned for traits in context.mobilities)
    if mobility in without_force and not turned_elsewhere and written.get("base", {}).get("force") is not None:
        yield ("base", "force"), expected(f"none: a {mobility} base has no thrusters", at_key=True)
    for quantity in QUANTITIES:
        given = {key: part[quantity] for key, part in written.items() if part.get(quantity) is not None}
        for key, bounds in given.items():
            yield from length_errors((key, quantity), bounds, key, axes, given, written=AsWritten(sliding, quantity))
            # the base of a robot in space, with three coordinates of its attitude behind those of its position
            if key == "base" and quantity == "position" and sizes.get(key) == len(ERROR_AXES[3]):
                limited = (i for i, pair in enumerate(bounds) if i >= 3 and pair is not None)
                yield from (((key, quantity, i), expected("null: an attitude has no limits")) for i in limited)


def _faults_of_unknown_parts(written: Mapping[str, Any], sizes: Mapping[str, int]) -> RuleErrors:
    """Yield errors for keys that name no part of the robot."""
    parts = [*sizes, "arms"]
    for key in (key for key in written if sizes and key not in parts):
        yield (key,), flaw(choice(key, parts), "no such part of the robot", at_key=True)


def _sliding(arms: Mapping[str, "Arm | SpatialArm"]) -> frozenset[str]:
    """Return the names of joint coordinates that are lengths, such as `arm_1.2`."""
    links = ((f"{name}.{i}", link) for name, arm in arms.items() for i, link in enumerate(arm.links, start=1))
    return frozenset(name for name, link in links if isinstance(link, SpatialLink) and link.joint.kind == "prismatic")


def _parts(base: int, arms: Mapping[str, Arm | SpatialArm]) -> dict[str, int]:
    return {"base": base, **{name: len(arm.links) for name, arm in arms.items()}}


LimitsByPart = Annotated[Mapping[str, PartLimits], validated_by(_limit_faults, as_written=True)]
"""Limits keyed by `base`, `arms` (every arm) or an arm's name."""


def _fit_joints(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for numbers of arms that the robot does not have, and lists without one number for each joint."""
    if "arms" in earlier_fields:
        sizes = {name: len(arm.links) for name, arm in earlier_fields["arms"].items()}
        axes = axes_of(sizes, "joint")
        yield from _faults_of_unknown_parts(written, sizes)
        for key, numbers in written.items():
            yield from length_errors((key,), numbers, key, axes, written)


ArmatureByArm = Annotated[Mapping[str, tuple[fields.NotNegative, ...]], validated_by(_fit_joints, as_written=True)]
"""Armatures of joints, keyed by `arms` (every arm) or an arm's name."""


def limits_of_part(limits: Mapping[str, PartLimits], part: str, quantity: str) -> tuple[fields.Pair | None, ...] | None:
    """Return the pairs that hold for a part, None if there are none; an arm's own take precedence over `arms`."""
    given = (getattr(limits[key], quantity) for key in (part, "arms") if key in limits and stands_for(key, part))
    return next((pairs for pairs in given if pairs is not None), None)


def wider(
    limits: Mapping[str, PartLimits], outer: Mapping[str, Mapping[str, PartLimits]], sizes: Mapping[str, int]
) -> RuleErrors:
    """Yield errors for limits that are wider than outer ones, which are keyed by whose they are."""
    for part, quantity, (whose, layer) in product(sizes, QUANTITIES, outer.items()):
        given = limits_of_part(limits, part, quantity) or ()
        allowed = limits_of_part(layer, part, quantity) or ()
        for index, (own, around) in enumerate(zip(given, allowed, strict=False)):
            low, high = own or (-np.inf, np.inf)
            least, most = around or (-np.inf, np.inf)
            if own is not None and (low < least or high > most):
                key = part if part in limits and getattr(limits[part], quantity) is not None else "arms"
                yield (key, quantity, index), expected(f"within {whose} [{least:.6g}, {most:.6g}]")


def is_arm_name(name: str) -> bool:
    """Tell whether an arm may have a name."""
    return fields.is_name(name) and name not in RESERVED


def _not_reserved(name: str) -> str:
    if name in RESERVED:
        raise expected(f"none of {', '.join(RESERVED)}", f"the reserved name {quoted(name)}", at_key=True)
    return name


ARMATURE = "rotor inertia that each joint feels, of arms (every arm) or an arm by name [kg m^2, kg]"

ArmKey = Annotated[fields.Name, AfterValidator(_not_reserved)]


class RobotSpec(Spec):
    """A space robot: a base, and arms that are chains of joints and links. Planar or spatial.

    `limits` is keyed by `base`, `arms` (every arm) or an arm's name.
    """

    name: fields.Name = Field(description="name of the robot")
    description: str = Field("", description="what it is, for people")
    arms: Mapping[ArmKey, Arm | SpatialArm]
    limits: LimitsByPart = Field({}, description="limits of base, arms (every arm) or an arm by name")
    armature: fields.Sparse[ArmatureByArm] = Field({}, description=ARMATURE)
    geometry: fields.Sparse[ShapesByBody] = Field({}, description=GEOMETRY)
    wheels: fields.Sparse[Wheels] = Field((), description=WHEELS)
    thrusters: fields.Sparse[tuple[Thruster, ...]] = Field((), description=THRUSTERS)
    pulse_period: PulsePeriod = Field(None, exclude_if=lambda value: value is None, description=PULSE_PERIOD)
    mobility: Mobility = Field(FREE_FLYING, exclude_if=lambda value: value == FREE_FLYING, description=MOBILITY)
    base: Base | SpatialBase

    dimension: ClassVar[int]
    """Number of position coordinates of a pose: 2 or 3."""

    @property
    def moved_by(self) -> MobilityTraits:
        """What moves the base."""
        return MOBILITIES[self.mobility]

    @property
    def has_plumes(self) -> bool:
        """Whether some thruster says where its plume is."""
        return any(thruster.plume for thruster in self.thrusters)

    @property
    def parts(self) -> dict[str, int]:
        """Names and numbers of velocity coordinates of the parts, in the order of v: `base`, then the arms."""
        return _parts(len(ERROR_AXES[self.dimension]), self.arms)

    @property
    def sliding(self) -> frozenset[str]:
        """Names of the joint coordinates that are lengths, such as `arm_1.2`; the others are angles."""
        return _sliding(self.arms)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The base, then the links of each arm from the base outward; a body comes after the one that carries it."""
        bodies = [_body("base", self.base)]
        for name, arm in self.arms.items():
            links: Sequence[Link | SpatialLink] = arm.links
            bodies += [_body(f"{name}.{number}", link) for number, link in enumerate(links, start=1)]
        return tuple(bodies)

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The joints through which the bodies after the base are carried, in the order of `bodies`.

        A joint knows the body that carries it by its number in `bodies`, where the base is 0.
        """
        joints = list[Joint]()
        body_numbers = {"base": 0}  # by name of the body
        for name, arm in self.arms.items():
            # in space a mount names a body; in the plane it is a pose on the base
            carrier = body_numbers[arm.mount if isinstance(arm.mount, str) else "base"]
            links: Sequence[Link | SpatialLink] = arm.links
            rotors = self.armature.get(name) or self.armature.get("arms") or (0.0,) * len(links)
            # frames has one more than there are links, that of the tool
            for number, (link, frame, rotor) in enumerate(zip(links, arm.frames, rotors, strict=False), start=1):
                at = Attachment(carrier, *frame)
                if isinstance(link, SpatialLink):
                    joints.append(Joint(at, link.joint.axis, link.joint.kind == "prismatic", armature=rotor))
                else:
                    joints.append(Joint(at, armature=rotor))
                carrier = body_numbers[f"{name}.{number}"] = len(joints)  # it carries the next link
        return tuple(joints)

    @property
    def tools(self) -> dict[str, Attachment]:
        """The end-effector frame of each arm."""
        last = {body.name.rpartition(".")[0]: number for number, body in enumerate(self.bodies)}
        return {name: Attachment(last[name], *arm.frames[-1]) for name, arm in self.arms.items()}

    def link_ends(self, arm: str) -> tuple[Triple, ...]:
        """Return where each link of an arm has the next joint, the last one the end-effector, in its frame [m]."""
        return tuple(position for position, _ in self.arms[arm].frames[1:])


def _body(name: str, part: Base | SpatialBase) -> Body:
    inertia = part.inertia if isinstance(part.inertia, tuple) else (0.0, 0.0, part.inertia, 0.0, 0.0, 0.0)
    return Body(name, part.mass, part.centre_of_mass, inertia)


class PlanarRobot(RobotSpec):
    """A robot that moves in a plane, with revolute joints. Paper Table I."""

    base: Base = Field(description="the base body")
    arms: Mapping[ArmKey, Arm] = Field(min_length=1, description="the arms by name, in the order of Q")
    thrusters: fields.Sparse[PlanarThrusters] = Field((), description=THRUSTERS)

    dimension: ClassVar[int] = 2


def _mounted(arms: Mapping[str, SpatialArm], earlier_fields: Fields, context: Any) -> RuleErrors:
    """Yield errors for arms that are mounted on what is not there before them."""
    carriers = ["base"]
    for name, arm in arms.items():
        if arm.mount not in carriers:
            yield (name, "mount"), flaw(choice(arm.mount, carriers))
        carriers += [f"{name}.{number}" for number in range(1, len(arm.links) + 1)]


class SpatialRobot(RobotSpec):
    """A robot that moves in space, with revolute and prismatic joints; an arm may branch off from a link of another."""

    space: Literal["spatial"] = Field(
        "spatial", description="poses have six coordinates; a robot without this key is planar"
    )
    assumed: tuple[str, ...] = Field((), description="what a URDF leaves out and was assumed, for people")
    base: SpatialBase = Field(description="the base body")
    wheels: fields.Sparse[SpatialWheels] = Field((), description=WHEELS)
    arms: Annotated[Mapping[ArmKey, SpatialArm], validated_by(_mounted)] = Field(
        {}, description="the arms by name, in the order of Q"
    )
    thrusters: fields.Sparse[SpatialThrusters] = Field((), description=THRUSTERS)

    dimension: ClassVar[int] = 3


_LinkName = Annotated[str, one_of(lambda urdf: urdf.links)]
_JointName = Annotated[str, one_of(lambda urdf: urdf.joints, "joint")]


class Tip(Spec):
    """An arm of a URDF: the joints on the way from the base to its tip."""

    tip: _LinkName = Field(min_length=1, description="link whose frame is the end-effector")


def _locked(written: Any, earlier_fields: Fields, urdf: Any) -> RuleErrors:
    """Yield errors for positions of joints in the unit of another kind, and angles without a unit."""
    for name, at in written.items() if isinstance(written, Mapping) else ():
        if name in urdf.joints:
            unit = LENGTH if urdf.joints[name].type.slides else ANGLE
            yield from (((name,), error) for _, error in unit_errors(at, unit.position))


class UrdfRobot(Spec):
    """A robot file that takes bodies, joints and limits of joints from a URDF."""

    name: fields.Name | None = Field(None, description="name of the robot, by default the URDF's")
    description: str = Field("", description="what it is, for people")
    urdf: str = Field(min_length=1, description="path of the URDF, relative to this file")
    base: _LinkName | None = Field(None, description="the link that is the base, by default the root")
    arms: Mapping[ArmKey, Tip] | None = Field(None, description="the arms by name; by default every leaf that moves")
    locked: Annotated[Mapping[_JointName, fields.Coordinate], validated_by(_locked, as_written=True)] = Field(
        {}, description="positions of joints that belong to no arm, by name [rad, m]"
    )
    limits: Mapping[str, PartLimits] = Field(
        {}, description="limits of base, arms (every arm) or an arm by name, besides the URDF's"
    )
    armature: Mapping[str, tuple[fields.NotNegative, ...]] = Field({}, description=ARMATURE)
    geometry: Mapping[str, tuple[PlacedShape, ...]] = Field(
        {}, description="shapes of the bodies, instead of the collision shapes that the URDF has of them"
    )
    thrusters: SpatialThrusters = Field((), description=THRUSTERS)
    pulse_period: PulsePeriod = Field(None, description=PULSE_PERIOD)
    wheels: SpatialWheels = Field((), description=WHEELS)
    mobility: Mobility = Field(FREE_FLYING, description=MOBILITY)


def wheel_axes(robot: RobotSpec) -> Vector:
    """Return the unit axes of a robot's W wheels in the base frame, along the components of its turn (1 or 3, W)."""
    axes = np.array([wheel.direction for wheel in robot.wheels], dtype=float).reshape(
        len(robot.wheels), 2 * robot.dimension - 3
    )
    return np.asarray((axes / np.linalg.norm(axes, axis=1, keepdims=True)).T)


def inertia_without_wheels(robot: RobotSpec) -> Six:
    """Return the base's inertia without what of the wheels turns about their axes, I - sum_i J_i a_i a_i' [kg m^2]."""
    inertia = robot.bodies[0].inertia
    if not robot.wheels:
        return inertia
    axes = wheel_axes(robot)
    taken = (axes * [wheel.inertia for wheel in robot.wheels]) @ axes.T
    if robot.dimension == 2:
        taken = np.diag([0.0, 0.0, taken.item()])
    left = np.array(inertia) - taken[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    xx, yy, zz, xy, xz, yz = left.tolist()
    return xx, yy, zz, xy, xz, yz


def wheel_faults(robot: RobotSpec, mobilities: Sequence[MobilityTraits]) -> list[str]:
    """Return what is wrong with the reaction wheels of a robot, as messages; at most one.

    The inertia of a base is given with its wheels locked, so what is left without their own inertia has to be that of a
    rigid body. Wheels that turn the base by themselves have to turn it about every axis.

    Args:
        robot: The robot.
        mobilities: What moves its base in the stages of a task, or as its own file says.
    """
    if not robot.wheels or not any(moved_by.moves for moved_by in mobilities):
        return []
    xx, yy, zz, xy, xz, yz = inertia_without_wheels(robot)
    left = [zz] if robot.dimension == 2 else np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).tolist()
    # principal moments of a rigid body are positive, and none is larger than the sum of the others, but for rounding
    if left[0] <= 0 or (len(left) == 3 and left[2] > (left[0] + left[1]) * (1 + 1e-6)):
        moments = ", ".join(f"{moment:.3g}" for moment in left)
        return [
            f"found wheels whose inertias leave the base {moments} kg m^2; expected a base with the inertia of a rigid "
            "body without them: the base's inertia is that with its wheels locked"
        ]
    turned_by_wheels = any(moved_by.is_turned and not moved_by.is_pushed for moved_by in mobilities)
    if turned_by_wheels and np.linalg.matrix_rank(wheel_axes(robot), tol=1e-6) < len(left):
        return [
            "found axes in one plane; expected wheels about three axes that are not in one plane: in stages with "
            "mobility attitude they turn the base about every axis"
        ]
    return []


def missing_directions(robot: RobotSpec) -> list[str]:
    """Return the directions in which the thrusters of a robot cannot push or turn its base: `+x`, `-theta`.

    Thrusts are not negative, so all wrenches are possible if and only if the thrusters' wrenches span the space with
    positive factors, which they do if they give both directions of every axis.
    """
    from scipy.optimize import nnls

    wrenches = np.array([thruster.wrench for thruster in robot.thrusters]).T
    axes = ERROR_AXES[robot.dimension]
    wanted = {f"{sign:+d}"[0] + axis: sign * np.eye(len(axes))[i] for i, axis in enumerate(axes) for sign in (1, -1)}
    return [name for name, wrench in wanted.items() if nnls(wrenches, wrench)[1] > 1e-9]


LARGEST_SPEED_RESERVE = 0.2
"""Largest part of a limit of velocity that is held in reserve."""

EASING = 0.05
"""Share of the largest acceleration with which a robot brakes to a limit that has become tighter."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of every coordinate in the order of Q, each (n,); +-inf where there is none.

    Attributes:
        position_low, position_high: Of Q [m, rad].
        velocity_low, velocity_high: Of Qdot [m/s, rad/s].
        acceleration_low, acceleration_high: Of Qddot [m/s^2, rad/s^2].
        jerk_low, jerk_high: Of the rate of Qddot [m/s^3, rad/s^3].
        force_low, force_high: Of the generalized force, the base's along its own axes [N, N m]; infinite for a base
            without thrusters.
    """

    position_low: Vector
    position_high: Vector
    velocity_low: Vector
    velocity_high: Vector
    acceleration_low: Vector
    acceleration_high: Vector
    jerk_low: Vector
    jerk_high: Vector
    force_low: Vector
    force_high: Vector

    def __repr__(self) -> str:
        bounded = []
        for quantity in QUANTITIES:
            low, high = (getattr(self, f"{quantity}_{side}") for side in ("low", "high"))
            bounded.append(f"{np.count_nonzero(np.isfinite(low) | np.isfinite(high))} of {quantity}")
        return f"<Limits of {len(self.position_low)} coordinates: {', '.join(bounded)}>"

    @cached_property
    def state_low(self) -> Vector:
        """Lower bounds of [Q; Qdot] (2n,)."""
        return np.concatenate([self.position_low, self.velocity_low])

    @cached_property
    def state_high(self) -> Vector:
        """Upper bounds of [Q; Qdot] (2n,)."""
        return np.concatenate([self.position_high, self.velocity_high])

    def available_speed_reserve(self, wanted: Vector, v: Vector, sample_time: float) -> Vector:
        """Return by how much limits of velocities can be tighter now, so that a robot at rest or in motion keeps them.

        At most `LARGEST_SPEED_RESERVE` of a limit is held in reserve, so that the robot can still move. A robot that
        moves faster than a tight limit allows could not keep it at once: it is only tightened to the velocity that the
        robot has after a sample of gentle braking, with `EASING` of the largest acceleration.

        Args:
            wanted: How much is wanted (n,) [m/s, rad/s].
            v: Velocities of the robot now (n,); NaN where they were not measured, which leaves no room.
            sample_time: Time between two samples [s].

        Returns:
            What lower limits are raised by, and what upper limits are lowered by, (2, n) [m/s, rad/s].
        """
        taken = np.minimum(wanted, LARGEST_SPEED_RESERVE * (self.velocity_high - self.velocity_low) / 2)
        room_below = (v + EASING * self.acceleration_high * sample_time) - self.velocity_low
        room_above = self.velocity_high - (v + EASING * self.acceleration_low * sample_time)
        return np.asarray(np.minimum(taken, np.fmax([room_below, room_above], 0.0)))

    def with_speed_reserve(self, reserve: Vector) -> "Limits":
        """Return limits of which those of velocities are tighter by a reserve (2, n), see `available_speed_reserve`."""
        raised, lowered = reserve
        return replace(self, velocity_low=self.velocity_low + raised, velocity_high=self.velocity_high - lowered)


def resolve_limits(robot: RobotSpec, *more: Mapping[str, PartLimits], moved_by: MobilityTraits | None = None) -> Limits:
    """Intersect the robot's limits with those in `more`, such as a task's and a skill's, for each coordinate.

    The tightest bound of each side counts: windows and plants are given these limits.

    Where a base is not actuated its limits are dropped, since other equations say what happens there. Without
    thrusters nothing pushes it, so a limit of its force would bound nothing; likewise of its torque where nothing turns
    it. While a mount holds the base, limits of its acceleration and jerk are dropped: it stops at once where the mount
    closes.

    Args:
        robot: The robot.
        more: Limits within its own.
        moved_by: What moves its base; by default what the robot's description says.

    Returns:
        Lowest and highest value of each quantity, (n,) each; infinite where there is no limit.
    """
    unlimited = (-np.inf, np.inf)

    def pairs_of(limits: Mapping[str, PartLimits], quantity: str) -> list[tuple[float, float]]:
        """Return (low, high) of a quantity for every coordinate, part by part, from one source of limits."""
        pairs = list[tuple[float, float]]()
        for part, size in robot.parts.items():
            pairs += [pair or unlimited for pair in limits_of_part(limits, part, quantity) or [unlimited] * size]
        return pairs

    bounds: dict[str, Vector] = {}
    for quantity in QUANTITIES:
        sources = np.array([pairs_of(limits, quantity) for limits in (robot.limits, *more)], dtype=np.float64)
        low, high = np.moveaxis(sources, -1, 0)  # from (sources, n, 2) to two of (sources, n)
        bounds[f"{quantity}_low"] = low.max(axis=0)
        bounds[f"{quantity}_high"] = high.min(axis=0)
    moved_by = moved_by or robot.moved_by
    has_no_force = np.zeros(len(bounds["force_low"]), bool)
    has_no_force[robot.dimension : robot.parts["base"]] = not moved_by.is_turned  # the base: positions, then angles
    has_no_force[: robot.dimension] = not moved_by.is_pushed
    held_by_mount = robot.moved_by.moves and not moved_by.moves
    if held_by_mount:
        for quantity in ("acceleration", "jerk"):
            bounds[f"{quantity}_low"][: robot.parts["base"]] = -np.inf
            bounds[f"{quantity}_high"][: robot.parts["base"]] = np.inf
    bounds["force_low"][has_no_force] = -np.inf
    bounds["force_high"][has_no_force] = np.inf
    return Limits(**bounds)


def labels(robot: RobotSpec, space: Space, *, of_error: bool = True) -> tuple[str, ...]:
    """Return the name of every row of the error, or of a target: `base.x`, `arm_1.2`."""
    axes = axes_of(robot.parts, space, of_error)
    return tuple(f"{part}.{axis}" for part in axes for axis in axes[part])


def units(robot: RobotSpec, space: Space = "joint", *, of_error: bool = True) -> tuple[CoordinateUnits, ...]:
    """Return the units of every row of the error, or of a target, in the order of `labels`; by default those of v."""
    axes = axes_of(robot.parts, space, of_error)
    return tuple(units_of(part, axis, robot.sliding) for part in axes for axis in axes[part])


def rows(chosen: Sequence[str], robot: RobotSpec, space: Space) -> tuple[int, ...]:
    """Return the rows of the error that names mean, sorted."""
    named = [(label, label.rpartition(".")[0]) for label in labels(robot, space)]
    meant = (any(name in (label, "all") or stands_for(name, part) for name in chosen) for label, part in named)
    return tuple(np.flatnonzero(list(meant)).tolist())


def stack(parts: Parts, robot: RobotSpec, space: Space, missing: float = np.nan, *, of_error: bool = False) -> Vector:
    """Stack numbers by part into one vector (n,) or (m,) in the order of Q or xi.

    Args:
        parts: The numbers; `arms` means every arm that has none of its own. One alone stands for all of its part.
        robot: Whose parts they are.
        space: Which order.
        missing: The value for parts that are missing.
        of_error: Whether the numbers belong to the rows of the error (weights, tolerances), not to those of a target.
    """
    axes = axes_of(robot.parts, space, of_error)
    given = {part: parts.get(part, (missing,) if part == "base" else parts.get("arms", (missing,))) for part in axes}
    return np.concatenate([np.broadcast_to(np.array(given[part], dtype=np.float64), len(axes[part])) for part in axes])
