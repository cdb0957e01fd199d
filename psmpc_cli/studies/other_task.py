"""What the task in a study's file and another one differ in, in words."""

import json
from collections.abc import Iterator
from itertools import islice

from psmpc_cli.errors import SpecError
from psmpc_cli.logs.results import Results
from psmpc_cli.specs.document import describe
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.messages import Path, dotted, quoted, shortened

MOST = 3
"""Keys that a message names."""


def difference(results: Results, task: Task) -> str:
    """Say what a study's task has that this one has not: another name, or other values, the first few."""
    name = str(results.attributes.get("task_name", ""))
    if name != task.spec.name:
        return f"found the task {quoted(name)}, this one is {quoted(task.spec.name)}"
    task_yaml, robot_yaml = (str(results.attributes.get(key, "")) for key in ("task_yaml", "robot_yaml"))
    try:
        found = parse_task(task_yaml, robot_yaml, name)
    except SpecError:
        return f"found a task {quoted(name)} that does not hold in this version"
    differing = _differing(_described(found), _described(task), ())
    named = [f"{key} {before}, this one has {now}" for key, before, now in islice(differing, MOST)]
    more = sum(1 for _ in differing)
    rest = f"; and {more} more {'key' if more == 1 else 'keys'} differ{'s' if more == 1 else ''}" if more else ""
    return f"found {'; '.join(named)}{rest}" if named else "found the arms of its robot in another order"


def _described(task: Task) -> dict[str, object]:
    """Return a task's keys, and below `robot` those of its robot."""
    return {**task.spec.model_dump(mode="json"), "robot": task.robot.model_dump(mode="json")}


def _differing(before: object, now: object, path: Path) -> Iterator[tuple[str, str, str]]:
    """Give path and both values of every key whose values differ."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys((*before, *now)):
            yield from _differing(before.get(key), now.get(key), (*path, key))
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for i, (one, other) in enumerate(zip(before, now, strict=True)):
            yield from _differing(one, other, (*path, i))
    elif before != now:
        yield dotted(path), _written(before), _written(now)


def _written(value: object) -> str:
    """Write a value on one line and not too long; of a list of mappings, how many."""
    if value is None or (isinstance(value, list) and any(isinstance(entry, dict) for entry in value)):
        return describe(value)
    return shortened(json.dumps(value, ensure_ascii=False))
