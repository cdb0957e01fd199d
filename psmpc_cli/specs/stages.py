"""Skills and stages of a task: what is wanted of each part, and how a stage ends. Validated data."""

from collections.abc import Collection, Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, Discriminator, Field, Tag

from psmpc_cli.specs import fields
from psmpc_cli.specs.document import choice, counted, mapping, quoted
from psmpc_cli.specs.fields import (
    Fields,
    InlineParts,
    RuleErrors,
    Spec,
    expected,
    flaw,
    one_of,
    validated_by,
)
from psmpc_cli.specs.geometry import (
    ClearanceSpec,
    OneCone,
)
from psmpc_cli.specs.object import OnObject, is_on_object
from psmpc_cli.specs.parts import (
    BASE,
    MOBILITIES,
    SKILL_KINDS,
    AsWritten,
    Context,
    Mobility,
    MobilityTraits,
    PlumeUse,
    SkillKind,
    Space,
    Wanted,
    axes_of,
    dimension_of,
    names,
    part_faults,
    parts_of_skills,
    required_parts,
    space_of,
    stands_for,
    unit_misfits,
)
from psmpc_cli.specs.robots.robot import LimitsByPart, RobotSpec, Vector, rows, stack, wider

_Aim = Annotated[
    Annotated[fields.Numbers, Tag("numbers")] | Annotated[OnObject, Tag("on_object")],
    Discriminator(lambda value: "on_object" if is_on_object(value) else "numbers"),
]


_SkillPart = Annotated[
    str, one_of(lambda context: context.sizes and [*context.sizes, "arms", *parts_of_skills()], "part of the robot")
]


_OneArm = Annotated[str, one_of(lambda context: [name for name in context.sizes if name != BASE], "arm")]


_Control = fields.OrByPart[fields.NotNegative, fields.Part, tuple[fields.NotNegative, ...]]


_Tolerance = fields.OrByPart[fields.CoordinateWidth, _SkillPart, fields.OneOrMore[fields.CoordinateWidth]]


_JointNames = fields.OneOrMore[Annotated[str, one_of(lambda context: names(context.sizes, "joint"))]]


_SkillName = Annotated[str, one_of(lambda context: context.spaces)]


StageName = Annotated[str, one_of(lambda context: context.stages)]


class SkillWeights(InlineParts):
    """W_q or W_p by part; W_r of the control, W_F of the force, W_j of the jerk: one number, or numbers by part.

    In YAML the parts, `control`, `force` and `rate` stand side by side.
    """

    replaced_keys: ClassVar[Mapping[str, str]] = {
        "jerk": "rate: the weights of the rate at which the control changes, which is the jerk"
    }

    parts: Mapping[_SkillPart, fields.OneOrMore[fields.NotNegative]] = {}
    control: _Control = Field(1.0, description="weights of the control, one number or numbers by part")
    force: fields.Sparse[_Control] = Field(
        0.0,
        description="weights of the generalized force, the base's along its own axes, one number or numbers by part",
    )
    rate: fields.Sparse[_Control] = Field(
        0.0, description="weights of the rate at which the control changes, the jerk, one number or numbers by part"
    )

    @property
    def weighs_force(self) -> bool:
        """Whether the force costs anything."""
        return _weighs(self.force)

    @property
    def weighs_rate(self) -> bool:
        """Whether changes of the acceleration cost anything."""
        return _weighs(self.rate)


def _weighs(weights: float | Mapping[str, tuple[float, ...]]) -> bool:
    """Tell whether any of some weights is not 0."""
    numbers = weights.values() if isinstance(weights, Mapping) else [weights]
    return any(np.any(each) for each in numbers)


def _weight_faults(weights: SkillWeights, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of the weights in the cost of a skill: missing parts, wrong lengths, and weights of nothing.

    Weights of the error are by part of the space of the skill, and one number may stand for all of a part. Weights of
    the control, the force and the rate of the control are by part of the space of its input; force and rate are of
    joints, so that an input in task space leaves them out. A base that nothing turns has no control.

    Args:
        weights: The valid key `weights` of a skill.
        earlier_fields: The valid keys of the skill before it.
        context: What is known of the robot and the rest of the task.

    Yields:
        Path of the value from `weights` on, and its error.
    """
    if earlier_fields.get("space") is not None and "parts" in earlier_fields:
        space = space_of(earlier_fields["space"], earlier_fields["parts"])
        axes = axes_of(context.sizes, space)
        yield from part_faults(weights.parts, axes, context.required(required_parts(axes, space)), one_suffices=True)
    axes = axes_of(context.sizes, earlier_fields.get("input", "joint"))
    if not any(traits.is_turned for traits in context.mobilities):
        axes = {part: axes[part] for part in axes if part != "base"}
    for at, error in part_faults(weights.control, axes, context.required(axes)):
        yield ("control", *at), error
    for key, numbers in (("force", weights.force), ("rate", weights.rate)):
        for at, error in part_faults(numbers, axes):
            yield (key, *at), error
    for key, is_weighed in (("force", weights.weighs_force), ("rate", weights.weighs_rate)):
        if is_weighed and earlier_fields.get("input", "joint") == "task":
            yield (key,), expected("none with input task", at_key=True)


def _mobility_faults(mobility: Mobility | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a base that a mount holds in all stages but some."""
    if mobility is not None and not context.moved_by.moves:
        yield (), expected(f"none: the base is {context.mobility} in all stages")


def _plumes(use: PlumeUse | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for plumes to be avoided of a robot without any, and those that have nothing to keep off."""
    if use != "avoided":
        return
    if not context.has_plumes:
        yield (), expected("ignored, or a robot whose thrusters have a `plume`: {angle: 30 deg, length: 1.5}")
    has_object = bool(mapping(context.file.value(("object",))).get("mass"))
    if not (has_object or context.file.value(("obstacles",))):
        yield (), expected("ignored, or an object with a mass, or obstacles: there is nothing to keep plumes off")


PlumesOrDefault = fields.Sparse[Annotated[PlumeUse | None, validated_by(_plumes)]]


class SkillSpec(Spec):
    """A reusable cost and its limits. Paper eqs. (9), (10), (30), (31)."""

    @property
    def wanted_in(self) -> Space:
        """In which space each of its parts is wanted."""
        return space_of(self.space, self.parts)

    space: SkillKind = Field(description="; ".join(f"{space}: {traits.about}" for space, traits in SKILL_KINDS.items()))
    parts: fields.Sparse[Mapping[_OneArm, Wanted]] = Field(
        {}, description="arms that are wanted in another space than `space`; free: nowhere"
    )
    input: Literal["joint", "task"] = Field("joint", description="the control is the acceleration of Q or of xi")
    weights: Annotated[SkillWeights, validated_by(_weight_faults)] = Field(
        description="weights by part, and of the control"
    )
    limits: LimitsByPart = Field({}, description="limits of this skill, within the task's")
    mobility: fields.Sparse[Annotated[Mobility | None, validated_by(_mobility_faults)]] = Field(
        None, description="what moves the base in stages of this skill, instead of the task's"
    )
    plumes: PlumesOrDefault = Field(None, description="plumes in stages of this skill, instead of the task's")


class ObjectEndSpec(Spec):
    """How near its destination, and how much at rest, the object is at the end of a stage that holds it; norms."""

    position: fields.Positive | None = Field(None, description="largest distance from the destination [m]")
    angle: fields.Width | None = Field(None, description="largest angle to the attitude there [rad]")
    velocity: fields.Positive | None = Field(None, description="largest speed of its centre of mass [m/s]")
    angular_velocity: fields.Width | None = Field(None, description="largest angular velocity [rad/s]")


class MomentumEndSpec(Spec):
    """How little momentum robot and held load have at the end of a stage, without that of reaction wheels; norms."""

    linear: fields.Positive | None = Field(None, description="largest linear momentum [N s]")
    angular: fields.Positive | None = Field(
        None, description="largest angular momentum about the common centre of mass [N m s]"
    )


class EndCondition(Spec):
    """When a stage is over, h of eq. (18): |error| <= tolerance, and where `velocity` is given |rate| <= velocity too.

    A coordinate is a part (`base`), `arms`, `all`, or one of a part (`base.x`, `arm_1.2`).
    """

    coordinates: fields.OneOrMore[str] = Field((), description="what must be at the target")
    tolerance: _Tolerance = Field(3e-3, description="how near, one number or numbers by part [m, rad]")
    velocity: _Tolerance | None = Field(
        None, description="how much at rest, one number or numbers by part [m/s, rad/s]"
    )
    moving: fields.Sparse[Mapping[_SkillPart, fields.OneOrMore[fields.OneVelocity]] | None] = Field(
        None, description="rates at the end instead of rest, by part, which `velocity` is about [m/s, rad/s]"
    )
    object: fields.Sparse[ObjectEndSpec | None] = Field(
        None, description="where the held object must be, and how much at rest"
    )
    momentum: fields.Sparse[MomentumEndSpec | None] = Field(
        None, description="how little momentum robot and held load must have"
    )
    hold: fields.Sparse[fields.Seconds] = Field(0.0, description="how long it must be met without a break [s]")

    def tolerances(self, robot: RobotSpec, space: Space) -> Vector:
        """Return the tolerance of every row of the error that it selects [m, rad], in the order of `rows`."""
        return self._of_rows(self.tolerance, robot, space)

    def velocities(self, robot: RobotSpec, space: Space) -> Vector | None:
        """Return the bound on the rate of every row of the error that it selects [m/s, rad/s]; None without one."""
        return None if self.velocity is None else self._of_rows(self.velocity, robot, space)

    def rates(self, robot: RobotSpec, space: Space) -> Vector:
        """Return the rates of all rows of the error at which a stage ends [m/s, rad/s]; 0 at rest."""
        return stack(self.moving or {}, robot, space, missing=0.0, of_error=True)

    def _of_rows(self, numbers: float | Mapping[str, Any], robot: RobotSpec, space: Space) -> Vector:
        chosen = list(rows(self.coordinates, robot, space))
        if not isinstance(numbers, Mapping):
            return np.full(len(chosen), numbers)
        return stack(numbers, robot, space, of_error=True)[chosen]


def _rising(times: tuple[float, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for times of a trajectory that do not rise from 0."""
    if times[0]:
        yield (0,), expected("0: times count from where the stage begins", f"{times[0]:g} s")
    for i in range(1, len(times)):
        if times[i] <= times[i - 1]:
            yield (i,), expected(f"later than the time before it, {times[i - 1]:g} s", f"{times[i]:g} s")


class TrajectorySpec(InlineParts):
    """A target that moves: values by part at times since the stage began, linear between, the last one held.

    In YAML the parts and `times` stand side by side. Paper eq. (30), "along a desired trajectory".
    """

    times: Annotated[tuple[fields.Number, ...], Field(min_length=2), validated_by(_rising)] = Field(
        description="times since the stage began, rising from 0 [s]"
    )
    parts: Mapping[_SkillPart, tuple[fields.Row, ...]] = {}

    def stacked(self, robot: RobotSpec, space: Space) -> Vector:
        """Stack the rows (times, n) or (times, m) in the order of Q or xi."""
        moments = range(len(self.times))
        return np.array([stack({part: rows[i] for part, rows in self.parts.items()}, robot, space) for i in moments])


def _target_kind(value: object) -> str:
    """Tell a target that moves from one that does not."""
    if not isinstance(value, Mapping):
        return "trajectory" if isinstance(value, BaseModel) else "parts"
    rows = any(isinstance(item, list | tuple) and item and isinstance(item[0], list | tuple) for item in value.values())
    return "trajectory" if "times" in value or rows else "parts"


Target = Annotated[
    Annotated[Mapping[_SkillPart, _Aim], Tag("parts")] | Annotated[TrajectorySpec, Tag("trajectory")],
    Discriminator(_target_kind),
]


def _target_faults(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for missing parts, wrong lengths, angles without a unit, and parts without a pose on the object."""
    if (space := context.spaces.get(earlier_fields.get("skill", ""))) is None:
        return
    axes = axes_of(context.sizes, space, of_error=False)
    required = context.required(required_parts(axes, space))
    yield from part_faults(written, axes, required, written=AsWritten(context.sliding, "position"))
    for key in (key for key, aim in written.items() if is_on_object(aim)):
        if key == "arms" or (key in axes and axes[key] != axes["base"]):
            yield (key,), expected("numbers: only the base, and an arm of a skill in task space, have a pose there")
        elif not isinstance(context.file.value(("object", "mass")), int | float):
            yield (key,), expected('an "object" with a mass', "no such object", at_key=True)


class _Carrying(NamedTuple):
    """Where a stage stands among those that take an object, hold it and let it go: indices of stages."""

    taken: int
    stage: int
    let_go: int


def _stages_that_carry(target_object: Mapping[str, Any], earlier_fields: Fields, context: Context) -> _Carrying | None:
    """Return where a stage stands among those that carry an object; None where a name is not that of a stage."""
    order = context.stages
    name = earlier_fields.get("name")
    taken_by, let_go_by = (target_object.get(key) for key in ("taken_by", "let_go_by"))
    if not (name in order and taken_by in order):
        return None
    let_go = order.index(let_go_by) if let_go_by in order else len(order)
    return _Carrying(order.index(taken_by), order.index(name), let_go)


def _object_end_faults(end: ObjectEndSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of an end condition of the object: it bounds nothing, or the stage does not hold the object."""
    if not end.model_dump(exclude_none=True):
        yield (), expected(f"at least one of {', '.join(ObjectEndSpec.model_fields)}", "none")
    target_object = mapping(context.file.value(("object",)))
    if not {"mass", "destination"} <= {key for key, value in target_object.items() if value}:
        yield (), expected('an "object" with a mass and a destination', "no such object", at_key=True)
        return
    order = context.stages
    carrying = _stages_that_carry(target_object, earlier_fields, context)
    if carrying is not None and not carrying.taken < carrying.stage < carrying.let_go:
        wanted = f"it in a stage that holds the object, from the one after {quoted(order[carrying.taken])} on"
        yield (), expected(wanted, f"it in {quoted(order[carrying.stage])}", at_key=True)


def parts_of_target(target: Mapping[str, Any] | TrajectorySpec) -> Collection[str]:
    """Return the parts of which a target, or a trajectory of targets, says where they are to be."""
    return target.parts if isinstance(target, TrajectorySpec) else target


def _onset_faults(names_of_joints: tuple[str, ...] | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for coordinates of a base without thrusters, which has no control."""
    for i, name in enumerate(names_of_joints or ()):
        if name.partition(".")[0] == "base" and not any(traits.is_turned for traits in context.mobilities):
            yield (i,), expected(f"coordinates of arms: a {context.mobility} base has no control")


def _end_faults(end: EndCondition, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of the end condition of a stage, but for those of units.

    It needs something to bound: coordinates, the object or the momentum. Coordinates have to exist and to have a
    target, and their parts need a tolerance and may have a velocity of the right length. Rates other than 0 at the end
    (`moving`) need a velocity, which is their tolerance, and only parts that are among the coordinates may have them.

    Args:
        end: The valid key `ends_when` of a stage.
        earlier_fields: The valid keys of the stage before it: skill and target.
        context: What is known of the robot and the rest of the task.

    Yields:
        Path of the value from `ends_when` on, and its error.
    """
    if end.object is not None:
        yield from ((("object", *at), error) for at, error in _object_end_faults(end.object, earlier_fields, context))
    elif not (end.coordinates or end.momentum):
        yield (), expected('at least one of "coordinates", "object", "momentum"', "none", at_key=True)
    if end.momentum is not None and not end.momentum.model_dump(exclude_none=True):
        yield ("momentum",), expected(f"at least one of {', '.join(MomentumEndSpec.model_fields)}", "none")
    sizes = context.sizes
    space = context.spaces.get(earlier_fields.get("skill", ""))
    if not sizes or space is None:
        return
    valid = names(sizes, space)
    for i, name in enumerate(end.coordinates):
        if name not in valid:
            yield ("coordinates", i), flaw(choice(name, valid))
    keys = [name.partition(".")[0] for name in end.coordinates]  # of `base.x` the part; or `arms`, or `all`
    target = earlier_fields.get("target")
    if target is not None and "base" not in parts_of_target(target):
        wanted = 'a target of "base" in this stage, or coordinates without it'
        of_base = (i for i, key in enumerate(keys) if key in ("base", "all"))
        yield from ((("coordinates", i), expected(wanted)) for i in of_base)
    axes = axes_of(sizes, space)
    needed = [part for part in axes if any(key == "all" or stands_for(key, part) for key in keys)]
    for key in ("tolerance", "velocity"):
        for at, error in part_faults(getattr(end, key), axes, needed, one_suffices=True):
            yield (key, *at), error
    if end.moving is not None:
        if end.velocity is None:
            yield ("moving",), expected('also "velocity": how near the rates are to these', at_key=True)
        for at, error in part_faults(end.moving, axes, one_suffices=True):
            yield ("moving", *at), error
        for part in end.moving:
            if part in axes and not any(key in ("all", part) or stands_for(key, part) for key in keys):
                known = ", ".join(quoted(key.partition(".")[0]) for key in end.coordinates)
                yield ("moving",), expected(f"parts of which the end condition has coordinates: {known}", quoted(part))


def _end_unit_faults(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of the units in an end condition, such as a tolerance of an angle that is written in m.

    Args:
        written: The key `ends_when` of a stage as it is written.
        earlier_fields: The valid keys of the stage before it.
        context: What is known of the robot and the rest of the task.

    Yields:
        Path of the value from `ends_when` on, and its error.
    """
    space = context.spaces.get(earlier_fields.get("skill", ""))
    if not (context.sizes and space and isinstance(written, Mapping)):
        return
    axes = axes_of(context.sizes, space)
    names_of_rows = written.get("coordinates", ())
    chosen = [names_of_rows] if isinstance(names_of_rows, str) else names_of_rows
    every_row = [(part, axis) for part in axes for axis in axes[part]]
    bounded = [
        row for row in every_row if {"all", ".".join(row)} & {*chosen} or any(stands_for(n, row[0]) for n in chosen)
    ]
    units_of_errors = AsWritten(context.sliding, "error")
    units_of_rates = AsWritten(context.sliding, "velocity")
    units_by_key = {"tolerance": units_of_errors, "velocity": units_of_errors, "moving": units_of_rates}
    for key, units in units_by_key.items():
        numbers = written.get(key)
        if isinstance(numbers, Mapping):
            yield from (
                ((key, *at), error) for at, error in part_faults(numbers, axes, one_suffices=True, written=units)
            )
        else:  # one number for all coordinates that the end condition bounds
            yield from unit_misfits((key,), numbers, bounded, units_of_errors)


def _priority_faults(priority: float, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a priority beside comparisons."""
    if context.file.value(("priorities",)) is not None:
        found = '"priority" at a stage and "priorities" in the task'
        yield (), expected("one or the other", found, at_key=True)


def _count_of_ends_faults(at: float | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a stage without an end, or with two."""
    if "ends_when" in earlier_fields:
        last = earlier_fields.get("name") == context.stages[-1]
        ends = [key for key, end in (("ends_when", earlier_fields["ends_when"]), ("at", at)) if end is not None]
        if ends != ["ends_when"] if last else len(ends) != 1:
            wanted = '"ends_when" in the last stage: it ends the run' if last else 'either "ends_when" or "at"'
            yield (), expected(wanted, " and ".join(map(quoted, ends)) or "no end", at_key=True)


class RetrySpec(Spec):
    """Another try where grippers miss the object at the end of the stage, or lose it in the stage, or take too long."""

    back_to: StageName = Field(description="the earlier stage to which the sequence returns")
    times: fields.Whole = Field(1, ge=1, description="how often at most; then the mission ends")
    timeout: fields.Sparse[fields.Seconds | None] = Field(
        None, description="duration after which a stage that has not taken the object has missed it [s]; default none"
    )


def _retry_faults(retry: RetrySpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of `if_missed`, by which the mission returns to an earlier stage if the object is missed or lost.

    Only the stage that takes an object with a mass can miss it, and only those that hold it can lose it. The stage to
    return to comes before, and does not hold the object. A timeout is for the stage that takes the object alone, and
    longer than the stage has to last.

    Args:
        retry: The valid key `if_missed` of a stage.
        earlier_fields: The valid keys of the stage before it.
        context: What is known of the rest of the task: its object, and the names of its stages in their order.

    Yields:
        Path of the value from `if_missed` on, and its error.
    """
    target_object = mapping(context.file.value(("object",)))
    if not target_object.get("mass"):
        yield (), expected('an "object" with a mass', "no such object", at_key=True)
        return
    order = context.stages
    carrying = _stages_that_carry(target_object, earlier_fields, context)
    if carrying is None:
        return
    if not carrying.taken <= carrying.stage < carrying.let_go:
        wanted = f"it in {quoted(order[carrying.taken])}, at whose end the object is taken, or in a stage that holds it"
        yield (), expected(wanted, f"it in {quoted(order[carrying.stage])}", at_key=True)
        return
    earlier = order[: min(carrying.stage, carrying.taken + 1)]
    if retry.back_to in order and retry.back_to not in earlier:
        where = f"an earlier stage that does not hold the object: {', '.join(map(quoted, earlier))}"
        wanted = where if earlier else "a stage before the one that takes the object: there is none"
        yield ("back_to",), expected(wanted, quoted(retry.back_to))
    if retry.timeout is None:
        return
    if carrying.stage != carrying.taken:
        wanted = f"it in {quoted(order[carrying.taken])}, at whose end the object is taken"
        yield ("timeout",), expected(wanted, f"it in {quoted(order[carrying.stage])}", at_key=True)
    elif retry.timeout <= (dwell := earlier_fields.get("dwell", 0.0)):
        yield ("timeout",), expected(f'more than the "dwell" of {dwell:g} s', f"{retry.timeout:g} s")


class StageSpec(Spec):
    """One activation of a skill."""

    name: fields.Name = Field(description="name of the stage")
    skill: _SkillName = Field(description="the skill to run, by name")
    priority: Annotated[fields.Positive, validated_by(_priority_faults)] = Field(
        1.0, description="relative importance omega, eq. (11)"
    )
    target: Annotated[Target, validated_by(_target_faults, as_written=True)] = Field(
        description="joint: base pose and joint coordinates; task: base and end-effector poses; or a trajectory of them"
    )
    ends_when: (
        Annotated[EndCondition, validated_by(_end_faults), validated_by(_end_unit_faults, as_written=True)] | None
    ) = Field(None, description="the condition that ends the stage, eq. (18)")
    at: Annotated[fields.Positive | None, validated_by(_count_of_ends_faults)] = Field(
        None, validate_default=True, description="fixed time that ends the stage [s], instead of a condition"
    )
    dwell: fields.NotNegative = Field(0.0, description="shortest duration, that of a trajectory at least [s]")
    onset: Annotated[_JointNames | None, validated_by(_onset_faults)] = Field(
        None, description="coordinates whose control marks the stage's actual start"
    )
    if_missed: fields.Sparse[Annotated[RetrySpec, validated_by(_retry_faults)] | None] = Field(
        None, description="another try where the object is missed at the stage's end, or lost in it; default none"
    )
    mobility: fields.Sparse[Annotated[Mobility | None, validated_by(_mobility_faults)]] = Field(
        None, description="what moves the base in this stage, instead of the skill's"
    )
    plumes: PlumesOrDefault = Field(None, description="plumes in this stage, instead of the skill's")
    clearance: fields.Sparse[ClearanceSpec | None] = Field(
        None, description="how far apart bodies keep in this stage, instead of the task's"
    )
    angles: Literal["nearest", "exact"] = Field(
        "nearest", description="nearest: a target angle means the nearest equivalent one; exact: itself"
    )
    cones: fields.Sparse[tuple[OneCone, ...]] = Field(
        (), description="axes of frames that stay within, or outside, an angle of a point or a direction"
    )


def repeated_fixed_times(stages: tuple[StageSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for tries that would repeat a stage with a fixed switch time."""
    order = [stage.name for stage in stages]
    for i, stage in enumerate(stages):
        if stage.if_missed is None or stage.if_missed.back_to not in order:
            continue
        fixed = [other.name for other in stages[order.index(stage.if_missed.back_to) : i + 1] if other.at is not None]
        if fixed:
            found = f"{quoted(fixed[0])} with the fixed switch time {stages[order.index(fixed[0])].at:g} s"
            yield (i, "if_missed", "back_to"), expected('stages with "ends_when" from there to here', found)


def _moved_by(stage: StageSpec, earlier_fields: Fields, context: Context) -> MobilityTraits:
    """Return what moves the base in a stage, as far as skills are valid."""
    skills: Mapping[str, SkillSpec] = earlier_fields.get("skills", {})
    of_skill = skills[stage.skill].mobility if stage.skill in skills else None
    given = stage.mobility or of_skill
    return MOBILITIES[given] if given else context.moved_by


def unchanged_momenta(stages: tuple[StageSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for ends by a momentum that nothing changes in their stage, or that its mount takes up."""
    for i, stage in enumerate(stages):
        bounds = stage.ends_when and stage.ends_when.momentum
        if not bounds:
            continue
        moved_by = _moved_by(stage, earlier_fields, context)
        for key, is_changed in (("linear", moved_by.is_pushed), ("angular", moved_by.is_turned)):
            if getattr(bounds, key) is not None and not is_changed:
                why = "nothing changes it" if moved_by.moves else "the mount takes it up"
                wanted = f"none: {why} where the base is {moved_by.name}"
                yield (i, "ends_when", "momentum", key), expected(wanted, at_key=True)


AT_REST = 0.01
"""Largest `velocity` of the base with which a stage may end before a mount takes hold of it [m/s, rad/s]."""


def mount_faults(stages: tuple[StageSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of stages in which a mount holds the base of a robot that moves in other stages.

    A mount takes hold of a base at rest: the stage before has to end so, or the robot has to begin so. A base that is
    held excludes an object with a mass, estimated masses and routes. A base that is fixed in all stages is no error.

    Args:
        stages: The valid stages of a task.
        earlier_fields: The valid keys of the task before them.
        context: What is known of the robot and the rest of the task.

    Yields:
        Path of the value from `stages` on, and its error.
    """
    held = [not _moved_by(stage, earlier_fields, context).moves for stage in stages]
    if not context.moved_by.moves or not any(held):
        return
    first = held.index(True)
    at = (first, "mobility") if stages[first].mobility else (first,)
    found = f"a fixed base in {quoted(stages[first].name)}"
    if mapping(context.file.value(("object",))).get("mass"):
        yield (
            at,
            expected(
                "a base that moves, or an object without a mass: a base that is held takes none", found, at_key=True
            ),
        )
    controller = earlier_fields.get("controller")
    if controller is not None and controller.masses == "estimated":
        yield (
            at,
            expected(
                "a base that moves with controller.masses: estimated, which its momentum tells", found, at_key=True
            ),
        )
    if context.file.value(("routes",)) is not None:
        yield at, expected("a base that moves: routes know nothing of a base that is held", found, at_key=True)
    if held[0] and any(earlier_fields.get("initial_velocity", {}).get("base", ())):
        yield at, expected("initial_velocity without base: a mount holds it from the start", found, at_key=True)
    for i in range(1, len(stages)):
        if held[i] and not held[i - 1] and (missing := _lacking_for_rest(stages[i - 1], context)):
            wanted = f"{missing}: in {quoted(stages[i].name)} a mount holds the base, which is at rest before"
            key = "ends_when" if stages[i - 1].ends_when else "name"
            yield (i - 1, key), expected(wanted, f"an end of {quoted(stages[i - 1].name)} in motion", at_key=True)


def _lacking_for_rest(stage: StageSpec, context: Context) -> str:
    """Return what the end condition of a stage lacks to leave the base at rest, for a message; empty if it does.

    It has to bound every coordinate of the base and its velocity, by at most `AT_REST`, about rates of 0.
    """
    end = stage.ends_when
    space = context.spaces.get(stage.skill)
    if not context.sizes or space is None:
        return ""
    if end is None:
        return '"ends_when" with coordinates: [base] and a velocity'
    rows_of_base = {f"{BASE}.{axis}" for axis in axes_of(context.sizes, space)[BASE]}
    if not ({"all", BASE} & {*end.coordinates} or rows_of_base <= {*end.coordinates}):
        return '"base" among the coordinates'
    velocity = end.velocity.get(BASE) if isinstance(end.velocity, Mapping) else end.velocity
    if velocity is None or np.max(velocity) > AT_REST:
        return f"a velocity of the base of at most {AT_REST:g}"
    if any(np.ravel((end.moving or {}).get(BASE, 0.0))):
        return 'no "moving" of the base'
    return ""


def fixed_time_faults(stages: tuple[StageSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield the error of each fixed switch time `at`, at which a stage ends, that cannot be kept.

    A fixed switch time has to leave time for the stages up to it, for their dwells (shortest durations) and the lengths
    of their target trajectories. It must differ from the fixed switch time before it, and come before the time limit.

    Args:
        stages: The valid stages of a task.
        earlier_fields: The valid keys of the task before them.
        context: The rest of the description, which this rule does not need.

    Yields:
        Path of the value from `stages` on, and its error.
    """
    limit = earlier_fields.get("time_limit", np.inf)
    earliest = 0.0  # [s] at which the stage can end
    last_fixed = 0.0  # [s]
    for i, stage in enumerate(stages):
        earliest += max(stage.dwell, stage.target.times[-1] if isinstance(stage.target, TrajectorySpec) else 0.0)
        if stage.at is not None and (stage.at < earliest or stage.at == last_fixed):
            wanted = f"a time after {earliest:g} s, by the dwells, trajectories and fixed times so far"
            yield (i, "at"), expected(wanted, f"{stage.at:g} s")
        elif stage.at is not None and stage.at >= limit:
            yield (i, "at"), expected(f"a time before the time_limit of {limit:g} s", f"{stage.at:g} s")
        elif stage.at is not None:
            earliest = stage.at
            last_fixed = stage.at


def skill_faults(skills: Mapping[str, SkillSpec], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for limits of skills wider than those of task or robot, and inputs that the solver cannot have."""
    controller = earlier_fields.get("controller")
    solver = earlier_fields.get("solver")
    has_levels = bool(controller and controller.traits.has_levels)
    joint_only = has_levels or not (solver and solver.traits.task_input)
    outer = {"the robot's": context.robot_limits, "the task's": earlier_fields.get("limits", {})}
    for name, skill in skills.items():
        if skill.input == "task" and joint_only:
            yield (name, "input"), expected('"joint" (task needs solver ipopt, and another controller than htmpc)')
        if skill.input == "task":
            yield from (((name, *at), error) for at, error in _not_in_task_space(context))
        for at, error in wider(skill.limits, outer, context.sizes):
            yield (name, "limits", *at), error


def _not_in_task_space(context: Context) -> RuleErrors:
    """Yield errors where the accelerations of a robot's poses cannot be the control of its windows."""
    at = ("input",)
    rows_of_pose = context.sizes.get("base", 0)  # as many as the base has coordinates
    if not context.is_always_actuated:
        yield at, expected('"joint": task takes bases that are free-flying in every stage')
    in_space = dimension_of(context.sizes) == 3
    for part, joints in context.sizes.items():
        if joints < rows_of_pose or (in_space and joints > rows_of_pose):
            wanted = f'"joint": task needs {rows_of_pose} joints{"" if in_space else " or more"} in every arm'
            yield at, expected(wanted, f"{counted(joints, 'joint', 'joints')} in {part}")
