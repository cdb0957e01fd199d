"""The skills: what each one's residual against a target is, and what a target's numbers mean.

A new skill is one entry of `SKILLS`. Its names of coordinates are those of `specs.coordinates`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.robot.model import RobotModel, angle_rows

FAR = 1e3
"""Coordinates of the point of an arm that need not point at anything [m]: the row stays smooth, and has no weight."""


@dataclass(frozen=True, eq=False)
class Posture:
    """Where a sequence of stages leads to, stage by stage: Q (n,) and poses xi (m,), as far as targets determine them.

    A target in one of the two leaves the joints of the other as they were, so that xi need not be g(Q).
    """

    Q: np.ndarray
    xi: np.ndarray


@dataclass(frozen=True)
class Skill:
    """One kind of skill.

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


def _at_configuration(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture Q_d, and its poses."""
    return Posture(target, np.asarray(model.g(target)).ravel())


def _at_poses(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture with poses xi_d; its joints are as before."""
    return Posture(np.r_[target[model.pose_rows["base"]], posture.Q[model.parts["base"].stop :]], target)


def _pointing_error(model: RobotModel, Q: ca.SX, target: ca.SX) -> ca.SX:
    """Return the error of the base's pose [m, rad], then the angle of each end-effector's x-axis [rad].

    It is the angle from the line to the point to the axis, by atan2 of their cross and dot product: smooth but where
    the axis points exactly away from the point.
    """
    xi, base = model.g(Q), model.pose_rows["base"]
    found, first = [xi[base] - target[base]], base.stop
    for frame in list(model.pose_rows.values())[1:]:
        pose, point = xi[frame], target[first : first + model.dimension]
        line, axis = point - pose[:2], ca.vertcat(ca.cos(pose[2]), ca.sin(pose[2]))
        cross, dot = line[0] * axis[1] - line[1] * axis[0], ca.dot(line, axis)
        found.append(ca.atan2(cross, dot))
        first += model.dimension
    return ca.vertcat(*found)


def _with_base(model: RobotModel, posture: Posture, target: np.ndarray) -> Posture:
    """Return the posture with the base at its target; its joints are as before."""
    Q = np.r_[target[model.pose_rows["base"]], posture.Q[model.parts["base"].stop :]]
    return _at_configuration(model, posture, Q)


def _base_and_points(model: RobotModel, target: np.ndarray) -> np.ndarray:
    """Return the position of the base and the points (frames, dimension) [m]; NaN of an arm without one."""
    base, d = model.pose_rows["base"], model.dimension
    found = np.vstack([target[base][:d], target[base.stop :].reshape(-1, d)])
    return np.where(found == FAR, np.nan, found)


SKILLS: dict[str, Skill] = {
    # Base pose and joint angles. Paper eq. (30).
    "joint": Skill(
        rows=lambda model: model.n,
        numbers=lambda model: model.n,
        error=lambda model, Q, target: Q - target,
        angles=lambda model: angle_rows(model).Q,
        before=lambda model, posture: posture.Q,
        after=_at_configuration,
        aims=lambda model, target: model.poses(target)[:, : model.dimension],
    ),
    # Base pose to keep and end-effector poses to reach. Paper eq. (31).
    "task": Skill(
        rows=lambda model: model.m,
        numbers=lambda model: model.m,
        error=lambda model, Q, target: model.g(Q) - target,
        angles=lambda model: angle_rows(model).xi,
        before=lambda model, posture: posture.xi,
        after=_at_poses,
        aims=lambda model, target: target.reshape(len(model.pose_rows), -1)[:, : model.dimension],
    ),
    # Base pose to keep, and each end-effector's x-axis through a point, at any distance from it.
    "point": Skill(
        rows=lambda model: model.pose_rows["base"].stop + len(model.pose_rows) - 1,
        numbers=lambda model: model.pose_rows["base"].stop + model.dimension * (len(model.pose_rows) - 1),
        error=_pointing_error,
        angles=lambda model: tuple(range(model.dimension, model.pose_rows["base"].stop)),
        before=lambda model, posture: posture.xi,
        after=_with_base,
        aims=_base_and_points,
        absent=FAR,
    ),
}
"""The skills by their name in a task file (`space:`)."""
