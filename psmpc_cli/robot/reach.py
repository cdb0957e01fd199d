"""Whether an arm can reach a pose from a given base pose within its joint limits: inverse kinematics."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from psmpc_cli.errors import InputError
from psmpc_cli.native.functions import ArrayFunction
from psmpc_cli.robot.configuration import configuration_space
from psmpc_cli.robot.kinematics import SpatialFrame, place
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import add, conjugate, exp, log, product, rotate, scaled, shorter
from psmpc_cli.specs.robots.robot import Limits, RobotSpec, limits_of_part

Array = NDArray[np.float64]

TOLERANCE = 1e-3
"""Largest error of a reached pose [m, rad]: targets are written with a few digits."""

PIECES = 10
"""Into how many pieces the way from a posture to a pose is divided."""

STARTS = 48
SEED = 0
"""Number of starts of the search, and the seed of the random ones."""


@dataclass(frozen=True)
class Reach:
    """How far an end-effector pose is from an arm's first joint, and how far the arm goes.

    Attributes:
        distance: First joint to end-effector [m].
        wrist_distance: First joint to the last joint as the full pose places it [m].
        inner: Least distance from the first joint that the links before the last can bring the last joint to [m].
        outer: Largest such distance [m].
        full_reach: Length of the stretched arm [m].
        within_annulus: Whether the last joint lies between `inner` and `outer`: reachable but for joint limits.
        reachable: Whether a configuration within the joint limits takes the pose, its angle modulo 2 pi. Without
            `within_annulus` there is none; otherwise it is searched for: True is certain, False is not.
        configuration: Such joint coordinates (links,) [rad, m]; None if not reachable.
        missed: By how much the nearest pose that was found misses it [m, rad]; infinite where none was looked for.
    """

    distance: float
    wrist_distance: float
    inner: float
    outer: float
    full_reach: float
    within_annulus: bool
    reachable: bool
    configuration: tuple[float, ...] | None
    missed: tuple[float, float]


def furthest_centre(robot: RobotSpec, limits: Limits) -> float:
    """Return an upper bound of the distance [m] between the base's origin and the robot's common centre of mass.

    The centre of mass of a floating robot at rest stays where it is, so this says how far its base can move. With the
    mass M of the robot, and mu_j that of all bodies which joint j carries, body i adds a vector that is fixed in it,

        s_i = (m_i c_i + sum over the joints j on body i of mu_j p_j) / M,

    with the mass m_i and centre c_i of the body, and the place p_j of the joint. So the distance is at most the sum of
    all |s_i|, plus mu_j / M times how far each joint j slides. It is the length of the virtual manipulator: Vafa,
    Dubowsky: The kinematics and dynamics of space manipulators: the virtual manipulator approach (1990).

    Args:
        robot: The robot.
        limits: Of its coordinates; a sliding joint moves within its limits.
    """
    bodies = robot.bodies
    masses = np.array([body.mass for body in bodies])
    vectors = masses[:, None] * np.array([body.centre for body in bodies])
    carried = masses.copy()
    slides = 0.0
    first = len(limits.position_low) - len(robot.joints)
    for number in range(len(robot.joints), 0, -1):  # from the tips inward
        joint = robot.joints[number - 1]
        carried[joint.at.body] += carried[number]  # by now the mass of this body and of all that it carries
        vectors[joint.at.body] += carried[number] * np.array(joint.at.position)
        if joint.prismatic:
            row = first + number - 1
            slides += carried[number] * max(abs(limits.position_low[row]), abs(limits.position_high[row]))
    return float((np.linalg.norm(vectors, axis=1).sum() + slides) / masses.sum())


def reach_of(
    model: RobotModel,
    arm: str,
    base_pose: ArrayLike,
    pose: ArrayLike,
    limits: tuple[Array, Array] | None = None,
    near: ArrayLike | None = None,
) -> Reach:
    """Compute whether an arm reaches a pose with the base at a given pose, and how far both are apart.

    Distances alone rule out poses whose last joint would lie outside the annulus that the other links can reach. For
    others joint coordinates within the limits are searched for.

    Args:
        model: The robot, which keeps what is derived for the search.
        arm: Name of the arm.
        base_pose: (x, y, angle), (3,) [m, m, rad]; in space position and quaternion, (7,).
        pose: Of the end-effector, likewise.
        limits: Lowest and highest joint coordinates of the arm (links,); by default the robot's.
        near: Joint coordinates from which the search starts (links,) [rad, m]. Of several solutions of the inverse
            kinematics it then finds the one to which a motion from there leads. By default 0.

    Returns:
        Distances, whether the pose is reached, and joint coordinates with which it is.

    Raises:
        InputError: The robot has no such arm, or a pose has not as many numbers.
    """
    robot = model.spec
    if arm not in robot.arms:
        raise InputError(f"robot '{robot.name}' has no arm '{arm}'; it has {', '.join(robot.arms)}")
    base = _frame(robot, "base_pose", base_pose)
    target = _frame(robot, "pose", pose)
    low, high = limits or _joint_limits(robot, arm)
    rows, sliding = _joint_rows_and_sliding(robot, arm)
    lengths = np.linalg.norm(robot.link_ends(arm), axis=1)
    slides = float(np.maximum(np.abs(low), np.abs(high))[sliding].sum())
    outer = float(lengths[:-1].sum()) + slides
    # links that turn freely cannot fold back closer than the longest one less all others
    inner = max(0.0, 2 * float(lengths[:-1].max(initial=0.0)) - outer)
    at_rest, _ = place(robot, base, np.zeros(len(robot.bodies) - 1))
    first = at_rest[rows.start + 1]
    tool = robot.tools[arm]
    # the full pose of the end-effector says where the last joint is
    last_attitude = product(target.quaternion, conjugate(exp(tool.rotation)))
    wrist = np.array(target.position) - rotate(last_attitude, tool.position)
    wrist_distance = float(np.linalg.norm(wrist - first.position))
    within = inner - TOLERANCE <= wrist_distance <= outer + TOLERANCE
    start = np.zeros(len(low)) if near is None else np.asarray(near, dtype=float)
    q, missed = _find_configuration(model, arm, base, target, low, high, start) if within else (None, (np.inf, np.inf))
    return Reach(
        distance=float(np.linalg.norm(np.array(target.position) - first.position)),
        wrist_distance=wrist_distance,
        inner=inner,
        outer=outer,
        full_reach=float(lengths.sum()) + slides,
        within_annulus=within,
        reachable=q is not None,
        configuration=None if q is None else tuple(q.tolist()),
        missed=missed,
    )


def _joint_rows_and_sliding(robot: RobotSpec, arm: str) -> tuple[slice, Array]:
    """Return the rows of an arm in the joint coordinates of all arms, and which of its joints slide, (links,)."""
    parts = list(robot.parts)[1:]
    first = sum(robot.parts[part] for part in parts[: parts.index(arm)])
    rows = slice(first, first + robot.parts[arm])
    return rows, np.array([joint.prismatic for joint in robot.joints[rows]])


def _find_configuration(
    model: RobotModel, arm: str, base: SpatialFrame, target: SpatialFrame, low: Array, high: Array, near: Array
) -> tuple[Array | None, tuple[float, float]]:
    """Search for joint coordinates of an arm within its limits with which the end-effector is at a pose.

    Inverse kinematics by bounded least squares on the error of the pose, paper eq. (1), from several starts: the first
    is the given configuration, others are random ones. Joints of other arms are at 0.

    Args:
        model: The robot.
        arm: Name of the arm.
        base: Pose of the base.
        target: Wanted pose of the end-effector.
        low: Lowest joint coordinates of the arm (links,).
        high: Highest ones (links,).
        near: Where the search starts (links,). If it is not 0, the arm is first led from there to the pose in small
            steps. Angles are returned as the equivalents nearest to it.

    Returns:
        The joint coordinates (links,), None if none were found; and by how much the nearest pose that was found misses
        the wanted one, [m] and [rad].
    """
    frames = np.r_[tuple(base.position), tuple(base.quaternion), tuple(target.position), tuple(target.quaternion)]
    pose_error, derivative = model.derived(("reach", arm), lambda: _pose_error_functions(model.spec, arm))
    _, sliding = _joint_rows_and_sliding(model.spec, arm)

    def error(q: Array) -> Array:
        return pose_error(q, frames)[0].ravel()

    bounds = low, np.maximum(high, low + 1e-9)  # least_squares needs room between them
    least_norm = np.inf
    least_miss = (np.inf, np.inf)  # in position, in attitude
    start_near = np.clip(near, low, high)
    if near.any():
        start_near = _follow_to_pose(error, derivative, frames, bounds, start_near)
    for start in _search_starts(low, high, start_near):
        solution = least_squares(
            error, start, lambda q: derivative(q, frames)[0].T, bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100
        )
        angles = np.where(sliding, np.clip(solution.x, low, high), _nearest_turns(solution.x, low, high, near))
        miss = error(angles)
        if np.linalg.norm(miss) < least_norm:
            least_norm = float(np.linalg.norm(miss))
            least_miss = (float(np.linalg.norm(miss[:3])), float(np.linalg.norm(miss[3:])))
        if np.abs(miss).max() <= TOLERANCE:
            return angles, least_miss
    return None, least_miss


def _follow_to_pose(
    error: Callable[[Array], Array],
    derivative: ArrayFunction,
    frames: Array,
    bounds: tuple[Array, Array],
    near: Array,
) -> Array:
    """Lead an arm from a configuration towards a pose in small steps, and return the configuration where it ends.

    Inverse kinematics has several solutions. A single large step may end at another one than a motion from the
    configuration leads to. So the error of the pose is reduced evenly to 0 in `PIECES` steps, each of which is solved
    from the result of the one before.

    Args:
        error: Joint coordinates (links,) -> by how much the pose is missed (6,) [m, rad].
        derivative: Joint coordinates, frames -> its derivative.
        frames: Poses of the base and of the target, positions and quaternions (14,).
        bounds: Lowest and highest joint coordinates.
        near: Where the arm begins (links,).

    Returns:
        The joint coordinates (links,). They miss the pose if it, or the way to it, is out of reach.
    """
    initial_error = error(near)
    q = near
    for share in np.linspace(1.0, 0.0, PIECES + 1)[1:]:
        remaining = share * initial_error
        q = least_squares(
            lambda q, remaining=remaining: error(q) - remaining,
            q,
            lambda q: derivative(q, frames)[0].T,
            bounds,
            max_nfev=20,
        ).x
    return q


def _pose_error_functions(robot: RobotSpec, arm: str) -> tuple[ArrayFunction, ArrayFunction]:
    """Return the error of an end-effector's pose, and its derivative by the arm's joints, as functions on arrays.

    The error is the difference in position, then the rotation vector of the shorter turn (6,) [m, rad]; the derivative
    is (6, links). Arguments of both are the joint coordinates of the arm (links,), and position and quaternion of the
    base, then those of the wanted pose (14,). Joints of other arms are at 0.
    """
    rows, sliding = _joint_rows_and_sliding(robot, arm)
    q = ca.SX.sym("q", len(sliding))
    frames = ca.SX.sym("frames", 14)
    base_position, base_quaternion, position, quaternion = map(ca.vertsplit, ca.vertsplit(frames, [0, 3, 7, 10, 14]))
    joints = ca.SX.zeros(len(robot.bodies) - 1)
    joints[rows.start : rows.stop] = q
    _, tools = place(robot, SpatialFrame(base_position, base_quaternion), joints)
    tip = tools[arm]
    turned = shorter(product(conjugate(quaternion), tip.quaternion))
    missed = ca.densify(ca.vertcat(*add(tip.position, scaled(position, -1)), *log(turned)))
    derivative = ca.densify(ca.jacobian(missed, q))
    value = ca.Function("miss", [q, frames], [missed])
    return ArrayFunction(value), ArrayFunction(ca.Function("miss_by_joints", [q, frames], [derivative]))


def _search_starts(low: Array, high: Array, near: Array) -> Iterator[Array]:
    """Yield where a search starts: joint coordinates nearest to given ones, then random ones within a turn of each."""
    yield np.clip(near, low, high)
    random = np.random.default_rng(SEED)
    first = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2 * np.pi, -np.pi))
    for _ in range(STARTS - 1):
        yield random.uniform(first, np.minimum(high, first + 2 * np.pi))


def _nearest_turns(q: Array, low: Array, high: Array, near: Array) -> Array:
    """Return each angle (links,), changed by whole turns to be as near as its limits allow to another one, `near`."""
    q = np.clip(q, low, high)
    turned = q - 2 * np.pi * np.round((q - near) / (2 * np.pi))
    return np.where((turned >= low) & (turned <= high), turned, q)


def _frame(robot: RobotSpec, name: str, values: ArrayLike) -> SpatialFrame:
    """Return a pose as a frame in space."""
    pose = np.asarray(values, dtype=float)
    space = configuration_space(robot)
    if pose.shape != (space.n_pose,):
        coordinates = f"{space.n_pose} numbers ({space.pose_text})"
        raise InputError(f"{name} is {np.asarray(values).tolist()}, but {coordinates} are expected")
    position, turned = space.to_3d(pose.tolist())
    return SpatialFrame(position, scaled(turned, 1 / float(np.linalg.norm(turned))))


def _joint_limits(robot: RobotSpec, arm: str) -> tuple[Array, Array]:
    """Return the lowest and highest joint coordinates of an arm, (links,) each; infinite where there are none."""
    pairs = limits_of_part(robot.limits, arm, "position") or (None,) * len(robot.arms[arm].links)
    low, high = np.array([pair or (-np.inf, np.inf) for pair in pairs], dtype=float).T
    return low, high
