"""The pointing skill: base pose to keep, and each end-effector's x-axis through a point, at any distance from it.

A row of an arm is the angle from the line to the point to the axis, by atan2 of their cross and dot product: smooth but
where the axis points exactly away from the point.
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import Posture, Skill
from psmpc_cli.robot.model import RobotModel

FAR = 1e3
"""Coordinates of the point of an arm that need not point at anything [m]: the row stays smooth, and has no weight."""


def rows(model: RobotModel) -> int:
    """Return the number of rows of the error: the base's pose, and an angle for each arm."""
    return int(model.pose_rows["base"].stop) + _arms(model)


def numbers(model: RobotModel) -> int:
    """Return the number of numbers of a target: the base's pose, and a point for each arm."""
    return int(model.pose_rows["base"].stop) + model.dimension * _arms(model)


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return the error of the base's pose [m, rad], then the angle of each end-effector's x-axis [rad]."""
    xi, base = model.g(Q), model.pose_rows["base"]
    found, first = [xi[base] - target[base]], base.stop
    for frame in list(model.pose_rows.values())[1:]:
        pose, point = xi[frame], target[first : first + model.dimension]
        line, axis = point - pose[:2], ca.vertcat(ca.cos(pose[2]), ca.sin(pose[2]))
        cross, dot = line[0] * axis[1] - line[1] * axis[0], ca.dot(line, axis)
        found.append(ca.atan2(cross, dot))
        first += model.dimension
    return ca.vertcat(*found)


def after(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture with the base at its target; its joints are as before."""
    base = model.pose_rows["base"]
    Q = np.r_[target[base], posture.Q[model.parts["base"].stop :]]
    return Posture(Q, np.asarray(model.g(Q)).ravel())


def aims(model: RobotModel, target: np.ndarray) -> np.ndarray:
    """Return the position of the base and the points (frames, dimension) [m]; NaN of an arm without one."""
    base, d = model.pose_rows["base"], model.dimension
    found = np.vstack([target[base][:d], target[base.stop :].reshape(-1, d)])
    return np.where(found == FAR, np.nan, found)


def _arms(model: RobotModel) -> int:
    return len(model.pose_rows) - 1


SKILL = Skill(
    rows=rows,
    numbers=numbers,
    error=error,
    angles=lambda model: tuple(range(model.dimension, model.pose_rows["base"].stop)),
    before=lambda model, posture: posture.xi,
    after=after,
    aims=aims,
    absent=FAR,
)
