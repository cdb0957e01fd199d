"""The joint-space skill: base pose and joint angles. Paper eq. (30)."""

import casadi as ca

from psmpc_cli.ocp.skills.base import Skill
from psmpc_cli.robot.model import RobotModel


def rows(model: RobotModel) -> int:
    """Return the number of rows of the error, n."""
    return model.n


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return Q - Q_d (n,) [m, rad]."""
    return Q - target


def rate(model: RobotModel, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
    """Return Qdot (n,) [m/s, rad/s]."""
    return Qdot


SKILL = Skill("joint", rows, error, rate)
