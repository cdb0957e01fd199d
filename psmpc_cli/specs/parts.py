"""Parts of a robot: the names of their coordinates, and the rules that numbers by part keep in any description."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from pydantic import WrapValidator

from psmpc_cli.specs.document import Document, Location, choice, counted, mapping
from psmpc_cli.specs.fields import Fields, RuleErrors, expected, flaw, unit_errors, validated_by

SkillKind = Literal["joint", "task", "point"]
"""In which space arms are wanted; each is the name of a file in `psmpc_cli.ocp.skills`."""

FREE = "free"

Wanted = Literal["joint", "task", "point", "free"]
"""The same of one arm, which need not be wanted anywhere."""

BASE = "base"


@dataclass(frozen=True)
class MixedSpace:
    """The space of a skill whose arms are wanted in different ways.

    Attributes:
        kind: How the arms are wanted that are not named.
        arms: How others are, by their names.
    """

    kind: SkillKind
    arms: tuple[tuple[str, Wanted], ...]

    def __str__(self) -> str:
        return f"{self.kind}, {', '.join(f'{arm} {wanted}' for arm, wanted in self.arms)}"


Space = SkillKind | MixedSpace
"""In which space a skill's cost is: one for all arms, or each in its own."""


def space_of(kind: SkillKind, arms: Mapping[str, Wanted]) -> Space:
    """Return the space of a skill some of whose arms are wanted in another way."""
    others = tuple(sorted((arm, wanted) for arm, wanted in arms.items() if wanted != kind))
    return MixedSpace(kind, others) if others else kind


def part_kind(space: Space, part: str) -> str:
    """Return how a part is wanted in a space: the base at a pose, arms in a `Wanted` way."""
    if part == BASE:
        return BASE
    return dict(space.arms).get(part, space.kind) if isinstance(space, MixedSpace) else space


Axes = Mapping[str, tuple[str, ...]]
"""Names of the numbers of every part."""

AxesByDimension = Mapping[int, tuple[str, ...]]
"""Names of numbers in the plane (2) and in space (3)."""

TARGET_AXES = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "qw", "qx", "qy", "qz")}
"""Coordinates of a pose in the plane, and in space, as they are in Q, xi and targets."""

ERROR_AXES = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "rx", "ry", "rz")}
"""The same as they are in velocities, limits and errors: in space the rotation vector."""

POSITION_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class CoordinateUnits:
    """Units of a coordinate and of what belongs to it."""

    position: str
    velocity: str
    acceleration: str
    jerk: str
    force: str


LENGTH = CoordinateUnits("m", "m/s", "m/s^2", "m/s^3", "N")
ANGLE = CoordinateUnits("rad", "rad/s", "rad/s^2", "rad/s^3", "N m")
PURE_NUMBER = CoordinateUnits("1", "1/s", "1/s^2", "1/s^3", "1")
"""Units of lengths, of angles, and of the parts of a quaternion."""

POINTING_AXES = {2: ("direction",), 3: ("direction_y", "direction_z")}
"""Rows of the error of an arm that points at a point: angles about the end-effector's axes."""

POINT_AXES = {2: POSITION_AXES[:2], 3: POSITION_AXES}
"""Coordinates of a point."""


@dataclass(frozen=True)
class SkillKindTraits:
    """What tells a kind of skill from the others: what its cost is about. Every skill is about the base's pose.

    Attributes:
        about: What the cost is, in a few words.
        axes: What else it is about, by part: names of the rows of the error, and of the numbers of a target. The part
            is `arms`, for every arm, or one that only this skill has. None: the joints of the arms.
        required: The parts that targets and weights must have; None for all.
        has_posture: A target is a posture, or poses for which inverse kinematics finds one.
    """

    about: str
    axes: Mapping[str, tuple[AxesByDimension, AxesByDimension]] | None = None
    required: tuple[str, ...] | None = None
    has_posture: bool = True


SKILL_KINDS: Mapping[str, SkillKindTraits] = {
    "joint": SkillKindTraits("cost on Q, eq. (30)"),
    "task": SkillKindTraits("cost on xi, eq. (31)", {"arms": (ERROR_AXES, TARGET_AXES)}),
    "point": SkillKindTraits(
        "end-effectors point at points", {"arms": (POINTING_AXES, POINT_AXES)}, ("base",), has_posture=False
    ),
}
"""The kinds of skill by their name, which is that of the space arms are wanted in."""

QUANTITIES = ("position", "velocity", "acceleration", "jerk", "force")
"""What of a part may have limits."""

Mobility = Literal["free-flying", "attitude", "free-floating", "fixed"]
"""What moves the base of a robot."""

PlumeUse = Literal["ignored", "avoided"]
"""Whether thrusters whose plumes reach the object or an obstacle fire nevertheless."""

PLUMES = "avoided: thrusters do not fire while their plumes reach the object or an obstacle"


@dataclass(frozen=True)
class MobilityTraits:
    """What tells a mobility of the base from the others.

    Attributes:
        name: Its name in files.
        about: What it is, in a few words.
        is_pushed: A force acts on the base at will.
        is_turned: A torque acts on the base at will.
        moves: The base moves.
    """

    name: Mobility
    about: str
    is_pushed: bool = False
    is_turned: bool = False
    moves: bool = True

    @property
    def actuated(self) -> bool:
        """Whether the base is moved at will: pushed and turned."""
        return self.is_pushed and self.is_turned

    @property
    def reacts(self) -> bool:
        """Whether the arms move the base along, so that its place at a target depends on the way there."""
        return self.moves and not self.actuated


MOBILITIES: Mapping[Mobility, MobilityTraits] = {
    "free-flying": MobilityTraits("free-flying", "thrusters push and turn the base", is_pushed=True, is_turned=True),
    "attitude": MobilityTraits("attitude", "wheels turn the base, nothing pushes it", is_turned=True),
    "free-floating": MobilityTraits("free-floating", "nothing acts on the base, which reacts to the arms"),
    "fixed": MobilityTraits("fixed", "the base stands still", moves=False),
}
"""The mobilities by their name."""

FREE_FLYING: Mobility = "free-flying"

MOBILITY = "; ".join(f"{mobility}: {traits.about}" for mobility, traits in MOBILITIES.items())


def parts_of_skills() -> tuple[str, ...]:
    """Return the parts that only skills have: no robot may have an arm of their name."""
    return tuple(part for traits in SKILL_KINDS.values() for part in traits.axes or () if part != "arms")


RESERVED = ("base", "arms", "all", "control", "times", *parts_of_skills())
"""Names that have another meaning wherever arms are named."""


@dataclass(frozen=True, eq=False)
class Context:
    """What the rules of one key know of the rest of a description.

    Attributes:
        file: The robot's file, or the task's, as written.
        sizes: The parts of the task's robot and their numbers of coordinates; none if the robot is not valid.
        robot_limits: The robot's limits.
        mobility: What moves its base, where a skill or a stage does not say it; None if what is written is none, which
            no further rule then judges.
        sliding: Names of its joint coordinates that are lengths, such as `arm_1.2`.
        has_thrusters, has_plumes: It has thrusters, and some that say where their plumes are; true where the robot is
            not valid.
    """

    file: Document
    sizes: Mapping[str, int] = field(default_factory=dict)
    robot_limits: Mapping[str, Any] = field(default_factory=dict)
    mobility: Mobility | None = FREE_FLYING
    sliding: Collection[str] = ()
    has_thrusters: bool = True
    has_plumes: bool = True

    @property
    def moved_by(self) -> MobilityTraits:
        """What moves the base of the task's robot, where a skill or a stage does not say it."""
        return MOBILITIES[self.mobility or FREE_FLYING]

    @cached_property
    def mobilities(self) -> list[MobilityTraits]:
        """What moves the base of the task's robot in any stage, as written."""
        skills = mapping(self.file.value(("skills",))).values()
        stages = self.file.value(("stages",))
        entries = [mapping(entry) for entry in (*skills, *(stages if isinstance(stages, list) else ()))]
        written = {name for entry in entries if isinstance(name := entry.get("mobility"), str)}
        return [self.moved_by, *(traits for name, traits in MOBILITIES.items() if name in written)]

    @property
    def is_actuated(self) -> bool:
        """Whether the base is moved at will in any stage."""
        return any(traits.actuated for traits in self.mobilities)

    @property
    def is_always_actuated(self) -> bool:
        """Whether the base is moved at will in every stage."""
        return all(traits.actuated for traits in self.mobilities)

    def required(self, parts: Collection[str]) -> list[str]:
        """Return which parts targets and weights must have: a base that is not moved at will may be left out."""
        may_lack_the_base = self.mobility is None or not self.is_always_actuated
        return [part for part in parts if part != "base" or not may_lack_the_base]

    @cached_property
    def spaces(self) -> dict[str, Space | None]:
        """The skills and their spaces as written, None where there is no such space."""
        given = mapping(self.file.value(("skills",)))
        return {name: _space_as_written(mapping(skill)) for name, skill in given.items()}

    @cached_property
    def stages(self) -> list[str]:
        """The names of the stages in their order, as written."""
        stages = self.file.value(("stages",))
        return [str(mapping(stage).get("name")) for stage in stages] if isinstance(stages, list) else []


def stands_for(key: str, part: str) -> bool:
    """Tell whether a key of numbers by part means a part: itself, or any arm for `arms`."""
    return key == part or (key == "arms" and part not in ("base", *parts_of_skills()))


def axes_of(parts: Mapping[str, int], space: Space, of_error: bool = True) -> dict[str, tuple[str, ...]]:
    """Return the names of the rows of a skill's error, or of the numbers of its target, by part of the robot.

    They differ for a part that has an attitude in space: its target has a quaternion, w x y z, and its error three
    rows. An arm that the skill leaves free is not in what is returned; a part that only the skill has is in it.

    Args:
        parts: The robot's parts, `base` and arms, and their numbers of coordinates; empty if the robot is not known,
            and then nothing is returned.
        space: In which space the skill wants the arms: as joints, poses or points.
        of_error: Whether names of the error's rows are returned, instead of those of a target's numbers.
    """
    if not parts:
        return {}
    dimension = dimension_of(parts)
    kind = 0 if of_error else 1  # tables of axes are pairs: those of the error, those of the target
    arms = {part: size for part, size in parts.items() if part != "base"}
    axes = {"base": (ERROR_AXES, TARGET_AXES)[kind][dimension]}
    for arm, size in arms.items():
        wanted = part_kind(space, arm)
        # None: the axes are the joints of the arm; without the key arms nothing is wanted of the arm
        names_of_arm = SKILL_KINDS[wanted].axes if wanted != FREE else {}
        if names_of_arm is None:
            axes[arm] = tuple(str(joint + 1) for joint in range(size))  # joints, which have numbers from 1 on
        elif "arms" in names_of_arm:
            axes[arm] = names_of_arm["arms"][kind][dimension]
    default = space.kind if isinstance(space, MixedSpace) else space
    axes_of_kind = SKILL_KINDS[default].axes or {}
    of_skill_alone = {part: names_of_part for part, names_of_part in axes_of_kind.items() if part != "arms"}
    return axes | {part: names_of_part[kind][dimension] for part, names_of_part in of_skill_alone.items()}


def required_parts(axes: Axes, space: Space) -> tuple[str, ...]:
    """Return the parts that targets and weights must have, of those that have axes."""
    kinds = {part: part_kind(space, part) for part in axes}
    return tuple(part for part, kind in kinds.items() if kind == BASE or SKILL_KINDS[kind].required is None)


def has_posture(arms: Collection[str], space: Space) -> bool:
    """Tell whether a target says of all arms where they are, or poses for which inverse kinematics finds that."""
    kinds = {part_kind(space, arm) for arm in arms}
    return FREE not in kinds and all(SKILL_KINDS[kind].has_posture for kind in kinds)


def _space_as_written(skill: Mapping[str, Any]) -> Space | None:
    """Return the space of a skill as it is written; None where there is no such space."""
    kind: Any = skill.get("space")
    arms = mapping(skill.get("parts"))
    is_valid = (
        isinstance(kind, str)
        and kind in SKILL_KINDS
        and all(wanted in (*SKILL_KINDS, FREE) for wanted in arms.values())
    )
    return space_of(kind, arms) if is_valid else None


def units_of(part: str, axis: str, sliding: Collection[str]) -> CoordinateUnits:
    """Return the units of a coordinate, or of a row of an error or a target.

    Args:
        part: The part that it is of.
        axis: Its name in the part.
        sliding: Names of the joint coordinates that are lengths.
    """
    if axis in POSITION_AXES or f"{part}.{axis}" in sliding:
        return LENGTH
    return PURE_NUMBER if axis in TARGET_AXES[3] else ANGLE


def keys_of(axes: Axes) -> tuple[str, ...]:
    """Return the keys that numbers by part may have: the parts, and `arms` but for a skill that is about no arm."""
    others = set(axes) & set(parts_of_skills())
    has_arms = not others or any(stands_for("arms", part) for part in axes)
    return (*axes, "arms") if has_arms else tuple(axes)


def dimension_of(parts: Mapping[str, int]) -> int:
    """Return 2 or 3: in how many dimensions a robot with such parts moves."""
    return 3 if parts.get("base") == len(ERROR_AXES[3]) else 2


def by_dimension(plane: int, space: int) -> WrapValidator:
    """Create a validator of a list whose length is another for a planar than for a spatial robot."""

    def rule(numbers: tuple[float, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
        length = plane if dimension_of(context.sizes) == 2 else space
        if context.sizes and len(numbers) != length:
            yield (), expected(counted(length, "entry", "entries"))

    return validated_by(rule)


def names(parts: Mapping[str, int], space: Space) -> tuple[str, ...]:
    """Return every name that means rows of the error; `parts` are the robot's."""
    axes = axes_of(parts, space)
    labels = (f"{part}.{axis}" for part in axes for axis in axes[part])
    return (*keys_of(axes), "all", *labels) if parts else ()


@dataclass(frozen=True)
class AsWritten:
    """How the units of coordinates are judged where numbers are as they are written.

    Attributes:
        sliding: Names of the joint coordinates that are lengths.
        quantity: What they are, one of `QUANTITIES`; `error` where they are differences of positions. Angles beyond one
            turn need their unit in positions alone.
    """

    sliding: Collection[str]
    quantity: str


def part_faults(
    numbers: Any,
    axes: Axes,
    required: Collection[str] = (),
    one_suffices: bool = False,
    written: AsWritten | None = None,
) -> RuleErrors:
    """Yield errors of numbers that are given by part of the robot, such as a target, weights or tolerances.

    Errors are unknown and missing parts, lists of the wrong length, and numbers with the unit of another coordinate.

    Args:
        numbers: Lists by part, or lists of such rows beside the key `times`; anything else has no errors here.
        axes: The names of the numbers of every part.
        required: The parts that must be there.
        one_suffices: Whether one number may stand for all of a part.
        written: How their units are judged; None where they are validated numbers, or have no units.

    Yields:
        Path of the list or number from `numbers` on, and its error.
    """
    if not isinstance(numbers, Mapping):
        return
    given = {key: row for key, row in numbers.items() if key != "times"}
    part_names = keys_of(axes)
    unknown = [key for key in given if axes and key not in part_names]
    for key in unknown:
        yield (key,), flaw(choice(key, part_names), "no such part here", at_key=True)
    missing = [part for part in required if not any(stands_for(key, part) for key in given)]
    if missing and not unknown:
        yield (), expected(f"also {', '.join(missing)}", ", ".join(given) or "no part", at_key=True)
    times = numbers.get("times", ())
    for key, row in given.items():
        if times and len(row) != len(times):
            yield (key,), expected(f"{counted(len(times), 'row', 'rows')}, one for every entry of times")
        rows = {(key, i): row_at_time for i, row_at_time in enumerate(row)} if times else {(key,): row}
        for at, numbers_of_part in rows.items():
            yield from length_errors(at, numbers_of_part, key, axes, given, one_suffices, written)


def in_joint_space(required: bool = False, one_suffices: bool = False, positions: bool = False) -> WrapValidator:
    """Create the validator of numbers by part of Q (`positions`) or of v, all of its parts or some.

    Further arguments are as for `part_faults`.
    """

    def rule(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
        axes = axes_of(context.sizes, "joint", of_error=not positions)
        units = AsWritten(context.sliding, "position" if positions else "velocity")
        yield from part_faults(written, axes, axes if required else (), one_suffices, units)

    return validated_by(rule, as_written=True)


def length_errors(
    at: Location,
    row: Any,
    key: str,
    axes: Axes,
    given: Collection[str],
    one_suffices: bool = False,
    written: AsWritten | None = None,
) -> RuleErrors:
    """Yield errors of one list of numbers by part: a wrong length, and units that do not fit the coordinates.

    Args:
        at: Path of the list.
        row: The list, of numbers or of pairs [low, high].
        key: Its key: a part, or `arms` for every arm without a list of its own.
        axes: The names of the numbers of every part.
        given: Keys of all lists.
        one_suffices: Whether one number may stand for all of a part.
        written: How units are judged, also that a large angle has one; None where numbers have no units.

    Yields:
        Path of the list or number, and its error.
    """
    parts = [part for part in axes if stands_for(key, part) and (key == part or part not in given)]
    is_list = isinstance(row, list | tuple)
    if not (parts and is_list):
        if written is not None and one_suffices:  # one number for all of the part
            yield from unit_misfits(at, row, [(part, axis) for part in parts for axis in axes[part]], written)
        return
    for part in parts:
        if len(row) not in (len(axes[part]), 1 if one_suffices else None):
            named = "" if axes[part][0].isdigit() else f" ({', '.join(axes[part])})"
            length = counted(len(axes[part]), "entry", "entries")
            yield at, expected(f"{length} for {part}{named}{', or one' if one_suffices else ''}")
            break
    if written is None:
        return
    for i, item in enumerate(row):
        stands_alone = one_suffices and len(row) == 1  # for every coordinate of its part
        meant = [(part, axis) for part in parts for axis in (axes[part] if stands_alone else axes[part][i : i + 1])]
        values = [((i, j), value) for j, value in enumerate(item)] if isinstance(item, list) else [((i,), item)]
        for place, value in values:
            yield from unit_misfits((*at, *place), value, meant, written)


def unit_misfits(at: Location, value: Any, coordinates: Sequence[tuple[str, str]], written: AsWritten) -> RuleErrors:
    """Yield the error in the unit of a number that stands for coordinates, each a part and an axis; at most one."""
    for part, axis in coordinates:
        units = units_of(part, axis, written.sliding)
        rate = "" if written.quantity in ("position", "error") else getattr(units, written.quantity)
        turns = written.quantity == "position"
        errors = [(at, error) for _, error in unit_errors(value, units.position, turns, rate)]
        yield from errors
        if errors:
            return
