"""End-effectors wanted at poses, as the base is in every skill. Paper eq. (31).

In space, joints that the poses leave free (an arm of seven) are drawn to where they are: rows q - q_measured, without
which they would drift.
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import PartKind, Posture
from psmpc_cli.robot.model import RobotModel


class BasePose(PartKind):
    """A pose of the base."""

    is_pose = True

    def error(self, model: RobotModel, part: str, Q: ca.SX, xi: ca.SX, wanted: ca.SX) -> ca.SX:
        """Return the error of the pose [m, rad]; in space position and the rotation vector from the wanted attitude."""
        return ca.SX(model.space.residual(xi[model.pose_rows[part]], wanted))

    def numbers_at(self, model: RobotModel, part: str, posture: Posture) -> np.ndarray:
        """Return the pose."""
        return posture.xi[model.pose_rows[part]]

    def aim(self, model: RobotModel, part: str, Q: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Return the position of the wanted pose [m]."""
        return wanted[: model.dimension]


class EndEffectorPose(BasePose):
    """A pose of an end-effector."""

    draws_joints = True


KIND = EndEffectorPose()
