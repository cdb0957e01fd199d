"""Whether an arm can reach a pose from a given base pose, joint limits included."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.errors import InputError
from psmpc_cli.robot.inverse import Chain, annulus, configuration, wrist_of
from psmpc_cli.specs.robot import Arm, RobotSpec

Array = NDArray[np.float64]

TOLERANCE = 1e-3
"""By how much a reachable pose may be missed [m, rad]: targets are written with a few digits."""


@dataclass(frozen=True)
class Reach:
    """How far an end-effector pose is from an arm's shoulder, and how far the arm goes.

    Attributes:
        distance: Shoulder to end-effector [m].
        wrist_distance: Shoulder to the last joint as the full pose places it [m].
        inner: Least distance from the shoulder that the links before the last can bring the last joint to [m].
        outer: Largest such distance [m].
        full_reach: Length of the stretched arm [m].
        within_annulus: Whether the last joint lies between `inner` and `outer`: reachable but for joint limits.
        reachable: Whether some configuration within the joint limits takes the pose, its angle modulo 2 pi. With more
            than three links it is searched for: True is certain, False is not.
        configuration: Such joint angles (links,) [rad]; None if not reachable.
    """

    distance: float
    wrist_distance: float
    inner: float
    outer: float
    full_reach: float
    within_annulus: bool
    reachable: bool
    configuration: tuple[float, ...] | None


def reach_of(robot: RobotSpec, arm: str, base_pose: Sequence[float], pose: Sequence[float]) -> Reach:
    """Find out whether `arm` reaches `pose` with the base at `base_pose`.

    Args:
        robot: The robot, whose position limits of the arm count.
        arm: Name of the arm.
        base_pose: (x, y, angle), (3,) [m, m, rad].
        pose: Of the end-effector, (x, y, angle), (3,) [m, m, rad].

    Raises:
        InputError: The robot has no such arm, or a pose has not three numbers.
    """
    part = _arm(robot, arm)
    lengths = np.array([link.a + link.b for link in part.links])
    tip = _in_shoulder_frame(part, _pose("base_pose", base_pose), _pose("pose", pose))
    inner, outer = annulus(lengths[:-1])
    wrist_distance = float(np.hypot(*wrist_of(lengths, tip)))
    within = inner - TOLERANCE <= wrist_distance <= outer + TOLERANCE
    q = configuration(Chain(lengths, *_joint_limits(robot, arm)), tip, TOLERANCE) if within else None
    return Reach(
        distance=float(np.hypot(*tip[:2])),
        wrist_distance=wrist_distance,
        inner=inner,
        outer=outer,
        full_reach=float(lengths.sum()),
        within_annulus=within,
        reachable=q is not None,
        configuration=None if q is None else tuple(q.tolist()),
    )


def _in_shoulder_frame(arm: Arm, base: Array, pose: Array) -> Array:
    """Pose of the last link's end, seen from the shoulder, (3,) [m, m, rad]."""
    heading = base[2] + arm.mount.angle
    offset = pose[:2] - base[:2] - _rotation(base[2]) @ np.array(arm.mount.position)
    return np.array([*(_rotation(heading).T @ offset), pose[2] - arm.tool.angle - heading])


def _rotation(angle: float) -> Array:
    """Of a frame at `angle` [rad], (2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _arm(robot: RobotSpec, name: str) -> Arm:
    """The arm of that name."""
    if name not in robot.arms:
        raise InputError(f"robot '{robot.name}' has no arm '{name}'; it has {', '.join(robot.arms)}")
    return robot.arms[name]


def _pose(name: str, values: Sequence[float]) -> Array:
    """Three numbers."""
    pose = np.asarray(values, dtype=float)
    if pose.shape != (3,):
        raise InputError(f"{name} is {list(values)}, but three numbers (x, y, angle) are expected")
    return pose


def _joint_limits(robot: RobotSpec, arm: str) -> tuple[Array, Array]:
    """Lowest and highest joint angles of an arm, (links,) [rad] each; infinite where there are none."""
    own, all_arms = robot.limits.get(arm), robot.limits.get("arms")
    position = (own and own.position) or (all_arms and all_arms.position)
    if not position:
        return np.full(len(robot.arms[arm].links), -np.inf), np.full(len(robot.arms[arm].links), np.inf)
    low, high = np.array(position, dtype=float).T
    return low, high
