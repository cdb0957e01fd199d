"""The task-space skill: base pose to keep and end-effector poses to reach. Paper eq. (31).

In space, joints that the poses leave free (an arm of seven) are drawn to where they are: rows q - q_measured, without
which they would drift.
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import Posture, Skill, anchored_poses
from psmpc_cli.robot.model import RobotModel


def error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return xi - xi_d (m,) [m, rad]; in space position and rotation vector of each frame, then of the posture."""
    xi = anchored_poses(model, Q, target)
    errors = (model.space.residual(xi[rows], target[rows]) for rows in model.pose_rows.values())
    posture = model.space.n_posture
    return ca.vertcat(*errors, Q[model.n - posture :] - target[target.numel() - posture :])


def after(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture with poses xi_d; its joints are as before."""
    base = model.pose_rows["base"]
    return Posture(np.r_[target[base], posture.Q[base.stop :]], target)


def aims(model: RobotModel, target: np.ndarray) -> np.ndarray:
    """Return the positions of base and end-effectors in xi_d (frames, dimension) [m]."""
    return target[: model.m].reshape(len(model.pose_rows), -1)[:, : model.dimension]


SKILL = Skill(
    rows=lambda model: model.space.n_twist * len(model.pose_rows) + model.space.n_posture,
    numbers=lambda model: model.m,
    error=error,
    after=after,
    aims=aims,
    poses=True,
)
