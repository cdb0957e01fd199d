"""Where a robot is at a task's start and targets, before anything has run: joints, end-effectors, loads, distances."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from psmpc_cli.ocp.constraints.clearance import Group, functions, kept_groups
from psmpc_cli.ocp.skills import SKILLS, Posture
from psmpc_cli.ocp.stage import SampleView, Stage
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import Reach, reach_of
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robot import labels, stack

SLACK = 1e-9
"""By which parts may be nearer than their margin [m]: rounding."""

TAKEN = 5e-3
"""Largest error of a pose that counts as taken [m, rad]: an arm that cannot reach stays where it was."""


@dataclass(frozen=True, eq=False)
class ArmPosture:
    """An arm at the target of a stage.

    Attributes:
        stage: Name of the stage.
        arm: Name of the arm.
        joints: Its joint coordinates (joints,) [rad, m]; None where none were found that take the target.
        pose: Pose of its end-effector in the inertial frame, (3,) or (7,) [m, rad].
    """

    stage: str
    arm: str
    joints: np.ndarray | None
    pose: np.ndarray


@dataclass(frozen=True)
class LoadRatio:
    """The largest inertia of a held object over that of the robot, over all motions that keep the closed chain.

    Attributes:
        ratio: rho of docs/capture.md [1].
        coordinate: The coordinate that has most of the kinetic energy in that motion.
        stage: Name of the stage at whose target that is so.
    """

    ratio: float
    coordinate: str
    stage: str


@dataclass(frozen=True)
class CloseParts:
    """The two parts that are farthest inside what a task keeps between them, at its start or a target.

    Attributes:
        stage: The stage at whose target, None at the start.
        parts: Their names.
        distance: How far apart they are, negative where they overlap [m].
        margin: How far apart they should be [m].
        others: Number of other pairs inside it.
    """

    stage: Stage | None
    parts: tuple[str, str]
    distance: float
    margin: float
    others: int


def configurations(
    task: Task, model: RobotModel, stages: Sequence[Stage], reaches: Sequence[Mapping[str, Reach]] = ()
) -> list[np.ndarray]:
    """Return the robot's coordinates at the start and at every stage's target, (nq,) each.

    Where a target is in task space the arms are those of inverse kinematics; an arm that cannot reach stays as it was.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        reaches: What is known already of the arms at the target of each stage; by default nothing.
    """
    stops = [stack(task.spec.initial, task.robot, "joint")]
    for stage, known in zip(stages, reaches or [{}] * len(stages), strict=True):
        before = Posture(stops[-1], np.asarray(model.g(stops[-1])).ravel())
        Q = SKILLS[stage.space].after(model, before, stage.target).Q.copy()
        base = stage.target[model.pose_rows["base"]]
        for arm in task.robot.arms if stage.space == "task" else ():
            reach = known[arm] if arm in known else reach_of(model, arm, base, stage.target[model.pose_rows[arm]])
            if reach.configuration is not None:
                Q[model.nq - model.n :][model.parts[arm]] = reach.configuration
        stops.append(Q)
    return stops


def arm_postures(model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]) -> Iterator[ArmPosture]:
    """Yield each arm at the target of each stage that says where the arms are: in joint space, or in task space.

    None of a robot whose base reacts to its arms: where the base is at a target depends on the way there.

    Args:
        model: The robot.
        stages: The stages of a task.
        stops: Their `configurations`.
    """
    for stage, Q in zip(stages, stops[1:], strict=True):
        if _base_reacts(model) or stage.space not in ("joint", "task"):
            continue
        for arm, pose in zip(model.spec.arms, model.poses(Q)[1:], strict=True):
            wanted = pose if stage.space == "joint" else stage.target[model.pose_rows[arm]]
            apart = model.space.pose_error(pose, wanted)
            taken = bool(np.abs(apart).max() <= TAKEN)
            joints = Q[model.nq - model.n :][model.parts[arm]] if taken else None
            yield ArmPosture(stage.name, arm, joints, np.asarray(wanted))


def largest_load_ratio(task: Task, model: RobotModel, stops: Sequence[np.ndarray]) -> LoadRatio | None:
    """Find where the object is largest against the robot; None where there is no object with a mass.

    The robot is looked at where the stages lead that take the object and hold it.

    Args:
        task: The task.
        model: Its robot.
        stops: The `configurations` of its stages.
    """
    target_object = task.spec.capture
    if target_object is None:
        return None
    load = HeldLoad(model, body_of(target_object), target_object.grasp)
    found = []
    held = task.spec.held_stages
    last = min(held.stop, len(task.spec.stages))  # an object that is held to the end is so beyond the last stage
    for index in range(held.start - 1, last):
        Q = stops[index + 1]
        ratio, v = load.largest_ratio(Q)
        mostly = int(np.argmax(v * (model.mass_matrix(Q) @ v)))
        found.append(LoadRatio(ratio, labels(task.robot, "joint")[mostly], task.spec.stages[index].name))
    return max(found, key=lambda each: each.ratio)


def close_parts(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]
) -> Iterator[CloseParts]:
    """Yield where parts are nearer than a task keeps them, at its start and at the targets that say the posture.

    At a target the margin is that of its stage. What has moved since the start, by itself or because it was let go, is
    left out there; so is all but the robot itself where the base reacts to the arms.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        stops: Their `configurations`.
    """
    known = _known_postures(task, model, stages, stops)
    places: list[tuple[Stage | None, np.ndarray]] = [(None, stops[0])]
    places += [(stage, Q) for stage, Q in zip(stages, stops[1:], strict=True) if stage.name in known]
    for stage, Q in places:
        spec = task.spec.clearance_of(0 if stage is None else stage.index)
        if spec is None:
            continue
        distances = _distances(task, model, stage, Q)
        inside = {parts: distance for parts, distance in distances.items() if distance < spec.margin - SLACK}
        if inside:
            nearest = min(inside, key=lambda parts: inside[parts])
            yield CloseParts(stage, nearest, inside[nearest], spec.margin, len(inside) - 1)


def _known_postures(task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]) -> set[str]:
    """Return the names of the stages whose targets say where all joints are, by inverse kinematics in task space."""
    missing = {each.stage for each in arm_postures(model, stages, stops) if each.joints is None}
    spaces = ("joint",) if _base_reacts(model) else ("joint", "task")
    drifts = task.spec.capture is not None and task.spec.capture.motion.moves
    of_base = 0 if model.spec.moved_by.actuated else model.space.n_twist  # rows that such a target need not ask for
    return {
        stage.name
        for stage in stages
        if stage.space in spaces and stage.asked[of_base:].all() and not (drifts and stage.on_object)
    } - missing


def _base_reacts(model: RobotModel) -> bool:
    """Tell whether the base moves with the arms, so that its place at a target depends on the way there."""
    moved_by = model.spec.moved_by
    return moved_by.moves and not moved_by.actuated


def _distances(task: Task, model: RobotModel, stage: Stage | None, Q: np.ndarray) -> dict[tuple[str, str], float]:
    """Compute the distances of parts that keep clear [m] with the robot at Q (nq,), of all whose place is known."""
    space = model.space
    chart = space.chart_at(Q)
    x = np.asarray(chart.enter(Q[None], np.zeros((1, model.n)))[0])
    pose = _object_pose(task, model, stage, Q)
    state = None if pose is None else (pose, np.zeros(space.n_twist))
    view = SampleView(0.0, x, chart.anchor, object_state=state)
    is_adrift = stage is not None and _base_reacts(model)
    found = dict[tuple[str, str], float]()
    for group in kept_groups(task.spec, model, 0 if stage is None else stage.index).values():
        pairs = replace(group.pairs, gripper=None)
        poses = _poses(group, view, at_start=stage is None)
        if poses is None or (is_adrift and poses):
            continue
        argument = np.concatenate([chart.anchor, [0.0], *poses])
        rows = model.owned((functions, pairs), partial(functions, model, pairs)).value(x, argument)[0]
        for pair, apart in zip(pairs.of_rows, rows.ravel().tolist(), strict=True):
            name = pairs.names[pair]
            found[name] = min(apart, found.get(name, np.inf))
    return found


def _poses(group: Group, view: SampleView, at_start: bool) -> list[np.ndarray] | None:
    """Return the poses of the object and of the obstacle in a group, where it has them; None if one is unknown."""
    poses = []
    if group.pairs.has("object"):
        if view.object_state is None:
            return None
        poses.append(view.object_state[0])
    if group.pairs.has("obstacle"):
        state = group.state(view)
        if state is None or (state[1].any() and not at_start):
            return None
        poses.append(state[0])
    return poses


def _object_pose(task: Task, model: RobotModel, stage: Stage | None, Q: np.ndarray) -> np.ndarray | None:
    """Return where the object is at the start, or with the robot at the target of a stage; None where that is unknown.

    Until it is taken it is where it was at the start if it does not move, then in its first gripper.
    """
    capture = task.spec.capture
    if capture is None:
        return None
    held = task.spec.held_stages
    if stage is None or (stage.index < held.start and not capture.motion.moves):
        return np.array(capture.pose)
    if stage.index not in held:
        return None
    holder, at = next(iter(capture.grasp.at.items()))
    gripper = model.poses(Q)[list(model.pose_rows).index(holder)]
    origin = model.space.dropped(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return model.space.composed(gripper, model.space.relative(origin, np.array(at)))
