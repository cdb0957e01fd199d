"""The task's stages as numbers: vectors in the order of Q or xi, rows of the end condition, limits in force."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.skills import SKILLS
from psmpc_cli.robot.model import RobotModel, angle_rows, nearest_equivalent
from psmpc_cli.specs.coordinates import Limits, Space, resolve_limits, rows, stack, stack_rows, tolerances
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import SkillSpec, StageSpec, TaskSpec, TrajectorySpec

Vector = np.ndarray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A desired trajectory: values (T, rows) at times (T,) [s] since the stage began, interpolated between."""

    times: Vector
    values: Vector


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of the task, resolved for one robot.

    Attributes:
        target: Target in the order of Q (n,) or xi (m,) [m, rad]; of a trajectory, its last value.
        trajectory: The desired trajectory the cost follows, or None where it is the target throughout.
        weights: Diagonal of W_q or W_p, as `target`.
        control_weights: Diagonal of W_r, one per input.
        end_rows: Rows of the error on which the end condition (18) stands; empty where `at` is given.
        tolerance: Its tolerance, one per end row [m, rad].
        end_velocity: Bound on the rate of those rows [m/s, rad/s], or None.
        at: Fixed switching time [s], or None.
        dwell: Minimum duration [s], that of the trajectory at least.
        onset_rows: Rows of the control whose norm marks the actual start.
    """

    index: int
    name: str
    space: str
    input: str
    priority: float
    target: Vector
    trajectory: Trajectory | None
    weights: Vector
    control_weights: Vector
    end_rows: tuple[int, ...]
    tolerance: Vector
    end_velocity: float | None
    at: float | None
    dwell: float
    limits: Limits
    onset_rows: tuple[int, ...]

    @property
    def waypoints(self) -> Vector:
        """What the target leads through (T, rows) [m, rad]: the rows of the trajectory, or the target alone."""
        return self.target[None] if self.trajectory is None else self.trajectory.values

    def reference(self, since: Vector) -> Vector:
        """Return what the cost follows at times since the stage began (K,) [s]: (K, rows)."""
        if self.trajectory is None:
            return np.tile(self.target, (len(since), 1))
        times, values = self.trajectory.times, self.trajectory.values
        return np.column_stack([np.interp(since, times, column) for column in values.T])

    def rate(self, since: Vector) -> Vector:
        """Return how fast that moves just after times since the stage began (K,) [s]: (K, rows) [m/s, rad/s]."""
        if self.trajectory is None:
            return np.zeros((len(since), len(self.target)))
        times, values = self.trajectory.times, self.trajectory.values
        rates = np.diff(values, axis=0) / np.diff(times)[:, None]
        rest = np.zeros((1, values.shape[1]))
        return np.asarray(np.vstack([rest, rates, rest])[np.searchsorted(times, since, side="right")])


def build_stages(task: TaskSpec, robot: RobotSpec, model: RobotModel) -> tuple[Stage, ...]:
    """Return the task's stages, resolved; target angles become the nearest equivalent ones along the sequence."""
    waypoints = _unwrapped_waypoints(task, robot, model)
    return tuple(_stage(i, task, robot, model, values) for i, values in enumerate(waypoints))


def _stage(index: int, task: TaskSpec, robot: RobotSpec, model: RobotModel, waypoints: Vector) -> Stage:
    spec = task.stages[index]
    trajectory = Trajectory(np.array(spec.target.times), waypoints) if isinstance(spec.target, TrajectorySpec) else None
    skill = task.skills[spec.skill]
    end = spec.ends_when if spec.at is None else None
    return Stage(
        index=index,
        name=spec.name,
        space=skill.space,
        input=skill.input,
        priority=spec.priority,
        target=waypoints[-1],
        trajectory=trajectory,
        weights=stack(skill.weights.parts, robot, skill.space),
        control_weights=_control_weights(skill, robot, model),
        end_rows=() if end is None else rows(end.coordinates, robot, skill.space),
        tolerance=np.zeros(0) if end is None else tolerances(end, robot, skill.space),
        end_velocity=None if end is None else end.velocity,
        at=spec.at,
        dwell=spec.dwell if trajectory is None else max(spec.dwell, float(trajectory.times[-1])),
        limits=resolve_limits(robot, task.limits, skill.limits),
        onset_rows=_onset_rows(task.stages, index, task, robot),
    )


def _control_weights(skill: SkillSpec, robot: RobotSpec, model: RobotModel) -> Vector:
    control = skill.weights.control
    if isinstance(control, float | int):
        return np.full(model.n if skill.input == "joint" else model.m, float(control))
    return stack(control, robot, skill.input)


def _onset_rows(stages: Sequence[StageSpec], index: int, task: TaskSpec, robot: RobotSpec) -> tuple[int, ...]:
    """Return the stage's onset coordinates in Q; by default all of them."""
    names = stages[index].onset
    return rows(names if names is not None else ("all",), robot, "joint")


def _unwrapped_waypoints(task: TaskSpec, robot: RobotSpec, model: RobotModel) -> list[Vector]:
    """Return what every stage's target leads through, (T, rows) each.

    Each angle is moved to the equivalent nearest to where the sequence stands before: for the first row that is where
    the stage before leads to, for every other row it is the row before.
    """
    Q = stack(task.initial, robot, "joint")
    xi = np.asarray(model.g(Q)).ravel()
    angles = angle_rows(model)
    found = []
    for spec in task.stages:
        space = task.skills[spec.skill].space
        waypoints = _waypoints(spec, robot, space)
        before, turning = (Q, list(angles.Q)) if space == "joint" else (xi, list(angles.xi))
        if spec.angles == "nearest":
            waypoints[:, turning] = _unwrapped(before[turning], waypoints[:, turning])
        found.append(waypoints)
        target = waypoints[-1]
        if space == "joint":
            Q, xi = target, np.asarray(model.g(target)).ravel()
        else:
            base = model.pose_rows["base"]
            xi, Q = target, np.r_[target[base], Q[model.parts["base"].stop :]]
    return found


def _waypoints(spec: StageSpec, robot: RobotSpec, space: Space) -> Vector:
    """Return the rows of a stage's target as given, (T, rows)."""
    if isinstance(spec.target, TrajectorySpec):
        return stack_rows(spec.target, robot, space)
    return stack(spec.target, robot, space)[None]


def _unwrapped(before: Vector, rows: Vector) -> Vector:
    """Return rows of angles (T, angles) [rad], each moved to the equivalents nearest to the row before it."""
    moved = []
    for row in rows:
        before = nearest_equivalent(before, row)
        moved.append(before)
    return np.array(moved)


def error_rows(stage: Stage, model: RobotModel) -> int:
    """Return the number of rows of the stage's error."""
    return SKILLS[stage.space].rows(model)
