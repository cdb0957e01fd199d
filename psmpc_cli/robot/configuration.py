"""Configuration spaces: positions Q (nq,) and velocities v (n,) of a base that moves freely and of joints.

Whether a robot or a body moves in the plane or in space is asked here and nowhere else. A configuration is the pose of
the base followed by the joints' coordinates; a free body is one without joints.

| space | pose | velocity of the base |
|---|---|---|
| `PlanarSpace` | x, y, angle [m, rad] | their rates |
| `SpatialSpace` | position [m], unit quaternion w, x, y, z | linear, inertial frame; angular, body's frame |

Functions take numbers, arrays (the same operation at many places at once) and CasADi expressions alike, where they
return lists of components. Names are those of Pinocchio: `neutral`, `integrate`, `difference`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import accumulate
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.kinematics import Frame, PlanarFrame, SpatialFrame
from psmpc_cli.robot.rotations import (
    add,
    body_rate,
    chart_rate,
    conjugate,
    cross,
    exp,
    log,
    matrix,
    product,
    rotate,
    scaled,
    shorter,
    turn,
    turn_matrix,
)
from psmpc_cli.specs.robots.robot import RobotSpec

Array = NDArray[np.float64]

TILT = 1e-3
"""Angle by which a line exactly behind is taken to lie off [rad], so that there is an axis to turn about; 0 ahead."""


class Chart(ABC):
    """Coordinates of configurations about an attitude, in which the motion model is that of all robots.

    A state in the chart is x = [Q; Qdot] (2n,).

    Attributes:
        anchor: Unit quaternion A (4,); empty in the plane.
    """

    anchor: Array

    @abstractmethod
    def to_chart(self, Q: Array, v: Array) -> Array:
        """Return the states x (K, 2n) in the chart at coordinates Q (K, nq) and velocities v (K, n)."""

    @abstractmethod
    def from_chart(self, X: Array) -> tuple[Array, Array]:
        """Return coordinates Q (K, nq) and velocities v (K, n) at states X (K, 2n) in the chart."""

    def states_in_chart(self, X: Array) -> Array:
        """Return the states in the chart (K, 2n) at states [Q; v] (K, nq + n)."""
        n = X.shape[1] // 2
        return self.to_chart(X[:, : X.shape[1] - n], X[:, X.shape[1] - n :])

    def is_same(self, other: "Chart") -> bool:
        """Tell whether another chart has the same coordinates."""
        return np.array_equal(self.anchor, other.anchor)

    def moved(self, X: Array, to: "Chart") -> Array:
        """Return states X (K, 2n) in another chart (K, 2n)."""
        return X if self.is_same(to) else to.to_chart(*self.from_chart(X))

    @abstractmethod
    def rate_shift(self, X: Array) -> Array:
        """Return Qdot - v (K, n) at states X (K, 2n), or (1, 1) where it is 0 at all.

        By this limits of v lie elsewhere in the chart's rates: (I - J_r(phi)) phidot in the rows of attitude.
        """

    @abstractmethod
    def velocity_rates(self, X: Array, u: Array, steps: Array) -> Array:
        """Return the mean rates of v (M, n) over steps (M, 1) [s] between states X (M + 1, 2n), under u (M, n)."""


class IdentityChart(Chart):
    """The chart of planar robots: their own coordinates."""

    def __init__(self) -> None:
        self.anchor = np.zeros(0)

    def to_chart(self, Q: Array, v: Array) -> Array:
        """Return [Q; v]."""
        return np.hstack([Q, v])

    def from_chart(self, X: Array) -> tuple[Array, Array]:
        """Split [Q; v]."""
        n = X.shape[1] // 2
        return X[:, :n], X[:, n:]

    def rate_shift(self, X: Array) -> Array:
        """Return 0."""
        return np.zeros((1, 1))

    def velocity_rates(self, X: Array, u: Array, steps: Array) -> Array:
        """Return u."""
        return u


class AttitudeChart(Chart):
    """Coordinates Q = [position (3), phi (3), joints] with the base's attitude R = A Exp(phi).

    A is the attitude measured at a sample, so phi is 0 at the start of every plan and its rate there is the body's
    angular velocity. docs/formulation.md, section "attitude".
    """

    def __init__(self, anchor: Array) -> None:
        self.anchor = anchor / np.linalg.norm(anchor)

    def to_chart(self, Q: Array, v: Array) -> Array:
        """Take phi = Log(A^-1 R) and phidot = J_r(phi)^-1 omega."""
        turned = product(conjugate(list(self.anchor)), list(Q[:, 3:7].T))
        sign = np.where(turned[0] < 0, -1.0, 1.0)
        phi = log([sign * part for part in turned])
        rate = chart_rate(phi, list(v[:, 3:6].T))
        return np.column_stack([Q[:, :3], *phi, Q[:, 7:], v[:, :3], *rate, v[:, 6:]])

    def from_chart(self, X: Array) -> tuple[Array, Array]:
        """Take R = A Exp(phi) and omega = J_r(phi) phidot."""
        n = X.shape[1] // 2
        phi = list(X[:, 3:6].T)
        rate = list(X[:, n + 3 : n + 6].T)
        attitude = np.column_stack(product(list(self.anchor), exp(phi)))
        attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
        omega = np.column_stack(body_rate(phi, rate))
        return np.hstack([X[:, :3], attitude, X[:, 6:n]]), np.hstack([X[:, n : n + 3], omega, X[:, n + 6 :]])

    def rate_shift(self, X: Array) -> Array:
        """Return (I - J_r(phi)) phidot in the rows of attitude, and 0 in all others."""
        n = X.shape[1] // 2
        return np.asarray(X[:, n:] - self.from_chart(X)[1])

    def velocity_rates(self, X: Array, u: Array, steps: Array) -> Array:
        """Return what omega changes by."""
        _, v = self.from_chart(X)
        return np.asarray(np.diff(v, axis=0) / steps)


IDENTITY = IdentityChart()
"""The chart of every planar robot."""


class ConfigurationSpace(ABC):
    """The configurations of a base with so many joints.

    Attributes:
        dimension: Coordinates of a position.
        n_pose: Coordinates of a pose.
        n_twist: Components of the base's velocity, of a wrench and of the error of a pose.
        n_moments: Entries of a body's inertia: zz, or xx, yy, zz, xy, xz, yz.
        moments: Which of xx, yy, zz, xy, xz, yz of a body count.
        n_principal: Principal moments of inertia of a body.
        n_pointing: Angles between a frame's x-axis and a line.
        keeps_posture: Joints that the poses of end-effectors leave free are drawn to where they are.
        pose_angles: Rows of a pose that are angles, of which the nearest equivalent is meant.
        pose_attitude: Rows of a pose that are its unit quaternion; none in the plane.
        pose_text: The coordinates of a pose in their order, for messages.
        joints: Number of joints.
        nq, n: Number of coordinates Q and of velocities v.
        attitude: Rows of Q that are the base's unit quaternion; none in the plane.
        rotation: Rows of v that turn the base.
        base, base_coordinates: Rows of the base in v, and in Q.
        joint_rates, joint_coordinates: Rows of the joints in v, and in Q.
    """

    dimension: ClassVar[int]
    n_pose: ClassVar[int]
    n_twist: ClassVar[int]
    moments: ClassVar[slice]
    n_moments: ClassVar[int]
    n_principal: ClassVar[int]
    n_pointing: ClassVar[int]
    keeps_posture: ClassVar[bool]
    pose_angles: ClassVar[tuple[int, ...]]
    pose_attitude: ClassVar[slice]
    pose_text: ClassVar[str]

    def __init__(self, joints: int = 0) -> None:
        self.joints = joints
        self.nq = self.n_pose + joints
        self.n = self.n_twist + joints
        self.attitude = self.pose_attitude
        self.rotation = slice(self.dimension, self.n_twist)
        self.base = slice(0, self.n_twist)
        self.base_coordinates = slice(0, self.n_pose)
        self.joint_rates = slice(self.n_twist, self.n)
        self.joint_coordinates = slice(self.n_pose, self.nq)

    @property
    def has_quaternion(self) -> bool:
        """Whether the attitude of a frame has a quaternion, and motions a chart about one."""
        return self.n_anchor > 0

    @property
    def n_anchor(self) -> int:
        """Size of a chart's anchor."""
        return int(self.pose_attitude.stop - self.pose_attitude.start)

    @property
    def n_posture(self) -> int:
        """Number of joints that are drawn to a posture where poses leave them free."""
        return self.joints if self.keeps_posture else 0

    @property
    def n_sample_numbers(self) -> int:
        """How many numbers of a target every sample sets: the chart's anchor, and the posture."""
        return self.n_anchor + self.n_posture

    def posture(self, joints: Array) -> Array:
        """Return the posture (n_posture,) that redundant joints are drawn to, all being at coordinates (joints,)."""
        return joints[: self.n_posture]

    @property
    @abstractmethod
    def neutral(self) -> Array:
        """Coordinates 0 (nq,), with the attitude of the inertial frame."""

    def at_neutral_base(self, joints: ca.SX) -> ca.SX:
        """Return coordinates (nq,) with joints (joints,) and the base's frame as the inertial one."""
        return ca.SX(ca.vertcat(*self.neutral[self.base_coordinates], joints))

    def attitudes_at(self, *first: int) -> list[slice]:
        """Return the rows of the unit quaternions in a vector that has poses from these rows on; none in the plane."""
        rows = self.pose_attitude
        return [slice(at + rows.start, at + rows.stop) for at in first if self.has_quaternion]

    # Motion

    @abstractmethod
    def rate(self, Q: Any, v: Any) -> list[Any]:
        """Compute Qdot (nq,) of velocities v (n,)."""

    @abstractmethod
    def integrate(self, Q: Any, step: Any) -> list[Any]:
        """Compute the coordinates (nq,) a step (n,) after Q (nq,): v times the time it lasts."""

    @abstractmethod
    def difference(self, Q: Any, after: Any) -> list[Any]:
        """Compute the step (n,) that leads from Q (nq,) to the coordinates after it (nq,), by the shorter turn."""

    @abstractmethod
    def path(self, Q: Array, steps: Array) -> Array:
        """Return the coordinates before and after each of consecutive steps (M, n), (M + 1, nq)."""

    @abstractmethod
    def magnus_correction(self, before: Array, after: Array, time: float) -> Array:
        """Compute what has to be added to the integral of a velocity to get the step of coordinates.

        Turns about different axes do not commute, so that a body whose angular velocity changes its direction does not
        turn by the integral of that velocity. With the correction the error of a step is of the order of time^5.

        Args:
            before: Velocities at the beginning of each interval (M, n); in between they change linearly.
            after: Velocities at its end (M, n).
            time: Its length [s].

        Returns:
            The corrections of the steps (M, n), or what broadcasts to them [m, rad].
        """

    def normalized(self, Q: Array) -> Array:
        """Return coordinates (..., nq) with unit quaternions."""
        Q = Q.copy()
        if self.has_quaternion:
            Q[..., self.attitude] /= np.linalg.norm(Q[..., self.attitude], axis=-1, keepdims=True)
        return Q

    @abstractmethod
    def chart_at(self, Q: Array) -> Chart:
        """Return the chart about the attitude in coordinates Q (nq,)."""

    @abstractmethod
    def charted_coordinates(self, Q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Return the coordinates (nq,) at coordinates Q (n,) in the chart about an anchor."""

    @abstractmethod
    def charted_velocity(self, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
        """Return v (n,) at coordinates Q and rates Qdot (n,) in a chart."""

    @abstractmethod
    def charted_acceleration(self, Q: ca.SX, Qdot: ca.SX, u: ca.SX) -> ca.SX:
        """Return the rates of v (n,) at coordinates Q, rates Qdot and accelerations u (n,) in a chart."""

    @abstractmethod
    def acceleration_in_chart(self, Q: ca.SX, Qdot: ca.SX, vdot: ca.SX) -> ca.SX:
        """Return the accelerations u (n,) in a chart under which v changes at rates vdot (n,).

        The inverse of `charted_acceleration`, at coordinates Q and rates Qdot (n,) in the chart.
        """

    @abstractmethod
    def acceleration_at(self, Q: ca.SX, v: ca.SX, u: ca.SX, anchor: ca.SX) -> ca.SX:
        """Return the rates of v (n,) at a state (nq,), (n,) under accelerations u (n,) in the chart about an anchor."""

    @abstractmethod
    def in_order_of_v(self, Q: Array) -> Array:
        """Return coordinates Q (nq,) row by row of v (n,); NaN for an attitude, which has no such coordinates."""

    @abstractmethod
    def unrolled(self, Q: Array) -> Array:
        """Return coordinates (K, nq) as numbers that are continuous along the rows, in the order of v (K, n)."""

    @abstractmethod
    def format_pose(self, pose: Array) -> str:
        """Write a pose for a message."""

    # Forces

    @abstractmethod
    def external_wrench(self, Q: Any, F: Any) -> list[Any]:
        """Compute the force of F (n,) on the base and its moment about the inertial origin, (n_twist,) [N, N m]."""

    @abstractmethod
    def external_wrench_rate(self, Q: Any, v: Any, F: Any) -> list[Any]:
        """Compute how fast the external wrench of a held force F (n,) changes, (n_twist,) [N/s, N m/s]."""

    def along_base_axes(self, Q: Any, F: Any) -> list[Any]:
        """Turn the force in the components F (n,) of a generalized force into the base's own axes, (n,) [N, N m]."""
        return self._with_force_turned(Q, F, conjugate)

    def along_inertial_axes(self, Q: Any, F: Any) -> list[Any]:
        """Turn a force along the base's axes in components F (n,) back into the inertial frame, (n,) [N, N m]."""
        return self._with_force_turned(Q, F, list)

    def _with_force_turned(self, Q: Any, F: Any, by: Callable[[list[Any]], list[Any]]) -> list[Any]:
        """Return the components F (n,) with the base's force turned by its attitude, or by the inverse."""
        _, quaternion = self.to_3d([Q[i] for i in range(self.n_pose)])
        linear, angular = self.twist_to_3d([F[i] for i in range(self.n_twist)])
        turned = self.twist(rotate(by(quaternion), linear), angular)
        return [*turned, *(F[i] for i in range(self.n_twist, self.n))]

    # Frames

    @abstractmethod
    def base_frame(self, Q: Any) -> Frame:
        """Return the base's frame at coordinates Q (nq,)."""

    def charted_frame(self, Q: ca.SX, anchor: ca.SX) -> Frame:
        """Return the base's frame at coordinates Q (n,) in the chart about an anchor."""
        return self.base_frame(self.charted_coordinates(Q, anchor))

    @abstractmethod
    def frames(self, poses: Array) -> Array:
        """Return the frames (K, 4, 4) of poses (K, n_pose); those of the plane are at z = 0."""

    @abstractmethod
    def residual(self, pose: ca.SX, wanted: ca.SX) -> ca.SX:
        """Return the error (n_twist,) [m, rad] of a pose against a wanted one, angles of the plane unwrapped."""

    @abstractmethod
    def pointing_error(self, line: ca.SX, pose: ca.SX) -> ca.SX:
        """Return the angles (n_pointing,) [rad] about a frame's axes that bring its x-axis to a line."""

    @abstractmethod
    def base_rotation(self, Q: ca.SX) -> list[list[Any]]:
        """Return the rotation matrix of the base (3, 3) at coordinates Q (nq,)."""

    # Vectors of the plane in space

    @abstractmethod
    def to_3d(self, pose: Any) -> tuple[list[Any], list[Any]]:
        """Return position (3,) and unit quaternion (4,) of a pose."""

    @abstractmethod
    def from_3d(self, position: Array, quaternion: Array) -> Array:
        """Return the pose (n_pose,) at a position (3,) and a unit quaternion (4,); the inverse of `to_3d`."""

    @abstractmethod
    def twist_to_3d(self, twist: Any) -> tuple[list[Any], list[Any]]:
        """Return the linear and the angular vector (3,) of a velocity or a wrench."""

    @abstractmethod
    def twist(self, linear: Any, angular: Any) -> list[Any]:
        """Return the components (n_twist,) of two vectors (3,) that count; the inverse of `twist_to_3d`."""

    @abstractmethod
    def moments_to_3d(self, moments: Any) -> list[Any]:
        """Return xx, yy, zz, xy, xz, yz of an inertia (n_moments,)."""

    # Poses relative to others

    @abstractmethod
    def composed(self, pose: Any, inside: Any) -> Array:
        """Compute a pose that is given in the frame of another one; angles add up."""

    @abstractmethod
    def relative(self, pose: Any, to: Any) -> Array:
        """Compute a pose as it is in the frame of another one, the inverse of `composed`."""

    @abstractmethod
    def pose_error(self, pose: Any, wanted: Any) -> Array:
        """Compute the difference of a pose from a wanted one (n_twist,) [m, rad]: the angle within half a turn."""

    def carried_rate(self, pose: Any, v: Any, inside: Any) -> Array:
        """Compute the velocity of a pose fixed to a moving one: linear in the inertial frame, angular in its own."""
        _, quaternion = self.to_3d(pose)
        at, turned = self.to_3d(inside)
        linear, angular = self.twist_to_3d(v)  # about the body's axes, which in the plane is the same
        moved = add(linear, rotate(quaternion, cross(angular, at)))
        return np.array(self.twist(moved, rotate(conjugate(turned), angular)))


class PlanarSpace(ConfigurationSpace):
    """Configurations in the plane: a vector space."""

    dimension = 2
    n_pose = 3
    n_twist = 3
    moments = slice(2, 3)
    n_moments = 1
    n_principal = 1
    n_pointing = 1
    keeps_posture = False
    pose_angles = (2,)
    pose_attitude = slice(2, 2)
    pose_text = "x, y, angle"

    @property
    def neutral(self) -> Array:
        """Return 0."""
        return np.zeros(self.nq)

    def rate(self, Q: Any, v: Any) -> list[Any]:
        """Return v."""
        return list(v)

    def integrate(self, Q: Any, step: Any) -> list[Any]:
        """Return the sum."""
        return add(Q, step)

    def difference(self, Q: Any, after: Any) -> list[Any]:
        """Return the difference."""
        return [b - a for a, b in zip(Q, after, strict=True)]

    def path(self, Q: Array, steps: Array) -> Array:
        """Return cumulative sums."""
        return np.cumsum(np.vstack([Q, steps]), axis=0)

    def magnus_correction(self, before: Array, after: Array, time: float) -> Array:
        """Return 0: turns in the plane commute."""
        return np.zeros((1, 1))

    def chart_at(self, Q: Array) -> Chart:
        """Return the identity."""
        return IDENTITY

    def charted_coordinates(self, Q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Return Q."""
        return Q

    def charted_velocity(self, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
        """Return Qdot."""
        return Qdot

    def charted_acceleration(self, Q: ca.SX, Qdot: ca.SX, u: ca.SX) -> ca.SX:
        """Return u."""
        return u

    def acceleration_in_chart(self, Q: ca.SX, Qdot: ca.SX, vdot: ca.SX) -> ca.SX:
        """Return vdot."""
        return vdot

    def acceleration_at(self, Q: ca.SX, v: ca.SX, u: ca.SX, anchor: ca.SX) -> ca.SX:
        """Return u."""
        return u

    def in_order_of_v(self, Q: Array) -> Array:
        """Return Q."""
        return Q

    def unrolled(self, Q: Array) -> Array:
        """Return Q."""
        return Q

    def format_pose(self, pose: Array) -> str:
        """Write the angle in degrees."""
        return f"[{pose[0]:g}, {pose[1]:g}, {np.degrees(pose[2]):g} deg]"

    def external_wrench(self, Q: Any, F: Any) -> list[Any]:
        """Return the force, and the moment with that of the force about the origin."""
        return [F[0], F[1], F[2] + Q[0] * F[1] - Q[1] * F[0]]

    def external_wrench_rate(self, Q: Any, v: Any, F: Any) -> list[Any]:
        """Return the rate of the moment of the force about the origin."""
        return [0 * F[0], 0 * F[1], v[0] * F[1] - v[1] * F[0]]

    def base_frame(self, Q: Any) -> Frame:
        """Return the frame at (x, y, angle)."""
        return PlanarFrame(Q[:2], Q[2])

    def frames(self, poses: Array) -> Array:
        """Turn about z."""
        frames = np.tile(np.eye(4), (len(poses), 1, 1))
        frames[:, :2, 3] = poses[:, :2]
        frames[:, :3, :3] = Rotation.from_rotvec(np.outer(poses[:, 2], (0, 0, 1))).as_matrix()
        return frames

    def residual(self, pose: ca.SX, wanted: ca.SX) -> ca.SX:
        """Return the difference."""
        return pose - wanted

    def pointing_error(self, line: ca.SX, pose: ca.SX) -> ca.SX:
        """Return the angle from the line (2,) to the x-axis, atan2 of cross and dot product."""
        axis = ca.vertcat(ca.cos(pose[2]), ca.sin(pose[2]))
        return ca.SX(ca.atan2(line[0] * axis[1] - line[1] * axis[0], ca.dot(line, axis)))

    def base_rotation(self, Q: ca.SX) -> list[list[Any]]:
        """Turn about z."""
        return turn_matrix((0.0, 0.0, 1.0), Q[2])

    def moments_to_3d(self, moments: Any) -> list[Any]:
        """Return zero but for zz."""
        return [0.0, 0.0, *moments, 0.0, 0.0, 0.0]

    def to_3d(self, pose: Any) -> tuple[list[Any], list[Any]]:
        """Put the pose at z = 0."""
        return [pose[0], pose[1], 0.0], turn((0.0, 0.0, 1.0), pose[2])

    def from_3d(self, position: Array, quaternion: Array) -> Array:
        """Take the angle about z."""
        return np.array([*position[:2], 2 * np.arctan2(quaternion[3], quaternion[0])])

    def twist_to_3d(self, twist: Any) -> tuple[list[Any], list[Any]]:
        """Turn about z."""
        return [twist[0], twist[1], 0.0], [0.0, 0.0, twist[2]]

    def twist(self, linear: Any, angular: Any) -> list[Any]:
        """Return x, y and the turn about z."""
        return [*linear[:2], angular[2]]

    def composed(self, pose: Any, inside: Any) -> Array:
        """Turn the position and add the angles."""
        position, quaternion = self.to_3d(pose)
        at, _ = self.to_3d(inside)
        moved = add(position, rotate(quaternion, at))
        return np.array([*moved[:2], pose[2] + inside[2]])

    def relative(self, pose: Any, to: Any) -> Array:
        """Turn the position back and subtract the angles."""
        position, quaternion = self.to_3d(to)
        at, _ = self.to_3d(pose)
        apart = rotate(conjugate(quaternion), add(at, scaled(position, -1)))
        return np.array([*apart[:2], pose[2] - to[2]])

    def pose_error(self, pose: Any, wanted: Any) -> Array:
        """Return the difference, its angle within half a turn."""
        angle = pose[2] - wanted[2]
        return np.array([pose[0] - wanted[0], pose[1] - wanted[1], np.arctan2(np.sin(angle), np.cos(angle))])


class SpatialSpace(ConfigurationSpace):
    """Configurations in space: the base's attitude is a unit quaternion, its rate the body's angular velocity.

    Sola, Deray, Atchuthan: A micro Lie theory for state estimation in robotics (2018).
    """

    dimension = 3
    n_pose = 7
    n_twist = 6
    moments = slice(0, 6)
    n_moments = 6
    n_principal = 3
    n_pointing = 2
    keeps_posture = True
    pose_angles = ()
    pose_attitude = slice(3, 7)
    pose_text = "x, y, z, quaternion w, x, y, z"

    @property
    def neutral(self) -> Array:
        """Return 0 with the quaternion (1, 0, 0, 0)."""
        Q = np.zeros(self.nq)
        Q[3] = 1.0
        return Q

    def rate(self, Q: Any, v: Any) -> list[Any]:
        """Return qdot = q (0, omega) / 2 in the rows of the quaternion q."""
        return [*v[:3], *scaled(product(Q[3:7], [0.0, *v[3:6]]), 0.5), *v[6:]]

    def integrate(self, Q: Any, step: Any) -> list[Any]:
        """Return q Exp(step) in the rows of the quaternion."""
        return [*add(Q[:3], step[:3]), *product(Q[3:7], exp(step[3:6])), *add(Q[7:], step[6:])]

    def difference(self, Q: Any, after: Any) -> list[Any]:
        """Return Log(q^-1 q_after), the shorter turn, in the rows of rotation."""
        turned = product(conjugate(Q[3:7]), after[3:7])
        before = [*Q[:3], *Q[7:]]
        apart = [b - a for a, b in zip(before, [*after[:3], *after[7:]], strict=True)]
        return [*apart[:3], *log(shorter(turned)), *apart[3:]]

    def path(self, Q: Array, steps: Array) -> Array:
        """Integrate step after step."""
        return np.array(list(accumulate(steps.tolist(), self.integrate, initial=Q.tolist())))

    def magnus_correction(self, before: Array, after: Array, time: float) -> Array:
        """Compute the second term of the Magnus expansion, time^2 / 12 omega_before x omega_after.

        The first term is the integral of omega. Iserles, Norsett: On the solution of linear differential equations in
        Lie groups (1999).
        """
        steps = np.zeros(before.shape)
        steps[..., 3:6] = time**2 / 12 * np.cross(before[..., 3:6], after[..., 3:6])
        return steps

    def chart_at(self, Q: Array) -> Chart:
        """Return the chart whose anchor is the quaternion."""
        return AttitudeChart(Q[self.attitude])

    def charted_coordinates(self, Q: ca.SX, anchor: ca.SX) -> ca.SX:
        """Return A Exp(phi) in the rows of the quaternion."""
        attitude = product(ca.vertsplit(anchor), exp(ca.vertsplit(Q[3:6])))
        return ca.vertcat(Q[:3], *attitude, Q[6:])

    def charted_velocity(self, Q: ca.SX, Qdot: ca.SX) -> ca.SX:
        """Return omega = J_r(phi) phidot in the rows of rotation."""
        omega = body_rate(ca.vertsplit(Q[3:6]), ca.vertsplit(Qdot[3:6]))
        return ca.vertcat(Qdot[:3], *omega, Qdot[6:])

    def charted_acceleration(self, Q: ca.SX, Qdot: ca.SX, u: ca.SX) -> ca.SX:
        """Return d/dt (J_r(phi) phidot) in the rows of rotation."""
        phi = ca.SX.sym("phi", 3)
        phidot = ca.SX.sym("phidot", 3)
        omega = ca.vertcat(*body_rate(ca.vertsplit(phi), ca.vertsplit(phidot)))
        alpha = ca.jtimes(omega, ca.vertcat(phi, phidot), ca.vertcat(phidot, u[3:6]))
        alpha_here = ca.substitute(alpha, ca.vertcat(phi, phidot), ca.vertcat(Q[3:6], Qdot[3:6]))
        return ca.vertcat(u[:3], alpha_here, u[6:])

    def acceleration_in_chart(self, Q: ca.SX, Qdot: ca.SX, vdot: ca.SX) -> ca.SX:
        """Return J_r(phi)^-1 (alpha - d/dt J_r(phi) phidot) in the rows of rotation."""
        drift = self.charted_acceleration(Q, Qdot, ca.SX.zeros(self.n))
        alpha = vdot[self.rotation] - drift[self.rotation]
        phiddot = chart_rate(ca.vertsplit(Q[self.rotation]), ca.vertsplit(alpha))
        return ca.vertcat(vdot[:3], *phiddot, vdot[6:])

    def acceleration_at(self, Q: ca.SX, v: ca.SX, u: ca.SX, anchor: ca.SX) -> ca.SX:
        """Take phi and phidot of the state first, of which position and joints have no part."""
        turned = product(conjugate(ca.vertsplit(anchor)), ca.vertsplit(Q[3:7]))
        phi = log(turned)
        phidot = chart_rate(phi, ca.vertsplit(v[3:6]))
        return self.charted_acceleration(ca.vertcat(Q[:3], *phi), ca.vertcat(v[:3], *phidot), u)

    def in_order_of_v(self, Q: Array) -> Array:
        """Return Q with NaN for the quaternion."""
        return np.concatenate([Q[:3], np.full(3, np.nan), Q[7:]])

    def unrolled(self, Q: Array) -> Array:
        """Return the rotation vectors of the attitudes, of two quaternions the one nearer to that of the row before."""
        flips = np.cumprod(np.where((Q[1:, 3:7] * Q[:-1, 3:7]).sum(axis=1) < 0, -1.0, 1.0))
        vector = np.array(log((Q[:, 3:7] * np.r_[1.0, flips][:, None]).T)).T
        return np.hstack([Q[:, :3], vector, Q[:, 7:]])

    def format_pose(self, pose: Array) -> str:
        """Write the angle of the turn in degrees."""
        turned = np.degrees(2 * np.arctan2(np.linalg.norm(pose[4:7]), abs(pose[3])))
        return f"[{pose[0]:g}, {pose[1]:g}, {pose[2]:g}], turned by {turned:g} deg"

    def external_wrench(self, Q: Any, F: Any) -> list[Any]:
        """Return the force, and r x f + R m: the moment m is about the base's axes."""
        return [*F[:3], *add(rotate(Q[3:7], F[3:6]), cross(Q[:3], F[:3]))]

    def external_wrench_rate(self, Q: Any, v: Any, F: Any) -> list[Any]:
        """Return rdot x f + R (omega x m) for the moment."""
        moment = add(rotate(Q[3:7], cross(v[3:6], F[3:6])), cross(v[:3], F[:3]))
        return [0 * F[0], 0 * F[1], 0 * F[2], *moment]

    def base_frame(self, Q: Any) -> Frame:
        """Return the frame at a position and a quaternion."""
        return SpatialFrame([Q[i] for i in range(3)], [Q[i] for i in range(3, 7)])

    def frames(self, poses: Array) -> Array:
        """Take rotation matrices of the quaternions."""
        frames = np.tile(np.eye(4), (len(poses), 1, 1))
        frames[:, :3, 3] = poses[:, :3]
        frames[:, :3, :3] = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
        return frames

    def residual(self, pose: ca.SX, wanted: ca.SX) -> ca.SX:
        """Return position and rotation vector from a wanted pose to the one found."""
        turned = product(conjugate([wanted[i] for i in range(3, 7)]), [pose[i] for i in range(3, 7)])
        return ca.vertcat(pose[:3] - wanted[:3], *log(turned))

    def pointing_error(self, line: ca.SX, pose: ca.SX) -> ca.SX:
        """Return the turns (2,) about the frame's y- and z-axis that would bring its x-axis to a line (3,)."""
        attitude = [pose[i] for i in range(3, 7)]
        x, y, z = rotate(conjugate(attitude), [line[i] for i in range(3)])
        z += TILT / 2 * (ca.norm_2(line) - x)
        # the shortest rotation from (1, 0, 0) to (x, y, z) has the quaternion (|(x, y, z)| + x, 0, -z, y)
        rotation = log([ca.norm_2(ca.vertcat(x, y, z)) + x, 0.0, -z, y])
        return ca.SX(ca.vertcat(rotation[1], rotation[2]))

    def base_rotation(self, Q: ca.SX) -> list[list[Any]]:
        """Return the matrix of the quaternion."""
        return matrix([Q[3 + i] for i in range(4)])

    def moments_to_3d(self, moments: Any) -> list[Any]:
        """Return all of them."""
        return list(moments)

    def to_3d(self, pose: Any) -> tuple[list[Any], list[Any]]:
        """Split position and quaternion."""
        return list(pose[:3]), list(pose[3:])

    def from_3d(self, position: Array, quaternion: Array) -> Array:
        """Join both."""
        return np.concatenate([position, quaternion])

    def twist_to_3d(self, twist: Any) -> tuple[list[Any], list[Any]]:
        """Split linear and angular parts."""
        return list(twist[:3]), list(twist[3:])

    def twist(self, linear: Any, angular: Any) -> list[Any]:
        """Join linear and angular parts."""
        return [*linear, *angular]

    def composed(self, pose: Any, inside: Any) -> Array:
        """Turn the position and multiply the quaternions."""
        position, quaternion = self.to_3d(pose)
        at, turned = self.to_3d(inside)
        return np.array([*add(position, rotate(quaternion, at)), *product(quaternion, turned)])

    def relative(self, pose: Any, to: Any) -> Array:
        """Turn position and quaternion back."""
        position, quaternion = self.to_3d(to)
        at, turned = self.to_3d(pose)
        back = conjugate(quaternion)
        return np.array([*rotate(back, add(at, scaled(position, -1))), *product(back, turned)])

    def pose_error(self, pose: Any, wanted: Any) -> Array:
        """Return position, and the rotation vector of the shorter turn."""
        turned = self.relative(pose, wanted)[self.pose_attitude]
        return np.array([*(np.asarray(pose[:3]) - np.asarray(wanted[:3])), *log(shorter(list(turned)))])


PLANE = PlanarSpace()
SPACE = SpatialSpace()
"""The poses of a free body."""

SPACES: tuple[type[ConfigurationSpace], ...] = (PlanarSpace, SpatialSpace)


def configuration_space(spec: RobotSpec) -> ConfigurationSpace:
    """Return the configuration space of a robot."""
    space = next(space for space in SPACES if space.dimension == spec.dimension)
    return space(sum(spec.parts.values()) - space.n_twist)


def space_of_pose(n_pose: int) -> ConfigurationSpace:
    """Return the space of a free body whose pose has so many coordinates."""
    return next(space for space in (PLANE, SPACE) if space.n_pose == n_pose)


def space_of_inertia(n_principal: int) -> ConfigurationSpace:
    """Return the space of a free body with so many principal moments of inertia."""
    return next(space for space in (PLANE, SPACE) if space.n_principal == n_principal)


def pose_frames(poses: ArrayLike) -> Array:
    """Return the frames (..., 4, 4) of poses: (x, y, angle) in the plane z = 0, or position and quaternion (..., 7)."""
    poses = np.asarray(poses, dtype=float)
    n_pose = poses.shape[-1]
    frames = space_of_pose(n_pose).frames(poses.reshape(-1, n_pose))
    return frames.reshape(*poses.shape[:-1], 4, 4)
