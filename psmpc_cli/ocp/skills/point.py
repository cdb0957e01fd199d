"""Each end-effector's x-axis wanted through a point, at any distance from it.

In the plane a row of an arm is the angle from the line to the point to the axis, by atan2 of cross and dot product:
smooth but where the axis points exactly away from the point. In space its rows are the rotation vector from the axis to
the line, whose length is that angle; where the axis points exactly away it turns about the frame's y-axis.
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.skills.base import PartKind, Posture
from psmpc_cli.robot.model import RobotModel

FAR = 1e3
"""Coordinates of the point of an arm that need not point at anything [m]: the row stays smooth, and has no weight."""


class PointingAxis(PartKind):
    """A point that the x-axis of an end-effector goes through."""

    is_point = True
    absent = FAR

    def error(self, model: RobotModel, part: str, Q: ca.SX, xi: ca.SX, wanted: ca.SX) -> ca.SX:
        """Return the angles of the end-effector's x-axis to the line to the point [rad]."""
        pose = xi[model.pose_rows[part]]
        return ca.SX(model.space.pointing_error(wanted - pose[: model.dimension], pose))

    def numbers_at(self, model: RobotModel, part: str, posture: Posture) -> np.ndarray:
        """Return no point: every one on the axis would do."""
        return np.full(model.dimension, FAR)

    def aim(self, model: RobotModel, part: str, Q: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Return the point [m]; NaN of an arm without one."""
        return np.where(wanted == FAR, np.nan, wanted)


KIND = PointingAxis()
