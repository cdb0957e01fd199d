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
        """Return that of a stage of a task."""
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
                    inside=space.relative(space.neutral, np.array(body.grasp.at[body.holder])),
                )
            )
        controller = task.controller
        steps = int(np.ceil(controller.horizon / controller.sample_time - 1e-9))
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
        """Return the numbers of a sample (size,), the robot moving on as the plan in force says."""
        X = np.tile(sample.x, (len(self.since), 1))
        space = model.space
        attitude = np.array(model.neutral)
        attitude[space.attitude] = sample.anchor
        if sample.plan is not None:
            X[1:] = sample.plan.states_at(np.minimum(sample.time + self.since[1:], sample.plan.end))
        Q, _ = space.chart_at(attitude).from_chart(X)
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
        """Return low and high (N, K) of what the others give over the intervals between N + 1 times.

        Args:
            normals: Along which (K, d), see `Thrusters.bounds`.
            unloading: By how much what unloads wheels may change it (K,).
            numbers: The numbers of a sample (size,).
            since: The times since the sample [s].
        """
        first = np.searchsorted(self.since, since[:-1] + 1e-9, side="right") - 1
        last = np.searchsorted(self.since, since[1:] - 1e-9, side="left")
        before = np.vstack([np.zeros(self.thrusters.count, int), self.is_shut(numbers).cumsum(axis=0)])
        count = before[np.minimum(last + 1, len(self.since))] - before[np.minimum(first, len(self.since) - 1)]
        low, high = self.thrusters.bounds(normals, count > 0)
        least, most = self.thrusters.bounds(normals, np.zeros((1, self.thrusters.count), bool))
        low = np.minimum(low + unloading, 0.0)
        high = np.maximum(high - unloading, 0.0)
        room = np.maximum(NARROWEST * (most - least) - (high - low), 0.0) / 2
        return low - room, high + room
