"""What does not stand against a task but is probably not meant."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from psmpc_cli.ocp.outlook import BASE, Outlook, counts, reach_with, reaches_of
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.ocp.wording import moment_of, path_of_part, path_of_row, span_of, target_path, value_of
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.messages import Fault, quoted

SLACK = 1e-6
"""By which a trajectory may be faster than a velocity limit [m/s, rad/s]: values are written with a few digits."""


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
        if excess[worst] > SLACK and counts(stage, slice(row, row + 1)):
            message = (
                f"found {labels(task.robot, 'joint')[row]} to move at {value_of(task.robot, row, rates[worst, row])}/s "
                f"from {times[worst]:g} s to {times[worst + 1]:g} s, expected within its velocity limits "
                f"{span_of(task.robot, row, low, high, '/s')}: the robot falls behind"
            )
            yield Fault(path_of_row(task, target_path(stage), row, stage.space, worst + 1), message)
