"""A task made computable: the robot's model, the stages as numbers, the functions of the skills on arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from psmpc_cli.ocp.constraints import CONSTRAINTS
from psmpc_cli.ocp.constraints.base import numbers_by_name
from psmpc_cli.ocp.end import MEASURES, AtTime, ByObject, ByState, End
from psmpc_cli.ocp.loads import UNWEIGHED_LOAD, known_load
from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.reference import Constant, Reference, Trajectory
from psmpc_cli.ocp.skills import Posture, skill_in
from psmpc_cli.ocp.stage import JERK, ConstraintNumbers, PlacedStage, PlaceOnObject, Stage
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.low_level import LowLevelLaw, low_level_law
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.object import ObjectBody, OnObject
from psmpc_cli.specs.parts import Space
from psmpc_cli.specs.robot import RobotSpec, resolve_limits, rows, stack
from psmpc_cli.specs.task import SkillSpec, StageSpec, TaskSpec, TrajectorySpec

ObjectState = tuple[np.ndarray, np.ndarray]
"""Pose of the object (3,) or (7,) and its velocity (3,) or (6,)."""

POSTURE = 1e-3
"""Weight of a redundant arm's posture, over the largest of its pose."""


def in_own_chart(
    model: RobotModel,
    stage: Stage,
    Q: np.ndarray,
    v: np.ndarray,
    since: float | None = None,
    object_state: ObjectState | None = None,
) -> tuple[PlacedStage, np.ndarray]:
    """Return a stage of a problem and a state (2n,), both in the chart about the attitude in Q (nq,).

    Of the two quaternions for an attitude of the target it has the nearer one; of a trajectory the target is that at a
    time `since` the stage began [s], its end without one; a target relative to the object is where the object has it,
    without a state of the object where that was at the start.
    """
    placed = stage.unplaced_copy()
    if stage.on_object and object_state is not None:
        placed = placed.at_object(*object_state)
    chart = model.space.chart_at(Q)
    x = np.asarray(chart.to_chart(Q[None], v[None])[0])
    poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    target = placed.wanted(since)
    nearer = {frame: float(target[at : at + 4] @ poses[frame][3:]) for frame, at in stage.attitudes.items()}
    signs = {frame: np.sign(w) or 1.0 for frame, w in nearer.items()}
    return placed.in_chart(chart.anchor, model.space.posture(Q[model.space.joint_coordinates]), signs), x


@dataclass(frozen=True, eq=False)
class Problem:
    """What controllers and solvers need of a task.

    Attributes:
        task: The task.
        model: Its robot as CasADi functions.
        stages: Its stages, resolved for the robot.
        costs: Errors, costs and end conditions of the stages on arrays.
    """

    task: Task
    model: RobotModel
    stages: tuple[Stage, ...]
    costs: StageCosts

    def __repr__(self) -> str:
        return f"<Problem of {self.spec.name}: {len(self.stages)} stages, {self.model.n} degrees of freedom>"

    @cached_property
    def spec(self) -> TaskSpec:
        """The task as validated data."""
        return self.task.spec

    @cached_property
    def body(self) -> ObjectBody:
        """The object as a rigid body, of mass 0 where the task has none."""
        return self.spec.body

    @cached_property
    def held_stages(self) -> range:
        """The stages in which grippers hold an object with a mass; none without one."""
        return self.spec.carrying_stages

    def retargeted(self, stage: str, target: Any) -> "Problem":
        """Return the problem of the same task with another target of a stage; robot and functions are the same.

        Args:
            stage: Name of the stage.
            target: Its target, as a task file has it.

        Raises:
            SpecError: The target is none of the stage; the message is that about the task's file.
        """
        before = self.task
        changes = {f"stages.{stage}.target": target}
        task = parse_task(before.task_yaml, before.robot_yaml, before.spec.name, changes)
        return replace(self, task=task, stages=build_stages(task.spec, task.robot, self.model))

    @cached_property
    def limits_are_soft(self) -> bool:
        """Whether limits on the states may be violated at a cost.

        By default where a measured state may violate them: by noise; or by ramps, which have other velocities than the
        plan, after which a limited jerk leaves no room.
        """
        soft = self.spec.controller.soft_limits
        if soft is not None:
            return soft
        return self.spec.uncertainty.measures_with_noise or any(JERK in stage.constraints for stage in self.stages)

    @cached_property
    def law(self) -> LowLevelLaw:
        """The low-level law, with what it knows of the object."""
        return low_level_law(self.model, body_of(self.body), self.body.grasp)


def build_problem(task: Task) -> Problem:
    """Build the problem of a task."""
    model = RobotModel(task.robot)
    return Problem(task, model, build_stages(task.spec, task.robot, model), StageCosts(model))


def build_stages(task: TaskSpec, robot: RobotSpec, model: RobotModel) -> tuple[Stage, ...]:
    """Return the task's stages, resolved; target angles become the nearest equivalent ones along the sequence."""
    waypoints = _unwrapped_waypoints(task, robot, model)
    stages = (_stage(i, task, robot, model, values) for i, values in enumerate(waypoints))
    return tuple(_with_constraints(_on_object(stage, task, model), task, model) for stage in stages)


def _with_constraints(stage: Stage, task: TaskSpec, model: RobotModel) -> Stage:
    """Return a stage with what constraints have of it."""
    constraints = dict[str, ConstraintNumbers]()
    for name, constraint in CONSTRAINTS.items():
        constraints |= numbers_by_name(name, constraint.numbers(task, model, stage.index))
    return replace(stage, constraints=constraints)


def _end(index: int, task: TaskSpec, robot: RobotSpec, lasts: float) -> End:
    """Return how a stage ends that lasts at least so long [s]; what it holds is in its gripper as the task has it."""
    spec = task.stages[index]
    space = task.skills[spec.skill].wanted_in
    condition = spec.ends_when
    dwell = max(spec.dwell, lasts)
    is_planned = task.controller.plans_ends and index < len(task.stages) - 1
    if condition is None:
        return AtTime(dwell, is_planned, at=np.inf if spec.at is None else spec.at)
    rates = condition.rates(robot, space)
    chosen = rows(condition.coordinates, robot, space)
    by_state = ByState(
        own_rates=rates if rates.any() else np.zeros(0),
        dwell=dwell,
        is_planned=is_planned,
        rows=chosen,
        target_rates=rates[list(chosen)] if rates.any() else np.zeros(0),
        tolerance=condition.tolerances(robot, space),
        rate_tolerance=condition.velocities(robot, space),
        hold=condition.hold,
    )
    body = task.body
    if condition.object is None:
        return by_state
    at = body.grasp.at[body.holder]
    pose_space = space_of_pose(len(at))
    bounds = {measure: getattr(condition.object, measure) for measure in MEASURES}
    given = {measure: bound for measure, bound in bounds.items() if bound is not None}
    return ByObject(
        **{attribute.name: getattr(by_state, attribute.name) for attribute in fields(by_state)},
        frame=body.holder,
        measures=tuple(given),
        object_tolerance=np.array(list(given.values())),
        destination=np.array(body.pose_after_release),
        inside=pose_space.relative(pose_space.neutral, at),
    )


def _on_object(stage: Stage, task: TaskSpec, model: RobotModel) -> Stage:
    """Return a stage with the poses of its target that are relative to the object, and their number of turns."""
    target = task.stages[stage.index].target
    if isinstance(target, TrajectorySpec):
        return stage
    on_object = dict[str, PlaceOnObject]()
    for frame, aim in target.items():
        if isinstance(aim, OnObject):
            at_start = stage.target[stage.parts[frame].numbers]
            inside = model.space.relative(at_start, task.body.pose)
            on_object[frame] = PlaceOnObject(body_of(task.body), inside, aim.met_in or 0.0)
    return replace(stage, on_object=on_object)


def _stage(index: int, task: TaskSpec, robot: RobotSpec, model: RobotModel, waypoints: np.ndarray) -> Stage:
    spec = task.stages[index]
    skill = task.skills[spec.skill]
    space = skill.wanted_in
    attitudes = skill_in(space).attitudes(model)
    reference: Reference = Constant(waypoints[-1])
    lasts = 0.0
    if isinstance(spec.target, TrajectorySpec):
        reference = Trajectory(np.array(spec.target.times), waypoints, tuple(attitudes.values()))
        lasts = spec.target.times[-1]
    moved_by = task.moved_by(index, robot)
    actuated = model.actuated(moved_by)
    control = skill.weights.control
    if isinstance(control, float | int):
        control_weights = np.full(model.n_inputs(skill.input), float(control))
    else:
        control_weights = stack(control, robot, skill.input, missing=0.0, of_error=True)
    if skill.input == "joint":
        control_weights = np.where(actuated, control_weights, 0.0)
    if skill.weights.weighs_force:
        control_weights = np.append(control_weights, _actuated_weights(skill.weights.force, robot, actuated))
    onset = rows(spec.onset if spec.onset is not None else ("all",), robot, "joint")
    return Stage(
        index=index,
        name=spec.name,
        space=space,
        input=skill.input,
        priority=spec.priority,
        target=waypoints[-1],
        reference=reference,
        weights=_weights(skill, robot, model),
        control_weights=control_weights,
        force_load=known_load(task, model, index).without_wheels if skill.weights.weighs_force else UNWEIGHED_LOAD,
        rate_weights=_rate_weights(skill, robot, actuated),
        end=_end(index, task, robot, lasts),
        limits=resolve_limits(robot, task.limits, skill.limits, moved_by=moved_by),
        moved_by=moved_by,
        onset_rows=tuple(row for row in onset if actuated[row]),
        parts=skill_in(space).parts(model),
        attitudes=attitudes,
    )


def _actuated_weights(
    given: float | Mapping[str, tuple[float, ...]], robot: RobotSpec, actuated: np.ndarray
) -> np.ndarray:
    """Return weights by coordinate (n,), given as one number or by part; 0 where nothing acts."""
    if isinstance(given, float | int):
        weights = np.full(len(actuated), float(given))
    else:
        weights = stack(given, robot, "joint", missing=0.0, of_error=True)
    return np.where(actuated, weights, 0.0)


def _rate_weights(skill: SkillSpec, robot: RobotSpec, actuated: np.ndarray) -> np.ndarray:
    """Return the weights of the rate of Qddot (n,); (0,) where all are 0."""
    weights = _actuated_weights(skill.weights.rate, robot, actuated)
    return weights if weights.any() else np.zeros(0)


def _weights(skill: SkillSpec, robot: RobotSpec, model: RobotModel) -> np.ndarray:
    """Return the weights of the rows of the error; those of the posture of redundant arms follow from the poses'."""
    space = skill.wanted_in
    weights = stack(skill.weights.parts, robot, space, missing=0.0, of_error=True)
    parts = skill_in(space).parts(model)
    if skill_in(space).rows(model) == len(weights):
        return weights
    posture = []
    for arm in robot.arms:
        links = robot.parts[arm]
        of_arm = weights[parts[arm].rows] if arm in parts and parts[arm].kind.draws_joints else np.ones(links)
        is_free = links > np.count_nonzero(of_arm)
        posture.append(np.full(links, POSTURE * of_arm.max() if is_free else 0.0))
    return np.concatenate([weights, *posture])


def _unwrapped_waypoints(task: TaskSpec, robot: RobotSpec, model: RobotModel) -> list[np.ndarray]:
    """Return what every stage's target leads through, (T, numbers) each.

    Each angle is moved to the equivalent nearest to where the sequence is before: for the first row that is where
    the stage before leads to, for every other row it is the row before. Of an attitude's two quaternions each row has
    the one nearer to the row before.
    """
    Q = stack(task.initial, robot, "joint")
    posture = Posture(Q, np.asarray(model.g(Q)).ravel())
    by_stage = []
    for spec in task.stages:
        space = task.skills[spec.skill].wanted_in
        skill = skill_in(space)
        waypoints = _waypoints(
            spec, robot, space, task.body, skill.absent(model), posture.Q[model.space.base_coordinates]
        )
        turning = skill.angles(model)
        if spec.angles == "nearest":
            before = skill.numbers_at(model, posture)[turning]
            waypoints[:, turning] = np.unwrap(np.vstack([before, waypoints[:, turning]]), axis=0)[1:]
        for at in skill.attitudes(model).values():
            q = waypoints[:, at : at + 4]  # a view
            q /= np.linalg.norm(q, axis=1, keepdims=True)
            q[1:] *= np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0))[:, None]
        by_stage.append(waypoints)
        posture = skill.after(model, posture, waypoints[-1])
    return by_stage


def _waypoints(
    spec: StageSpec,
    robot: RobotSpec,
    space: Space,
    body: ObjectBody,
    absent: np.ndarray,
    base: np.ndarray,
) -> np.ndarray:
    """Return the rows of a stage's target as given, (T, rows); those relative to the object where it is first.

    A base that is left out, having no thrusters, is wanted at the pose `base` (n_pose,), with weight 0; other parts
    have the numbers `absent`.
    """
    if isinstance(spec.target, TrajectorySpec):
        values = spec.target.stacked(robot, space)
    else:
        parts = {part: _placed(aim, body) for part, aim in spec.target.items()}
        values = stack(parts, robot, space)[None]
    of_base = values[:, : len(base)]  # a view: every target begins with the base's pose
    of_base[...] = np.where(np.isnan(of_base), base, of_base)
    return np.where(np.isnan(values), absent, values)


def _placed(aim: tuple[float, ...] | OnObject, body: ObjectBody) -> tuple[float, ...]:
    """Return the numbers of a part of a target, the object being where it is at the start."""
    if not isinstance(aim, OnObject):
        return aim
    at = body.grasp.at[aim.object] if isinstance(aim.object, str) else aim.object
    return tuple(space_of_pose(len(at)).composed(body.pose, at).tolist())
