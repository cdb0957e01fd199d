"""Arms wanted at joint coordinates. Paper eq. (30)."""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import PartKind, Posture, joints_of
from psmpc_cli.robot.model import RobotModel


class Joints(PartKind):
    """Joint coordinates of an arm."""

    is_joints = True

    def error(self, model: RobotModel, part: str, Q: ca.SX, xi: ca.SX, wanted: ca.SX) -> ca.SX:
        """Return q - q_d (joints,) [rad, m]."""
        return Q[model.parts[part]] - wanted

    def numbers_at(self, model: RobotModel, part: str, posture: Posture) -> np.ndarray:
        """Return the joint coordinates."""
        return posture.Q[joints_of(model, part)]

    def aim(self, model: RobotModel, part: str, Q: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Return the position of the end-effector with the joints and the base at their targets [m]."""
        return np.asarray(model.poses(Q)[list(model.pose_rows).index(part)][: model.dimension])


KIND = Joints()
