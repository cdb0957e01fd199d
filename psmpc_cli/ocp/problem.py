"""A task made computable: the robot's model, the stages as numbers, the functions of the skills on arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from psmpc_cli.ocp.constraints import CONSTRAINTS
from psmpc_cli.ocp.constraints.base import numbers_by_name
from psmpc_cli.ocp.end import MEASURES, MOMENTA, AtTime, ByObject, ByState, End, NormBound, component_counts
from psmpc_cli.ocp.loads import NO_KNOWN_LOAD, UNWEIGHED_LOAD, known_load
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
from psmpc_cli.specs.robots.robot import RobotSpec, resolve_limits, rows, stack
from psmpc_cli.specs.stages import EndCondition, SkillSpec, StageSpec, TrajectorySpec
from psmpc_cli.specs.task import TaskSpec

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
    """Return a stage and a state in the coordinates of a window that begins there: the chart about the attitude in Q.

    Checks, summaries and figures evaluate errors and end conditions with it; a controller places its stages itself. In
    a chart a spatial attitude is a rotation vector about an anchor, here the attitude in Q. Of the two quaternions of
    each attitude in the target the one nearer to the robot's is taken.

    Args:
        model: The robot.
        stage: The stage.
        Q: Coordinates, (nq,).
        v: Velocities, (n,).
        since: Time since the stage began [s], at which a trajectory is read; its end without one.
        object_state: Pose and velocity of the object that a target may be relative to; without it that is where the
            object was at the start.

    Returns:
        The stage, and the state x, (2n,).
    """
    placed = stage.unplaced_copy()
    if stage.on_object and object_state is not None:
        placed = placed.at_object(*object_state)
    chart = model.space.chart_at(Q)
    x = np.asarray(chart.to_chart(Q[None], v[None])[0])
    poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    target = placed.wanted(since)
    signs = dict[str, float]()
    for frame, first in stage.attitudes.items():
        cosine = float(target[first : first + 4] @ poses[frame][3:])  # of half the angle between both attitudes
        signs[frame] = np.sign(cosine) or 1.0
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
    stages = (_build_stage(i, task, robot, model, values) for i, values in enumerate(waypoints))
    return tuple(_with_constraints(_with_places_on_object(stage, task, model), task, model) for stage in stages)


def _with_constraints(stage: Stage, task: TaskSpec, model: RobotModel) -> Stage:
    """Return a stage with what constraints have of it."""
    constraints = dict[str, ConstraintNumbers]()
    for name, constraint in CONSTRAINTS.items():
        constraints |= numbers_by_name(name, constraint.numbers(task, model, stage.index))
    return replace(stage, constraints=constraints)


def _norm_bounds(condition: EndCondition, dimension: int) -> tuple[NormBound, ...]:
    """Return what an end condition bounds of the object, and then of the momentum."""
    of_object = [getattr(condition.object, measure, None) for measure in MEASURES]
    of_momentum = [getattr(condition.momentum, kind, None) for kind in ("linear", "angular")]
    measures = (*MEASURES, *MOMENTA)
    bounds = zip(measures, (*of_object, *of_momentum), component_counts(measures, dimension), strict=True)
    return tuple(NormBound(measure, most, components) for measure, most, components in bounds if most is not None)


def _build_end(index: int, task: TaskSpec, model: RobotModel, lasts: float) -> End:
    """Return how a stage ends: at a time, by the robot's state, or by the state of the object that it holds.

    Args:
        index: Index of the stage.
        task: The task.
        model: The robot.
        lasts: Time that the stage lasts at least, since its target is a trajectory [s]; else 0.
    """
    spec = task.stages[index]
    robot = model.spec
    space = task.skills[spec.skill].wanted_in
    condition = spec.ends_when
    dwell = max(spec.dwell, lasts)
    # Whether windows may end the stage at a planned switch time, and not only what is measured.
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
        norms=_norm_bounds(condition, robot.dimension),
        load=NO_KNOWN_LOAD if condition.momentum is None else known_load(task, model, index).without_wheels,
        hold=condition.hold,
    )
    body = task.body
    if condition.object is None:
        return by_state
    gripper_on_object = body.grasp.at[body.holder]
    pose_space = space_of_pose(len(gripper_on_object))
    return ByObject(
        **{attribute.name: getattr(by_state, attribute.name) for attribute in fields(by_state)},
        frame=body.holder,
        destination=np.array(body.pose_after_release),
        inside=pose_space.relative(pose_space.neutral, gripper_on_object),  # the object in the gripper's frame
    )


def _with_places_on_object(stage: Stage, task: TaskSpec, model: RobotModel) -> Stage:
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


def _build_stage(index: int, task: TaskSpec, robot: RobotSpec, model: RobotModel, waypoints: np.ndarray) -> Stage:
    """Build a stage of a task for one robot: its target and weights as numbers, its limits, and how it ends.

    Args:
        index: Index of the stage.
        task: The task.
        robot: The robot as its file describes it.
        model: The robot as functions.
        waypoints: What the target leads through, (T, numbers), T = 1 for one that stands still.
    """
    spec = task.stages[index]
    skill = task.skills[spec.skill]
    space = skill.wanted_in
    attitudes = skill_in(space).attitudes(model)
    reference: Reference = Constant(waypoints[-1])
    trajectory_duration = 0.0
    if isinstance(spec.target, TrajectorySpec):
        reference = Trajectory(np.array(spec.target.times), waypoints, tuple(attitudes.values()))
        trajectory_duration = spec.target.times[-1]
    moved_by = task.moved_by(index, robot)
    is_actuated = model.actuated(moved_by)
    control = skill.weights.control
    if isinstance(control, float | int):
        control_weights = np.full(model.n_inputs(skill.input), float(control))
    else:
        control_weights = stack(control, robot, skill.input, missing=0.0, of_error=True)
    if skill.input == "joint":
        control_weights = np.where(is_actuated, control_weights, 0.0)
    if skill.weights.weighs_force:  # these stand behind those of the control
        control_weights = np.append(control_weights, _actuated_weights(skill.weights.force, robot, is_actuated))
    # Coordinates whose acceleration shows when the stage really begins, for the record.
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
        rate_weights=_rate_weights(skill, robot, is_actuated),
        end=_build_end(index, task, model, trajectory_duration),
        limits=resolve_limits(robot, task.limits, skill.limits, moved_by=moved_by),
        moved_by=moved_by,
        onset_rows=tuple(row for row in onset if is_actuated[row]),
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
    """Return the numbers that every stage's target leads through, (T, numbers) each, without unintended full turns.

    A target at rest has one row, T = 1; a trajectory one for each of its times. Unless the task wants angles as given,
    each angle is moved by full turns to be nearest to the one before: to that of the row before, or, in the first row,
    to where the stage before leads. Of an attitude's two quaternions each row has the one nearer to the row before.

    Args:
        task: The task.
        robot: The robot as its file describes it.
        model: The robot as functions.
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
        angles = skill.angles(model)
        if spec.angles == "nearest":
            before = skill.numbers_at(model, posture)[angles]
            waypoints[:, angles] = np.unwrap(np.vstack([before, waypoints[:, angles]]), axis=0)[1:]
        for first in skill.attitudes(model).values():
            q = waypoints[:, first : first + 4]  # a view
            q /= np.linalg.norm(q, axis=1, keepdims=True)
            is_farther = (q[1:] * q[:-1]).sum(axis=1) < 0  # -q is nearer to the row before than q
            q[1:] *= np.cumprod(np.where(is_farther, -1.0, 1.0))[:, None]
        by_stage.append(waypoints)
        posture = skill.posture_after(model, posture, waypoints[-1])
    return by_stage


def _waypoints(
    spec: StageSpec,
    robot: RobotSpec,
    space: Space,
    body: ObjectBody,
    absent: np.ndarray,
    base: np.ndarray,
) -> np.ndarray:
    """Return a stage's target as the task gives it, completed where parts are left out, (T, numbers).

    A target at rest is one row, T = 1; a trajectory has a row for each of its times. Poses relative to the object
    become those in the inertial frame, the object being where it is at the start.

    Args:
        spec: The stage.
        robot: The robot.
        space: The space of its skill, which says what the numbers are.
        body: The object.
        absent: What stands for parts that are left out, (numbers,); their weights are 0.
        base: The same for a base that is left out, having no thrusters: a pose, (n_pose,).
    """
    if isinstance(spec.target, TrajectorySpec):
        values = spec.target.stacked(robot, space)
    else:
        parts = {part: _with_object_at_start(aim, body) for part, aim in spec.target.items()}
        values = stack(parts, robot, space)[None]
    # Numbers that the target leaves out are NaN.
    base_values = values[:, : len(base)]  # a view: every target begins with the base's pose
    base_values[...] = np.where(np.isnan(base_values), base, base_values)
    return np.where(np.isnan(values), absent, values)


def _with_object_at_start(aim: tuple[float, ...] | OnObject, body: ObjectBody) -> tuple[float, ...]:
    """Return the numbers of a part of a target, the object being where it is at the start."""
    if not isinstance(aim, OnObject):
        return aim
    at = body.grasp.at[aim.object] if isinstance(aim.object, str) else aim.object
    return tuple(space_of_pose(len(at)).composed(body.pose, at).tolist())
