"""Limits fit the robot's parts, and a task's and a skill's only tighten what is there before."""

from collections.abc import Iterator, Mapping

from psmpc_cli.specs.checks.parts import check_key, joints
from psmpc_cli.specs.coordinates import QUANTITIES, of_part
from psmpc_cli.specs.cursor import Cursor
from psmpc_cli.specs.fields import Pair
from psmpc_cli.specs.messages import Fault
from psmpc_cli.specs.robot import PartLimits, RobotSpec

Layers = tuple[tuple[str, Mapping[str, PartLimits]], ...]
"""Limits by whose they are, such as `the robot's`."""


def check_limits(task: Cursor, robot: RobotSpec) -> Iterator[Fault]:
    """Give what is wrong with the limits of a task and its skills."""
    layers: Layers = (("the robot's", robot.limits),)
    yield from check_layer(task["limits"], robot.parts)
    yield from _looser(task["limits"], robot, layers)
    layers = (*layers, ("the task's", _valid(task["limits"])))
    for _, skill in task["skills"].items():
        yield from check_layer(skill["limits"], robot.parts)
        yield from _looser(skill["limits"], robot, layers)


def check_layer(limits: Cursor, parts: Mapping[str, int]) -> Iterator[Fault]:
    """Give unknown parts and wrong lengths of one set of limits."""
    for key, part in limits.items():
        problem = check_key(part, key, parts)
        if problem is not None:
            yield problem
            continue
        for quantity in QUANTITIES:
            pairs = part[quantity]
            message = _wrong_length(key, pairs.length, parts)
            if pairs.length is not None and message:
                yield pairs.problem(f"found {pairs.found}, expected {message}")


def _wrong_length(key: str, length: int | None, parts: Mapping[str, int]) -> str | None:
    """Say which length was expected of a part's list, None if it is right."""
    for part in joints(key, parts):
        if length != parts[part]:
            return f"{parts[part]} entries, one for every coordinate of {part}"
    return None


def _valid(limits: Cursor) -> dict[str, PartLimits]:
    """Return the limits of the parts that are valid."""
    found = {key: part.valid(PartLimits) for key, part in limits.items()}
    return {key: part for key, part in found.items() if part is not None}


def _looser(limits: Cursor, robot: RobotSpec, before: Layers) -> Iterator[Fault]:
    """Give the bounds of a set of limits that lie outside those before it."""
    for key, given in _valid(limits).items():
        for quantity in QUANTITIES:
            for index, pair in enumerate(getattr(given, quantity) or ()):
                place = limits[key][quantity][index]
                allowed = (_wider(pair, index, part, quantity, before) for part in joints(key, robot.parts))
                tighter = next((text for text in allowed if text), None)
                if tighter:
                    yield place.problem(f"found {place.found}, expected within {tighter}")


def _wider(pair: Pair, index: int, part: str, quantity: str, before: Layers) -> str | None:
    """Say which bounds of a coordinate a pair exceeds, None if none."""
    for whose, layer in before:
        allowed = of_part(layer, part, quantity)
        if allowed is None or index >= len(allowed):
            continue
        least, most = allowed[index]
        if pair[0] < least or pair[1] > most:
            return f"{whose} [{least:.6g}, {most:.6g}] of {part}"
    return None
