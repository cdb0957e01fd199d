"""What the controller knows of the task's object: its motion, and when the grippers are to be closed on it."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.end import ROUNDING
from psmpc_cli.robot.free_body import FreeBody, body_of, velocity_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import conjugate, rotate
from psmpc_cli.specs.object import CaptureSpec

GAINS = 0.5, 1 / 6
"""alpha and beta of the filter, beta = alpha^2 / (2 - alpha): the best of its kind for a given alpha.

Benedict, Bordner: Synthesis of an optimal set of radar track-while-scan smoothing equations (1962).
"""


@dataclass(frozen=True, eq=False)
class Grip:
    """A gripper that holds the object.

    Attributes:
        pose: Its pose, (3,) or (7,).
        velocity: Its linear velocity in the inertial frame, its angular velocity about its own axes, (3,) or (6,).
    """

    pose: np.ndarray
    velocity: np.ndarray

    @classmethod
    def of(cls, model: RobotModel, gripper: str, Q: np.ndarray, v: np.ndarray) -> "Grip":
        """Return a gripper of a robot at coordinates Q (nq,) and velocities v (n,)."""
        space = model.space
        frame = list(model.pose_rows).index(gripper)
        pose = model.poses(Q)[frame]
        twist = (np.array(model.J_C(Q)) @ v).reshape(-1, space.n_twist)[frame]
        linear, angular = space.lifted_twist(twist)
        _, attitude = space.lifted(pose)
        return cls(pose, np.array(space.twist(linear, rotate(conjugate(attitude), angular))))


@dataclass(frozen=True, eq=False)
class ObjectEstimate:
    """The motion of the object: what the task says of it, corrected by measured poses.

    An alpha-beta filter: pose and velocity are predicted, and a part of what the measured pose differs by corrects
    both. Without measurements it predicts from what the task says. A held object moves with the gripper that holds it:
    its pose is predicted at its place in the gripper, and the velocity is that of this place.

    Attributes:
        body: The object.
        pose: Estimated pose at `time`, (3,) or (7,).
        velocity: Estimated velocity then, (3,) or (6,).
        time: Of the estimate [s].
        measured_at: When its pose was measured last [s]; minus infinity before.
        grip: What holds it at `time`; None where nothing does.
    """

    body: FreeBody
    pose: np.ndarray
    velocity: np.ndarray
    time: float = 0.0
    measured_at: float = -np.inf
    grip: Grip | None = None

    @classmethod
    def of(cls, target_object: CaptureSpec) -> "ObjectEstimate":
        """Return what the task says of its object."""
        return cls(body_of(target_object), np.array(target_object.pose), velocity_of(target_object))

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Predict pose, (3,) or (7,), and velocity at a time [s]."""
        return self.body.predicted(self.pose, self.velocity, time - self.time)

    def with_measurement(self, time: float, pose: np.ndarray | None, grip: Grip | None = None) -> "ObjectEstimate":
        """Return the estimate after a pose measured at a time [s]; one that is not finite, or None, is ignored.

        Args:
            time: Of the measurement.
            pose: The pose, (3,) or (7,).
            grip: What holds the object then.
        """
        if pose is None or not np.isfinite(pose).all():
            return self
        alpha, beta = GAINS
        space = self.body.space
        predicted, velocity = self.at(time)
        if grip is not None and self.grip is not None:
            predicted = space.composed(grip.pose, space.relative(self.pose, self.grip.pose))
        innovation = space.pose_error(pose, predicted)
        corrected = np.array(space.integrate(predicted, alpha * innovation))
        since = time - self.measured_at
        if grip is not None:
            velocity = space.carried_rate(grip.pose, grip.velocity, space.relative(corrected, grip.pose))
        elif np.isfinite(since) and since > 0:
            velocity = velocity + beta / since * innovation
        return ObjectEstimate(self.body, corrected, velocity, time=time, measured_at=time, grip=grip)


def to_be_closed(holding: range, sequence: MovingSequence, ticks: np.ndarray) -> np.ndarray:
    """Tell at which ticks (M,) [s] the grippers are to be closed (M,).

    From the first one at or after the planned switch time with which the stages begin that hold the object until that
    with which they end.

    Args:
        holding: The stages that hold the object; empty of a task without one to hold.
        sequence: The stages in the window, with their planned switch times.
        ticks: Beginnings of the ticks [s].
    """
    if not holding:
        return np.zeros(len(ticks), bool)

    def end(stage: int) -> float:
        if stage < sequence.first:
            return -np.inf
        ends = (*sequence.instants, sequence.ended_at, np.inf)
        return float(ends[min(stage - sequence.first, len(ends) - 1)])

    taken = end(holding.start - 1)
    released = end(holding.stop - 1)
    return np.asarray((ticks >= taken - ROUNDING) & (ticks < released - ROUNDING))
