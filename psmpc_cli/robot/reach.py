"""Whether an arm can reach a pose from a given base pose within its joint limits: planar inverse kinematics."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from psmpc_cli.errors import InputError
from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.robot.bodies import PlanarFrame, place_arm
from psmpc_cli.specs.robot import Arm, RobotSpec

Array = NDArray[np.float64]

TOLERANCE = 1e-3
"""Largest error of a reached pose [m, rad]: targets are written with a few digits."""

STARTS, SEED = 48, 0
"""Number of starts of the search, and the seed of the random ones."""


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
        reachable: Whether a configuration within the joint limits takes the pose, its angle modulo 2 pi. Without
            `within_annulus` there is none; otherwise it is searched for: True is certain, False is not.
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
    """Compute whether `arm` reaches `pose` with the base at `base_pose`.

    Args:
        robot: The robot, with position limits of the arm.
        arm: Name of the arm.
        base_pose: (x, y, angle), (3,) [m, m, rad].
        pose: Of the end-effector, (x, y, angle), (3,) [m, m, rad].

    Raises:
        InputError: The robot has no such arm, or a pose has not three numbers.
    """
    if arm not in robot.arms:
        raise InputError(f"robot '{robot.name}' has no arm '{arm}'; it has {', '.join(robot.arms)}")
    part, base, target = robot.arms[arm], _pose("base_pose", base_pose), _pose("pose", pose)
    lengths = np.array([link.a + link.b for link in part.links])
    inner, outer = _annulus(lengths[:-1])
    shoulder = PlanarFrame(ca.DM(base[:2]), base[2]).moved(*part.mount.position).position
    tip = PlanarFrame(ca.DM(target[:2]), target[2] - part.tool.angle)
    wrist_distance = float(ca.norm_2(tip.moved(-lengths[-1]).position - shoulder))
    within = inner - TOLERANCE <= wrist_distance <= outer + TOLERANCE
    q = _configuration(part, base, target, *_joint_limits(robot, arm)) if within else None
    return Reach(
        distance=float(ca.norm_2(tip.position - shoulder)),
        wrist_distance=wrist_distance,
        inner=inner,
        outer=outer,
        full_reach=float(lengths.sum()),
        within_annulus=within,
        reachable=q is not None,
        configuration=None if q is None else tuple(q.tolist()),
    )


def _annulus(lengths: Array) -> tuple[float, float]:
    """Return the least and largest distance [m] that links of these lengths, freely jointed, span."""
    if not lengths.size:
        return 0.0, 0.0
    return max(0.0, float(2 * lengths.max() - lengths.sum())), float(lengths.sum())


def _configuration(arm: Arm, base: Array, pose: Array, low: Array, high: Array) -> Array | None:
    """Search for joint angles (links,) [rad] within the limits that take a pose, starting near zero; None if not found.

    Bounded least squares on the error of the pose, from several starts. Paper eq. (1).
    """
    q = ca.SX.sym("q", len(arm.links))
    xi = place_arm(arm, PlanarFrame(ca.SX(base[:2]), ca.SX(base[2])), q).frames["tool"].pose()
    evaluate = ArrayFunction(ca.Function("tip", [q], [xi, ca.densify(ca.jacobian(xi, q))]))

    def error(q: Array) -> Array:
        missed: Array = evaluate(q)[0][0] - pose
        missed[2] -= 2 * np.pi * np.round(missed[2] / (2 * np.pi))
        return missed

    def slope(q: Array) -> Array:
        return evaluate(q)[1].T

    bounds = low, np.maximum(high, low + 1e-9)  # least_squares needs room between them
    for start in _starts(low, high):
        found = least_squares(error, start, slope, bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100)
        angles = _nearest_zero(found.x, low, high)
        missed = error(angles)
        if np.hypot(*missed[:2]) <= TOLERANCE and abs(missed[2]) <= TOLERANCE:
            return angles
    return None


def _starts(low: Array, high: Array) -> Iterator[Array]:
    """Give the joint angles nearest to zero, then random ones within one turn of each joint."""
    yield np.clip(0.0, low, high)
    random = np.random.default_rng(SEED)
    first = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2 * np.pi, -np.pi))
    for _ in range(STARTS - 1):
        yield random.uniform(first, np.minimum(high, first + 2 * np.pi))


def _nearest_zero(q: Array, low: Array, high: Array) -> Array:
    """Return the equivalent of each angle (links,) that is nearest to zero within its limits."""
    q = np.clip(q, low, high)
    turned = q - 2 * np.pi * np.round(q / (2 * np.pi))
    return np.where((turned >= low) & (turned <= high), turned, q)


def _pose(name: str, values: Sequence[float]) -> Array:
    """Return three numbers as an array."""
    pose = np.asarray(values, dtype=float)
    if pose.shape != (3,):
        raise InputError(f"{name} is {list(values)}, but three numbers (x, y, angle) are expected")
    return pose


def _joint_limits(robot: RobotSpec, arm: str) -> tuple[Array, Array]:
    """Return the lowest and highest joint angles of an arm, (links,) [rad] each; infinite where there are none."""
    own, all_arms = robot.limits.get(arm), robot.limits.get("arms")
    position = (own and own.position) or (all_arms and all_arms.position)
    if not position:
        return np.full(len(robot.arms[arm].links), -np.inf), np.full(len(robot.arms[arm].links), np.inf)
    low, high = np.array(position, dtype=float).T
    return low, high
