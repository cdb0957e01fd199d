"""The pointing skill: base pose to keep, and each end-effector's x-axis through a point, at any distance from it.

In the plane a row of an arm is the angle from the line to the point to the axis, by atan2 of cross and dot product:
smooth but where the axis points exactly away from the point. In space its rows are the rotation vector from the axis to
the line, whose length is that angle; where the axis points exactly away it turns about the frame's y-axis.
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import Posture, Skill, anchored_poses, pose_error
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import conjugate, log, rotate

TILT = 1e-3
"""Angle by which a line exactly behind is taken to lie off [rad], so that there is an axis to turn about; 0 ahead."""

FAR = 1e3
"""Coordinates of the point of an arm that need not point at anything [m]: the row stays smooth, and has no weight."""


def rows(model: RobotModel) -> int:
    """Return the number of rows of the error: the base's pose, and an angle for each arm, or two in space."""
    return 3 + _arms(model) if model.dimension == 2 else 6 + 2 * _arms(model)


def numbers(model: RobotModel) -> int:
    """Return the number of numbers of a target: the base's pose, and a point for each arm."""
    return int(model.pose_rows["base"].stop) + model.dimension * _arms(model)


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return the error of the base's pose [m, rad], then the angles of each end-effector's x-axis [rad]."""
    planar = model.dimension == 2
    base = model.pose_rows["base"]
    d = model.dimension
    xi = model.g(Q) if planar else anchored_poses(model, Q, target)
    found = [xi[base] - target[base] if planar else pose_error(xi[base], target[base])]
    first = base.stop
    for frame in list(model.pose_rows.values())[1:]:
        line = target[first : first + d] - xi[frame][:d]
        pose = xi[frame]
        found.append(_angle(line, pose[2]) if planar else _angles(line, pose[3:]))
        first += d
    return ca.vertcat(*found)


def _angle(line: ca.SX, angle: ca.SX) -> ca.SX:
    """Return the angle from a line (2,) to the axis at an angle [rad]."""
    axis = ca.vertcat(ca.cos(angle), ca.sin(angle))
    return ca.SX(ca.atan2(line[0] * axis[1] - line[1] * axis[0], ca.dot(line, axis)))


def _angles(line: ca.SX, attitude: ca.SX) -> ca.SX:
    """Return the turns (2,) [rad] about the frame's y- and z-axis that would bring its x-axis to a line (3,)."""
    x, y, z = rotate(conjugate([attitude[i] for i in range(4)]), [line[i] for i in range(3)])
    z += TILT / 2 * (ca.norm_2(line) - x)
    # the shortest rotation from (1, 0, 0) to (x, y, z) has the quaternion (|(x, y, z)| + x, 0, -z, y)
    turn = log([ca.norm_2(ca.vertcat(x, y, z)) + x, 0.0, -z, y])
    return ca.SX(ca.vertcat(turn[1], turn[2]))


def after(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture with the base at its target; its joints are as before."""
    base = model.pose_rows["base"]
    Q = np.r_[target[base], posture.Q[base.stop :]]
    return Posture(Q, np.asarray(model.g(Q)).ravel())


def aims(model: RobotModel, target: np.ndarray) -> np.ndarray:
    """Return the position of the base and the points (frames, dimension) [m]; NaN of an arm without one."""
    base = model.pose_rows["base"]
    d = model.dimension
    found = np.vstack([target[base][:d], target[base.stop : numbers(model)].reshape(-1, d)])
    return np.where(found == FAR, np.nan, found)


def _arms(model: RobotModel) -> int:
    return len(model.pose_rows) - 1


SKILL = Skill(
    rows=rows,
    numbers=numbers,
    error=error,
    after=after,
    aims=aims,
    absent=FAR,
)
