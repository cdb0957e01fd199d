"""The interface of a skill: its residual against a target, and what a target's numbers mean."""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True, eq=False)
class Posture:
    """Where a sequence of stages leads to, stage by stage: Q (n,) and poses xi (m,), as far as targets determine them.

    A target in one of the two leaves the joints of the other as they were, so that xi need not be g(Q).
    """

    Q: np.ndarray
    xi: np.ndarray


@dataclass(frozen=True)
class Skill:
    """One kind of skill. Its names of coordinates are those of `specs.parts`.

    Attributes:
        rows: Number of rows of the error.
        numbers: Number of numbers of a target.
        error: Error (rows,) at Q (n,) against a target (numbers,); units of the coordinates.
        angles: Numbers of a target that are angles, of which the nearest equivalent is meant.
        before: The numbers of a target that describe a posture; only those of `angles` are used.
        after: The posture to which a target leads.
        aims: Positions (frames, dimension) [m] of base and end-effectors, or of their points, that a target is about.
        absent: The numbers of a part that the target leaves out, whose weights are then 0; NaN where all are required.
    """

    rows: Callable[[RobotModel], int]
    numbers: Callable[[RobotModel], int]
    error: Callable[[RobotModel, ca.SX, ca.SX], ca.SX]
    angles: Callable[[RobotModel], tuple[int, ...]]
    before: Callable[[RobotModel, Posture], np.ndarray]
    after: Callable[[RobotModel, Posture, np.ndarray], Posture]
    aims: Callable[[RobotModel, np.ndarray], np.ndarray]
    absent: float = np.nan
