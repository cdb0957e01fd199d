"""How stages follow each other: what ends them, when, and what happens to the object meanwhile."""

from collections.abc import Iterator

from psmpc_cli.specs.checks.names import stage_names
from psmpc_cli.specs.checks.trajectories import lasts
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault, dotted, quoted
from psmpc_cli.specs.task import TaskSpec

BOUNDS = ("above_start_at_most", "below_start_at_most", "at_most", "at_least")
"""Ways to bound a monitored signal."""

FRAMES = {"distance": 2, "speed": 1}
"""How many frames a monitored quantity is about."""


def check_stages(task: Cursor) -> Iterator[Fault]:
    """Give stages that never end or end twice, instants out of order, and an object let go before it is taken."""
    stages = list(task["stages"].entries())
    for stage in stages:
        yield from _end(stage, last=stage is stages[-1])
    yield from _instants(task, stages)
    yield from _object(task)
    for monitor in task["monitors"].entries():
        yield from _monitor(monitor)


def _end(stage: Cursor, last: bool) -> Iterator[Fault]:
    """Give a stage without an end, or with two."""
    if not isinstance(stage.value, dict):
        return
    if last and stage["at"].exists:
        yield stage["at"].problem('found "at" in the last stage, expected "ends_when", which ends the run', True)
    elif last and not stage["ends_when"].exists:
        yield stage.problem('found no "ends_when", expected it in the last stage: it ends the run', True)
    elif not last and stage["ends_when"].exists and stage["at"].exists:
        yield stage["at"].problem('found both "ends_when" and "at", expected one of them', True)
    elif not last and not stage["ends_when"].exists and not stage["at"].exists:
        yield stage.problem(
            'found neither "ends_when" nor "at", expected one of them in every stage but the last', True
        )


def _instants(task: Cursor, stages: list[Cursor]) -> Iterator[Fault]:
    """Give fixed switching times and shortest durations that no order of events can keep."""
    limit = task["time_limit"].number if task["time_limit"].exists else TaskSpec.model_fields["time_limit"].default
    earliest, because = 0.0, "the start"
    for stage in stages:
        at, (dwell, key) = stage["at"].number, lasts(stage)
        after = f"{earliest + dwell:g} s ({f'{key} after ' if dwell else ''}{because})"
        earliest += dwell
        if at is None:
            because = f"the {key} of {dotted(stage.path)}" if dwell else because
            continue
        if at <= earliest - dwell or at < earliest:
            yield stage["at"].problem(f"found {at:g} s, expected a time after {after}")
        elif limit is not None and at >= limit:
            yield stage["at"].problem(f"found {at:g} s, expected a time before the time_limit of {limit:g} s")
        earliest, because = max(at, earliest), dotted(stage["at"].path)


def _object(task: Cursor) -> Iterator[Fault]:
    """Give an object that is let go before it is taken."""
    names = stage_names(task)
    taken, let_go = task["object"]["taken_by"].text, task["object"]["let_go_by"].text
    if taken in names and let_go in names and names.index(let_go) <= names.index(taken):
        found = f"found {quoted(let_go)}, expected a stage after {quoted(taken)}, which takes the object"
        yield task["object"]["let_go_by"].problem(found)


def _monitor(monitor: Cursor) -> Iterator[Fault]:
    """Give a monitor that bounds nothing, contradicts itself or is about the wrong number of frames."""
    if not isinstance(monitor.value, dict):
        return
    if not any(monitor[bound].exists for bound in BOUNDS):
        yield monitor.problem(f"found no bound, expected one of {', '.join(BOUNDS)}", True)
    least, most = monitor["at_least"].number, monitor["at_most"].number
    if least is not None and most is not None and least > most:
        yield monitor["at_least"].problem(f"found {least:g}, expected no more than at_most, {most:g}")
    frames = [frame.text for frame in monitor["of"].entries()]
    number = FRAMES.get(monitor["quantity"].text or "")
    if number is not None and frames and (len(frames) != number or len(set(frames)) != number):
        wanted = "one frame" if number == 1 else "two different frames"
        yield monitor["of"].problem(f"found {monitor['of'].found}, expected {wanted} for a {monitor['quantity'].text}")
