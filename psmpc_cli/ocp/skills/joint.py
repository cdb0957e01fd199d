"""The joint-space skill: base pose and joint angles. Paper eq. (30)."""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import Posture, Skill, anchored_poses
from psmpc_cli.robot.model import RobotModel


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return Q - Q_d (n,) [m, rad]; in space with the rotation vector from the wanted attitude."""
    space = model.space
    base = model.pose_rows["base"]
    of_base = space.residual(anchored_poses(model, Q, target)[base], target[base])
    return ca.vertcat(of_base, Q[space.joint_rates] - target[space.joint_coordinates])


def after(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture Q_d, and its poses."""
    return Posture(target, np.asarray(model.g(target)).ravel())


def aims(model: RobotModel, target: np.ndarray) -> np.ndarray:
    """Return the positions of base and end-effectors at Q_d (frames, dimension) [m]."""
    return model.poses(target[: model.nq])[:, : model.dimension]


SKILL = Skill(
    rows=lambda model: model.n,
    numbers=lambda model: model.nq,
    error=error,
    after=after,
    aims=aims,
)
