"""How soon a robot at rest can take poses, with limits of the velocity and acceleration of each coordinate."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import conjugate, rotate

STEPS = 0.2 * 0.8 ** np.arange(12)
"""Largest steps of a coordinate, one after another, for which poses count as linear [m, rad].

They shrink: near a curved optimum steps of one size would go to and fro.
"""

PER_LENGTH = 1e-3
"""What a step costs beside the time, so that of several quickest motions the nearest counts [s/m, s/rad]."""


@dataclass(frozen=True, eq=False)
class RestToRest:
    """The fastest motion of each coordinate from rest to rest: its velocity rises, stays and falls again (a trapezoid).

    Attributes:
        velocity: Largest velocity of each (n,) [m/s, rad/s]; infinite where it has no limit.
        acceleration: Its largest acceleration (n,) [m/s^2, rad/s^2], likewise.
        low: Its lowest coordinate (n,) [m, rad], likewise.
        high: Its highest.
    """

    velocity: np.ndarray
    acceleration: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def ramp(self) -> np.ndarray:
        """How long each takes to gain its largest velocity (n,) [s]."""
        with np.errstate(all="ignore"):
            return np.where(np.isfinite(self.acceleration), self.velocity / self.acceleration, 0.0)

    def distances(self, times: np.ndarray) -> np.ndarray:
        """Return how far each comes in a time of its own [s], (n,) [m, rad]."""
        with np.errstate(all="ignore"):
            short = self.acceleration * times**2 / 4
            long = self.velocity * (times - self.ramp)
        return np.where(times > 0, np.where(times < 2 * self.ramp, short, long), 0.0)

    def slopes(self, times: np.ndarray) -> np.ndarray:
        """Return the derivatives of `distances` by the times (n,), which grow with the times."""
        with np.errstate(all="ignore"):
            return np.where(times < 2 * self.ramp, self.acceleration * np.maximum(times, 0.0) / 2, self.velocity)

    def times(self, displacements: np.ndarray) -> np.ndarray:
        """Return how long each takes for a displacement (n,) [s]; infinite where it cannot move."""
        distances = np.abs(displacements)
        with np.errstate(all="ignore"):
            short = 2 * np.sqrt(distances / self.acceleration)
            long = distances / self.velocity + self.ramp
            is_short = distances < self.velocity * self.ramp
        return np.where(distances > 0, np.where(is_short, short, long), 0.0)


@dataclass(frozen=True, eq=False)
class Begin:
    """Where a motion begins, and when.

    Attributes:
        Q: Coordinates of the robot (nq,).
        ahead: How long before time 0 each coordinate begins to move (n,) [s].
    """

    Q: np.ndarray
    ahead: np.ndarray


def earliest_arrival(
    model: RobotModel,
    motion: RestToRest,
    begin: Begin,
    end: np.ndarray,
    poses: Mapping[str, np.ndarray],
    is_free: np.ndarray,
) -> tuple[float, np.ndarray]:
    """Return the earliest time at which end-effectors take poses [s], and the coordinates with which they do (nq,).

    Base and arms share the motion, and many coordinates take the same poses: those are sought that are reached first.
    With delta for the step from coordinates Q that nearly take the poses,

        minimize t  subject to  J(Q) delta = -error(Q)  and  |Q + delta - Q_begin| <= d(t + ahead)

    where the distances d, that coordinates can go in a time, are linearized in t. They are convex, so that the
    linearization allows nothing that they forbid. It is repeated at Q + delta, and comes to a local minimum near the
    coordinates that it starts from. It stops early at time 0, and where no step has a solution.

    Args:
        model: The robot.
        motion: The fastest motion of each coordinate from rest to rest, which gives d.
        begin: Where the motion begins, and how long before time 0 each coordinate begins to move.
        end: Coordinates that take the poses (nq,), from which the search starts.
        poses: The pose of each end-effector, (3,) or (7,) [m, rad], by arm.
        is_free: Coordinates of v that may end elsewhere than at those of `end` (n,).
    """
    space = model.space
    Q = end
    time = _time_of(model, motion, begin, Q)
    for largest in STEPS if poses else ():
        if time <= 0 or not np.isfinite(time):
            break
        step = _step_of_linear_program(model, motion, begin, Q, poses, np.where(is_free, largest, 0.0), time)
        if step is None:
            break
        Q = np.array(space.integrate(Q.tolist(), step.tolist()))
        time = _time_of(model, motion, begin, Q)
    return time, Q


def _time_of(model: RobotModel, motion: RestToRest, begin: Begin, Q: np.ndarray) -> float:
    """Return when the last coordinate is at those of Q (nq,) [s]."""
    times = motion.times(np.array(model.space.difference(begin.Q, Q)))
    return float(np.max(times - begin.ahead, where=times > 0, initial=0.0))


def _step_of_linear_program(
    model: RobotModel,
    motion: RestToRest,
    begin: Begin,
    Q: np.ndarray,
    poses: Mapping[str, np.ndarray],
    largest: np.ndarray,
    time: float,
) -> np.ndarray | None:
    """Solve the linear program of `earliest_arrival` about coordinates Q and a time, both linearization points.

    Its unknowns are the positive and the negative part of the step delta, (n,) each, and the time t. It minimizes t,
    and `PER_LENGTH` times the length of the step.

    Args:
        model: The robot.
        motion: The fastest motion of each coordinate from rest to rest.
        begin: Where the motion begins, and how long before time 0 each coordinate begins to move.
        Q: Coordinates that nearly take the poses (nq,).
        poses: The pose of each end-effector, (3,) or (7,) [m, rad], by arm.
        largest: Largest step of each coordinate (n,) [m, rad]; 0 where it has to stay.
        time: Time about which distances are linearized [s].

    Returns:
        The step delta (n,); None if the program has no solution.
    """
    from scipy.optimize import linprog

    space = model.space
    error, jacobian = _pose_errors(model, Q, poses)
    moved = np.array(space.difference(begin.Q, Q))
    times = time + begin.ahead
    reach = motion.distances(times)
    slope = motion.slopes(times)
    limited = np.flatnonzero(np.isfinite(reach))  # coordinates without limits may go anywhere
    rows = np.hstack([np.eye(model.n), -np.eye(model.n)])[limited]  # of the step's positive and negative parts
    at_zero = reach[limited] - slope[limited] * time  # the linearized distance at t = 0
    # Both signs of |moved + delta| <= at_zero + slope t.
    A = np.block([[rows, -slope[limited, None]], [-rows, -slope[limited, None]]])
    b = np.concatenate([at_zero - moved[limited], at_zero + moved[limited]])
    coordinates = np.nan_to_num(space.in_order_of_v(Q))  # an attitude has no limits
    low = np.clip(motion.low - coordinates, -largest, 0.0)
    high = np.clip(motion.high - coordinates, 0.0, largest)
    solved = linprog(
        np.append(np.full(2 * model.n, PER_LENGTH), 1.0),
        A_ub=A,
        b_ub=b,
        A_eq=np.hstack([jacobian, -jacobian, np.zeros((len(jacobian), 1))]),
        b_eq=-error,
        bounds=[*((0.0, most) for most in (*high, *-low)), (0.0, None)],
    )
    return np.subtract(*np.split(solved.x[:-1], 2)) if solved.status == 0 else None


def _pose_errors(model: RobotModel, Q: np.ndarray, poses: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much end-effectors miss poses (rows,) [m, rad], and the derivative of that by v (rows, n).

    The derivative holds near the poses, where the rate of an error of the attitude is the angular velocity about the
    axes of the end-effector.
    """
    frames = list(model.pose_rows)
    at = model.poses(Q)
    # Columns of all Jacobians: the twists of the frames for a unit velocity of each coordinate.
    twists = model.twists(np.tile(Q, (model.n, 1)), np.eye(model.n)).reshape(model.n, len(frames), -1)
    errors = []
    jacobians = []
    for arm, wanted in poses.items():
        frame = frames.index(arm)
        errors.append(model.space.pose_error(at[frame], wanted))
        jacobians.append(np.transpose([_about_own_axes(model, at[frame], v) for v in twists[:, frame]]))
    return np.concatenate(errors), np.vstack(jacobians)


def _about_own_axes(model: RobotModel, pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Return a velocity of a pose with its angular part about the axes of the pose, from that about inertial axes."""
    _, quaternion = model.space.to_3d(pose.tolist())
    linear, angular = model.space.twist_to_3d(twist.tolist())
    return np.array(model.space.twist(linear, rotate(conjugate(quaternion), angular)))
