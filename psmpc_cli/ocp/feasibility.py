"""Whether a task can be done at all, as far as that can be told beforehand: limits, reach, and the order of events."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.outlook import (
    BASE,
    Outlook,
    Vector,
    counts,
    end_tolerances,
    is_coordinate,
    look_ahead,
    pose_rows,
    reach_with,
    reaches_of,
)
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.ocp.wording import beyond, moment_of, path_of_part, path_of_row, span_of, target_path
from psmpc_cli.robot.reach import Reach
from psmpc_cli.specs.coordinates import labels, stack
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.messages import Fault, dotted, quoted
from psmpc_cli.specs.robot import RobotSpec

SLACK = 1e-9
"""By which a bound may be missed [m, rad]: decimals of degrees."""

ALL_KNOWN = 3
"""Links of an arm up to which "not reachable" is certain."""


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


def _rows_outside(stage: Stage, values: Vector) -> list[int]:
    """Return the rows of Q whose values (n,) or (m,) the stage asks for but its limits forbid."""
    last = len(values) if stage.space == "joint" else BASE.stop
    limits = stage.limits
    rows = _outside(values[:last], limits.position_low[:last], limits.position_high[:last])
    return [row for row in rows if counts(stage, slice(row, row + 1))]


def _out_of_reach(arm: str, reach: Reach, pose: Vector, links: int) -> str | None:
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


def _outside(values: Vector, low: Vector, high: Vector) -> list[int]:
    """Return the rows whose values are out of bounds."""
    return [int(row) for row in np.flatnonzero((values < low - SLACK) | (values > high + SLACK))]
