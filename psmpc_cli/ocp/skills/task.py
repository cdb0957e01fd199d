"""The task-space skill: base pose to keep and end-effector poses to reach. Paper eq. (31)."""

import casadi as ca

from psmpc_cli.ocp.skills.base import Skill
from psmpc_cli.robot.model import RobotModel


def rows(model: RobotModel) -> int:
    """Return the number of rows of the error, m."""
    return model.m


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return xi - xi_d (m,) [m, rad]."""
    return model.g(Q) - target


def rate(model: RobotModel, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """Return J_C Qdot (m,) [m/s, rad/s]. Paper eq. (2)."""
    return model.J_C(Q) @ Qdot


SKILL = Skill("task", rows, error, rate)
