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
from psmpc_cli.specs.coordinates import labels, stack
from psmpc_cli.specs.load import Changes, Task, ensure_planar, load_task
from psmpc_cli.specs.messages import Fault, dotted, quoted
from psmpc_cli.specs.messages import Path as Location
from psmpc_cli.specs.robot import PartLimits, RobotSpec

BASE = slice(0, 3)
"""Rows of the base pose in Q and xi."""

SLACK = 1e-9
"""By which a bound may be missed [m, rad]: decimals of degrees."""

ALL_KNOWN = 3
"""Links of an arm up to which "not reachable" is certain."""

SPEED_SLACK = 1e-6
"""By which a trajectory may be faster than a velocity limit [m/s, rad/s]: values are written with a few digits."""

UNITS = {"position": "", "velocity": "/s"}
"""What follows on the unit of a coordinate in its derivatives."""


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


def load_feasible(reference: str | Path | Mapping[str, Any], set: Changes = ()) -> Task:
    """Load a task as `load_task` does, and make sure that nothing stands against it.

    Raises:
        SpecError: Something is wrong or stands against it; the message has all of it, located in the task's file.
    """
    return load_task(reference, set, _review_sound)


def _review_sound(task: Task, sound: Collection[int] | None) -> list[Fault]:
    """Return the faults of a task; if only some stages are valid, those of their targets."""
    ensure_planar(task)
    if sound is None:
        return review(task)
    return [problem for each in look_ahead(task) if each.stage.index in sound for problem in _targets(task, each)]


def ensure_feasible(task: Task) -> None:
    """Make sure that nothing stands against a task.

    Raises:
        SpecError: Something does; the message has all of it, located in the task's file.
    """
    ensure_planar(task)
    if problems := review(task):
        raise SpecError(task.source.report(problems))


def review(task: Task) -> list[Fault]:
    """Return everything that stands against a task."""
    outlooks = look_ahead(task)
    return [
        *_initial(task, outlooks[0].stage),
        *(problem for outlook in outlooks for problem in _targets(task, outlook)),
        *(problem for now, then in pairwise(outlooks) for problem in _handover(task, now.stage, then.stage)),
        *_times(task, outlooks),
    ]


def _initial(task: Task, first: Stage) -> Iterator[Fault]:
    """Give what of the initial state the first stage does not allow."""
    position = stack(task.spec.initial, task.robot, "joint")
    velocity = stack(task.spec.initial_velocity, task.robot, "joint", missing=0.0, of_error=True)
    for key, kind, values in (("initial", "position", position), ("initial_velocity", "velocity", velocity)):
        for row in _outside(values, *_bounds(first, kind)):
            yield Fault(_place(task, (key,), row, "joint"), _beyond(task, row, values[row], first, kind))


def _targets(task: Task, outlook: Outlook) -> Iterator[Fault]:
    """Give what of a stage's target, or of any row of its trajectory, lies outside its limits, or out of reach."""
    stage = outlook.stage
    for index, values in enumerate(stage.waypoints):
        for row in _rows_outside(stage, values):
            yield Fault(_place(task, stage, row, stage.space, index), _beyond(task, row, values[row], stage))
        last = index == len(stage.waypoints) - 1
        for arm, reach in (outlook.reaches if last else _reaches(stage, task.robot, values)).items():
            found = _out_of_reach(arm, reach, values[BASE], len(task.robot.arms[arm].links))
            if found:
                yield Fault(_place_of_part(task, stage, arm, index), found)


def _rows_outside(stage: Stage, values: np.ndarray) -> list[int]:
    """Return the rows of Q whose values (n,) or (m,) the stage asks for but its limits forbid."""
    last = len(values) if stage.space == "joint" else BASE.stop
    low, high = _bounds(stage, "position")
    return [row for row in _outside(values[:last], low[:last], high[:last]) if _counts(stage, slice(row, row + 1))]


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


def _handover(task: Task, stage: Stage, then: Stage) -> Iterator[Fault]:
    """Give the coordinates that a stage leaves where the limits of the next one do not allow them."""
    low, high = _bounds(then, "position")
    for row, tolerance in _coordinates_at_end(stage).items():
        value = stage.target[row]
        outside = value + tolerance < low[row] - SLACK or value - tolerance > high[row] + SLACK
        if outside and row not in _rows_outside(stage, stage.target):
            message = f"{_beyond(task, row, value, then)}, where {quoted(then.name)} keeps it"
            yield Fault(("stages", stage.index, "ends_when"), message)


def _times(task: Task, outlooks: Sequence[Outlook]) -> Iterator[Fault]:
    """Give end conditions that can never be met, and times that are too early for what comes before them."""
    before = 0.0
    for outlook in outlooks:
        stage, path = outlook.stage, ("stages", outlook.stage.index)
        for row in outlook.stuck:
            name, limits = labels(task.robot, "joint")[row], _span(task, row, stage, "velocity")
            message = f"found {name} to be moved, expected velocity limits that allow it, not {limits}"
            yield Fault((*path, "ends_when"), message)
        if stage.at is not None and stage.at < before + stage.dwell:
            since = dotted(("stages", stage.index - 1))
            message = f"found {stage.at:g} s, expected later: {since} cannot end before {before:.4g} s"
            yield Fault((*path, "at"), f"{message} under the velocity limits")
        before = max(before, outlook.earliest_end)


def remarks(task: Task, outlooks: Sequence[Outlook]) -> list[Fault]:
    """Return what is probably not meant.

    A base kept where it is not left, trajectories the robot cannot follow, a time limit no run can keep.
    """
    pairs = pairwise(outlooks)
    return [
        *(problem for before, outlook in pairs for problem in _far_base(task, before.stage, outlook.stage)),
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
    own, moved = _reaches(stage, task.robot, first), _reaches(stage, task.robot, first, left)
    far = [arm for arm, reach in moved.items() if reach.distance > reach.full_reach and not reach.reachable]
    for arm in (arm for arm in far[:1] if own[arm].reachable):
        message = (
            f"found the base {np.hypot(*(first[:2] - left[:2])):.4g} m from where {quoted(before.name)} leaves it, "
            f"expected it there: the target of {arm} is then {moved[arm].distance:.4g} m from its shoulder, "
            f"its reach is {moved[arm].full_reach:.4g} m"
        )
        yield Fault(_place_of_part(task, stage, "base", 0), message)


def _too_fast(task: Task, stage: Stage) -> Iterator[Fault]:
    """Give the coordinates of Q that a trajectory moves faster than their velocity limits, each where it is worst."""
    if stage.trajectory is None:
        return
    times, (low, high) = stage.trajectory.times, _bounds(stage, "velocity")
    rates = np.diff(stage.trajectory.values, axis=0) / np.diff(times)[:, None]
    for row in range(len(stage.target) if stage.space == "joint" else BASE.stop):
        excess = np.maximum(rates[:, row] - high[row], low[row] - rates[:, row])
        worst = int(excess.argmax())
        if excess[worst] > SPEED_SLACK and _counts(stage, slice(row, row + 1)):
            name, rate = labels(task.robot, "joint")[row], _number(task, row, rates[worst, row], "/s")
            message = (
                f"found {name} to move at {rate} from {times[worst]:g} s to {times[worst + 1]:g} s, expected within "
                f"its velocity limits {_span(task, row, stage, 'velocity')}: the robot falls behind"
            )
            yield Fault(_place(task, stage, row, stage.space, worst + 1), message)


def look_ahead(task: Task) -> tuple[Outlook, ...]:
    """Return the outlook of every stage of a task."""
    stages = build_stages(task.spec, task.robot, build_model(task.robot))
    ends = earliest_ends(stages, stack(task.spec.initial, task.robot, "joint"))
    reaches = (_reaches(stage, task.robot, stage.target) for stage in stages)
    return tuple(Outlook(stage, reach, *end) for stage, reach, end in zip(stages, reaches, ends, strict=True))


def earliest_ends(stages: Sequence[Stage], Q: np.ndarray) -> list[tuple[float, tuple[int, ...]]]:
    """Return for every stage a lower bound on the time at which it ends [s], starting from Q (n,), and its stuck rows.

    A coordinate that one stage leaves at its target, and a later one must have at another, takes at least their
    distance over its largest velocity in between; the tolerances are taken off the distance.
    """
    value, tolerance, since = Q.copy(), np.zeros(len(Q)), np.zeros(len(Q))
    up, down = np.zeros(len(Q)), np.zeros(len(Q))  # largest velocities since a coordinate was known
    found, end = list[tuple[float, tuple[int, ...]]](), 0.0
    for stage in stages:
        up, down = np.maximum(up, stage.limits.velocity_high), np.maximum(down, -stage.limits.velocity_low)
        asked = _coordinates_at_end(stage)
        rows, within = np.array(list(asked), int), np.array(list(asked.values()))
        way = stage.target[rows] - value[rows]
        distance, rate = np.abs(way) - within - tolerance[rows], np.where(way > 0, up[rows], down[rows])
        stuck = (distance > 0) & (rate <= 0)
        arrivals = since[rows] + np.maximum(distance, 0.0) / np.where(rate > 0, rate, np.inf)
        end = max(end + max(stage.dwell, stage.hold), *(arrivals[~stuck] + stage.hold), 0.0)
        end = stage.at if stage.at is not None else end
        value[rows], tolerance[rows], since[rows], up[rows], down[rows] = stage.target[rows], within, end, 0.0, 0.0
        found.append((end, tuple(rows[stuck].tolist())))
    return found


def _coordinates_at_end(stage: Stage) -> dict[int, float]:
    """Return the tolerance of every coordinate of Q in the end condition [m, rad]: in task space those of the base."""
    asked = zip(stage.end_rows, stage.tolerance.tolist(), strict=True)
    return {row: tolerance for row, tolerance in asked if stage.space == "joint" or row < BASE.stop}


def _counts(stage: Stage, rows: slice) -> bool:
    """Tell whether weights or the end condition ask for all of some rows of the target."""
    inside = range(rows.start, rows.stop)
    return all(stage.weights[row] > 0 or row in stage.end_rows for row in inside)


def _reaches(stage: Stage, robot: RobotSpec, xi: np.ndarray, base: np.ndarray | None = None) -> dict[str, Reach]:
    """Return how far poses xi (m,) of a stage's target are, of the arms whose poses count, under the stage's limits.

    With the base (3,) at its own pose, or elsewhere.
    """
    if stage.space != "task" or not _counts(stage, BASE):
        return {}
    bounded, first, found = {}, 0, {}
    for part, size in robot.parts.items():
        low, high = (bound[first : first + size].tolist() for bound in _bounds(stage, "position"))
        bounded[part] = PartLimits.model_construct(position=tuple(zip(low, high, strict=True)))
        first += size
    limited = robot.model_copy(update={"limits": bounded})
    for i, arm in enumerate(robot.arms, start=1):
        pose = slice(BASE.stop * i, BASE.stop * (i + 1))
        if _counts(stage, pose):
            found[arm] = reach_of(limited, arm, (xi[BASE] if base is None else base).tolist(), xi[pose].tolist())
    return found


def _bounds(stage: Stage, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return low and high of the positions or velocities of Q, (n,) each."""
    return getattr(stage.limits, f"{kind}_low"), getattr(stage.limits, f"{kind}_high")


def _outside(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[int]:
    """Return the rows whose values are out of bounds."""
    return [int(row) for row in np.flatnonzero((values < low - SLACK) | (values > high + SLACK))]


def _beyond(task: Task, row: int, value: float, stage: Stage, kind: str = "position") -> str:
    """Say that a coordinate is out of a stage's bounds."""
    name, found = labels(task.robot, "joint")[row], _number(task, row, value, UNITS[kind])
    return f"found {name} at {found}, expected within its limits {_span(task, row, stage, kind)}"


def _number(task: Task, row: int, value: float, per: str) -> str:
    """Write a value of Q with its unit, angles in degrees."""
    lengths = ("base.x", "base.y")
    in_metres = labels(task.robot, "joint")[row] in lengths
    return f"{value:.6g} m{per}" if in_metres else f"{np.degrees(value):.6g} deg{per}"


def _span(task: Task, row: int, stage: Stage, kind: str) -> str:
    """Write a stage's bounds of a coordinate with their unit."""
    low, high = (_number(task, row, bound[row], UNITS[kind]) for bound in _bounds(stage, kind))
    return f"[{low}, {high}]"


def _place(task: Task, of: Stage | Location, row: int, space: str, index: int = 0) -> Location:
    """Return where a row of Q or xi is in numbers by part, of a stage's target at one of its waypoints."""
    names = labels(task.robot, "joint" if space == "joint" else "task")
    part = names[row].rpartition(".")[0]
    first = next(i for i, name in enumerate(names) if name.rpartition(".")[0] == part)
    return (*_place_of_part(task, of, part, index), row - first)


def _place_of_part(task: Task, of: Stage | Location, part: str, index: int = 0) -> Location:
    """Return where the numbers of a part are, under its own name or under `arms`; of a trajectory at a waypoint."""
    parts = ("stages", of.index, "target") if isinstance(of, Stage) else of
    own = (*parts, part)
    path = own if own in task.source.origins or part == "base" else (*parts, "arms")
    return (*path, index) if isinstance(of, Stage) and of.trajectory is not None else path
