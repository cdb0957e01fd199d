"""Parts of a robot: the names of their coordinates, and the rules that numbers by part keep in any description."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, get_args

from pydantic import WrapValidator

from psmpc_cli.specs.document import Document, Location, counted, mapping
from psmpc_cli.specs.fields import Fields, RuleErrors, expected, holds, within_a_turn

Space = Literal["joint", "task", "point"]
"""In which space a skill's cost is; each is the name of a file in `psmpc_cli.ocp.skills`."""

Axes = Mapping[str, tuple[str, ...]]
"""Names of the numbers of every part."""

AxesByDimension = Mapping[int, tuple[str, ...]]
"""Names of numbers in the plane (2) and in space (3)."""

SPACES: tuple[Space, ...] = get_args(Space)

TARGET_AXES = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "qw", "qx", "qy", "qz")}
"""Coordinates of a pose in the plane, and in space, as they are in Q, xi and targets."""

ERROR_AXES = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "rx", "ry", "rz")}
"""The same as they are in velocities, limits and errors: in space the rotation vector."""

POSITION_AXES = ("x", "y", "z")

POINTING_AXES = {2: ("direction",), 3: ("direction_y", "direction_z")}
"""Rows of the error of an arm that points at a point: angles about the end-effector's axes."""

POINT_AXES = {2: POSITION_AXES[:2], 3: POSITION_AXES}
"""Coordinates of a point."""

ARM_AXES: dict[Space, tuple[AxesByDimension, AxesByDimension]] = {
    "task": (ERROR_AXES, TARGET_AXES),
    "point": (POINTING_AXES, POINT_AXES),
}
"""Rows of an arm's error and numbers of its target, by space; where there is none they are the arm's joints."""

QUANTITIES = ("position", "velocity", "acceleration")

RESERVED = ("base", "arms", "all", "control", "times")
"""Names that have another meaning wherever arms are named."""


@dataclass(frozen=True, eq=False)
class Context:
    """What the rules of one key know of the rest of a description.

    Attributes:
        file: The robot's file, or the task's, as written.
        sizes: The parts of the task's robot and their numbers of coordinates; none if the robot is not valid.
        robot_limits: The robot's limits.
    """

    file: Document
    sizes: Mapping[str, int] = field(default_factory=dict)
    robot_limits: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def spaces(self) -> dict[str, Space | None]:
        """The skills and their spaces as written, None where there is no such space."""
        given = {name: mapping(skill).get("space") for name, skill in mapping(self.file.value(("skills",))).items()}
        return {name: space if space in SPACES else None for name, space in given.items()}

    @cached_property
    def stages(self) -> list[str]:
        """The names of the stages in their order, as written."""
        stages = self.file.value(("stages",))
        return [str(mapping(stage).get("name")) for stage in stages] if isinstance(stages, list) else []


def stands_for(key: str, part: str) -> bool:
    """Tell whether a key of numbers by part means a part: itself, or any arm for `arms`."""
    return key == part or (key == "arms" and part != "base")


def axes_of(parts: Mapping[str, int], space: Space, of_error: bool = True) -> dict[str, tuple[str, ...]]:
    """Return the names of the rows of the error, or of the numbers of a target, by part; `parts` are the robot's."""
    dimension = dimension_of(parts)
    kind = 0 if of_error else 1
    axes = {part: tuple(str(joint + 1) for joint in range(size)) for part, size in parts.items()}
    if space in ARM_AXES:
        axes = dict.fromkeys(parts, ARM_AXES[space][kind][dimension])
    return {**axes, "base": (ERROR_AXES, TARGET_AXES)[kind][dimension]} if "base" in parts else axes


def dimension_of(parts: Mapping[str, int]) -> int:
    """Return 2 or 3: in how many dimensions a robot with such parts moves."""
    return 3 if parts.get("base") == len(ERROR_AXES[3]) else 2


def by_dimension(plane: int, space: int) -> WrapValidator:
    """Create a validator of a list whose length is another for a planar than for a spatial robot."""

    def rule(numbers: tuple[float, ...], before: Fields, context: Context) -> RuleErrors:
        length = plane if dimension_of(context.sizes) == 2 else space
        if context.sizes and len(numbers) != length:
            yield (), expected(counted(length, "entry", "entries"))

    return holds(rule)


def names(parts: Mapping[str, int], space: Space) -> tuple[str, ...]:
    """Return every name that means rows of the error; `parts` are the robot's."""
    labels = (f"{part}.{axis}" for part, axes in axes_of(parts, space).items() for axis in axes)
    return (*parts, "arms", "all", *labels) if parts else ()


def part_faults(
    numbers: Any, axes: Axes, required: Collection[str] = (), one: bool = False, angles: bool = False
) -> RuleErrors:
    """Give missing parts, wrong lengths and angles without a unit in numbers by part.

    Args:
        numbers: Lists by part, or lists of such rows beside the key `times`; anything else has no flaws.
        axes: The names of the numbers of every part.
        required: The parts that must be there.
        one: Whether one number may stand for all of a part.
        angles: Whether some of the numbers, as written, are angles, which need a unit beyond one turn.
    """
    if not isinstance(numbers, Mapping):
        return
    given = {key: row for key, row in numbers.items() if key != "times"}
    missing = [part for part in required if not any(stands_for(key, part) for key in given)]
    if missing:
        yield (), expected(f"also {', '.join(missing)}", ", ".join(given) or "no part", at_key=True)
    times = numbers.get("times", ())
    for key, row in given.items():
        if times and len(row) != len(times):
            yield (key,), expected(f"{counted(len(times), 'row', 'rows')}, one for every entry of times")
        rows = {(key, i): each for i, each in enumerate(row)} if times else {(key,): row}
        for at, each in rows.items():
            yield from misfit(at, each, key, axes, given, one, angles)


def in_joint_space(required: bool = False, one: bool = False, angles: bool = False) -> WrapValidator:
    """Create the validator of numbers by part of Q (`angles`) or of v, all of its parts or some.

    Further arguments are as for `part_faults`.
    """

    def rule(written: Any, before: Fields, context: Context) -> RuleErrors:
        axes = axes_of(context.sizes, "joint", of_error=not angles)
        yield from part_faults(written, axes, axes if required else (), one, angles)

    return holds(rule, as_written=True)


def misfit(
    at: Location, row: Any, key: str, axes: Axes, given: Collection[str], one: bool = False, angles: bool = False
) -> RuleErrors:
    """Give a list of numbers, or of pairs, that part_faults a part its key stands for, and its angles without a unit.

    Parts of `given` have lists of their own.
    """
    parts = [part for part in axes if stands_for(key, part) and (key == part or part not in given)]
    if not parts or not isinstance(row, list | tuple):
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
                yield from (((*at, *place), error) for _, error in within_a_turn(value, {}, None))
