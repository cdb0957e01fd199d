"""Shapes of bodies and obstacles, what is to keep clear of what, and where axes point. docs/clearance.md."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from psmpc_cli.specs import fields
from psmpc_cli.specs.document import choice, counted, mapping
from psmpc_cli.specs.fields import Fields, RuleErrors, Spec, ensure, expected, flaw, listed, one_of, validated_by
from psmpc_cli.specs.object import PoseNumbers
from psmpc_cli.specs.parts import TARGET_AXES, Context, by_dimension, dimension_of

ShapeKind = Literal["capsule", "box", "half_space"]

OBJECT = "object"
"""Name of the object among parts that keep clear of each other."""

DEEP = 1e6
"""Length along z of a box in the plane [m]: beyond all others, so that it is never the nearest way out."""


SHORTEST_VECTOR = 1e-6
"""Length below which a vector gives no direction, and a quaternion no attitude."""


@dataclass(frozen=True)
class Shape:
    """A convex shape about its own frame, in space; those of the plane are in z = 0.

    Attributes:
        kind: capsule: the points nearer than a radius to a segment along x with its middle at the origin, a sphere if
            that is of length 0; box, with its centre at the origin; or half_space: the points p with normal' p <= 0.
        size: Of a capsule radius and length of its segment (2,) [m], of a box its edges (3,) [m], of a half-space the
            unit normal, which points out of it (3,).
    """

    kind: ShapeKind
    size: tuple[float, ...]

    @property
    def edges(self) -> tuple[float, ...]:
        """Edges of a box [m]: two in the plane, three in space."""
        return tuple(edge for edge in self.size if edge < DEEP)


class ShapeSpec(Spec):
    """A shape about its own frame, in one of four ways."""

    sphere: fields.Positive | None = Field(None, description="radius [m]")
    capsule: Annotated[tuple[fields.Positive, fields.Positive], listed("2 entries", 2)] | None = Field(
        None, description="[radius, length of the segment that it is about], along x [m]"
    )
    box: tuple[fields.Positive, ...] | None = Field(None, description="lengths along x, y and in space z [m]")
    half_space: tuple[fields.Number, ...] | None = Field(
        None, description="outward normal of the plane through the origin that bounds it"
    )

    @property
    def shape(self) -> Shape:
        """The shape as numbers."""
        if self.sphere is not None:
            return Shape("capsule", (self.sphere, 0.0))
        if self.capsule is not None:
            return Shape("capsule", self.capsule)
        if self.box is not None:
            return Shape("box", (*self.box, DEEP)[:3])
        normal = np.array([*(self.half_space or ()), 0.0])[:3]
        return Shape("half_space", tuple((normal / np.linalg.norm(normal)).tolist()))


def _dimension(context: Context) -> int | None:
    """Return the dimension of the robot of a description, of a robot's own file too; None where it is not known."""
    if context.sizes:
        return dimension_of(context.sizes)
    robot = mapping(context.file.data)
    return 3 if "space" in robot else 2 if "arms" in robot else None


def _one_shape(shape: ShapeSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a shape that is none, or several, and sizes of another dimension."""
    given = [key for key in ShapeSpec.model_fields if getattr(shape, key) is not None]
    if len(given) != 1:
        yield (), expected(f"one of {', '.join(ShapeSpec.model_fields)}", ", ".join(given) or "none", at_key=True)
        return
    (key,) = given
    numbers = getattr(shape, key)
    dimension = _dimension(context)
    if key in ("box", "half_space") and dimension not in (None, len(numbers)):
        yield (key,), expected(counted(dimension, "entry", "entries"))
    if key == "half_space" and np.linalg.norm(numbers) < SHORTEST_VECTOR:
        yield (key,), expected("a normal that is not 0")


OneShape = Annotated[ShapeSpec, validated_by(_one_shape)]


class PlacedShape(Spec):
    """A shape on a body of a robot."""

    shape: OneShape = Field(description="sphere, capsule or box")
    pose: PoseNumbers | None = Field(
        None, description="pose of its frame in that of the body; default the body's frame"
    )


def _faults_of_body_shapes(
    given: Mapping[str, tuple[PlacedShape, ...]], earlier_fields: Fields, context: Context
) -> RuleErrors:
    """Yield errors of the shapes that a robot's file gives its bodies.

    A body has to exist, its shapes must not be half-spaces, which have no end, and their poses must have as many
    numbers as poses of the robot have, with a quaternion that is not 0.

    Args:
        given: The shapes by body, `base` or `arm.number`.
        earlier_fields: The valid keys of the robot before it, arms among them.
        context: What is known of the rest of the robot's file.

    Yields:
        Path of the value from `geometry` on, and its error.
    """
    dimension = _dimension(context)
    bodies = ["base"]
    for name, arm in earlier_fields.get("arms", {}).items():
        bodies += [f"{name}.{number}" for number in range(1, len(arm.links) + 1)]
    for body, placed in given.items():
        if "arms" in earlier_fields and body not in bodies:
            yield (body,), flaw(choice(body, bodies), "no such body of the robot", at_key=True)
        for number, shape in enumerate(placed):
            if shape.shape.half_space is not None:
                yield (body, number, "shape", "half_space"), expected("sphere, capsule or box", at_key=True)
            if shape.pose is not None and dimension is not None and len(shape.pose) != len(TARGET_AXES[dimension]):
                yield (body, number, "pose"), expected(counted(len(TARGET_AXES[dimension]), "entry", "entries"))
            elif shape.pose is not None and dimension == 3 and np.linalg.norm(shape.pose[3:]) < SHORTEST_VECTOR:
                yield (body, number, "pose"), expected("a quaternion w, x, y, z that is not 0 after the position")


GEOMETRY = "shapes that the bodies are covered by, by body: base, or arm.number; default fitted to the joints"

ShapesByBody = Annotated[Mapping[str, tuple[PlacedShape, ...]], validated_by(_faults_of_body_shapes)]
"""Shapes of a robot's bodies, keyed as `RobotSpec.bodies` names them."""


class ObstacleSpec(Spec):
    """A body that the robot does not touch, at rest or in uniform motion."""

    name: fields.Name = Field(description="name of the obstacle")
    shape: OneShape = Field(description="sphere, capsule, box or half_space")
    pose: PoseNumbers = Field(description="pose of the shape's frame at the start, as the object's")
    velocity: Annotated[tuple[fields.Number, ...], by_dimension(2, 3)] = Field(
        (), description="velocity in the inertial frame; default rest [m/s]"
    )


def names_of_parts(context: Context) -> list[str]:
    """Return the names of what can keep clear in a task: base, arms, their bodies, obstacles and the object.

    None where the robot is not known.
    """
    if not context.sizes:
        return []
    bodies = [
        f"{part}.{number + 1}" for part, size in context.sizes.items() if part != "base" for number in range(size)
    ]
    obstacles = context.file.value(("obstacles",))
    named = [str(mapping(each).get("name")) for each in obstacles] if isinstance(obstacles, list) else []
    return [*context.sizes, *bodies, *named, *([OBJECT] if context.file.value(("object",)) else [])]


def pair_name(first: str, second: str) -> str:
    """Return what logs and messages call two parts that keep clear of each other."""
    return f"{first} - {second}"


def _known_parts(pairs: tuple[tuple[str, str], ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for names of parts that are none."""
    valid = names_of_parts(context)
    for i, pair in enumerate(pairs if valid else ()):
        for j, name in enumerate(pair):
            if name not in valid:
                yield (i, j), flaw(choice(name, valid))


class RoutesSpec(Spec):
    """Routes round what blocks the straight motion to a stage's target, planned before the run."""

    iterations: fields.Whole = Field(5000, ge=1, le=1_000_000, description="iterations of the planner for each route")
    spare: fields.NotNegative = Field(0.02, description="by how much more than the margin routes keep clear [m]")


class ClearanceSpec(Spec):
    """How far apart bodies keep: the robot from itself, from obstacles and from the object."""

    margin: fields.NotNegative = Field(0.02, description="smallest distance of two bodies [m]")
    excepted: Annotated[
        tuple[Annotated[tuple[str, str], listed("a pair of parts", 2)], ...], validated_by(_known_parts)
    ] = Field(
        (),
        alias="except",
        description="pairs of parts that need not: bodies such as arm_1.2, arms with all their bodies, base, "
        "obstacles by name, object",
    )
    hard: fields.Flag = Field(False, description="no plan may come nearer; default: violations cost")


_Frame = Annotated[str, one_of(lambda context: context.sizes)]
_Vector = Annotated[tuple[fields.Number, ...], by_dimension(2, 3)]
_DirectionVector = Annotated[
    _Vector, ensure(lambda vector: float(np.linalg.norm(vector)) >= SHORTEST_VECTOR, "a vector that is not 0")
]


class ConeTargetSpec(Spec):
    """What a cone is about: a point, or a direction."""

    point: _Vector | None = Field(None, description="a point in the inertial frame [m]")
    direction: _DirectionVector | None = Field(None, description="a direction in the inertial frame, of any length")


def _point_or_direction(target: ConeTargetSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a target that is none, or both."""
    given = [key for key in ConeTargetSpec.model_fields if getattr(target, key) is not None]
    if len(given) != 1:
        yield (), expected("either point or direction", " and ".join(given) or "neither", at_key=True)


class ConeSpec(Spec):
    """An axis of a frame that stays within an angle of a point or a direction, or outside of it."""

    frame: _Frame = Field(description="base, or an arm: the frame of its end-effector")
    axis: _DirectionVector = Field(description="the axis in that frame, of any length")
    apex: fields.Sparse[_Vector | None] = Field(
        None, description="where in that frame the axis begins; default its origin [m]"
    )
    of: Annotated[ConeTargetSpec, validated_by(_point_or_direction)] = Field(
        description="what the angle is measured from"
    )
    within: fields.Width | None = Field(None, description="largest angle between the axis and the way there [rad]")
    outside: fields.Width | None = Field(None, description="smallest angle between them [rad]")
    hard: fields.Flag = Field(False, description="never violated by a plan; default soft, violated at a cost")

    @property
    def angle(self) -> float:
        """The angle of the cone [rad]."""
        return self.within or self.outside or 0.0


def _one_angle(cone: ConeSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a cone with no angle, or with two, or with one that is no angle between two directions."""
    given = [key for key in ("within", "outside") if getattr(cone, key) is not None]
    if len(given) != 1:
        yield (), expected("either within or outside", " and ".join(given) or "neither", at_key=True)
        return
    if cone.angle >= np.pi:
        yield (given[0],), expected("an angle between 0 and 180 deg, with its unit: 30 deg")


OneCone = Annotated[ConeSpec, validated_by(_one_angle)]
