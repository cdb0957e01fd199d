"""Where a stage holds arms far from where the next stage needs them, though its end does not ask for these arms.

Such a stage gives time away: the arms could be posed for the next stage while the stage does what its end waits for.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from psmpc_cli.ocp.feasibility.forecast import coordinate_of_row, earliest_ends, is_asked_for, shortest_time
from psmpc_cli.ocp.feasibility.postures import reasons_unforeseen
from psmpc_cli.ocp.feasibility.quickest import Begin, RestToRest, earliest_arrival
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import reach_of
from psmpc_cli.specs.document import Fault, quoted
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.parts import BASE, LENGTH
from psmpc_cli.specs.robots.robot import units

LEAST_GAIN = 0.5
"""Least time [s] that posing has to save to be advised: less is lost in what later stages vary by."""


@dataclass(frozen=True, eq=False)
class Posing:
    """Arms that a stage holds where the next one does not need them.

    Attributes:
        stage: Index of the stage.
        arms: The arms that could be posed.
        Q: Coordinates of the robot (nq,): the base at the target of the stage, these arms where the next stage needs
            them, the others as the stage holds them.
        time: How long these arms take at least from where they are held to there [s].
        lead: How long before the end of the stage the controller may move them already [s].
        saved: By how much the mission is estimated to be shorter with the arms posed [s].
    """

    stage: int
    arms: tuple[str, ...]
    Q: np.ndarray
    time: float
    lead: float
    saved: float


def posings(task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]) -> Iterator[Posing]:
    """Yield the stages in which arms could be posed for the next stage.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at every stage's target, of `configurations_at_stops`.
    """
    for stage in stages[:-1]:
        if _may_pose_arms(task, stages, stage.index):
            yield from _worthwhile_posing(task, model, stages, stops, stage.index)


def posing_remarks(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray]
) -> Iterator[Fault]:
    """Yield the stages in which arms could be posed for the next stage, with the posture and what it saves."""
    for posing in posings(task, model, stages, stops):
        then = quoted(stages[posing.stage + 1].name)
        postures = ", ".join(f"{arm}: {_joints(task, model, posing, arm)}" for arm in posing.arms)
        begins = f"up to {posing.lead:.3g} s before the switch" if posing.lead else "at the switch"
        message = (
            f"found {' and '.join(posing.arms)} held in a posture that the end of the stage does not ask for, and from "
            f"which {then} has to move for {posing.time:.3g} s at the speed limits; this controller begins that "
            f"{begins}; expected the arms posed for {then} before, which saves some {posing.saved:.2g} s: {postures}"
        )
        yield Fault(("stages", posing.stage, "target"), message)


def _joints(task: Task, model: RobotModel, posing: Posing, arm: str) -> str:
    """Write the joint coordinates of an arm as a task's target has them."""
    rows = model.parts[arm]
    values = posing.Q[model.nq - model.n :][rows]
    written = (
        f"{value + 0.0:.3g} m" if unit == LENGTH else f"{np.degrees(value) + 0.0:.3g} deg"
        for value, unit in zip(values, units(task.robot)[rows], strict=True)
    )
    return f"[{', '.join(written)}]"


def _may_pose_arms(task: Task, stages: Sequence[Stage], index: int) -> bool:
    """Tell whether arms could be posed in a stage for the next one: another target there does no harm.

    They could not if the stage has no target for the joints of all arms, or if they hold an object, follow a
    trajectory, move the base by their reactions, or are what cones, clearance or a monitor are about. Nor could they if
    it is not known before the run where the next stage needs them, since its target or something else moves, or if that
    stage ends at a fixed time, which posing does not bring forward.

    Args:
        task: The task.
        stages: Its stages.
        index: Index of the stage; it is not the last.
    """
    stage = stages[index]
    then = stages[index + 1]
    spec = task.spec
    return not (
        set(stage.arms_at_joints) != set(task.robot.arms)
        or stage.reference.moves
        or then.reference.moves
        or then.end.shape.is_fixed
        or stage.moved_by.reacts
        or then.moved_by.reacts
        or index in spec.held_stages
        or spec.stages[index].cones
        or spec.clearance_of(index) is not None
        or any(monitor.during == stage.name for monitor in spec.monitors)
        or reasons_unforeseen(spec, stages).keys() & {index, index + 1}
    )


def _worthwhile_posing(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray], index: int
) -> Iterator[Posing]:
    """Yield the advice to pose arms in a stage, if that saves more than `LEAST_GAIN`; nothing otherwise.

    Two forecasts of what follows the switch to the next stage are compared: with the arms held where the stage's
    target has them, and with them where the next stage needs them.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at every stage's target, (nq,) each.
        index: Index of the stage.
    """
    switch = _switch_after(task, model, stages, stops, index)
    if not switch.is_held.any() or not switch.postures:
        return
    needed = min(switch.postures, key=switch.nearness)
    need = model.space.in_order_of_v(needed)
    limits = switch.stage.limits
    # No advice where the limits of this stage do not allow the posture.
    beyond = (need < limits.position_low) | (need > limits.position_high)
    if beyond[switch.is_held].any():
        return

    held = switch.forecast(switch.hold)
    posed = switch.forecast(_with_joints(model, switch.hold, needed, switch.is_held))
    saved = held.time - posed.time
    # Coordinates that, held where they are, arrive after the posed robot would: they are what is worth posing.
    late = switch.is_held & (switch.arrivals(held.begin, needed) > posed.arrival)
    if not (np.isfinite(saved) and saved > LEAST_GAIN and late.any()):
        return
    arms = tuple(arm for arm in task.robot.arms if late[model.parts[arm]].any())
    is_posed = np.zeros(model.n, bool)
    for arm in arms:
        is_posed[model.parts[arm]] = True
    Q = _with_joints(model, switch.hold, needed, is_posed)
    from_held = switch.next_motion.times(np.array(model.space.difference(switch.hold, needed)))
    yield Posing(index, arms, Q, float(from_held[late].max()), switch.lead, float(saved))


@dataclass(frozen=True, eq=False)
class _Forecast:
    """What follows a switch.

    Attributes:
        time: How long the next stage and the flight of the base in the stage after it last together [s].
        arrival: When the robot is where the end of the next stage asks it to be, from the switch on [s].
        begin: Where the next stage begins to move the robot, and when.
    """

    time: float
    arrival: float
    begin: Begin


@dataclass(frozen=True, eq=False)
class _Switch:
    """A switch from one stage to the next, whose motions are the fastest that the limits allow.

    Idle arms move to where the stage holds them until the next stage is in the window, and from then on to where that
    one needs them. The base moves for the next stage once the switch is over and it has come to rest.

    Attributes:
        model: The robot.
        stage: The stage.
        then: The next stage.
        after: The stage after that; None where there is none, or where its target is not known before the run.
        begin: Coordinates at which the stage begins (nq,).
        hold: Those of its target (nq,).
        goal: Those of the target of `after` (nq,); of no meaning without it.
        postures: Coordinates that take the target of the next stage, (nq,) each.
        awaited: Coordinates of v for which the end of the next stage waits (n,).
        is_held: Of these those of arms that the stage holds although its end does not ask for them (n,).
        duration: How long the stage lasts [s].
        lead: How long before the switch the next stage is in the window [s].
        settling: How long after the switch each coordinate of the base could be at rest, (3,) or (6,) [s].
        sample_time: Of the controller [s].
    """

    model: RobotModel
    stage: Stage
    then: Stage
    after: Stage | None
    begin: np.ndarray
    hold: np.ndarray
    goal: np.ndarray
    postures: Sequence[np.ndarray]
    awaited: np.ndarray
    is_held: np.ndarray
    duration: float
    lead: float
    settling: np.ndarray
    sample_time: float

    @cached_property
    def next_motion(self) -> RestToRest:
        """How the next stage moves the robot."""
        return _motion_of(self.model, self.then)

    def nearness(self, posture: np.ndarray) -> tuple[float, float]:
        """Return how much longer than the stage arms take to a posture (nq,), and how long from the held one [s]."""
        from_begin = self.arrivals(Begin(self.begin, np.full(self.model.n, self.duration)), posture)
        from_held = self.arrivals(Begin(self.hold, np.zeros(self.model.n)), posture)
        return max(float(from_begin[self.is_held].max()), 0.0), float(from_held[self.is_held].max())

    def arrivals(self, begin: Begin, posture: np.ndarray) -> np.ndarray:
        """Return how long after the switch coordinates that the next stage asks for are those of a posture (n,) [s]."""
        times = self.next_motion.times(np.array(self.model.space.difference(begin.Q, posture)))
        return np.where(self.awaited & (times > 0), times - begin.ahead, 0.0)

    def forecast(self, hold: np.ndarray) -> _Forecast:
        """Return what follows the switch if the stage holds the robot at some coordinates (nq,)."""
        space = self.model.space
        begin, posture = self._begin_of_next(hold)
        step = np.where(self.awaited, space.difference(begin.Q, posture), 0.0)
        end = np.array(space.integrate(begin.Q.tolist(), step.tolist()))
        poses = {
            arm: pose for arm, pose in self.then.poses_of_arms.items() if self.awaited[self.model.parts[arm]].any()
        }
        is_free = self.awaited & ~_coordinates_in_end(self.model, self.then)
        arrival, Q = earliest_arrival(self.model, self.next_motion, begin, end, poses, is_free)
        lasts = max(self.then.end.dwell, arrival + self.then.end.hold, self.sample_time)
        return _Forecast(lasts + self._flight_after(Q, lasts), arrival, begin)

    def _begin_of_next(self, hold: np.ndarray) -> tuple[Begin, np.ndarray]:
        """Return where and when the next stage begins to move the robot, and which posture it then takes (nq,).

        Of the postures that take the target of the next stage it is the one that is reached first. Idle joints, which
        the end of this stage does not ask for, move on when the next stage comes into the window, `lead` before the
        switch; until then they have come as far towards `hold` as time allows. A joint that is still on its way there,
        and then goes on in the same direction, does not stop in between: its motion counts from where it began.

        Args:
            hold: Coordinates at which this stage holds the robot (nq,).
        """
        space = self.model.space
        joints = space.joint_coordinates
        is_idle = np.isin(np.arange(self.model.n), self.stage.end.rows, invert=True)
        is_idle[space.base] = False
        motion = _motion_of(self.model, self.stage)
        has_weight = self.stage.weights[space.joint_rates] > 0
        reach = motion.distances(np.full(self.model.n, self.duration - self.lead))[space.joint_rates]
        reach = np.where(has_weight, reach, 0.0)  # nothing moves a joint without a weight
        first = self.begin[joints]
        moved = first + np.clip(hold[joints] - first, -reach, reach)
        start = hold.copy()
        start[joints] = np.where(is_idle[space.joint_rates], moved, hold[joints])
        ahead = np.where(is_idle, self.lead, 0.0)
        ahead[space.base] = -self.settling  # negative: the base comes to rest after the switch
        stopped = Begin(start, ahead)
        posture = min(self.postures, key=lambda posture: float(self.arrivals(stopped, posture).max()))

        goes_on = has_weight & ((hold[joints] - start[joints]) * (posture[joints] - start[joints]) > 0)
        Q = start.copy()
        Q[joints] = np.where(goes_on, first, start[joints])
        earlier = ahead.copy()
        earlier[space.joint_rates] = np.where(goes_on, self.duration, ahead[space.joint_rates])
        return Begin(Q, earlier), posture

    def _flight_after(self, Q: np.ndarray, lasts: float) -> float:
        """Return how long the base flies to its target in the stage after the next [s]; 0 if there is no such stage.

        A base that the flight before has not let come to rest in time has to stop first, if it turns round. If it flies
        on in the same direction it keeps its speed and saves that time instead.

        Args:
            Q: Coordinates at which the next stage ends (nq,).
            lasts: How long the next stage lasts [s].
        """
        if self.after is None:
            return 0.0
        space = self.model.space
        flown = np.array(space.difference(self.begin, self.hold))[space.base]  # in this stage
        displacements = np.array(space.difference(Q, self.goal))
        flight = _motion_of(self.model, self.after).times(displacements)[space.base]
        unsettled = np.maximum(self.settling - lasts, 0.0)
        times = flight + np.where(flown * displacements[space.base] > 0, -unsettled, unsettled)
        of_base = _coordinates_in_end(self.model, self.after)[space.base]
        return float(times[of_base].max(initial=0.0))


def _switch_after(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray], index: int
) -> _Switch:
    """Collect what is known of the switch at the end of a stage: where the robot is, and what the next stage needs.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at every stage's target, (nq,) each.
        index: Index of the stage; it is not the last.
    """
    stage = stages[index]
    then = stages[index + 1]
    has_after = index + 2 < len(stages) and index + 2 not in reasons_unforeseen(task.spec, stages)
    awaited = _awaited_coordinates(model, then)
    is_held = awaited & (stage.weights[: model.n] > 0)
    is_held[model.space.base] = False
    is_held[list(stage.end.rows)] = False
    duration, settling = _duration_and_settling(task, model, stages, stops, index)
    controller = task.spec.controller
    return _Switch(
        model=model,
        stage=stage,
        then=then,
        after=stages[index + 2] if has_after else None,
        begin=stops[index],  # the target of the stage before, or the start
        hold=stops[index + 1],
        goal=stops[index + 3 if has_after else index + 2],
        postures=_postures_at_poses(model, then, *stops[index : index + 3]),
        awaited=awaited,
        is_held=is_held,
        duration=duration,
        # A controller whose windows have one stage knows of the next one only from the switch on.
        lead=0.0 if controller.traits.one_stage else min(controller.horizon, duration),
        settling=settling,
        sample_time=controller.sample_time,
    )


def _postures_at_poses(
    model: RobotModel, stage: Stage, begin: np.ndarray, hold: np.ndarray, target: np.ndarray
) -> list[np.ndarray]:
    """Return the coordinates with which the robot takes the poses of a stage's target, (nq,) each.

    Inverse kinematics of an arm has several branches (elbow up or down). It is solved from several coordinates, and
    every combination of the solutions that are found for the arms is one posture. There is none where a pose is out of
    reach.

    Args:
        model: The robot.
        stage: The stage whose target is to be taken.
        begin: Coordinates at which the stage before begins (nq,), near which one solution is sought.
        hold: Coordinates at which that stage holds the robot (nq,), likewise.
        target: Coordinates at the stage's target as `configurations_at_stops` has them (nq,), likewise; the base and
            joints that no pose is about stay as they are there.
    """
    if not is_asked_for(stage, range(model.space.base.stop)):
        return [target]  # it is not known where arms have to be
    before = model.nq - model.n
    base = stage.target[stage.parts[BASE].numbers]
    branches = []
    for arm, pose in stage.poses_of_arms.items():
        rows = model.parts[arm]
        limits = stage.limits.position_low[rows], stage.limits.position_high[rows]
        nearby = (None, *(Q[before:][rows] for Q in (begin, hold, target)))
        reaches = [reach_of(model, arm, base, pose, limits, near) for near in nearby]
        branches.append([np.array(reach.configuration) for reach in reaches if reach.configuration is not None])
    postures = []
    for joints in product(*branches):
        posture = target.copy()
        for arm, values in zip(stage.poses_of_arms, joints, strict=True):
            posture[before:][model.parts[arm]] = values
        postures.append(posture)
    return postures


def _with_joints(model: RobotModel, Q: np.ndarray, other: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return a copy of Q (nq,) with joint coordinates of `other` (nq,) where the mask `rows` of v (n,) is true."""
    mixed = Q.copy()
    joints = model.space.joint_coordinates
    mixed[joints] = np.where(rows[model.space.joint_rates], other[joints], Q[joints])
    return mixed


def _coordinates_in_end(model: RobotModel, stage: Stage) -> np.ndarray:
    """Return a mask of the coordinates of v that the end condition of a stage bounds themselves (n,)."""
    rows = np.zeros(model.n, bool)
    coordinates = coordinate_of_row(stage)
    rows[[coordinates[row] for row in stage.end.rows if row in coordinates]] = True
    return rows


def _awaited_coordinates(model: RobotModel, stage: Stage) -> np.ndarray:
    """Return a mask of the coordinates of v for which the end of a stage waits (n,).

    It waits for those that its end condition bounds, and for all coordinates of an arm and of the base if the end
    condition has rows of the pose of that arm's end-effector. The latter only if the stage asks for all of that pose
    and of the base's: otherwise the joints need not be at known coordinates.
    """
    awaited = _coordinates_in_end(model, stage)
    ends = set(stage.end.rows)
    base = range(model.space.base.stop)
    for arm in stage.poses_of_arms:
        part = stage.parts[arm]
        rows = range(part.rows.start, part.rows.stop)
        if ends & set(rows) and is_asked_for(stage, [*base, *rows]):
            awaited[model.parts[arm]] = True
            awaited[list(base)] = True
    return awaited


def _duration_and_settling(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray], index: int
) -> tuple[float, np.ndarray]:
    """Estimate how long a stage lasts, and how long after it the base takes to come to rest.

    Every coordinate moves as fast as the limits allow, from the target of the stage before, at rest. A stage whose end
    does not ask for rest is over when the last coordinate arrives, at full speed.

    Args:
        task: The task.
        model: Its robot.
        stages: Its stages.
        stops: The robot's coordinates at the start and at every stage's target, (nq,) each.
        index: Index of the stage.

    Returns:
        The duration [s], and for each coordinate of the base how long after it that could be at rest, (3,) or (6,) [s].
    """
    stage = stages[index]
    motion = _motion_of(model, stage)
    displacements = np.array(model.space.difference(stops[index], stops[index + 1]))
    at_rest = motion.times(displacements)
    if stage.end.shape.is_fixed:
        before = earliest_ends(task, stages)[index - 1][0] if index else 0.0
        lasts = max(stage.end.latest - before, 0.0)
    else:
        at_speed = shortest_time(np.abs(displacements), motion.velocity, motion.acceleration, np.zeros(model.n))
        # A coordinate that cannot move takes infinitely long, which `shortest_time` does not return.
        arrivals = np.where(stage.end.shape.has_rates | np.isinf(at_rest), at_rest, at_speed)
        lasts = max(stage.end.dwell, float(arrivals[list(stage.end.rows)].max(initial=0.0)) + stage.end.hold)
    return lasts, np.maximum(at_rest[model.space.base] - lasts, 0.0)


def _motion_of(model: RobotModel, stage: Stage) -> RestToRest:
    """Return how a stage moves each coordinate: the smaller limit of both directions counts."""
    limits = stage.limits
    velocity = np.minimum(limits.velocity_high, -limits.velocity_low)
    if not stage.moved_by.moves:
        velocity[model.space.base] = 0.0
    acceleration = np.minimum(limits.acceleration_high, -limits.acceleration_low)
    return RestToRest(velocity, acceleration, limits.position_low, limits.position_high)
