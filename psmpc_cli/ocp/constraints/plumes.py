"""Which thrusters are shut because of their plumes, at a sample and along the plan in force.

A thruster is shut while its plume reaches the object or an obstacle (robot/actuators/plumes.py). What the others give
is bounded by the planes of all of them, nearer to each other (robot/actuators/thrusters.py): so the rows of forces are
the same, and numbers that samples set say how far apart their bounds are over each interval
(ocp/constraints/forces.py).

The plan in force is looked at once a sample time. A thruster counts as shut over an interval if it is at any of these
times in it, or next to it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from psmpc_cli.ocp.constraints.clearance import (
    PoseState,
    Solid,
    cover_of_object,
    poses_after,
    solids_of_obstacle,
    state_of_obstacle,
)
from psmpc_cli.ocp.stage import SampleContext, Stage
from psmpc_cli.robot.actuators.plumes import Plumes
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.kinematics import SpatialFrame
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec

NARROWEST = 1e-6
"""Least distance of two bounds, as a part of that with all thrusters: interior-point methods need room between them."""


@dataclass(frozen=True, eq=False)
class Surrounding:
    """A body that plumes are kept off.

    Attributes:
        solids: Its shapes.
        state: What a sample has -> pose and velocity of a body that moves by itself, or None where that is not known.
        gripper: The arm that holds it in the stage; None of one that moves by itself.
        inside: Its pose in that gripper as the task has it (n_pose,).
    """

    solids: tuple[Solid, ...]
    state: Callable[[SampleContext], PoseState | None]
    gripper: str | None = None
    inside: np.ndarray | None = None

    def poses(self, model: RobotModel, sample: SampleContext, Q: np.ndarray, since: np.ndarray) -> np.ndarray | None:
        """Return its poses (n_pose, P) at times since a sample (P,) [s], the robot being at Q (P, nq); None if unknown.

        In the gripper it is where the sample has it, or as the task says while it is yet to be taken.
        """
        state = self.state(sample)
        if self.gripper is None:
            return None if state is None else poses_after(model, *state, since).T
        of_gripper = model.poses(Q)[:, list(model.pose_rows).index(self.gripper)].T
        inside = self.inside
        if sample.is_current and state is not None:
            inside = model.space.relative(state[0], of_gripper[:, 0])
        return model.space.composed(of_gripper, inside)


@dataclass(frozen=True, eq=False)
class PlumeForecast:
    """Which of the thrusters are shut in a stage that avoids plumes, at times since a sample.

    It stands in numbers: eight thrusters, one bit each, are one number at each of the times.

    Attributes:
        thrusters: The thrusters.
        plumes: Their plumes.
        surroundings: What these are kept off.
        since: The times (P,) [s], 0 first.
    """

    thrusters: Thrusters
    plumes: Plumes
    surroundings: tuple[Surrounding, ...]
    since: np.ndarray

    @classmethod
    def of(cls, task: TaskSpec, model: RobotModel, stage: int) -> "PlumeForecast":
        """Return the forecast for a stage of a task in which thrusters are shut while their plume would reach a body.

        The bodies that plumes are kept off are the obstacles and, if it has a mass, the object, which is free or in the
        gripper that holds it in the stage. The forecast has one entry for each sample time over the horizon.

        Args:
            task: The task.
            model: The robot.
            stage: Index of the stage.
        """
        surroundings = [
            Surrounding(solids_of_obstacle(obstacle), partial(state_of_obstacle, obstacle, model))
            for obstacle in task.obstacles
        ]
        body = task.body
        if body.mass:
            is_held = stage in task.held_stages
            space = model.space
            surroundings.append(
                Surrounding(
                    solids=tuple(cover_of_object(body.shape)),
                    state=lambda sample: sample.object_state,
                    gripper=body.holder if is_held else None,
                    # `grasp.at` is the pose of the gripper on the object; the object in the gripper is its inverse
                    inside=space.relative(space.neutral, np.array(body.grasp.at[body.holder])),
                )
            )
        controller = task.controller
        steps = int(np.ceil(controller.horizon / controller.sample_time - 1e-9))  # a multiple but for rounding is one
        return cls(
            thrusters=Thrusters.of(model.spec.thrusters),
            plumes=Plumes.of(model.spec.thrusters),
            surroundings=tuple(surroundings),
            since=controller.sample_time * np.arange(steps + 1),
        )

    @property
    def size(self) -> int:
        """How many numbers it takes."""
        return len(self.since) * self._bytes

    @property
    def _bytes(self) -> int:
        """How many numbers it takes at each time."""
        return (self.thrusters.count + 7) // 8

    def numbers(self, model: RobotModel, sample: SampleContext) -> np.ndarray:
        """Forecast which thrusters are shut from a sample on, the robot moving as the plan in force says.

        A thruster is shut while its plume reaches a body. Beyond the end of the plan the robot stays where that ends;
        bodies whose pose is not known are left out.

        Args:
            model: The robot.
            sample: The sample: measured state, plan in force, pose and velocity of the object.

        Returns:
            (size,) numbers between 0 and 255: at each time of `since` the thrusters' bits, 1 for shut, eight to a
            number.
        """
        X = np.tile(sample.x, (len(self.since), 1))  # without a plan the robot stays
        if sample.plan is not None:
            X[1:] = sample.plan.states_at(np.minimum(sample.time + self.since[1:], sample.plan.end))
        space = model.space
        # a configuration with the attitude of the anchor makes the chart that the states are in
        Q_at_anchor = np.array(model.neutral)
        Q_at_anchor[space.attitude] = sample.anchor
        Q, _ = space.chart_at(Q_at_anchor).from_chart(X)
        base = SpatialFrame(*space.to_3d(model.poses(Q)[:, 0].T))
        is_shut = np.zeros((len(Q), self.thrusters.count), bool)
        for body in self.surroundings:
            poses = body.poses(model, sample, Q, self.since)
            if poses is None:
                continue
            frame = SpatialFrame(*space.to_3d(poses))
            for solid in body.solids:
                is_shut |= self.plumes.reach(base, solid.shape, frame.carried(solid.at))
        return np.packbits(is_shut, axis=1).astype(float).ravel()

    def is_shut(self, numbers: np.ndarray) -> np.ndarray:
        """Return which thrusters are shut at the times, of the numbers (size,) of a sample, (P, T)."""
        packed = numbers.reshape(len(self.since), self._bytes).astype(np.uint8)
        return np.unpackbits(packed, axis=1, count=self.thrusters.count).astype(bool)

    def shut_now(self, stage: Stage) -> np.ndarray:
        """Return which thrusters are shut at the sample that has set the numbers of a stage (T,)."""
        constraint = next(each for each in stage.constraints.values() if each.for_bounds)
        return np.asarray(self.is_shut(constraint.of_bounds)[0])

    def bounds(
        self, normals: np.ndarray, unloading: np.ndarray, numbers: np.ndarray, since: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return what the thrusters that are not shut can give over the intervals of a plan.

        A thruster counts as shut over an interval if the forecast has it shut at one of its times inside the interval,
        or at the nearest one before or after it.

        Args:
            normals: Combinations of the force on the base that are bounded, (K, d), see `Thrusters.bounds`.
            unloading: What thrusters keep back of each combination to balance the unloading of wheels, (K,).
            numbers: The forecast of a sample, (size,), see `numbers`.
            since: The times (N + 1,) at which the intervals begin and end, counted from the sample [s].

        Returns:
            Low and high of each combination over each interval, (N, K) each.
        """
        # The last time of the forecast before an interval and the first one after it; rounding does not count.
        first = np.searchsorted(self.since, since[:-1] + 1e-9, side="right") - 1
        last = np.searchsorted(self.since, since[1:] - 1e-9, side="left")
        # How often each thruster is shut from `first` to `last`: a difference of cumulative counts.
        times_shut_before = np.vstack([np.zeros(self.thrusters.count, int), self.is_shut(numbers).cumsum(axis=0)])
        shut_up_to_last = times_shut_before[np.minimum(last + 1, len(self.since))]
        shut_before_first = times_shut_before[np.minimum(first, len(self.since) - 1)]
        low, high = self.thrusters.bounds(normals, shut_up_to_last - shut_before_first > 0)
        # no force at all stays possible: low <= 0 <= high
        low = np.minimum(low + unloading, 0.0)
        high = np.maximum(high - unloading, 0.0)
        # Bounds that meet leave an interior-point method no interior: they are moved apart a little.
        all_low, all_high = self.thrusters.bounds(normals, np.zeros((1, self.thrusters.count), bool))
        missing_width = np.maximum(NARROWEST * (all_high - all_low) - (high - low), 0.0)
        return low - missing_width / 2, high + missing_width / 2
