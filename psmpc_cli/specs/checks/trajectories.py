"""Targets that move: times that rise from 0, and for every part one row of values a time."""

from collections.abc import Iterator, Mapping

from psmpc_cli.specs.checks.parts import TIMES, check_keys, joints, moves, space_of_stage, wanted_length
from psmpc_cli.specs.coordinates import sizes
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault, counted
from psmpc_cli.specs.robot import RobotSpec


def check_times(task: Cursor) -> Iterator[Fault]:
    """Give times of trajectories that do not rise from 0."""
    for stage in task["stages"].entries():
        times = list(stage["target"][TIMES].entries())
        numbers = [time.number for time in times]
        if numbers and numbers[0] is not None and numbers[0] != 0:
            yield times[0].problem(f"found {numbers[0]:g} s, expected 0: times count from where the stage begins")
        for time, before, after in zip(times[1:], numbers[:-1], numbers[1:], strict=True):
            if before is not None and after is not None and after <= before:
                yield time.problem(f"found {after:g} s, expected later than the time before it, {before:g} s")


def check_trajectories(task: Cursor, robot: RobotSpec) -> Iterator[Fault]:
    """Give unknown and missing parts of trajectories, and rows that do not fit times and parts."""
    for stage in task["stages"].entries():
        space, target = space_of_stage(task, stage), stage["target"]
        if space is not None and moves(target):
            parts = sizes(robot, space)
            yield from check_keys(target, parts, beside=(TIMES,))
            yield from _check_rows(target, parts)


def lasts(stage: Cursor) -> tuple[float, str]:
    """Return how long a stage lasts at least [s], as far as that can be told, and the key that says so."""
    last = [time.number for time in stage["target"][TIMES].entries()][-1:]
    known = {"dwell": stage["dwell"].number or 0.0, "trajectory": last[0] or 0.0 if last else 0.0}
    longest = max(known, key=known.__getitem__)
    return max(known[longest], 0.0), longest


def _check_rows(target: Cursor, parts: Mapping[str, int]) -> Iterator[Fault]:
    """Give parts with too few or too many rows, and rows that are too short or too long."""
    number = target[TIMES].length
    for key, part in target.items():
        if key == TIMES:
            continue
        if number is not None and part.length is not None and part.length != number:
            rows = counted(number, "row", "rows")
            yield part.problem(f"found {part.found}, expected {rows}, one for every entry of times")
        for name in joints(key, parts):
            if key == "arms" and target[name].exists:
                continue
            wrong = [row for row in part.entries() if row.length not in (None, parts[name])]
            yield from (row.problem(f"found {row.found}, expected {wanted_length(name, parts[name])}") for row in wrong)
            if wrong:
                break
