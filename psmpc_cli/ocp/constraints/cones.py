"""Cones: an axis of a frame stays within an angle of a point or a direction, or outside of it.

With the unit axis a, the unit direction d to the point from where the axis begins, and the angle theta between them, a
cone is theta <= alpha, or theta >= alpha. Rows are in rad at the edge, so that soft ones cost as other angles do.

Every smooth function of theta, a'd = cos(theta) above all, is flat at theta = 0, where a camera looks most of the time:
the linear model there lets the axis turn as far as it likes. So an axis within a cone has as rows the turns that bring
it to d. In the plane that is the angle with its sign. In space it is the rotation vector (e_y, e_z) of length theta,
whose bound is a circle; its rows are those of the polygon in it with 2 SIDES sides,

    |cos(i pi / SIDES) e_y + sin(i pi / SIDES) e_z| <= alpha cos(pi / (2 SIDES)),    i = 0, ..., SIDES - 1.

A soft row on theta itself in place of the polygon is curved by 1 / theta across the way back to d, and windows that
begin outside of narrow cones do not converge (docs/decisions.md).

An axis outside a cone has the chord c = |a - d| = 2 sin(theta / 2), which is smooth where a points away from d:

    k (sqrt(c^2 + l^2 / 4) - sqrt(5 / 4) l) >= 0,    l = 2 sin(alpha / 2),    k = sqrt(5 / 4) / cos(alpha / 2).

It has the slope 1 by theta at the edge and curves less there than cos(theta) with the same slope, which is as good from
30 deg on and takes up to twice as many iterations at 1 deg. Cones are at most half-spaces: the rest are those about the
opposite axis, from the other side.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, ConstraintFunctions, rows_at_nodes
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, conjugate, cross, dot, product, rotate, scaled
from psmpc_cli.specs.geometry import ConeSpec
from psmpc_cli.specs.task import TaskSpec

SIDES = 6
"""Rows of an axis within a cone in space: half the sides of the polygon, which is within 3.4 % of the circle."""

NEAREST = 1e-6
"""By how much a point is taken to be further along the axis [m]: it has a direction from the apex even there."""


@dataclass(frozen=True)
class Cone:
    """What decides the rows of a cone beside the robot.

    Attributes:
        frame: Of the axis.
        has_point: It is about a point, not a direction.
        is_within: The axis stays within it.
        soft: It may be violated at a cost.
    """

    frame: str
    has_point: bool
    is_within: bool
    soft: bool

    def bounds(self, angle: float, space: ConfigurationSpace) -> tuple[list[float], list[float]]:
        """Return low and high of its rows for an angle [rad]."""
        if not self.is_within:
            return [0.0], [np.inf]
        if space.n_pointing == 1:
            return [-angle], [angle]
        reach = angle * float(np.cos(np.pi / (2 * SIDES)))
        return [-reach] * SIDES, [reach] * SIDES

    def rows(self, line: ca.SX, angle: ca.SX, space: ConfigurationSpace) -> list[ca.SX]:
        """Return the rows [rad] that keep the axis inside or outside the cone while they are within `bounds`.

        Outside it is one row, a smooth function of the angle between axis and line. Inside the rows are linear in the
        rotation that brings the axis onto the line, since a row in the angle itself has a kink at 0, where cameras
        look. In the plane that rotation is one number. In space it is a vector of two, whose length has to be at most
        `angle`: that circle is replaced by a polygon inside it, with one row for each pair of opposite sides.

        Args:
            line: Unit direction (dimension,) of the point or direction that the cone is about, in a frame whose x-axis
                is the axis.
            angle: Half the opening of the cone [rad].
            space: Configuration space of the robot.
        """
        if not self.is_within:
            return [_outside(line, angle)]
        rotation = space.pointing_error(line, ca.SX(space.neutral[space.base_coordinates]))
        if space.n_pointing == 1:
            return [rotation]
        normal_angles = [i * np.pi / SIDES for i in range(SIDES)]
        return [np.cos(normal) * rotation[0] + np.sin(normal) * rotation[1] for normal in normal_angles]


def cone_limits(task: TaskSpec, model: RobotModel, stage: int) -> dict[str, ConstraintNumbers]:
    """Return the cones of a stage by their numbers: the pose of the axis, what it is about, and the angle of each."""
    by_name = dict[str, ConstraintNumbers]()
    for number, spec in enumerate(task.stages[stage].cones):
        is_within, axis, angle = _narrowed(spec)
        cone = Cone(spec.frame, spec.of.point is not None, is_within, not spec.hard)
        low, high = cone.bounds(angle, model.space)
        by_name[str(number)] = ConstraintNumbers(
            structure=cone,
            argument=np.concatenate([_pose_of_axis(spec, axis, model.space), _point_or_direction(spec), [angle]]),
            low=np.array(low),
            high=np.array(high),
        )
    return by_name


def _narrowed(spec: ConeSpec) -> tuple[bool, np.ndarray, float]:
    """Return whether the axis stays within a cone, the unit axis (dimension,), and the angle [rad], at most pi / 2.

    Within an angle beyond 90 deg is outside of the rest to 180 deg about the opposite axis.
    """
    axis = np.array(spec.axis) / np.linalg.norm(spec.axis)
    is_within = spec.within is not None
    if spec.angle > np.pi / 2:
        return not is_within, -axis, np.pi - spec.angle
    return is_within, axis, spec.angle


def _pose_of_axis(spec: ConeSpec, axis: np.ndarray, space: ConfigurationSpace) -> np.ndarray:
    """Return the pose (n_pose,) of a frame whose x-axis is the axis (dimension,), in the frame that it is fixed to."""
    x, y, z = [*axis, 0.0][:3]
    # the shortest rotation from (1, 0, 0) to (x, y, z); half a turn about z where that is opposite
    turned = np.array([1 + x, 0.0, -z, y]) if x > -1 + 1e-12 else np.array([0.0, 0.0, 0.0, 1.0])
    apex = [*(spec.apex or np.zeros(space.dimension)), 0.0][:3]
    return space.from_3d(np.array(apex), turned / np.linalg.norm(turned))


def angle_of_axis(spec: ConeSpec, pose: np.ndarray, space: ConfigurationSpace) -> float:
    """Return the angle between the axis of a cone, on a frame at a pose (n_pose,), and what it is about [rad]."""
    position, quaternion = space.to_3d(pose)
    axis = rotate(quaternion, [*spec.axis, 0.0][:3])
    apex = add(position, rotate(quaternion, [*(spec.apex or np.zeros(space.dimension)), 0.0][:3]))
    line = [*_point_or_direction(spec), 0.0][:3]
    if spec.of.point is not None:
        line = add(line, scaled(apex, -1))
    return float(np.arctan2(np.linalg.norm(cross(axis, line)), dot(axis, line)))


def _point_or_direction(spec: ConeSpec) -> np.ndarray:
    """Return the point of a cone [m], or its unit direction, (dimension,)."""
    if spec.of.point is not None:
        return np.array(spec.of.point)
    direction = np.array(spec.of.direction)
    return np.asarray(direction / np.linalg.norm(direction))


def cone_rows(model: RobotModel, cone: Cone) -> ConstraintFunctions:
    """Return the rows of a cone constraint as functions of x and of [anchor; pose of the axis; target; angle].

    The axis of the cone, that of a camera for example, is the x-axis of a pose that is fixed to a frame of the robot.
    The target, a point or a direction in the inertial frame, has to stay inside or outside the cone about the axis. All
    that rows depend on is the direction of the target from the apex, the origin of that pose, in the frame of the axis.

    Args:
        model: The robot.
        cone: The frame to which the axis is fixed, whether the target is a point, and on which side it stays.

    Returns:
        The rows in rad, see `Cone.rows`, with bounds as in `Cone.bounds`.
    """
    space = model.space
    d = space.dimension
    x = ca.SX.sym("x", 2 * model.n)
    anchor = ca.SX.sym("anchor", space.n_anchor)  # attitude about which the coordinates in x are a chart
    axis_pose = ca.SX.sym("axis_pose", space.n_pose)
    target = ca.SX.sym("target", d)
    angle = ca.SX.sym("angle")
    xi = model.charted(x[: model.n], anchor)
    frame_position, frame_attitude = space.to_3d(ca.vertsplit(xi[model.pose_rows[cone.frame]]))
    position_in_frame, attitude_in_frame = space.to_3d(ca.vertsplit(axis_pose))
    line = [*ca.vertsplit(target), ca.SX(0)][:3]  # in 3-D, z = 0 for a planar robot
    if cone.has_point:
        apex = add(frame_position, rotate(frame_attitude, position_in_frame))
        line = add(line, scaled(apex, -1))
    along_axis, *across = rotate(conjugate(product(frame_attitude, attitude_in_frame)), line)
    # A point at the apex has no direction: it is taken to be a little further along the axis.
    line_in_axis_frame = ca.vertcat(along_axis + NEAREST * cone.has_point, *across)[:d]
    rows = cone.rows(line_in_axis_frame / ca.norm_2(line_in_axis_frame), angle, space)
    return ConstraintFunctions(x, ca.vertcat(anchor, axis_pose, target, angle), ca.vertcat(*rows))


def _outside(line: ca.SX, angle: ca.SX) -> ca.SX:
    """Return the row of an axis outside a cone, see above, of a unit line as `Cone.rows` has it."""
    chord = line - ca.vertcat(1, ca.SX.zeros(line.numel() - 1))
    limit = 2 * ca.sin(angle / 2)
    slope = np.sqrt(5 / 4) / ca.cos(angle / 2)
    return ca.SX(slope * (ca.sqrt(ca.sumsqr(chord) + limit**2 / 4) - np.sqrt(5 / 4) * limit))


def _is_soft(cone: Cone) -> bool:
    return cone.soft


CONSTRAINT = Constraint(rows_at_nodes("cones", cone_rows, _is_soft), cone_limits)
