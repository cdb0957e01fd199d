"""The interface of a skill: its residual against a target, and what a target's numbers mean.

The numbers of a spatial target are followed by those that every sample sets: the anchor (4,) of the chart, and the
posture (joints,) that redundant joints are drawn to. See `Stage.in_chart`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class Posture:
    """Where a sequence of stages leads to, stage by stage: Q (nq,) and poses xi (m,), as far as targets determine them.

    A target in one of the two leaves the joints of the other as they were, so that xi need not be g(Q).
    """

    Q: np.ndarray
    xi: np.ndarray


@dataclass(frozen=True)
class Skill:
    """One kind of skill. Its names of coordinates are those of `specs.parts`.

    Attributes:
        rows: Number of rows of the error.
        numbers: Number of numbers of a target in a task file.
        error: Error (rows,) at Q (n,) in the chart against a target; units of the coordinates.
        after: The posture to which a target leads.
        aims: Positions (frames, dimension) [m] of base and end-effectors, or of their points, that a target is about.
        poses: Whether a target begins with the poses of all frames; if not, with that of the base alone.
        points: Whether the numbers of an arm's target are a point that it points at.
        absent: The numbers of a part that the target leaves out, whose weights are then 0; NaN where all are required.
    """

    rows: Callable[[RobotModel], int]
    numbers: Callable[[RobotModel], int]
    error: Callable[[RobotModel, ca.SX, ca.SX], ca.SX]
    after: Callable[[RobotModel, Posture, np.ndarray], Posture]
    aims: Callable[[RobotModel, np.ndarray], np.ndarray]
    poses: bool = False
    points: bool = False
    absent: float = np.nan

    def angles(self, model: RobotModel) -> list[int]:
        """Return the numbers of a planar target that are angles of frames, of which the nearest equivalent is meant."""
        return [rows.start + row for rows in self._poses(model).values() for row in model.space.pose_angles]

    def attitudes(self, model: RobotModel) -> dict[str, int]:
        """Return the first numbers of the quaternions of a spatial target, by frame."""
        if not model.space.turns_freely:
            return {}
        return {frame: rows.start + model.space.attitude.start for frame, rows in self._poses(model).items()}

    def _poses(self, model: RobotModel) -> dict[str, slice]:
        return model.pose_rows if self.poses else {"base": model.pose_rows["base"]}


def anchored_poses(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return the poses xi (m,) of a robot at Q (n,) in the chart whose anchor a target has."""
    first = target.numel() - model.space.n_sample_numbers
    return model.charted(Q, target[first : first + model.space.n_anchor])
