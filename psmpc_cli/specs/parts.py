"""Parts of a robot: the names of their coordinates, and the rules that numbers by part keep in any description."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any, Literal

from pydantic import WrapValidator

from psmpc_cli.specs.document import Data, Location, counted, entries, mapping
from psmpc_cli.specs.fields import Fields, Flaws, beyond_a_turn, expected, holds

Space = Literal["joint", "task", "point"]
Axes = Mapping[str, tuple[str, ...]]
"""Names of the numbers of every part."""

SPACES: tuple[Space, ...] = ("joint", "task", "point")

TARGET_AXES = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "qw", "qx", "qy", "qz")}
"""Coordinates of a pose in the plane, and in space, as they are in Q, xi and targets."""

ERROR_AXES = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "rx", "ry", "rz")}
"""The same as they are in velocities, limits and errors: in space the rotation vector."""

POSITION_AXES = ("x", "y", "z")

POINTING_AXES = {2: ("direction",), 3: ("direction_y", "direction_z")}
"""Rows of the error of an arm that points at a point: angles about the end-effector's axes."""

QUANTITIES = ("position", "velocity", "acceleration")

RESERVED = ("base", "arms", "all", "control", "times")
"""Names that have another meaning wherever arms are named."""


@dataclass(frozen=True, eq=False)
class Context:
    """What the rules of one key know of the other keys, as written: what cannot be read is empty or None.

    Attributes:
        data: The robot, or the task.
        robot: The robot.
        robot_limits: Its limits if it is valid.
        urdf: The URDF that the robot's file refers to.
        well_formed: Values that rules were applied to, by field: other rules use them even if a rule rejects them.
    """

    data: Data
    robot: Data
    robot_limits: Mapping[str, Any] = field(default_factory=dict)
    urdf: Any = None
    well_formed: dict[str, Any] = field(default_factory=dict)

    def value(self, *path: str) -> Data:
        """Return the value at a path, None if there is none."""
        return reduce(lambda found, key: mapping(found).get(key), path, self.data)

    @property
    def is_spatial(self) -> bool:
        """Whether the robot moves in space."""
        return mapping(self.robot).get("space") == "spatial"

    @cached_property
    def sizes(self) -> dict[str, int]:
        """The parts of the robot and their numbers of coordinates."""
        arms = mapping(self.robot).get("arms", {} if self.is_spatial else None)
        lengths = {name: len(entries(mapping(arm).get("links"))) for name, arm in mapping(arms).items()}
        known = isinstance(arms, dict) and all(lengths.values()) and not any(name in RESERVED for name in lengths)
        return {"base": 6 if self.is_spatial else 3, **lengths} if known else {}

    @cached_property
    def parts(self) -> list[str]:
        """The keys of numbers by part."""
        return [*self.sizes, "arms"] if self.sizes else []

    @cached_property
    def spaces(self) -> dict[str, Space | None]:
        """The skills and their spaces."""
        given = {name: mapping(skill).get("space") for name, skill in mapping(self.value("skills")).items()}
        return {name: next((each for each in SPACES if each == space), None) for name, space in given.items()}

    @cached_property
    def stages(self) -> list[str]:
        """The names of the stages in their order."""
        names = (mapping(stage).get("name") for stage in entries(self.value("stages")))
        return [name for name in names if isinstance(name, str)]


def stands_for(key: str, part: str) -> bool:
    """Tell whether a key of numbers by part means a part: itself, or any arm for `arms`."""
    return key == part or (key == "arms" and part != "base")


def target_axes(parts: Mapping[str, int], space: Space) -> dict[str, tuple[str, ...]]:
    """Return the names of the numbers of a target, by part; `parts` are the robot's."""
    d = dimension_of(parts)
    of_arm = {"task": TARGET_AXES[d], "point": POSITION_AXES[:d]}
    return _axes(parts, TARGET_AXES[d], of_arm.get(space))


def error_axes(parts: Mapping[str, int], space: Space) -> dict[str, tuple[str, ...]]:
    """Return the names of the rows of the error, by part; `parts` are the robot's."""
    d = dimension_of(parts)
    of_arm = {"task": ERROR_AXES[d], "point": POINTING_AXES[d]}
    return _axes(parts, ERROR_AXES[d], of_arm.get(space))


def dimension_of(parts: Mapping[str, int]) -> int:
    """Return 2 or 3: in how many dimensions a robot with such parts moves."""
    return 3 if parts.get("base") == len(ERROR_AXES[3]) else 2


def _axes(
    parts: Mapping[str, int], of_base: tuple[str, ...], of_arm: tuple[str, ...] | None
) -> dict[str, tuple[str, ...]]:
    """Return names by part; those of an arm are its joints from 1 if it has none of its own."""
    joints = {part: tuple(str(joint + 1) for joint in range(size)) for part, size in parts.items()}
    return {part: of_base if part == "base" else of_arm or joints[part] for part in parts}


def names(parts: Mapping[str, int], space: Space | None) -> tuple[str, ...]:
    """Return every name that means rows of the error, in any space if it is None; `parts` are the robot's."""
    axes = [error_axes(parts, each) for each in SPACES if space in (each, None)]
    labels = (f"{part}.{axis}" for by_part in axes for part in parts for axis in by_part[part])
    return tuple(dict.fromkeys((*parts, "arms", "all", *labels)))


def misfits(written: Any, axes: Axes, required: Collection[str] = (), one: bool = False, angles: bool = False) -> Flaws:
    """Give missing parts, wrong lengths and angles without a unit in numbers by part as written.

    Args:
        written: Lists of numbers by part, or lists of such rows beside the key `times`; anything else has no faults.
        axes: The names of the numbers of every part.
        required: The parts that must be there.
        one: Whether one number may stand for all of a part.
        angles: Whether some of the numbers are angles, so that they need a unit beyond one turn.
    """
    if not isinstance(written, dict):
        return
    given = [key for key in written if key in (*axes, "arms")]
    missing = [part for part in required if not any(stands_for(key, part) for key in given)]
    if missing:
        yield (), expected(f"also {', '.join(missing)}", ", ".join(given) or "no part", at_key=True)
    times = written.get("times")
    for key in given:
        numbers = written[key]
        if isinstance(times, list) and isinstance(numbers, list) and len(numbers) != len(times):
            yield (key,), expected(f"{counted(len(times), 'row', 'rows')}, one for every entry of times")
        rows = [((key, i), row) for i, row in enumerate(entries(numbers)) if isinstance(row, list | dict)]
        places: list[tuple[Location, Any]] = [*rows] or [((key,), numbers)]
        for at, row in places:
            yield from _entries(at, row, key, axes, given, one, angles)


def in_joint_space(required: bool = False, one: bool = False, angles: bool = False) -> WrapValidator:
    """Create the validator of numbers by part of Q (`angles`) or of v, all of its parts or some.

    Further arguments are as for `misfits`.
    """

    def rule(written: Any, before: Fields, context: Context) -> Flaws:
        axes = (target_axes if angles else error_axes)(context.sizes, "joint")
        yield from misfits(written, axes, axes if required else (), one, angles)

    return holds(rule, as_written=True)


def misfit_limits(written: Any, before: Fields, context: Context) -> Flaws:
    """Give lists of limits by part with wrong lengths, and bounds of angles without a unit."""
    axes = error_axes(context.sizes, "joint")
    for quantity in QUANTITIES:
        given = {key: mapping(part).get(quantity) for key, part in mapping(written).items()}
        given = {key: bounds for key, bounds in given.items() if bounds is not None}
        for key, bounds in given.items():
            yield from _entries((key, quantity), bounds, key, axes, given, angles=quantity == "position")
            if key == "base" and quantity == "position" and context.is_spatial:
                limited = (i for i, pair in enumerate(entries(bounds)) if i >= 3 and pair is not None)
                yield from (((key, quantity, i), expected("null: an attitude has no limits")) for i in limited)


def _entries(
    at: Location, row: Any, key: str, axes: Axes, given: Collection[str], one: bool = False, angles: bool = False
) -> Flaws:
    """Give a list of numbers, or of pairs, that misfits a part its key stands for, and its angles without a unit.

    Parts of `given` have lists of their own.
    """
    parts = [part for part in axes if stands_for(key, part) and (key == part or part not in given)]
    if not parts or not isinstance(row, list):
        return
    for part in parts:
        if len(row) not in (len(axes[part]), 1 if one else None):
            named = "" if axes[part][0].isdigit() else f" ({', '.join(axes[part])})"
            length = counted(len(axes[part]), "entry", "entries")
            yield at, expected(f"{length} for {part}{named}{', or one' if one else ''}")
            break
    for i, (axis, item) in enumerate(zip(axes[parts[0]], row, strict=False)):
        if angles and (axis == "theta" or axis.isdigit()):
            values = [((i, j), value) for j, value in enumerate(item)] if isinstance(item, list) else [((i,), item)]
            for place, value in values:
                if (error := beyond_a_turn(value)) is not None:
                    yield (*at, *place), error
