"""The task-space skill: base pose to keep and end-effector poses to reach. Paper eq. (31)."""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import Posture, Skill
from psmpc_cli.robot.model import RobotModel, angle_rows


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return xi - xi_d (m,) [m, rad]."""
    return model.g(Q) - target


def after(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture with poses xi_d; its joints are as before."""
    base = model.pose_rows["base"]
    return Posture(np.r_[target[base], posture.Q[model.parts["base"].stop :]], target)


def aims(model: RobotModel, target: np.ndarray) -> np.ndarray:
    """Return the positions of base and end-effectors in xi_d (frames, dimension) [m]."""
    return target.reshape(len(model.pose_rows), -1)[:, : model.dimension]


SKILL = Skill(
    rows=lambda model: model.m,
    numbers=lambda model: model.m,
    error=error,
    angles=lambda model: angle_rows(model).xi,
    before=lambda model, posture: posture.xi,
    after=after,
    aims=aims,
)
