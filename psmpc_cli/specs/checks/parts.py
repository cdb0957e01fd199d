"""Numbers by part: the parts are the robot's, none is missing, and every list is as long as its part."""

from collections.abc import Iterator, Mapping

from psmpc_cli.specs.coordinates import AXES, Space, sizes
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.messages import Fault, choice, counted
from psmpc_cli.specs.robot import RobotSpec

SPACES: dict[str, Space] = {"joint": "joint", "task": "task"}

TIMES = "times"
"""The key that stands beside the parts of a target that moves."""


def check_parts(task: Cursor, robot: RobotSpec) -> Iterator[Fault]:
    """Give unknown and missing parts and wrong lengths wherever a task gives numbers by part."""
    yield from _check(task["initial"], sizes(robot, "joint"))
    yield from _check(task["initial_velocity"], sizes(robot, "joint"), complete=False)
    for _, skill in task["skills"].items():
        space, control = space_of(skill), skill["weights"]["control"]
        if space is not None:
            yield from _check(skill["weights"], sizes(robot, space), beside=("control",))
        if isinstance(control.value, dict):
            yield from _check(control, sizes(robot, "task" if skill["input"].text == "task" else "joint"))
    for stage in task["stages"].entries():
        space = space_of_stage(task, stage)
        if space is not None:
            if not moves(stage["target"]):
                yield from _check(stage["target"], sizes(robot, space))
            yield from _check(stage["ends_when"]["tolerance"], sizes(robot, space), complete=False, shortest=1)


def space_of(skill: Cursor) -> Space | None:
    """Return the space of a skill, None if it has no valid one."""
    return SPACES.get(skill["space"].text or "")


def space_of_stage(task: Cursor, stage: Cursor) -> Space | None:
    """Return the space of a stage's skill, None if it is not known."""
    name = stage["skill"].text
    return None if name is None else space_of(task["skills"][name])


def moves(target: Cursor) -> bool:
    """Tell whether a target is a trajectory: it has times, or rows of values."""
    rows = (entry for _, part in target.items() for entry in part.entries() if entry.length is not None)
    return isinstance(target.value, dict) and (TIMES in target.value or any(True for _ in rows))


def joints(key: str, parts: Mapping[str, int]) -> tuple[str, ...]:
    """Return the parts that a key stands for: `arms` for every arm."""
    return tuple(part for part in parts if part == key or (key == "arms" and part != "base"))


def check_key(part: Cursor, key: str, parts: Mapping[str, int]) -> Fault | None:
    """Return a problem if a key is no part of the robot."""
    if joints(key, parts):
        return None
    return part.problem(f"found no such part of the robot{choice(key, (*parts, 'arms'))}", at_key=True)


def _check(
    place: Cursor, parts: Mapping[str, int], complete: bool = True, beside: tuple[str, ...] = (), shortest: int = 0
) -> Iterator[Fault]:
    """Give what is wrong with one mapping by part; lists of the length `shortest` are right for every part."""
    yield from check_keys(place, parts, complete, beside)
    keys = [key for key, _ in place.items() if key not in beside]
    for key in keys:
        length = place[key].length
        for part in joints(key, parts):
            if length is not None and length not in (parts[part], shortest) and not (key == "arms" and part in keys):
                yield place[key].problem(f"found {place[key].found}, expected {wanted_length(part, parts[part])}")
                break


def check_keys(
    place: Cursor, parts: Mapping[str, int], complete: bool = True, beside: tuple[str, ...] = ()
) -> Iterator[Fault]:
    """Give the keys of one mapping by part that are no parts, and the parts that are missing."""
    keys = [key for key, _ in place.items() if key not in beside]
    yield from (problem for key in keys if (problem := check_key(place[key], key, parts)) is not None)
    missing = [part for part in parts if not any(part in joints(key, parts) for key in keys)]
    if complete and missing and isinstance(place.value, dict):
        yield place.problem(f"found {', '.join(keys) or 'no part'}, expected also {', '.join(missing)}", True)


def wanted_length(part: str, size: int) -> str:
    """Say how long the list of a part must be."""
    axes = f" ({', '.join(AXES)})" if part == "base" else ""
    return f"{counted(size, 'entry', 'entries')} for {part}{axes}"
