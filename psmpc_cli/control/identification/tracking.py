"""What the controller knows of the task's object: its motion, and when the grippers are to be closed on it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.ocp.end import ROUNDING
from psmpc_cli.ocp.problem import ObjectState
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.robot.free_body import FreeBody, body_of, velocity_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.rotations import conjugate, rotate
from psmpc_cli.specs.object import ObjectBody

Poses = Mapping[str, np.ndarray]
"""Poses of frames, (3,) or (7,), by name."""

GAIN = 0.5
"""Gain alpha of the filter where the task says none."""


def gain_of_velocity(alpha: float) -> float:
    """Return the filter's gain beta of the velocity, the best one for the gain alpha of the pose.

    Benedict, Bordner: Synthesis of an optimal set of radar track-while-scan smoothing equations (1962).
    """
    return alpha**2 / (2 - alpha)


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
        linear, angular = space.twist_to_3d(twist)
        _, attitude = space.to_3d(pose)
        return cls(pose, np.array(space.twist(linear, rotate(conjugate(attitude), angular))))


class ObjectEstimate(ABC):
    """What the controller knows of the motion of the task's object.

    Attributes:
        measured_at: When its pose was measured last [s]; minus infinity before.
    """

    measured_at: float

    @abstractmethod
    def at(self, time: float) -> ObjectState | None:
        """Predict pose, (3,) or (7,), and velocity at a time [s]; None where there is no object."""

    @abstractmethod
    def with_measurement(self, time: float, pose: np.ndarray | None, grip: Grip | None = None) -> "ObjectEstimate":
        """Return the estimate after a pose measured at a time [s]; one that is not finite, or None, is ignored.

        Args:
            time: Of the measurement.
            pose: The pose, (3,) or (7,).
            grip: What holds the object then.
        """

    @abstractmethod
    def carried(self, duration: float, grip: Grip | None) -> "ObjectEstimate":
        """Return the estimate after a time [s] in which what held the object has come to `grip`, or nothing did."""

    @abstractmethod
    def place(self, stage: PlacedStage, time: float) -> PlacedStage:
        """Return a stage with the parts of its target that are on the object where it is at a time [s]."""

    @abstractmethod
    def follow(self, stage: PlacedStage, time: float, elapsed: float, horizon: float) -> PlacedStage:
        """Return a stage whose cost follows the object over a horizon from a time on, begun so long before [s]."""

    @abstractmethod
    def hold(self, stages: Sequence[PlacedStage], time: float, grippers: Poses) -> tuple[PlacedStage, ...]:
        """Return stages with the object where it is, at a time [s], in the grippers that hold it, of these poses."""


class _NoObject(ObjectEstimate):
    """Of a task without an object that has a mass."""

    measured_at = -np.inf

    def at(self, time: float) -> None:
        """Return None."""
        return

    def with_measurement(self, time: float, pose: np.ndarray | None, grip: Grip | None = None) -> ObjectEstimate:
        """Return this."""
        return self

    def carried(self, duration: float, grip: Grip | None) -> ObjectEstimate:
        """Return this."""
        return self

    def place(self, stage: PlacedStage, time: float) -> PlacedStage:
        """Return the stage."""
        return stage

    def follow(self, stage: PlacedStage, time: float, elapsed: float, horizon: float) -> PlacedStage:
        """Return the stage."""
        return stage

    def hold(self, stages: Sequence[PlacedStage], time: float, grippers: Poses) -> tuple[PlacedStage, ...]:
        """Return the stages."""
        return tuple(stages)


NO_OBJECT = _NoObject()


def object_estimate(target_object: ObjectBody, gain: float = GAIN) -> ObjectEstimate:
    """Return what the task says of its object, to be corrected by measured poses with a gain alpha."""
    return FilteredObject.of(target_object, gain) if target_object.mass else NO_OBJECT


@dataclass(frozen=True, eq=False)
class FilteredObject(ObjectEstimate):
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
        gain: Of the filter, alpha: the part of the difference that corrects the pose.
    """

    body: FreeBody
    pose: np.ndarray
    velocity: np.ndarray
    time: float = 0.0
    measured_at: float = -np.inf
    grip: Grip | None = None
    gain: float = GAIN

    @classmethod
    def of(cls, target_object: ObjectBody, gain: float = GAIN) -> "FilteredObject":
        """Return what the task says of its object."""
        return cls(body_of(target_object), np.array(target_object.pose), velocity_of(target_object), gain=gain)

    def at(self, time: float) -> ObjectState:
        """Predict pose and velocity by the body's free motion."""
        return self.body.predicted(self.pose, self.velocity, time - self.time)

    def with_measurement(self, time: float, pose: np.ndarray | None, grip: Grip | None = None) -> "FilteredObject":
        """Return the estimate corrected by a measured pose: one step of an alpha-beta filter.

        The pose that is predicted for the time is corrected by the part alpha of its difference to the measured one.
        The velocity of a free object is corrected by the part beta of this difference, over the time since the last
        measurement. An object in a gripper is predicted to stay where it was in the gripper, and its velocity is that
        of this place.

        Args:
            time: Of the measurement [s].
            pose: The measured pose, (3,) or (7,); if it is None or not finite, the estimate stays as it is.
            grip: The gripper that holds the object then; None if none does.
        """
        if pose is None or not np.isfinite(pose).all():
            return self
        alpha = self.gain
        beta = gain_of_velocity(alpha)
        space = self.body.space
        predicted, velocity = self.at(time)
        if grip is not None and self.grip is not None:  # held at both measurements
            predicted = space.composed(grip.pose, space.relative(self.pose, self.grip.pose))
        innovation = space.pose_error(pose, predicted)
        corrected = np.array(space.integrate(predicted, alpha * innovation))
        since = time - self.measured_at
        if grip is not None:
            velocity = space.carried_rate(grip.pose, grip.velocity, space.relative(corrected, grip.pose))
        elif np.isfinite(since) and since > 0:
            velocity = velocity + beta / since * innovation
        return replace(self, pose=corrected, velocity=velocity, time=time, measured_at=time, grip=grip)

    def carried(self, duration: float, grip: Grip | None) -> "FilteredObject":
        """Return the estimate with the object at its place in the gripper, where that has come to; else as it moves."""
        later = replace(self, measured_at=self.measured_at + duration)
        if grip is None or self.grip is None:
            return later
        space = self.body.space
        place = space.relative(self.pose, self.grip.pose)
        velocity = space.carried_rate(grip.pose, grip.velocity, place)
        pose = space.composed(grip.pose, place)
        return replace(later, pose=pose, velocity=velocity, time=self.time + duration, grip=grip)

    def place(self, stage: PlacedStage, time: float) -> PlacedStage:
        """Return the stage with its target where the object has it."""
        return stage.at_object(*self.at(time)) if stage.on_object else stage

    def follow(self, stage: PlacedStage, time: float, elapsed: float, horizon: float) -> PlacedStage:
        """Return the stage following the object's free motion."""
        return stage.following(self.body, np.concatenate(self.at(time)), elapsed, horizon) if stage.on_object else stage

    def hold(self, stages: Sequence[PlacedStage], time: float, grippers: Poses) -> tuple[PlacedStage, ...]:
        """Return the stages with the object where it is."""
        pose, v = self.at(time)
        return tuple(stage.with_held_object(grippers, pose, v) for stage in stages)


def to_be_closed(holding: range, sequence: MovingSequence, ticks: np.ndarray) -> np.ndarray:
    """Tell at which ticks of the low-level loop the grippers are to be closed on the object.

    They close with the first tick at or after the planned end of the stage before the stages that hold the object, and
    open with the first one at or after the planned end of the last of these stages.

    Args:
        holding: Indices of the stages that hold the object; empty of a task without an object to hold.
        sequence: The stages in the window, with their planned switch times.
        ticks: Beginnings of the ticks (M,) [s].

    Returns:
        Whether they are to be closed, at each tick (M,).
    """
    if not holding:
        return np.zeros(len(ticks), bool)

    def planned_end(stage: int) -> float:
        if stage < sequence.first:
            return -np.inf
        # of the stages in the window; after these of the task's last stage, if it is over
        ends = (*sequence.switch_times, sequence.ended_at, np.inf)
        return float(ends[min(stage - sequence.first, len(ends) - 1)])

    closing = planned_end(holding.start - 1)
    opening = planned_end(holding.stop - 1)
    return np.asarray((ticks >= closing - ROUNDING) & (ticks < opening - ROUNDING))
