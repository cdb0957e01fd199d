"""Where a robot is at the targets of a task's stages, before anything has run: joints, end-effectors, loads."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.skills import Posture, skill_in
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import Reach, reach_of
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.object import ObjectBody
from psmpc_cli.specs.robots.robot import labels, stack
from psmpc_cli.specs.task import TaskSpec

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
        ratio: rho of docs/grasp_model.md [1].
        coordinate: The coordinate that has most of the kinetic energy in that motion.
        stage: Name of the stage at whose target that is so.
    """

    ratio: float
    coordinate: str
    stage: str


def configurations(
    task: Task, model: RobotModel, stages: Sequence[Stage], reaches: Sequence[Mapping[str, Reach]] = ()
) -> list[np.ndarray]:
    """Return the robot's coordinates at the start and at every stage's target, (nq,) each.

    Where a target wants arms at poses they are those of inverse kinematics, on the branch to which the motion from the
    posture before leads; an arm that cannot reach stays as it was.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        reaches: What is known already of the arms at the target of each stage; by default nothing. Arms that cannot
            reach are not looked at again.
    """
    stops = [stack(task.spec.initial, task.robot, "joint")]
    for stage, reach_by_arm in zip(stages, reaches or [{}] * len(stages), strict=True):
        before = Posture(stops[-1], np.asarray(model.g(stops[-1])).ravel())
        Q = skill_in(stage.space).after(model, before, stage.target).Q
        base = stage.target[stage.parts["base"].numbers]
        joints = Q[model.nq - model.n :]
        limits = stage.limits
        for arm, pose in stage.poses_of_arms.items():
            at = model.parts[arm]
            if arm in reach_by_arm and not reach_by_arm[arm].reachable:
                continue
            bounds = limits.position_low[at], limits.position_high[at]
            reach = reach_of(model, arm, base, pose, limits=bounds, near=joints[at])
            if reach.configuration is not None:
                joints[at] = reach.configuration
        stops.append(Q)
    return stops


def unforeseen(task: TaskSpec, stages: Sequence[Stage]) -> dict[int, str]:
    """Return what keeps places of a stage from being known before the run, by the index of the stages where there is.

    Something moves: an obstacle; the object, before grippers hold it; or the place where the stage begins or ends is on
    an object that moves.
    """
    object_moves = task.body.motion.moves
    moving = [obstacle.name for obstacle in task.obstacles if any(obstacle.velocity)]
    reasons = dict[int, str]()
    for stage in stages:
        is_on_object = stage.on_object or (stage.index and stages[stage.index - 1].on_object)
        if object_moves and stage.index < task.held_stages.start:
            reasons[stage.index] = "the object moves"
        elif object_moves and is_on_object:
            reasons[stage.index] = "it begins where an object that moves was taken"
        elif moving:
            reasons[stage.index] = f"obstacle {moving[0]} moves"
    return reasons


def arm_postures(model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]) -> Iterator[ArmPosture]:
    """Yield each arm at the target of each stage that says where the arms are: at joint coordinates, or at a pose.

    None of a stage whose base reacts to its arms: where the base is at a target depends on the way there.

    Args:
        model: The robot.
        stages: The stages of a task.
        stops: Their `configurations`.
    """
    for stage, Q in zip(stages, stops[1:], strict=True):
        if stage.moved_by.reacts:
            continue
        for arm, pose in zip(model.spec.arms, model.poses(Q)[1:], strict=True):
            if arm not in (*stage.poses_of_arms, *stage.arms_at_joints):
                continue
            wanted = stage.poses_of_arms.get(arm, pose)
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
    target_object = task.spec.body
    if target_object.mass == 0.0:
        return None
    load = HeldLoad(model, body_of(target_object), target_object.grasp)
    ratios = []
    held = task.spec.held_stages
    last = min(held.stop, len(task.spec.stages))  # an object that is held to the end is so beyond the last stage
    for index in range(held.start - 1, last):
        Q = stops[index + 1]
        ratio, v = load.largest_ratio(Q)
        mostly = int(np.argmax(v * (model.mass_matrix(Q) @ v)))
        ratios.append(LoadRatio(ratio, labels(task.robot, "joint")[mostly], task.spec.stages[index].name))
    return max(ratios, key=lambda ratio: ratio.ratio)


def held_pose(model: RobotModel, body: ObjectBody, Q: np.ndarray) -> np.ndarray:
    """Return the pose of an object, (3,) or (7,), that the first gripper holds as the task describes, at Q (nq,)."""
    at = body.grasp.at[body.holder]
    gripper = model.poses(Q)[list(model.pose_rows).index(body.holder)]
    origin = model.space.neutral[model.space.base_coordinates]
    return model.space.composed(gripper, model.space.relative(origin, np.array(at)))
