"""Whether a task can be done, as far as that can be told before anything is solved: limits, reach, order of events."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.problem import Stage, build_stages
from psmpc_cli.robot.model import build_model
from psmpc_cli.robot.reach import Reach, reach_of
from psmpc_cli.specs.coordinates import Limits, labels, stack
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.messages import Fault, dotted, quoted
from psmpc_cli.specs.messages import Path as Location
from psmpc_cli.specs.overrides import Changes
from psmpc_cli.specs.robot import PartLimits, RobotSpec

BASE = slice(0, 3)
"""Rows of the base pose in Q and xi."""

SLACK = 1e-9
"""By which a bound may be missed [m, rad]: decimals of degrees."""

ALL_KNOWN = 3
"""Links of an arm up to which "not reachable" is certain."""


SPEED_SLACK = 1e-6
"""By which a trajectory may be faster than a velocity limit [m/s, rad/s]: values are written with a few digits."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """One stage, looked at beforehand.

    Attributes:
        stage: The stage.
        reaches: By arm, how far its target is with the base at its own, under the limits in force; empty in joint
            space, and for arms (or with a base) whose place neither weights nor the end condition ask for. Of a
            trajectory, the last row's.
        earliest_end: Time before which the stage cannot end [s]: from velocity limits, dwells and fixed times.
        stuck: Rows of Q that its end condition wants elsewhere but velocity limits let not move that way.
    """

    stage: Stage
    reaches: Mapping[str, Reach]
    earliest_end: float
    stuck: tuple[int, ...] = ()


@dataclass(frozen=True)
class _Known:
    """A coordinate was at `value` within `tolerance` [m, rad] at the end of stage `index`, not before `time` [s]."""

    value: float
    tolerance: float
    index: int
    time: float


def load_feasible(reference: str | Path | Mapping[str, Any], set: Changes = ()) -> Task:
    """Load a task as `load_task` does, and make sure that nothing stands against it.

    Raises:
        SpecError: Something is wrong or stands against it; the message has all of it, located in the task's file.
    """
    return load_task(reference, set, _review_sound)


def _review_sound(task: Task, sound: Collection[int] | None) -> list[Fault]:
    """Return what stands against a task; if only some stages are sound, against the targets of these."""
    outlooks = look_ahead(task)
    if sound is None:
        return review(task, outlooks)
    return [problem for outlook in outlooks if outlook.stage.index in sound for problem in _targets(task, outlook)]


def ensure_feasible(task: Task) -> None:
    """Make sure that nothing stands against a task.

    Raises:
        SpecError: Something does; the message has all of it, located in the task's file.
    """
    problems = review(task)
    if problems:
        raise SpecError(task.source.report(problems))


def review(task: Task, outlooks: Sequence[Outlook] | None = None) -> list[Fault]:
    """Return everything that stands against a task.

    Args:
        task: The task.
        outlooks: What is known of its stages; found out if not given.
    """
    outlooks = look_ahead(task) if outlooks is None else outlooks
    return [
        *_initial(task, outlooks[0].stage),
        *(problem for outlook in outlooks for problem in _targets(task, outlook)),
        *(problem for now, then in pairwise(outlooks) for problem in _handover(task, now, then)),
        *_times(task, outlooks),
    ]


def _initial(task: Task, first: Stage) -> Iterator[Fault]:
    """Give what of the initial state the first stage does not allow."""
    limits = first.limits
    position = stack(task.spec.initial, task.robot, "joint")
    velocity = stack(task.spec.initial_velocity, task.robot, "joint", missing=0.0)
    for key, values, low, high in (
        ("initial", position, limits.position_low, limits.position_high),
        ("initial_velocity", velocity, limits.velocity_low, limits.velocity_high),
    ):
        for row in _outside(values, low, high):
            path = path_of_row(task, (key,), row, "joint")
            unit = "/s" if key == "initial_velocity" else ""
            yield Fault(path, beyond(task.robot, row, values[row], low[row], high[row], unit))


def _targets(task: Task, outlook: Outlook) -> Iterator[Fault]:
    """Give what of a stage's target, or of any row of its trajectory, lies outside its limits, or out of reach."""
    stage, low, high = outlook.stage, outlook.stage.limits.position_low, outlook.stage.limits.position_high
    for index, values in enumerate(stage.waypoints):
        moment = moment_of(stage, index)
        for row in _rows_outside(stage, values):
            path = path_of_row(task, target_path(stage), row, stage.space, moment)
            yield Fault(path, beyond(task.robot, row, values[row], low[row], high[row]))
        last = index == len(stage.waypoints) - 1
        for arm, reach in (outlook.reaches if last else reaches_of(stage, task.robot, values)).items():
            found = _out_of_reach(arm, reach, values[BASE], len(task.robot.arms[arm].links))
            if found:
                yield Fault(path_of_part(task, target_path(stage), arm, moment), found)


def _rows_outside(stage: Stage, values: np.ndarray) -> list[int]:
    """Return the rows of Q whose values (n,) or (m,) the stage asks for but its limits forbid."""
    last = len(values) if stage.space == "joint" else BASE.stop
    limits = stage.limits
    rows = _outside(values[:last], limits.position_low[:last], limits.position_high[:last])
    return [row for row in rows if counts(stage, slice(row, row + 1))]


def _out_of_reach(arm: str, reach: Reach, pose: np.ndarray, links: int) -> str | None:
    """Say why an arm cannot take its target with the base at its pose (3,); None if it can, or if nobody can tell."""
    x, y, theta = pose
    base = f"with the base at [{x:g}, {y:g}, {np.degrees(theta):g} deg]"
    if reach.distance > reach.full_reach and not reach.reachable:
        return (
            f"found a pose {reach.distance:.4g} m from the shoulder of {arm} {base}, "
            f"expected at most its reach of {reach.full_reach:.4g} m"
        )
    if not reach.within_annulus:
        return (
            f"found a pose that puts the last joint {reach.wrist_distance:.4g} m from the shoulder of {arm} {base}, "
            f"expected between {reach.inner:.4g} and {reach.outer:.4g} m, the reach of the links before the last"
        )
    if not reach.reachable and links <= ALL_KNOWN:
        return (
            f"found a pose that {arm} can take only beyond its joint limits {base} "
            f"({reach.distance:.4g} m from its shoulder, within its reach of {reach.full_reach:.4g} m), "
            "expected one within them"
        )
    return None


def _handover(task: Task, now: Outlook, then: Outlook) -> Iterator[Fault]:
    """Give what a stage leaves behind at its end that the limits of the next one do not allow."""
    stage, limits, path = now.stage, then.stage.limits, ("stages", now.stage.index, "ends_when")
    for row, tolerance in end_tolerances(stage).items():
        if not is_coordinate(stage, row) or row in _rows_outside(stage, stage.target):
            continue
        value, low, high = stage.target[row], limits.position_low[row], limits.position_high[row]
        if value + tolerance < low - SLACK or value - tolerance > high + SLACK:
            message = beyond(task.robot, row, value, low, high)
            yield Fault(path, f"{message}, where {quoted(then.stage.name)} keeps it")
    for arm in _pinned(now, task.robot):
        if not reach_with(task.robot, arm, limits, stage.target).reachable:
            message = (
                f"found a pose of {arm} that it can take only beyond its joint limits in {quoted(then.stage.name)}"
            )
            yield Fault(path, f"{message}, expected one within them")


def _pinned(outlook: Outlook, robot: RobotSpec) -> list[str]:
    """Return the arms whose place at the end of a stage is known, base and all, and whose limits can be told."""
    known = set(outlook.stage.end_rows)
    return [
        arm
        for arm, reach in outlook.reaches.items()
        if {*range(BASE.stop), *range(pose_rows(robot, arm).start, pose_rows(robot, arm).stop)} <= known
        if reach.reachable and len(robot.arms[arm].links) <= ALL_KNOWN
    ]


def _times(task: Task, outlooks: Sequence[Outlook]) -> Iterator[Fault]:
    """Give end conditions that can never be met, and times that are too early for what comes before them."""
    before = 0.0
    for outlook in outlooks:
        stage, path = outlook.stage, ("stages", outlook.stage.index)
        for row in outlook.stuck:
            low, high = (bound[row] for bound in (stage.limits.velocity_low, stage.limits.velocity_high))
            message = (
                f"found {labels(task.robot, 'joint')[row]} to be moved, expected velocity limits that allow it, not"
            )
            yield Fault((*path, "ends_when"), f"{message} {span_of(task.robot, row, low, high, '/s')}")
        if stage.at is not None and stage.at < before + stage.dwell:
            since = dotted(("stages", stage.index - 1))
            message = f"found {stage.at:g} s, expected later: {since} cannot end before {before:.4g} s"
            yield Fault((*path, "at"), f"{message} under the velocity limits")
        before = max(before, outlook.earliest_end)


def _outside(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[int]:
    """Return the rows whose values are out of bounds."""
    return [int(row) for row in np.flatnonzero((values < low - SLACK) | (values > high + SLACK))]


def remarks(task: Task, outlooks: Sequence[Outlook]) -> list[Fault]:
    """Return what is probably not meant.

    A base kept where it is not left, trajectories the robot cannot follow, a time limit no run can keep.
    """
    return [
        *(
            problem
            for before, outlook in pairwise(outlooks)
            for problem in _far_base(task, before.stage, outlook.stage)
        ),
        *(problem for outlook in outlooks for problem in _too_fast(task, outlook.stage)),
        *_too_short(task, outlooks),
    ]


def _too_short(task: Task, outlooks: Sequence[Outlook]) -> Iterator[Fault]:
    """Give a time limit that stops every run before its last stage can end."""
    earliest = max(outlook.earliest_end for outlook in outlooks)
    if earliest > task.spec.time_limit:
        message = (
            f"found {task.spec.time_limit:g} s, expected at least {earliest:.4g} s: "
            f"{quoted(outlooks[-1].stage.name)} cannot end before under the velocity limits"
        )
        yield Fault(("time_limit",), message)


def _far_base(task: Task, before: Stage, stage: Stage) -> Iterator[Fault]:
    """Give a base that a stage in task space wants elsewhere than the stage before leaves it.

    And so far that an arm does not reach its first pose from there: one of the two may be a misprint.
    """
    first, left = stage.waypoints[0], before.target[BASE]
    if not set(range(BASE.stop)) <= set(before.end_rows):
        return
    own = reaches_of(stage, task.robot, first)
    reaches = {arm: reach_with(task.robot, arm, stage.limits, first, left) for arm in own}
    far = [arm for arm, reach in reaches.items() if reach.distance > reach.full_reach and not reach.reachable]
    for arm in (arm for arm in far[:1] if own[arm].reachable):
        message = (
            f"found the base {np.hypot(*(first[:2] - left[:2])):.4g} m from where {quoted(before.name)} leaves it, "
            f"expected it there: the target of {arm} is then {reaches[arm].distance:.4g} m from its shoulder, "
            f"its reach is {reaches[arm].full_reach:.4g} m"
        )
        yield Fault(path_of_part(task, target_path(stage), "base", moment_of(stage, 0)), message)


def _too_fast(task: Task, stage: Stage) -> Iterator[Fault]:
    """Give the coordinates of Q that a trajectory moves faster than their velocity limits, each where it is worst."""
    if stage.trajectory is None:
        return
    times, limits = stage.trajectory.times, stage.limits
    rates = np.diff(stage.trajectory.values, axis=0) / np.diff(times)[:, None]
    for row in range(len(stage.target) if stage.space == "joint" else BASE.stop):
        low, high = limits.velocity_low[row], limits.velocity_high[row]
        excess = np.maximum(rates[:, row] - high, low - rates[:, row])
        worst = int(excess.argmax())
        if excess[worst] > SPEED_SLACK and counts(stage, slice(row, row + 1)):
            message = (
                f"found {labels(task.robot, 'joint')[row]} to move at {value_of(task.robot, row, rates[worst, row])}/s "
                f"from {times[worst]:g} s to {times[worst + 1]:g} s, expected within its velocity limits "
                f"{span_of(task.robot, row, low, high, '/s')}: the robot falls behind"
            )
            yield Fault(path_of_row(task, target_path(stage), row, stage.space, worst + 1), message)


def look_ahead(task: Task) -> tuple[Outlook, ...]:
    """Return the outlook of every stage of a task."""
    stages = build_stages(task.spec, task.robot, build_model(task.robot))
    ends = earliest_ends(stages, stack(task.spec.initial, task.robot, "joint"))
    reaches = (reaches_of(stage, task.robot, stage.target) for stage in stages)
    return tuple(Outlook(stage, reach, *end) for stage, reach, end in zip(stages, reaches, ends, strict=True))


def earliest_ends(stages: Sequence[Stage], Q: np.ndarray) -> tuple[tuple[float, tuple[int, ...]], ...]:
    """Return for every stage a lower bound on the time at which it ends [s], starting from Q (n,), and its stuck rows.

    A coordinate that one stage leaves at its target, and a later one must have at another, takes at least their
    distance over its largest velocity in between; the tolerances are taken off the distance.
    """
    known = {row: _Known(float(value), 0.0, -1, 0.0) for row, value in enumerate(Q)}
    ends: list[tuple[float, tuple[int, ...]]] = []
    for stage in stages:
        asked = {row: tolerance for row, tolerance in end_tolerances(stage).items() if is_coordinate(stage, row)}
        arrivals = {row: _arrival(stages, stage, row, tolerance, known[row]) for row, tolerance in asked.items()}
        possible = [time for time in arrivals.values() if np.isfinite(time)]
        least = max(stage.dwell, stage.hold)
        end = max([(ends[-1][0] if ends else 0.0) + least, *(time + stage.hold for time in possible)])
        end = stage.at if stage.at is not None else end
        known |= {row: _Known(float(stage.target[row]), asked[row], stage.index, end) for row in asked}
        ends.append((end, tuple(row for row, time in arrivals.items() if np.isinf(time))))
    return tuple(ends)


def end_tolerances(stage: Stage) -> dict[int, float]:
    """Return the tolerance of every row of the end condition [m, rad]."""
    return dict(zip(stage.end_rows, stage.tolerance.tolist(), strict=True))


def is_coordinate(stage: Stage, row: int) -> bool:
    """Tell whether a row of the stage's target is one of Q: all in joint space, the base's in task space."""
    return stage.space == "joint" or row < BASE.stop


def counts(stage: Stage, rows: slice) -> bool:
    """Tell whether weights or the end condition ask for all of some rows of the target."""
    inside = range(rows.start, rows.stop)
    return all(stage.weights[row] > 0 or row in stage.end_rows for row in inside)


def under(robot: RobotSpec, limits: Limits) -> RobotSpec:
    """Return the robot with other position limits of its arms."""
    bounded, first = {}, 0
    for part, size in robot.parts.items():
        rows = slice(first, first + size)
        pairs = zip(limits.position_low[rows].tolist(), limits.position_high[rows].tolist(), strict=True)
        bounded[part] = PartLimits.model_construct(position=tuple(pairs))
        first += size
    return robot.model_copy(update={"limits": bounded})


def pose_rows(robot: RobotSpec, arm: str) -> slice:
    """Return the rows of an arm's pose in xi."""
    first = BASE.stop * (1 + list(robot.arms).index(arm))
    return slice(first, first + BASE.stop)


def reach_with(robot: RobotSpec, arm: str, limits: Limits, xi: np.ndarray, base: np.ndarray | None = None) -> Reach:
    """Return how far an arm's pose in xi (m,) is, with the base (3,) at its own or elsewhere, under some limits."""
    base = xi[BASE] if base is None else base
    return reach_of(under(robot, limits), arm, base.tolist(), xi[pose_rows(robot, arm)].tolist())


def reaches_of(stage: Stage, robot: RobotSpec, xi: np.ndarray) -> dict[str, Reach]:
    """Return how far poses xi (m,) of a stage's target are, of the arms whose poses count."""
    if stage.space != "task" or not counts(stage, BASE):
        return {}
    arms = [arm for arm in robot.arms if counts(stage, pose_rows(robot, arm))]
    return {arm: reach_with(robot, arm, stage.limits, xi) for arm in arms}


def _arrival(stages: Sequence[Stage], stage: Stage, row: int, tolerance: float, before: _Known) -> float:
    """Return the time before which a coordinate cannot be at the stage's target [s]; inf if it cannot move there."""
    way = float(stage.target[row]) - before.value
    limits = [passed.limits for passed in stages[before.index + 1 : stage.index + 1]]
    rate = max(float(limit.velocity_high[row] if way > 0 else -limit.velocity_low[row]) for limit in limits)
    distance = abs(way) - tolerance - before.tolerance
    if distance <= 0:
        return before.time
    return before.time + distance / rate if rate > 0 else np.inf


def beyond(robot: RobotSpec, row: int, value: float, low: float, high: float, per: str = "") -> str:
    """Say that a coordinate is out of bounds."""
    name, found = labels(robot, "joint")[row], value_of(robot, row, value, per)
    return f"found {name} at {found}, expected within its limits {span_of(robot, row, low, high, per)}"


def value_of(robot: RobotSpec, row: int, value: float, per: str = "") -> str:
    """Write a value of Q with its unit, angles in degrees."""
    lengths = ("base.x", "base.y")
    return f"{value:.6g} m{per}" if labels(robot, "joint")[row] in lengths else f"{np.degrees(value):.6g} deg{per}"


def span_of(robot: RobotSpec, row: int, low: float, high: float, per: str = "") -> str:
    """Write a pair of bounds with their unit."""
    return f"[{value_of(robot, row, low, per)}, {value_of(robot, row, high, per)}]"


def path_of_row(task: Task, parts: Location, row: int, space: str, moment: int | None = None) -> Location:
    """Return where a row of Q or xi is in numbers by part; of a trajectory at the `moment`-th of its times."""
    part = labels(task.robot, "joint" if space == "joint" else "task")[row].rpartition(".")[0]
    sizes = task.robot.parts if space == "joint" else dict.fromkeys(task.robot.parts, BASE.stop)
    before = sum(size for name, size in sizes.items() if list(sizes).index(name) < list(sizes).index(part))
    return (*path_of_part(task, parts, part, moment), row - before)


def path_of_part(task: Task, parts: Location, part: str, moment: int | None = None) -> Location:
    """Return where the numbers of a part are, under its own name or under `arms`; of a trajectory at a moment."""
    own = (*parts, part)
    path = own if own in task.source.origins or part == "base" else (*parts, "arms")
    return path if moment is None else (*path, moment)


def target_path(stage: Stage) -> Location:
    """Return where a stage's target is."""
    return ("stages", stage.index, "target")


def moment_of(stage: Stage, index: int) -> int | None:
    """Return the index of a waypoint of a stage's target in the file; None if the target is no trajectory."""
    return None if stage.trajectory is None else index
