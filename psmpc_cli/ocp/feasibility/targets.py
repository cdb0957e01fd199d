"""What a task's start and the targets of its stages do to what it keeps: distances of parts, and cones."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.ocp.constraints.clearance import Group, distances_on_arrays, groups_to_clear, poses_at, poses_at_sample
from psmpc_cli.ocp.constraints.cones import angle_of_axis
from psmpc_cli.ocp.constraints.plumes import PlumeForecast
from psmpc_cli.ocp.feasibility.postures import arm_postures, held_pose, reasons_unforeseen
from psmpc_cli.ocp.skills import Posture, skill_in
from psmpc_cli.ocp.stage import SampleContext, Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.document import Fault, Location, counted, quoted
from psmpc_cli.specs.geometry import pair_name
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.parts import BASE, has_posture

SLACK = 1e-9
"""By which parts may be nearer than their margin [m]: rounding."""

CONE_SLACK = 1e-3
"""By which a target may lie beyond the edge of a cone [rad]: tolerances of end conditions are wider."""


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


def clearance_remarks(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]
) -> Iterator[Fault]:
    """Yield remarks on parts that are too near each other at the start or at a target, where no plan could keep clear.

    A part is a body of the robot, the object or an obstacle. Too near means nearer than the margin that the task asks
    for. One more remark is about obstacles that have no effect, since neither clearance nor the plumes of thrusters
    are about them.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at the target of every stage, (nq,) each.
    """
    avoids_plumes = any(task.spec.avoids_plumes(stage.index, task.robot) for stage in stages)
    if task.spec.obstacles and not (task.spec.keeps_clear or avoids_plumes):
        yield Fault(("obstacles",), 'found no "clearance", expected one: without it nothing keeps clear of obstacles')
    for close in _close_parts(task, model, stages, stops):
        where = "at the start"
        path: Location = ("initial",)
        if close.stage is not None:
            by = ", by inverse kinematics" if close.stage.poses_of_arms else ""
            where = f"where {quoted(close.stage.name)} leads{by}"
            path = ("stages", close.stage.index, "target")
        first, second = close.parts
        millimetres = 1e3 * close.distance
        apart = f"{millimetres:.1f} mm apart" if millimetres >= 0 else f"{-millimetres:.1f} mm deep in each other"
        others = f" ({counted(close.others, 'more pair', 'more pairs')} inside it)" if close.others else ""
        wanted = f"at least the margin of {1e3 * close.margin:g} mm between them{others}"
        yield Fault(path, f"found {first} and {second} {apart} {where}, expected {wanted}")


def _close_parts(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]
) -> Iterator[CloseParts]:
    """Yield where parts of robot and surroundings are nearer than the task's margin: one `CloseParts` for each place.

    Places are the start, and those targets that determine all joints. At a target the margin is that of its stage.
    Parts whose place at a target is not known are left out there: what moves by itself, an object that was let go, and
    everything but the robot itself where the base reacts to the arms.

    Args:
        task: The task.
        model: The robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at the target of every stage, (nq,) each.
    """
    known_postures = _known_postures(task, model, stages, stops)
    places: list[tuple[Stage | None, np.ndarray]] = [(None, stops[0])]
    places += [(stage, Q) for stage, Q in zip(stages, stops[1:], strict=True) if stage.name in known_postures]
    for stage, Q in places:
        spec = task.spec.clearance_of(0 if stage is None else stage.index)
        if spec is None:
            continue
        distances = _known_distances(task, model, stage, Q)
        inside = {parts: distance for parts, distance in distances.items() if distance < spec.margin - SLACK}
        if inside:
            nearest = min(inside, key=lambda parts: inside[parts])
            yield CloseParts(stage, nearest, inside[nearest], spec.margin, len(inside) - 1)


def _known_postures(task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]) -> set[str]:
    """Return the names of the stages whose targets determine all joints, so that distances there can be checked.

    Poses of a target in task space determine joints by inverse kinematics, if a solution was found. Targets do not
    determine joints where weights leave coordinates free, where the base reacts to the arms, or where the target is on
    an object that drifts: there the posture depends on how the robot gets there.

    Args:
        task: The task.
        model: The robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at the target of every stage, (nq,) each.
    """
    without_solution = {posture.stage for posture in arm_postures(model, stages, stops) if posture.joints is None}
    object_drifts = task.spec.body.motion.moves

    def depends_on_the_way(stage: Stage) -> bool:
        base_reacts = stage.moved_by.reacts and stage.poses_of_arms
        return bool(base_reacts or (object_drifts and stage.on_object))

    def says_all_joints(stage: Stage) -> bool:
        # rows of the error stand in the order of base, then arms; they are relevant with a weight or an end condition
        first_row = 0 if stage.moved_by.actuated else model.space.n_twist  # a base that stays need not be asked for
        asks_for_all = has_posture(model.spec.arms, stage.space) and stage.relevant_rows[first_row:].all()
        return bool(asks_for_all) and not depends_on_the_way(stage)

    return {stage.name for stage in stages if says_all_joints(stage)} - without_solution


def _known_distances(task: Task, model: RobotModel, stage: Stage | None, Q: np.ndarray) -> dict[tuple[str, str], float]:
    """Compute the distances of all pairs of parts that the task keeps apart and whose places are known.

    Args:
        task: The task.
        model: The robot.
        stage: The stage at whose target the robot is; None at the start.
        Q: Coordinates of the robot there, (nq,).

    Returns:
        The distance of the parts by their two names [m], the smallest over the shapes that they consist of; negative
        where they overlap.
    """
    at_rest_there = _sample_at_rest(task, model, stage, Q)
    smallest = dict[tuple[str, str], float]()
    for group in groups_to_clear(task.spec, model, 0 if stage is None else stage.index).values():
        argument = poses_at_sample(group, model, at_rest_there)
        if argument is None or (stage is not None and _may_have_moved(group, stage, at_rest_there)):
            continue
        poses = poses_at(group.pairs, model, argument, np.zeros(1))[0]
        taken = np.concatenate([at_rest_there.anchor, poses])  # the argument of the function of distances
        (distances,) = distances_on_arrays(model, group.pairs)(at_rest_there.x, taken)
        for pair, distance in zip(group.pairs.pair_of_row, distances.ravel().tolist(), strict=True):
            names = group.pairs.names[pair]
            smallest[names] = min(distance, smallest.get(names, np.inf))
    return smallest


def _sample_at_rest(task: Task, model: RobotModel, stage: Stage | None, Q: np.ndarray) -> SampleContext:
    """Return what constraints see with the robot at rest at Q (nq,), at the start or at the target of a stage."""
    chart = model.space.chart_at(Q)
    x = np.asarray(chart.to_chart(Q[None], np.zeros((1, model.n)))[0])
    pose = _object_pose(task, model, stage, Q)
    state = None if pose is None else (pose, np.zeros(model.space.n_twist))
    return SampleContext(0.0, x, chart.anchor, object_state=state)


def shut_thrusters(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]
) -> dict[str, tuple[int, ...] | None]:
    """Return which thrusters are shut at the targets of the stages that keep plumes off object and obstacles.

    `psmpc check` prints them.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at the target of every stage, (nq,) each.

    Returns:
        The numbers of the thrusters, from 1 on, by name of the stage; None where something moves, so that they are not
        known before the run.
    """
    moving = reasons_unforeseen(task.spec, stages)
    shut: dict[str, tuple[int, ...] | None] = {}
    for stage, Q in zip(stages, stops[1:], strict=True):
        if not task.spec.avoids_plumes(stage.index, task.robot):
            continue
        shut[stage.name] = None
        if stage.index not in moving:
            # A forecast for one time alone: with the robot at rest at the target.
            forecast = replace(PlumeForecast.of(task.spec, model, stage.index), since=np.zeros(1))
            (is_shut,) = forecast.is_shut(forecast.numbers(model, _sample_at_rest(task, model, stage, Q)))
            shut[stage.name] = tuple(int(number) for number in np.flatnonzero(is_shut) + 1)
    return shut


def _may_have_moved(group: Group, stage: Stage, start: SampleContext) -> bool:
    """Tell whether an obstacle of a group is elsewhere at a target than at the start, seen from a base that reacts."""
    has_poses = group.pairs.has("object") or group.pairs.has("obstacle")
    if stage.moved_by.reacts and has_poses:
        return True
    state = group.state(start) if group.pairs.has("obstacle") else None
    return state is not None and bool(state[1].any())


def _object_pose(task: Task, model: RobotModel, stage: Stage | None, Q: np.ndarray) -> np.ndarray | None:
    """Return where the object is at the start, or with the robot at the target of a stage; None where that is unknown.

    Until it is taken it is where it was at the start if it does not move, then in its first gripper.
    """
    body = task.spec.body
    if body.mass == 0.0:
        return None
    held = task.spec.held_stages
    if stage is None or (stage.index < held.start and not body.motion.moves):
        return np.array(body.pose)
    return held_pose(model, body, Q) if stage.index in held else None


def monitor_faults(task: Task, model: RobotModel) -> Iterator[Fault]:
    """Yield monitors of a clearance about parts that are no pair that keeps clear in their stage."""
    names = [stage.name for stage in task.spec.stages]
    for number, monitor in enumerate(task.spec.monitors):
        if monitor.quantity != "clearance":
            continue
        groups = groups_to_clear(task.spec, model, names.index(monitor.during)).values()
        if not any(monitor.is_about(pair_name(*pair)) for group in groups for pair in group.pairs.names):
            message = (
                f"found {' and '.join(map(quoted, monitor.of)) or 'all pairs'}, expected parts that keep clear in "
                f"{quoted(monitor.during)}: not neighbours, nor what can never meet, may touch or is excepted"
            )
            yield Fault(("monitors", number, "of"), message)


def cone_remarks(task: Task, model: RobotModel, stages: Sequence[Stage]) -> Iterator[Fault]:
    """Yield cones that the target of their own stage violates, so that the stage cannot both reach it and keep them.

    A cone keeps an axis of a frame, such as a camera's, within an angle of a point or direction, or outside that angle.
    Cones of frames whose pose the target does not determine are left out.
    """
    for stage in stages:
        cones = task.spec.stages[stage.index].cones
        poses = _poses_at_target(model, stage) if cones else {}
        for number, cone in enumerate(cones):
            if cone.frame not in poses:
                continue
            angle = angle_of_axis(cone, poses[cone.frame], model.space)
            stays_within = cone.within is not None
            violation = angle - cone.angle if stays_within else cone.angle - angle
            if violation > CONE_SLACK:
                side = "at most" if stays_within else "at least"
                message = (
                    f"found the axis of {cone.frame} at {np.degrees(angle):.4g} deg where {quoted(stage.name)} leads "
                    f"it, expected {side} {np.degrees(cone.angle):.4g} deg there"
                )
                yield Fault(("stages", stage.index, "cones", number), message)


def _poses_at_target(model: RobotModel, stage: Stage) -> dict[str, np.ndarray]:
    """Return the poses (n_pose,) of base and end-effectors that a stage's target determines, by name.

    Weights or end condition have to ask for all of a part: a pose of the base or an arm is then the target's own. The
    pose of an arm whose target is joint coordinates follows from them and from the base, if they ask for that too.
    """
    neutral = Posture(model.space.neutral.copy(), np.zeros(model.m))
    Q = skill_in(stage.space).posture_after(model, neutral, stage.target).Q  # neutral where the target says nothing
    poses = dict(zip(model.pose_rows, model.poses(Q), strict=True))
    asks_for_base = stage.relevant_rows[stage.parts[BASE].rows].all()
    known_poses = dict[str, np.ndarray]()
    for name, part in stage.parts.items():
        asks_for_part = stage.relevant_rows[part.rows].all()
        if part.kind.is_pose and asks_for_part:
            known_poses[name] = stage.target[part.numbers]
        elif part.kind.is_joints and asks_for_part and asks_for_base:
            known_poses[name] = poses[name]
    return known_poses
