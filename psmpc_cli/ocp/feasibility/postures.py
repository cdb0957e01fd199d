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


def configurations_at_stops(
    task: Task, model: RobotModel, stages: Sequence[Stage], reaches: Sequence[Mapping[str, Reach]] = ()
) -> list[np.ndarray]:
    """Return the robot's coordinates at its stops: at the start and at every stage's target, (nq,) each.

    Checks of a task look at clearances, loads and thrusters there, and routes are planned between them. Where a target
    wants arms at poses, inverse kinematics finds their joint coordinates. Of several solutions it is the one nearest to
    where the motion from the posture before leads. An arm that cannot reach its pose stays as it was.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        reaches: Of each stage, how far its target is for the arms, by arm, as far as that is known already: arms that
            cannot reach are then not tried again. By default all are tried.
    """
    stops = [stack(task.spec.initial, task.robot, "joint")]
    for stage, reach_by_arm in zip(stages, reaches or [{}] * len(stages), strict=True):
        before = Posture(stops[-1], np.asarray(model.g(stops[-1])).ravel())
        Q = skill_in(stage.space).posture_after(model, before, stage.target).Q
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


def reasons_unforeseen(task: TaskSpec, stages: Sequence[Stage]) -> dict[int, str]:
    """Return why places of stages are not known before the run, in words, by index of those stages.

    Something moves: an obstacle; the object, before grippers hold it; or the place where the stage begins or ends is on
    an object that moves. Routes are not planned for such stages, and distances there not checked.
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
    """Yield the posture of each arm at each target that says where the arm is, by joint coordinates or by a pose.

    `psmpc check` prints them. Stages whose base reacts to the arms are left out: there the place of the base, and with
    it the posture, depends on the way to the target.

    Args:
        model: The robot.
        stages: The stages of a task.
        stops: The robot's coordinates at the start and at every stage's target, (nq,) each.

    Yields:
        An `ArmPosture`, without joint coordinates where the arm cannot take its pose.
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
    """Find the motion in which the inertia of a held object is largest over that of the robot; None without a mass.

    A low-level law that does not know of the object moves the robot the more slowly, the larger this ratio is. It is
    computed with the robot at the targets of the stages that take the object and hold it.

    Args:
        task: The task.
        model: Its robot.
        stops: The robot's coordinates at the start and at every stage's target, (nq,) each.
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
        mostly = int(np.argmax(v * (model.mass_matrix(Q) @ v)))  # coordinate with most of the kinetic energy
        ratios.append(LoadRatio(ratio, labels(task.robot, "joint")[mostly], task.spec.stages[index].name))
    return max(ratios, key=lambda ratio: ratio.ratio)


def held_pose(model: RobotModel, body: ObjectBody, Q: np.ndarray) -> np.ndarray:
    """Return the pose of an object, (3,) or (7,), that the first gripper holds as the task describes, at Q (nq,)."""
    at = body.grasp.at[body.holder]
    gripper = model.poses(Q)[list(model.pose_rows).index(body.holder)]
    origin = model.space.neutral[model.space.base_coordinates]
    return model.space.composed(gripper, model.space.relative(origin, np.array(at)))
