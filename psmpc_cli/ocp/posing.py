"""Where a stage holds arms far from where the next stage needs them, though its end does not ask for these arms.

Such a stage gives time away: the arms could be posed for the next stage while the stage does what its end waits for.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.forecast import angle_between, coordinate_of_row, counts, earliest_ends, largest_rates, shortest_time
from psmpc_cli.ocp.postures import unforeseen
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.reach import reach_of
from psmpc_cli.specs.document import Fault, quoted
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.parts import BASE, LENGTH
from psmpc_cli.specs.robot import units

LEAST_GAIN = 0.5
"""Least time [s] that posing has to save to be advised: less is lost in what later stages vary by."""

LOST = 1.0
"""Of the time that posing saves at the speed limits, what the rest of the mission loses again [s].

It is the median of 20 random missions (benchmarks/posing.py, missions 100 to 119).
"""


@dataclass(frozen=True, eq=False)
class Posing:
    """Arms that a stage holds where the next one does not need them.

    Attributes:
        stage: Index of the stage.
        arms: The arms that could be posed.
        Q: Coordinates of the robot (nq,): the base at the target of the stage, these arms where the next stage needs
            them, the others as the stage holds them.
        time: What the next stage takes at least to move these arms from where they are held [s].
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
        stops: The robot's coordinates at the start and at every stage's target, of `configurations`.
    """
    for stage in stages[:-1]:
        if _may_pose(task, stages, stage.index):
            yield from _posing(task, model, stages, stops, stage.index)


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


def _may_pose(task: Task, stages: Sequence[Stage], index: int) -> bool:
    """Tell whether the arms of a stage may be elsewhere, and the next stage is known to need them somewhere.

    They may not where they hold an object, follow a trajectory, or where cones, clearance or a monitor are about them;
    nor where they move the base. Where the next stage needs them is not known if its target moves.
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
        or unforeseen(spec, stages).keys() & {index, index + 1}
    )


def _posing(
    task: Task, model: RobotModel, stages: Sequence[Stage], stops: Sequence[np.ndarray], index: int
) -> Iterator[Posing]:
    """Yield what posing the arms in a stage saves, if it saves enough.

    The motion at the speed limits is followed. In a stage that lasts T the arms move from where it begins towards where
    it holds them, for the last `lead` seconds towards where the next stage needs them; what is left of that is time of
    the next stage, unless its base, or an arm that is not held, takes longer. Posed, they move to the latter for all
    of T.
    """
    space = model.space
    stage = stages[index]
    then = stages[index + 1]
    asked = _rows_asked(model, then)
    of_joints = slice(space.base.stop, model.n)
    held = np.zeros(model.n + 1, bool)
    held[of_joints] = stage.weights[of_joints] > 0
    held[list(stage.end.rows)] = False
    held &= asked
    if not held.any():
        return
    needed = _needed(model, then, *stops[index : index + 3])
    begin, hold, need = map(space.in_order_of_v, (*stops[index : index + 2], needed))
    beyond = (need < stage.limits.position_low) | (need > stage.limits.position_high)
    if beyond[held[:-1]].any():
        return

    duration = _duration(task, space, stages, stops, index)
    controller = task.spec.controller
    lead = 0.0 if controller.traits.one_stage else min(controller.horizon, duration)
    rates = largest_rates(space, stage)[:2, :-1]
    posed_at = _moved(begin, need, rates, duration)
    left_at = _moved(_moved(begin, hold, rates, duration - lead), need, rates, lead)
    is_free = np.isin(np.arange(model.n), stage.end.rows, invert=True) & ~held[:-1]
    is_free[space.base] = False
    others_at = np.where(is_free, _moved(begin, need, rates, lead), hold)

    turn = angle_between(stops[index + 1][space.attitude], needed[space.attitude])
    others = _times(space, then, need - others_at, turn)
    unposed = np.where(held, _times(space, then, need - left_at, turn), others)
    posed = np.where(held, _times(space, then, need - posed_at, turn), others)
    shortest = max(then.end.dwell, posed[asked].max() + then.end.hold)
    saved = max(then.end.dwell, unposed[asked].max() + then.end.hold) - shortest - LOST
    if not (np.isfinite(saved) and saved > LEAST_GAIN):
        return
    late = held & (unposed + then.end.hold > shortest)
    arms = tuple(arm for arm in task.robot.arms if late[:-1][model.parts[arm]].any())
    Q = _with_arms(model, stops[index + 1], needed, arms)
    from_held = _times(space, then, need - hold, turn)
    yield Posing(index, arms, Q, float(from_held[late].max()), lead, float(saved))


def _needed(model: RobotModel, stage: Stage, begin: np.ndarray, hold: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return where a stage needs the robot (nq,): of the postures that take its poses those nearest to the held one.

    Args:
        model: The robot.
        stage: The stage.
        begin: Where the stage before begins (nq,); a posture may be on a branch that leads on from there.
        hold: Where it holds the robot (nq,).
        target: Where the motion from there leads, of `configurations` (nq,).
    """
    needed = target.copy()
    space = model.space
    before = model.nq - model.n
    rates = np.minimum(*largest_rates(space, stage)[:2, :-1])
    for arm, pose in stage.poses_of_arms.items():
        rows = model.parts[arm]
        limits = stage.limits.position_low[rows], stage.limits.position_high[rows]
        base = stage.target[stage.parts[BASE].numbers]
        held = hold[before:][rows]
        candidates = [target[before:][rows]]
        if not counts(stage, range(space.base.stop)) or np.array_equal(candidates[0], held):
            continue  # it is not known where the arm has to be, or it is there
        for near in (None, begin[before:][rows]):
            reach = reach_of(model, arm, base, pose, limits, near)
            if reach.configuration is not None:
                candidates.append(np.array(reach.configuration))
        needed[before:][rows] = min(candidates, key=lambda joints: np.max(np.abs(joints - held) / rates[rows]))
    return needed


def _with_arms(model: RobotModel, Q: np.ndarray, other: np.ndarray, arms: Sequence[str]) -> np.ndarray:
    """Return coordinates (nq,) of which some arms have those of another configuration."""
    mixed = Q.copy()
    before = model.nq - model.n
    for arm in arms:
        mixed[before:][model.parts[arm]] = other[before:][model.parts[arm]]
    return mixed


def _rows_asked(model: RobotModel, stage: Stage) -> np.ndarray:
    """Return which coordinates of v, and the base's attitude behind them, the end of a stage waits for (n + 1,).

    For those of an arm and of the base it waits through the pose of an end-effector, where all of the pose is wanted.
    """
    asked = np.zeros(model.n + 1, bool)
    ends = set(stage.end.rows)
    base = range(model.space.base.stop)
    coordinates = coordinate_of_row(stage)
    asked[[coordinates[row] for row in ends & coordinates.keys()]] = True
    for arm in stage.poses_of_arms:
        part = stage.parts[arm]
        rows = range(part.rows.start, part.rows.stop)
        if ends & set(rows) and counts(stage, [*base, *rows]):
            asked[model.parts[arm]] = True
            asked[list(base)] = True
    asked[-1] = asked[model.space.rotation].all()
    return asked


def _duration(
    task: Task, space: ConfigurationSpace, stages: Sequence[Stage], stops: Sequence[np.ndarray], index: int
) -> float:
    """Return how long a stage lasts at least, from the target of the one before on [s]."""
    stage = stages[index]
    if stage.end.shape.is_fixed:
        before = earliest_ends(task, stages)[index - 1][0] if index else 0.0
        return max(stage.end.latest - before, 0.0)
    begin, hold = stops[index : index + 2]
    turn = angle_between(begin[space.attitude], hold[space.attitude])
    times = _times(space, stage, space.in_order_of_v(hold) - space.in_order_of_v(begin), turn)
    rows = list(stage.end.rows)
    if set(range(space.rotation.start, space.rotation.stop)) <= set(rows):
        rows.append(len(times) - 1)
    return max(stage.end.dwell, float(times[rows].max(initial=0.0)) + stage.end.hold)


def _times(space: ConfigurationSpace, stage: Stage, displacement: np.ndarray, turn: float) -> np.ndarray:
    """Return how long coordinates take at the speed limits of a stage for displacements from rest, (n + 1,) [s].

    Args:
        space: The robot's coordinates.
        stage: The stage.
        displacement: By how much they change (n,) [m, rad].
        turn: By how much a spatial base turns [rad]; it stands for the components of its attitude.
    """
    change = np.append(displacement, turn)
    if space.has_quaternion:
        change[space.rotation] = 0.0
    rates = largest_rates(space, stage)
    rate, gain = np.where(change > 0, rates[::2], rates[1::2])
    times = shortest_time(np.abs(change), rate, gain, np.zeros(len(change)))
    return np.asarray(np.where((change != 0) & (rate <= 0), np.inf, times))


def _moved(start: np.ndarray, goal: np.ndarray, rates: np.ndarray, time: float) -> np.ndarray:
    """Return where coordinates (n,) are that move to a goal for some time at their largest rates up and down (2, n)."""
    most = rates * time if time > 0 else np.zeros_like(rates)  # rates may be infinite
    return np.asarray(start + np.clip(goal - start, -most[1], most[0]))
