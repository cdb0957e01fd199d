"""The pointing skill: base pose to keep, and each end-effector's x-axis through a point, at any distance from it.

In the plane a row of an arm is the angle from the line to the point to the axis, by atan2 of cross and dot product:
smooth but where the axis points exactly away from the point. In space its rows are the rotation vector from the axis to
the line, whose length is that angle; where the axis points exactly away it turns about the frame's y-axis.
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import Posture, Skill, anchored_poses
from psmpc_cli.robot.model import RobotModel

FAR = 1e3
"""Coordinates of the point of an arm that need not point at anything [m]: the row stays smooth, and has no weight."""


def rows(model: RobotModel) -> int:
    """Return the number of rows of the error: the base's pose, and an angle for each arm, or two in space."""
    return model.space.n_twist + model.space.n_pointing * _arms(model)


def numbers(model: RobotModel) -> int:
    """Return the number of numbers of a target: the base's pose, and a point for each arm."""
    return int(model.pose_rows["base"].stop) + model.dimension * _arms(model)


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return the error of the base's pose [m, rad], then the angles of each end-effector's x-axis [rad]."""
    space = model.space
    base = model.pose_rows["base"]
    xi = anchored_poses(model, Q, target)
    found = [space.residual(xi[base], target[base])]
    first = base.stop
    for frame in list(model.pose_rows.values())[1:]:
        pose = xi[frame]
        line = target[first : first + space.dimension] - pose[: space.dimension]
        found.append(space.pointing_error(line, pose))
        first += space.dimension
    return ca.vertcat(*found)


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
    points=True,
    absent=FAR,
)
