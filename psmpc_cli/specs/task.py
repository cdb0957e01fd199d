"""What a task is: skills and stages, how to run them, its object, and what the controller does not know.

Plain validated data in SI units.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, Discriminator, Field, Tag, ValidationError, ValidationInfo, model_validator

from psmpc_cli.specs import fields
from psmpc_cli.specs.document import choice, counted, mapping, quoted
from psmpc_cli.specs.fields import (
    Choice,
    Fields,
    InlineParts,
    RuleErrors,
    Spec,
    expected,
    flaw,
    listed,
    one_of,
    validated_by,
)
from psmpc_cli.specs.geometry import (
    OBJECT,
    ClearanceSpec,
    ObstacleSpec,
    OneCone,
    RoutesSpec,
    names_of_parts,
    pair_name,
)
from psmpc_cli.specs.object import NO_BODY, Moments, ObjectBody, ObjectSpec, OnObject, complete, is_on_object
from psmpc_cli.specs.parts import (
    BASE,
    MOBILITIES,
    PLUMES,
    SKILL_KINDS,
    AsWritten,
    Context,
    Mobility,
    MobilityTraits,
    PlumeUse,
    SkillKind,
    Space,
    StageMobility,
    Wanted,
    axes_of,
    dimension_of,
    in_joint_space,
    names,
    part_faults,
    parts_of_skills,
    required_parts,
    space_of,
    stands_for,
    unit_misfits,
)
from psmpc_cli.specs.priorities import disagreements
from psmpc_cli.specs.robot import LimitsByPart, PartLimits, RobotSpec, Vector, limits_of_part, rows, stack, wider
from psmpc_cli.specs.uncertainty import StateNoiseSpec, UncertaintySpec

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
_StageName = Annotated[str, one_of(lambda context: context.stages)]
_Comparison = Annotated[tuple[_StageName, _StageName, fields.Positive], listed("a comparison [stage, stage, ratio]", 3)]
_StageKey = Annotated[str, one_of(lambda context: context.stages, "stage")]

ControllerKind = Literal["psmpc", "smpc", "hard", "htmpc"]

_ControllerKey = Annotated[str, one_of(lambda context: CONTROLLERS, "controller")]


NOTHING_TOUCHED = "nothing touched"
"""What is judged of bodies that keep clear of each other: at no tick does one overlap another."""


class ObjectCheck(StrEnum):
    """What is judged of an object with a mass, in this order."""

    TAKEN = "object taken"
    NOT_LOST = "object not lost"
    DELIVERED = "object delivered"


class MonitorSpec(Spec):
    """A bound on a signal during a stage that decides whether the mission succeeded."""

    name: str = Field(min_length=1, description="what the bound means, such as object held")
    quantity: Literal["distance", "speed", "clearance"] = Field(
        description="between two frames, of one, or the smallest distance of parts that keep clear"
    )
    of: fields.Several[str] = Field(
        description="base or arms: two for a distance, one for a speed; for a clearance two parts, or [] for all pairs"
    )
    during: _StageName = Field(description="the stage in which it must hold")
    above_start_at_most: fields.NotNegative | None = Field(
        None, description="rise above its value at the stage's start"
    )
    below_start_at_most: fields.NotNegative | None = Field(
        None, description="fall below its value at the stage's start"
    )
    at_most: fields.Number | None = Field(None, description="upper bound [m, m/s]")
    at_least: fields.Number | None = Field(None, description="lower bound [m, m/s]")

    @property
    def unit(self) -> str:
        """Unit of the signal and its margin."""
        return "m/s" if self.quantity == "speed" else "m"

    def is_about(self, pair: str) -> bool:
        """Tell whether a monitor of a clearance is about two parts, by `pair_name`; an arm stands for its bodies."""
        if not self.of:
            return True
        one, other = (rf"{re.escape(part)}(\.\d+)?" for part in self.of)
        return any(re.fullmatch(pair_name(*each), pair) for each in ((one, other), (other, one)))


class PublishedRun(Spec):
    """A published run to compare with."""

    switch_time: Mapping[_StageKey, fields.Number] = Field(
        {}, description="switch times that end the stages, by name [s]"
    )
    actual_start: Mapping[_StageKey, fields.Number] = Field({}, description="actual starts of the stages, by name [s]")


FREE_END = "free_end"
"""`one_stage` with which windows over one stage have its end condition at a free switch time."""


class LoadPriorSpec(Spec):
    """What the controller takes for the load before it has found out more, with `object.grasp.known: estimated`."""

    mass: fields.Positive | None = Field(None, description="mass; default the object's [kg]")
    inertia: Moments | None = Field(
        None, description="inertia about its centre of mass, in space about its axes; default the object's [kg m^2]"
    )
    deviation: fields.Positive = Field(0.5, le=10, description="standard deviation of each of them, as a part of it")


class HtmpcSpec(Spec):
    """The lexicographic controller, eq. (32)."""

    depth: fields.Whole | None = Field(None, ge=1, description="levels a sample solves; default all remaining stages")
    constraint: Literal["cost", "error"] = Field("cost", description="what may not get worse: costs, or errors by node")
    tolerance: fields.Positive = Field(
        1e-3, description="by what part of it a cost, or by how much an error, may get worse"
    )


@dataclass(frozen=True)
class ControllerTraits:
    """What tells a controller from the others.

    Attributes:
        has_priorities: The priorities of stages weigh their costs.
        one_stage: The window holds the current stage alone.
        has_levels: Levels that look further than the window refine the plan, none at an earlier one's expense.
    """

    has_priorities: bool = True
    one_stage: bool = False
    has_levels: bool = False


CONTROLLERS: Mapping[ControllerKind, ControllerTraits] = {
    "psmpc": ControllerTraits(),
    "smpc": ControllerTraits(has_priorities=False),
    "hard": ControllerTraits(one_stage=True),
    "htmpc": ControllerTraits(one_stage=True, has_levels=True),
}
"""The controllers by their `kind`."""


@dataclass(frozen=True)
class SolverTraits:
    """What a back-end can do.

    Attributes:
        stops_early: Its solves end at a deadline.
        task_input: It takes stages whose control is the acceleration of poses.
        real_time: It takes a few iterations a sample instead of solving windows to their optima.
        by_costates: It simulates the states, and the gradient of its objective is that of costates; costs of other
            stages, as levels of HTMPC bound them, have none.
    """

    stops_early: bool = True
    task_input: bool = False
    real_time: bool = False
    by_costates: bool = False


SOLVERS: Mapping[str, SolverTraits] = {
    "sqp": SolverTraits(real_time=True),
    "fatrop": SolverTraits(stops_early=False),
    "ipopt": SolverTraits(task_input=True),
    "adjoint": SolverTraits(by_costates=True),
}
"""The solvers by their `kind`."""


AS_PRINTED: Mapping[str, Any] = {
    "normalization": "range",
    "normalization_at": "nodes",
    "pending_cost": 0,
    "discretization": "euler",
    "detection_margin": 1,
}
"""The keys that `as_printed` sets, with their values: each takes back a departure of the controller from the paper."""


class ControllerSpec(Choice):
    """The controller and its objective; symbols as in docs/formulation.md."""

    replaced_keys: ClassVar[Mapping[str, str]] = {
        "known_delay": "delay: in seconds, such as 0.1 s for one sample, or auto, the default, to find it out"
    }

    @model_validator(mode="before")
    @classmethod
    def _fill_as_printed(cls, value: object, info: ValidationInfo) -> object:
        """Add the keys that `as_printed` sets; in a file none of them may stand beside it."""
        if not isinstance(value, Mapping) or value.get("as_printed") is not True:
            return value
        errors: list[Any] = []
        for key, printed in AS_PRINTED.items():
            if key in value and info.context:
                wanted = f"one of the two: as_printed sets {key} to {printed}"
                error = expected(wanted, f"{quoted(key)} beside as_printed: true", at_key=True)
                errors.append({"type": error, "loc": (key,), "input": value[key]})
        if errors:
            raise ValidationError.from_exception_data(cls.__name__, errors)
        return {**value, **AS_PRINTED}

    @property
    def traits(self) -> ControllerTraits:
        """What tells it from the other controllers."""
        return CONTROLLERS[self.kind]

    @property
    def plans_ends(self) -> bool:
        """Whether windows have planned ends of stages."""
        return not self.traits.one_stage or self.one_stage == FREE_END

    kind: ControllerKind = Field("psmpc", description="which controller")
    horizon: fields.Positive = Field(4.0, le=1000, description="prediction horizon T_h [s]")
    nodes: fields.Intervals = Field(100, description="intervals a stage, N_s; auto: as many as `mesh_tolerance` needs")
    mesh_tolerance: fields.Positive = Field(
        5e-3, le=0.1, description="nodes auto: by what part of J the cost may change with twice the nodes"
    )
    sample_time: fields.Positive = Field(0.1, description="time between two solves [s]")
    pending_cost: fields.NotNegative = Field(1.0, description="cost delta of every second a stage waits; 0 as printed")
    terminal_cost: fields.NotNegative = Field(0.0, description="weight kappa of the last node's cost")
    zeta: fields.Positive = Field(1e-3, description="what keeps the normalization from dividing by 0")
    as_printed: fields.Sparse[fields.Flag] = Field(
        False,
        description="as the paper prints: " + ", ".join(f"`{key}: {value}`" for key, value in AS_PRINTED.items()),
    )
    normalization: Literal["nadir", "range", "none"] = Field("nadir", description="how costs are normalized, eq. (12)")
    normalization_at: Literal["samples", "nodes"] = Field(
        "samples",
        exclude_if=lambda value: value == "samples",
        description="where the last plan's costs are read for it: at samples, the control averaged, or at its nodes",
    )
    discretization: Literal["exact", "euler"] = Field("exact", description="zero-order hold, or Euler as in eq. (20)")
    detection_margin: fields.Number = Field(
        10.0, ge=1, description="tolerances within which a stage is predicted to end"
    )
    multistart: fields.Whole | None = Field(
        None,
        ge=1,
        le=100,
        description="guesses of the switch times a window is solved from; default 1, the last plan's",
    )
    soft_limits: fields.Flag | None = Field(
        None,
        description="limits on states give way where they must; default `true` with noisy measurements or limited jerk",
    )
    delay: fields.SecondsOrAuto = Field(
        "auto",
        exclude_if=lambda value: value == "auto",
        description="after how long commands reach the robot; auto: estimated from the motion [s]",
    )
    measurement_noise: StateNoiseSpec | None = Field(
        None, description="noise that the state is filtered for, 0: no filter; default that of `uncertainty.noise`"
    )
    offset_free: fields.Flag = Field(False, description="estimate a constant disturbance and take it off the control")
    offset_gain: fields.Positive = Field(0.3, le=1, description="offset_free: gain of the estimate's filter a sample")
    object_gain: fields.Positive = Field(
        0.5,
        le=1,
        exclude_if=lambda value: value == 0.5,
        description="gain of the filter of the object's measured pose a sample; smaller: less noise, and slower",
    )
    masses: Literal["as_described", "estimated"] = Field(
        "as_described",
        exclude_if=lambda value: value == "as_described",
        description="masses and inertias in the low-level law; estimated: from the motion",
    )
    one_stage: Literal["as_published", "free_end"] = Field(
        "as_published",
        exclude_if=lambda value: value == "as_published",
        description="windows over one stage: without its end, or with its end condition at a free switch time",
    )
    load_prior: fields.Sparse[LoadPriorSpec | None] = Field(
        None, description="prior of a load that is estimated; default the object's numbers, 50 % off"
    )
    htmpc: HtmpcSpec = Field(HtmpcSpec(), description="what only the lexicographic controller needs")

    @property
    def normalization_step(self) -> float | None:
        """Time between two costs that the normalization reads [s]; None: those at the nodes."""
        return self.sample_time if self.normalization_at == "samples" else None

    @property
    def uniform_nodes(self) -> int:
        """N_s where every stage is to have the same: as given, 100 as in the paper where it is automatic."""
        return 100 if self.nodes == "auto" else self.nodes


class SolverSpec(Choice):
    """The NLP back-end."""

    @property
    def traits(self) -> SolverTraits:
        """What it can do."""
        return SOLVERS[self.kind]

    def to_optimum(self) -> "SolverSpec":
        """Return the settings of a solver that solves each window to its optimum."""
        return self.model_copy(update={"kind": "fatrop"}) if self.traits.real_time else self

    def of_levels(self) -> "SolverSpec":
        """Return the settings of the solver of HTMPC's levels.

        Bounded costs need their curvature, so `sqp` leaves them to IPOPT, which starts from multipliers.
        """
        return self.model_copy(update={"kind": "ipopt"}) if self.traits.real_time else self

    kind: Literal["sqp", "fatrop", "ipopt", "adjoint"] = Field("sqp", description="which solver")
    tolerance: fields.Positive = Field(1e-8, le=1e-2, description="optimality tolerance of the scaled problem")
    max_iterations: fields.Whole = Field(200, ge=1, description="iterations after which it gives up")
    iterations: fields.Whole = Field(1, ge=1, description="sqp: iterations a sample from the shifted plan")
    entry_iterations: fields.Whole | None = Field(
        None,
        ge=1,
        exclude_if=lambda value: value is None,
        description="sqp: iterations a sample of a window that a stage enters; the next sample goes on; default all",
    )
    deadline: fields.Positive | None = Field(
        None, description="time after which the solves of a sample stop [s], not with fatrop; default none"
    )
    gradient: Literal["exact", "printed"] = Field(
        "exact",
        exclude_if=lambda value: value == "exact",
        description="adjoint: dJ/dt_s by the discrete adjoint, or by eq. (26) as printed",
    )
    compiled: fields.Flag = Field(True, description="sqp and plant rk4 as compiled C, where there is a compiler")


@dataclass(frozen=True)
class PlantTraits:
    """What tells a plant from the others.

    Attributes:
        has_forces: It has bodies and forces, which loads, friction and noise of the law disturb.
        compiles: It runs as compiled C where there is a compiler.
    """

    has_forces: bool = True
    compiles: bool = False


PLANTS: Mapping[str, PlantTraits] = {
    "rk4": PlantTraits(compiles=True),
    "mujoco": PlantTraits(),
    "ideal": PlantTraits(has_forces=False),
}
"""The plants by their `kind`."""


class PlantSpec(Choice):
    """The simulated physics."""

    @property
    def traits(self) -> PlantTraits:
        """What tells it from the other plants."""
        return PLANTS[self.kind]

    @property
    def alternatives(self) -> str:
        """The plants that have forces, as a message about one without them expects them."""
        others = " or ".join(kind for kind, traits in PLANTS.items() if traits.has_forces)
        return f"plant {others}: {self.kind} has neither bodies nor forces"

    kind: Literal["ideal", "rk4", "mujoco"] = Field("rk4", description="which physics")
    low_level_rate: fields.Positive = Field(1000.0, le=1e5, description="rate of the computed-torque loop [Hz]")
    step: Annotated[fields.Positive, Field(ge=1e-6)] | None = Field(
        None, description="step of the integrator [s]; default one tick of the loop"
    )
    thrusters: Literal["pulsed", "continuous"] = Field(
        "pulsed",
        exclude_if=lambda value: value == "pulsed",
        description="whether thrusters fire in pulses, or give the mean over each period of pulses throughout",
    )


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


def _weights(weights: SkillWeights, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give missing parts and wrong lengths of a skill's weights."""
    if earlier_fields.get("space") is not None and "parts" in earlier_fields:
        space = space_of(earlier_fields["space"], earlier_fields["parts"])
        axes = axes_of(context.sizes, space)
        yield from part_faults(weights.parts, axes, context.required(required_parts(axes, space)), one=True)
    axes = axes_of(context.sizes, earlier_fields.get("input", "joint"))
    if not any(traits.is_turned for traits in context.mobilities):
        axes = {part: axes[part] for part in axes if part != "base"}  # which has no control
    for at, error in part_faults(weights.control, axes, context.required(axes)):
        yield ("control", *at), error
    for key, numbers in (("force", weights.force), ("rate", weights.rate)):
        for at, error in part_faults(numbers, axes):
            yield (key, *at), error
    for key, is_weighed in (("force", weights.weighs_force), ("rate", weights.weighs_rate)):
        if is_weighed and earlier_fields.get("input", "joint") == "task":
            yield (key,), expected("none with input task", at_key=True)


def _mobility(mobility: StageMobility | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give a base that a mount holds in all stages but some."""
    if mobility is not None and not context.moved_by.moves:
        yield (), expected(f"none: the base is {context.mobility} in all stages")


def _plumes(use: PlumeUse | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give plumes to be avoided of a robot without any, and those that have nothing to keep off."""
    if use != "avoided":
        return
    if not context.has_plumes:
        yield (), expected("ignored, or a robot whose thrusters have a `plume`: {angle: 30 deg, length: 1.5}")
    has_object = bool(mapping(context.file.value(("object",))).get("mass"))
    if not (has_object or context.file.value(("obstacles",))):
        yield (), expected("ignored, or an object with a mass, or obstacles: there is nothing to keep plumes off")


_Plumes = fields.Sparse[Annotated[PlumeUse | None, validated_by(_plumes)]]


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
    weights: Annotated[SkillWeights, validated_by(_weights)] = Field(description="weights by part, and of the control")
    limits: LimitsByPart = Field({}, description="limits of this skill, within the task's")
    mobility: fields.Sparse[Annotated[StageMobility | None, validated_by(_mobility)]] = Field(
        None, description="what moves the base in stages of this skill, instead of the task's"
    )
    plumes: _Plumes = Field(None, description="plumes in stages of this skill, instead of the task's")


class ObjectEndSpec(Spec):
    """How near its destination, and how much at rest, the object is at the end of a stage that holds it; norms."""

    position: fields.Positive | None = Field(None, description="largest distance from the destination [m]")
    angle: fields.Width | None = Field(None, description="largest angle to the attitude there [rad]")
    velocity: fields.Positive | None = Field(None, description="largest speed of its centre of mass [m/s]")
    angular_velocity: fields.Width | None = Field(None, description="largest angular velocity [rad/s]")


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
    """Give times of a trajectory that do not rise from 0."""
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


def _target(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give missing parts, wrong lengths, angles without a unit, and parts that have no pose on the object."""
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


def _carrying(target_object: Mapping[str, Any], earlier_fields: Fields, context: Context) -> _Carrying | None:
    """Return where a stage stands among those that carry an object; None where a name is not that of a stage."""
    order = context.stages
    name = earlier_fields.get("name")
    taken_by, let_go_by = (target_object.get(key) for key in ("taken_by", "let_go_by"))
    if not (name in order and taken_by in order):
        return None
    let_go = order.index(let_go_by) if let_go_by in order else len(order)
    return _Carrying(order.index(taken_by), order.index(name), let_go)


def _object_end(end: ObjectEndSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give an end condition of the object that bounds nothing, or in a stage that does not hold it all the time."""
    if not end.model_dump(exclude_none=True):
        yield (), expected(f"at least one of {', '.join(ObjectEndSpec.model_fields)}", "none")
    target_object = mapping(context.file.value(("object",)))
    if not {"mass", "destination"} <= {key for key, value in target_object.items() if value}:
        yield (), expected('an "object" with a mass and a destination', "no such object", at_key=True)
        return
    order = context.stages
    carrying = _carrying(target_object, earlier_fields, context)
    if carrying is not None and not carrying.taken < carrying.stage < carrying.let_go:
        wanted = f"it in a stage that holds the object, from the one after {quoted(order[carrying.taken])} on"
        yield (), expected(wanted, f"it in {quoted(order[carrying.stage])}", at_key=True)


def parts_of_target(target: Mapping[str, Any] | TrajectorySpec) -> Collection[str]:
    """Return the parts of which a target, or a trajectory of targets, says where they are to be."""
    return target.parts if isinstance(target, TrajectorySpec) else target


def _has_control(names_of_joints: tuple[str, ...] | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give coordinates of a base without thrusters, which has no control."""
    for i, name in enumerate(names_of_joints or ()):
        if name.partition(".")[0] == "base" and not any(traits.is_turned for traits in context.mobilities):
            yield (i,), expected(f"coordinates of arms: a {context.mobility} base has no control")


def _end(end: EndCondition, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give coordinates of an end condition that the robot does not have, and tolerances that are missing or misfit."""
    if end.object is not None:
        yield from (((("object", *at)), error) for at, error in _object_end(end.object, earlier_fields, context))
    elif not end.coordinates:
        yield (), expected('"coordinates", "object" or both', "neither", at_key=True)
    sizes = context.sizes
    space = context.spaces.get(earlier_fields.get("skill", ""))
    if not sizes or space is None:
        return
    valid = names(sizes, space)
    for i, name in enumerate(end.coordinates):
        if name not in valid:
            yield ("coordinates", i), flaw(choice(name, valid))
    keys = [name.partition(".")[0] for name in end.coordinates]
    target = earlier_fields.get("target")
    if target is not None and "base" not in parts_of_target(target):
        wanted = 'a target of "base" in this stage, or coordinates without it'
        of_base = (i for i, key in enumerate(keys) if key in ("base", "all"))
        yield from ((("coordinates", i), expected(wanted)) for i in of_base)
    axes = axes_of(sizes, space)
    needed = [part for part in axes if any(key == "all" or stands_for(key, part) for key in keys)]
    for key in ("tolerance", "velocity"):
        for at, error in part_faults(getattr(end, key), axes, needed, one=True):
            yield (key, *at), error
    if end.moving is not None:
        if end.velocity is None:
            yield ("moving",), expected('also "velocity": how near the rates are to these', at_key=True)
        for at, error in part_faults(end.moving, axes, one=True):
            yield ("moving", *at), error
        for part in end.moving:
            if part in axes and not any(key in ("all", part) or stands_for(key, part) for key in keys):
                known = ", ".join(quoted(key.partition(".")[0]) for key in end.coordinates)
                yield ("moving",), expected(f"parts of which the end condition has coordinates: {known}", quoted(part))


def _end_units(written: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give tolerances and velocities of an end condition in the unit of another kind of coordinate."""
    space = context.spaces.get(earlier_fields.get("skill", ""))
    if not (context.sizes and space and isinstance(written, Mapping)):
        return
    axes = axes_of(context.sizes, space)
    units = AsWritten(context.sliding, "error")
    names_of_rows = written.get("coordinates", ())
    chosen = [names_of_rows] if isinstance(names_of_rows, str) else names_of_rows
    every_row = [(part, axis) for part in axes for axis in axes[part]]
    asked = [
        row for row in every_row if {"all", ".".join(row)} & {*chosen} or any(stands_for(n, row[0]) for n in chosen)
    ]
    rates = AsWritten(context.sliding, "velocity")
    for key, of_key in (("tolerance", units), ("velocity", units), ("moving", rates)):
        numbers = written.get(key)
        if isinstance(numbers, Mapping):
            yield from (((key, *at), error) for at, error in part_faults(numbers, axes, one=True, written=of_key))
        else:
            yield from unit_misfits((key,), numbers, asked, units)


def _one_way(priority: float, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give a priority beside comparisons."""
    if context.file.value(("priorities",)) is not None:
        found = '"priority" at a stage and "priorities" in the task'
        yield (), expected("one or the other", found, at_key=True)


def _one_end(at: float | None, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give a stage without an end, or with two."""
    if "ends_when" in earlier_fields:
        last = earlier_fields.get("name") == context.stages[-1]
        ends = [key for key, end in (("ends_when", earlier_fields["ends_when"]), ("at", at)) if end is not None]
        if ends != ["ends_when"] if last else len(ends) != 1:
            wanted = '"ends_when" in the last stage: it ends the run' if last else 'either "ends_when" or "at"'
            yield (), expected(wanted, " and ".join(map(quoted, ends)) or "no end", at_key=True)


class RetrySpec(Spec):
    """Another try where grippers miss the object at the end of the stage, or lose it in the stage."""

    back_to: _StageName = Field(description="the earlier stage to which the sequence returns")
    times: fields.Whole = Field(1, ge=1, description="how often at most; then the mission ends")


def _retry(retry: RetrySpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give another try of a stage that neither takes nor holds an object with a mass, and one from a later stage."""
    target_object = mapping(context.file.value(("object",)))
    if not target_object.get("mass"):
        yield (), expected('an "object" with a mass', "no such object", at_key=True)
        return
    order = context.stages
    carrying = _carrying(target_object, earlier_fields, context)
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


class StageSpec(Spec):
    """One activation of a skill."""

    name: fields.Name = Field(description="name of the stage")
    skill: _SkillName = Field(description="the skill to run, by name")
    priority: Annotated[fields.Positive, validated_by(_one_way)] = Field(
        1.0, description="relative importance omega, eq. (11)"
    )
    target: Annotated[Target, validated_by(_target, as_written=True)] = Field(
        description="joint: base pose and joint coordinates; task: base and end-effector poses; or a trajectory of them"
    )
    ends_when: Annotated[EndCondition, validated_by(_end), validated_by(_end_units, as_written=True)] | None = Field(
        None, description="the condition that ends the stage, eq. (18)"
    )
    at: Annotated[fields.Positive | None, validated_by(_one_end)] = Field(
        None, validate_default=True, description="fixed time that ends the stage [s], instead of a condition"
    )
    dwell: fields.NotNegative = Field(0.0, description="shortest duration, that of a trajectory at least [s]")
    onset: Annotated[_JointNames | None, validated_by(_has_control)] = Field(
        None, description="coordinates whose control marks the stage's actual start"
    )
    if_missed: fields.Sparse[Annotated[RetrySpec, validated_by(_retry)] | None] = Field(
        None, description="another try where the object is missed at the stage's end, or lost in it; default none"
    )
    mobility: fields.Sparse[Annotated[StageMobility | None, validated_by(_mobility)]] = Field(
        None, description="what moves the base in this stage, instead of the skill's"
    )
    plumes: _Plumes = Field(None, description="plumes in this stage, instead of the skill's")
    clearance: fields.Sparse[ClearanceSpec | None] = Field(
        None, description="how far apart bodies keep in this stage, instead of the task's"
    )
    angles: Literal["nearest", "exact"] = Field(
        "nearest", description="nearest: a target angle means the nearest equivalent one; exact: itself"
    )
    cones: fields.Sparse[tuple[OneCone, ...]] = Field(
        (), description="axes of frames that stay within, or outside, an angle of a point or a direction"
    )


class PrioritiesSpec(Spec):
    """Priorities of all stages from paired comparisons, instead of one at each stage; the first stage's is 1."""

    compare: tuple[_Comparison, ...] = Field(
        min_length=1, description="[a, b, r]: stage a is r times as important as stage b"
    )


class OnsetSpec(Choice):
    """What marks a stage's actual start: what it adds to the control, or how near the control is to its own optimum."""

    kind: Literal["control", "closeness"] = Field("control", description="what must reach the threshold")
    epsilon: fields.Positive = Field(0.1, description="threshold, of a control [m/s^2, rad/s^2] or of closeness [1]")
    series: tuple[fields.Positive, ...] = Field(
        (1e-4, 1e-3, 1e-2, 1e-1), description="further thresholds that are always evaluated"
    )


class LogSpec(Spec):
    """What the log holds beyond the samples."""

    ticks: fields.Flag = Field(False, description="every tick of the low-level loop")
    plans: fields.Flag = Field(True, description="every horizon's plan, for replay")
    shares: fields.Flag = Field(True, description="each stage's share in the control, for some more solves a sample")


def _own_names(
    key: str, entries: tuple[StageSpec | MonitorSpec | ObstacleSpec, ...], earlier_fields: Fields, context: Context
) -> RuleErrors:
    """Give names of entries of a list that an earlier entry has."""
    first: dict[str, int] = {}
    for i, entry in enumerate(entries):
        if first.setdefault(entry.name, i) != i:
            found = f"{quoted(entry.name)} again (first at {key}[{first[entry.name]}])"
            yield (i, "name"), expected("a name of its own", found)


def _may_have_routes(routes: RoutesSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give routes of a robot that cannot follow them, or round nothing."""
    if any(traits.reacts for traits in context.mobilities):
        yield (), expected("none: the base moves as the arms move it, of which routes know nothing", at_key=True)
    stages = earlier_fields.get("stages", ())
    if (
        "clearance" in earlier_fields
        and earlier_fields["clearance"] is None
        and not any(stage.clearance for stage in stages)
    ):
        yield (), expected('also "clearance": routes keep clear of what it names', "routes alone", at_key=True)


def _obstacle_names(obstacles: tuple[ObstacleSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give obstacles with names that parts of the robot have, or the object."""
    taken = [*context.sizes, OBJECT]
    for i, obstacle in enumerate(obstacles):
        if obstacle.name in taken:
            yield (i, "name"), expected(f"a name other than {', '.join(taken)}", quoted(obstacle.name))


def _comes_again(stages: tuple[StageSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give tries that would repeat a stage with a fixed switch time."""
    order = [stage.name for stage in stages]
    for i, stage in enumerate(stages):
        if stage.if_missed is None or stage.if_missed.back_to not in order:
            continue
        fixed = [other.name for other in stages[order.index(stage.if_missed.back_to) : i + 1] if other.at is not None]
        if fixed:
            found = f"{quoted(fixed[0])} with the fixed switch time {stages[order.index(fixed[0])].at:g} s"
            yield (i, "if_missed", "back_to"), expected('stages with "ends_when" from there to here', found)


def _instants(stages: tuple[StageSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give fixed switch times that no order of events can keep."""
    limit = earlier_fields.get("time_limit", np.inf)
    earliest = 0.0
    fixed = 0.0
    for i, stage in enumerate(stages):
        earliest += max(stage.dwell, stage.target.times[-1] if isinstance(stage.target, TrajectorySpec) else 0.0)
        if stage.at is not None and (stage.at < earliest or stage.at == fixed):
            wanted = f"a time after {earliest:g} s, by the dwells, trajectories and fixed times so far"
            yield (i, "at"), expected(wanted, f"{stage.at:g} s")
        elif stage.at is not None and stage.at >= limit:
            yield (i, "at"), expected(f"a time before the time_limit of {limit:g} s", f"{stage.at:g} s")
        elif stage.at is not None:
            earliest = stage.at
            fixed = stage.at


def _controller(controller: ControllerSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give times of a controller that do not fit each other, and meshes that it cannot have."""
    if controller.sample_time > controller.horizon:
        wanted = f"at most the horizon of {controller.horizon:g} s"
        yield ("sample_time",), expected(wanted, f"{controller.sample_time:g} s")
    if controller.delay != "auto" and controller.delay >= controller.horizon:
        yield ("delay",), expected(f"less than the horizon of {controller.horizon:g} s", f"{controller.delay:g} s")
    if controller.one_stage == FREE_END and not controller.traits.one_stage:
        kinds = " or ".join(kind for kind, traits in CONTROLLERS.items() if traits.one_stage)
        wanted = f'"as_published", or controller {kinds}: windows of {controller.kind} are over several stages'
        yield ("one_stage",), expected(wanted)
    if controller.traits.has_levels and controller.nodes == "auto":
        yield ("nodes",), expected("a number with controller htmpc, which compares levels node by node")


def _solver(solver: SolverSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give a controller or a gradient that is not of the solver, and a deadline that it cannot keep."""
    controller = earlier_fields.get("controller")
    if solver.traits.by_costates and controller and controller.traits.has_levels:
        kinds = " or ".join(kind for kind, traits in SOLVERS.items() if not traits.by_costates)
        yield (
            ("kind",),
            expected(f"{kinds} with controller htmpc: {solver.kind} has no gradient of costs that are kept"),
        )
    if solver.gradient != "exact" and not solver.traits.by_costates:
        kinds = " or ".join(kind for kind, traits in SOLVERS.items() if traits.by_costates)
        yield ("gradient",), expected(f'"exact", or solver {kinds}: {solver.kind} differentiates J itself')
    if solver.deadline is None:
        return
    if not solver.traits.stops_early:
        yield (
            ("deadline",),
            expected("none with solver fatrop, which cannot stop early, or solver sqp, ipopt or adjoint"),
        )


def _plant(plant: PlantSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give a plant whose ticks and steps do not divide a sample."""
    if (controller := earlier_fields.get("controller")) is None:
        return
    sample = controller.sample_time
    rate = plant.low_level_rate
    if not _is_whole(sample * rate):
        found = f"{rate:g} Hz, which makes {sample * rate:.6g} ticks of a sample_time of {sample:g} s"
        yield ("low_level_rate",), expected("a whole number of ticks", found)
    if not (plant.traits.has_forces or context.is_always_actuated):
        yield ("kind",), expected(f"{plant.alternatives}, by which a base moves that is not free-flying")
    if "thrusters" in plant.model_fields_set and not context.has_thrusters:
        yield ("thrusters",), expected("none: the robot has no thrusters", at_key=True)
    if not (plant.step is None or _is_whole(1 / rate / plant.step)):
        found = f"{plant.step:g} s, which makes {1 / rate / plant.step:.6g} steps of a tick of {1 / rate:g} s"
        yield ("step",), expected("a whole number of steps", found)


def _is_whole(ratio: float) -> bool:
    """Tell whether a ratio of times is a whole number, but for the digits it is written with."""
    return round(ratio) >= 1 and abs(ratio - round(ratio)) <= 1e-6 * ratio


def _within_the_robots(limits: Mapping[str, PartLimits], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give limits of a task that are wider than its robot's."""
    yield from wider(limits, {"the robot's": context.robot_limits}, context.sizes)


def _skills(skills: Mapping[str, SkillSpec], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give limits of skills that are wider than those around them, and inputs that the solver cannot have."""
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
    """Give why the accelerations of a robot's poses cannot be the control of its windows."""
    at = ("input",)
    rows_of_pose = context.sizes.get("base", 0)  # as many as the base has coordinates
    if not context.is_always_actuated:
        yield at, expected('"joint": task takes bases that are free-flying in every stage')
    in_space = dimension_of(context.sizes) == 3
    for part, joints in context.sizes.items():
        if joints < rows_of_pose or (in_space and joints > rows_of_pose):
            wanted = f'"joint": task needs {rows_of_pose} joints{"" if in_space else " or more"} in every arm'
            yield at, expected(wanted, f"{counted(joints, 'joint', 'joints')} in {part}")


def _monitor(monitor: MonitorSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give a monitor that bounds nothing or is about the wrong number of frames."""
    bounds = ("above_start_at_most", "below_start_at_most", "at_most", "at_least")
    if all(getattr(monitor, bound) is None for bound in bounds):
        yield (), expected(f"one of {', '.join(bounds)}", "no bound", at_key=True)
    is_clearance = monitor.quantity == "clearance"
    valid = names_of_parts(context) if is_clearance else list(context.sizes)
    unknown = [i for i, name in enumerate(monitor.of) if valid and name not in valid]
    yield from ((("of", i), flaw(choice(monitor.of[i], valid))) for i in unknown)
    if is_clearance:
        yield from _monitored_clearance(monitor, earlier_fields)
        return
    number = 2 if monitor.quantity == "distance" else 1
    if not (unknown or len(monitor.of) == len(set(monitor.of)) == number):
        yield ("of",), expected("two different frames for a distance, one for a speed")


def _monitored_clearance(monitor: MonitorSpec, earlier_fields: Fields) -> RuleErrors:
    """Give a monitor of a clearance that is not about two parts, or of a stage in which nothing keeps clear."""
    if len(monitor.of) not in (0, 2):
        yield ("of",), expected("two parts for a clearance, or [] for all pairs")
    if not ("stages" in earlier_fields and "clearance" in earlier_fields):
        return
    of_stage = any(stage.clearance for stage in earlier_fields["stages"] if stage.name == monitor.during)
    if not (earlier_fields["clearance"] or of_stage):
        wanted = f'distance or speed, or "clearance" in the task or in {quoted(monitor.during)}'
        yield ("quantity",), expected(f"{wanted}: nothing keeps clear there")


def _uncertainty(spec: UncertaintySpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give what the plant cannot do, a delay beyond the horizon, and a payload without an object."""
    controller = earlier_fields.get("controller")
    plant = earlier_fields.get("plant")
    if controller is not None and spec.delay >= controller.horizon:
        yield ("delay",), expected(f"less than the horizon of {controller.horizon:g} s", f"{spec.delay:g} s")
    if plant and spec.changes_the_plant and not plant.traits.has_forces:
        found = ", ".join(
            key for key in type(spec).model_fields if key in spec.model_fields_set - {"noise", "delay", "jitter"}
        )
        yield (), expected(f"only noise and delay, or {plant.alternatives}", f"{found} with plant {plant.kind}")
    if spec.impulse is not None and spec.impulse.at >= earlier_fields.get("time_limit", np.inf):
        wanted = f"a time before the time_limit of {earlier_fields['time_limit']:g} s"
        yield ("impulse", "at"), expected(wanted, f"{spec.impulse.at:g} s")
    if not (spec.impulse is None or context.moved_by.moves):
        yield ("impulse",), expected("none: the base is fixed", at_key=True)
    if spec.payload and "object" in earlier_fields and not earlier_fields["object"]:
        wanted = "one: it says which stages take the payload and let it go"
        yield ("payload",), expected(wanted, 'no "object"', at_key=True)
    has_mass = bool(earlier_fields.get("object") and earlier_fields["object"].mass)
    if spec.payload and has_mass:
        yield ("payload",), expected("none: the object has a mass of its own", "a payload", at_key=True)
    if spec.object and not has_mass:
        yield ("object",), expected('an "object" with a mass', "no such object", at_key=True)
    yield from (
        _shares_of_no_limit(spec.force_share, earlier_fields["limits"], context) if "limits" in earlier_fields else ()
    )


def _shares_of_no_limit(
    given: float | Mapping[str, tuple[float, ...]], limits: Mapping[str, PartLimits], context: Context
) -> RuleErrors:
    """Give shares other than 1 of the force limits of parts whose force neither the robot nor the task limits."""
    layers = (context.robot_limits, limits)
    limited = [part for part in context.sizes if any(limits_of_part(each, part, "force") for each in layers)]
    if not any(traits.is_turned for traits in context.mobilities):
        limited = [part for part in limited if part != "base"]
    by_part = given if isinstance(given, Mapping) else {"robot": (given,)}
    for key, shares in by_part.items():
        parts = [part for part in context.sizes if key == "robot" or stands_for(key, part)]
        if any(share != 1 for share in shares) and parts and not set(parts) & set(limited):
            where = () if key == "robot" else (key,)
            part = "PART" if key == "robot" else key
            wanted = f"1, or a limit that it is a share of: limits: {{{part}: {{force: ...}}}} in the robot or the task"
            yield ("force_share", *where), expected(wanted)


_Monitor = Annotated[MonitorSpec, validated_by(_monitor)]


def _prior_of_a_load(target_object: ObjectSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give a load to find out where the law counts with none, or a prior without one."""
    controller = earlier_fields.get("controller")
    estimated = target_object.grasp is not None and target_object.grasp.is_estimated
    if controller and controller.load_prior and not estimated:
        wanted = "object.grasp.known: estimated, or no controller.load_prior"
        found = None if target_object.grasp else "an object without a grasp"
        yield ("grasp", "known") if target_object.grasp else (), expected(wanted, found, at_key=found is not None)


def _names_of_checks(monitors: tuple[MonitorSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give monitors with the name of what is judged besides."""
    keeps_clear = earlier_fields.get("clearance") or any(stage.clearance for stage in earlier_fields.get("stages", ()))
    target_object = earlier_fields.get("object")
    taken = [NOTHING_TOUCHED] if keeps_clear else []
    taken += [check.value for check in ObjectCheck] if target_object and target_object.mass else []
    for i, monitor in enumerate(monitors):
        if monitor.name in taken:
            yield (i, "name"), expected(f"a name other than {', '.join(taken)}", quoted(monitor.name))


def _fixed_base_rests(velocity: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Give an initial velocity of a base that stands still."""
    if any(velocity.get("base", ())) and not context.moved_by.moves:
        yield ("base",), expected("zeros, or no base: it is fixed")


class TaskSpec(Spec):
    """A whole experiment."""

    name: fields.Name = Field("", description="name of the task; default the file's stem")
    description: str = Field("", description="what it is, for people")
    robot: str = Field(min_length=1, description="a built-in robot's name, or a path relative to this file")
    mobility: Mobility | None = Field(
        None, exclude_if=lambda value: value is None, description="what moves the base, instead of the robot's own"
    )
    plumes: _Plumes = Field(None, description=f"{PLUMES}; default ignored")
    initial: Annotated[Mapping[fields.Part, fields.Numbers], in_joint_space(required=True, positions=True)] = Field(
        description="base pose and joint coordinates at the start [m, rad]"
    )
    initial_velocity: Annotated[
        Mapping[fields.Part, tuple[fields.Coordinate, ...]], in_joint_space(), validated_by(_fixed_base_rests)
    ] = Field({}, description="their rates at the start [m/s, rad/s]; default rest")
    controller: Annotated[ControllerSpec, validated_by(_controller)] = Field(
        ControllerSpec(), description="the controller and its objective"
    )
    solver: Annotated[SolverSpec, validated_by(_solver)] = Field(SolverSpec(), description="the NLP back-end")
    plant: Annotated[PlantSpec, validated_by(_plant)] = Field(PlantSpec(), description="the simulated physics")
    time_limit: fields.Positive = Field(60.0, description="time after which the run is stopped [s]")
    limits: Annotated[LimitsByPart, validated_by(_within_the_robots)] = Field(
        {}, description="limits of this task, within the robot's"
    )
    skills: Annotated[Mapping[fields.Name, SkillSpec], Field(min_length=1), validated_by(_skills)] = Field(
        description="the skills by name"
    )
    stages: Annotated[
        tuple[StageSpec, ...],
        Field(min_length=1),
        validated_by(partial(_own_names, "stages")),
        validated_by(_instants),
        validated_by(_comes_again),
    ] = Field(description="the stages in their order")
    priorities: Annotated[PrioritiesSpec, validated_by(disagreements)] | None = Field(
        None, description="priorities of all stages from paired comparisons, instead of one at each stage"
    )
    onset: OnsetSpec = Field(OnsetSpec(), description="what counts as the actual start of a stage")
    object: Annotated[ObjectSpec, validated_by(complete), validated_by(_prior_of_a_load)] | None = Field(
        None, description="the target object"
    )
    obstacles: fields.Sparse[
        Annotated[
            tuple[ObstacleSpec, ...], validated_by(partial(_own_names, "obstacles")), validated_by(_obstacle_names)
        ]
    ] = Field((), description="bodies that the robot does not touch")
    clearance: fields.Sparse[ClearanceSpec | None] = Field(
        None, description="how far apart bodies keep; default nothing is kept, measured or called a touch"
    )
    routes: fields.Sparse[Annotated[RoutesSpec, validated_by(_may_have_routes)] | None] = Field(
        None, description="routes round what blocks the straight motion to a target; default none"
    )
    uncertainty: Annotated[UncertaintySpec, validated_by(_uncertainty)] = Field(
        UncertaintySpec(), description="what the controller does not know"
    )
    monitors: Annotated[
        tuple[_Monitor, ...], validated_by(partial(_own_names, "monitors")), validated_by(_names_of_checks)
    ] = Field((), description="what must hold for the mission to succeed")
    published: Mapping[_ControllerKey, PublishedRun] = Field(
        {}, description="published runs to compare with, by controller"
    )
    by_controller: Mapping[_ControllerKey, Mapping[str, Any]] = Field(
        {},
        exclude=True,
        description="settings for one controller alone, by controller: values by the path of their key",
    )
    log: LogSpec = Field(LogSpec(), description="what the log holds beyond the samples")
    seed: fields.Whole = Field(0, ge=0, description="seed of everything random")

    @property
    def judged(self) -> dict[str, str]:
        """What decides whether the mission succeeded; units by name.

        That nothing touched where bodies keep clear, monitors, and what becomes of an object with a mass.
        """
        units = {NOTHING_TOUCHED: "m"} if self.keeps_clear else {}
        units |= {monitor.name: monitor.unit for monitor in self.monitors}
        return units | dict.fromkeys(self.object_checks, "1")

    @property
    def object_checks(self) -> tuple[str, ...]:
        """Names of what is judged of an object with a mass; none without one."""
        body = self.body
        if body.mass == 0.0:
            return ()
        left_out = {ObjectCheck.DELIVERED} if body.destination is None else set()
        return tuple(check.value for check in ObjectCheck if check not in left_out)

    @property
    def body(self) -> ObjectBody:
        """The task's object as a rigid body, of mass 0 where the task has no such object."""
        return NO_BODY if self.object is None else self.object.body

    @property
    def finds_load(self) -> bool:
        """Whether the controller finds out what the grippers hold."""
        return self.body.grasp.is_estimated

    @property
    def finds_masses(self) -> bool:
        """Whether the controller finds out masses and inertias of the robot."""
        return self.controller.masses == "estimated"

    @property
    def is_uncertain(self) -> bool:
        """Whether the robot may differ from what the low-level law counts with."""
        return self.uncertainty.in_force or self.finds_masses

    @property
    def carrying_stages(self) -> range:
        """The stages in which grippers hold an object with a mass."""
        return self.held_stages if self.body.mass else range(0)

    @property
    def tries_again(self) -> bool:
        """Whether the sequence returns to an earlier stage where the object is missed or lost in some stage."""
        return any(stage.if_missed is not None for stage in self.stages)

    def moved_by(self, stage: int, robot: RobotSpec) -> MobilityTraits:
        """Return what moves the base of the task's robot in a stage."""
        spec = self.stages[stage]
        return MOBILITIES[spec.mobility or self.skills[spec.skill].mobility or robot.mobility]

    def avoids_plumes(self, stage: int, robot: RobotSpec) -> bool:
        """Return whether thrusters do not fire in a stage while their plumes reach the object or an obstacle."""
        spec = self.stages[stage]
        use = spec.plumes or self.skills[spec.skill].plumes or self.plumes
        return use == "avoided" and robot.has_plumes and self.moved_by(stage, robot).is_pushed

    def changes_mobility(self, robot: RobotSpec) -> bool:
        """Return whether the base is moved otherwise in some stage than the robot's description says."""
        return any(self.moved_by(stage, robot) != robot.moved_by for stage in range(len(self.stages)))

    def finds_delay(self, robot: RobotSpec) -> bool:
        """Return whether the controller finds out after how long its commands act.

        Not where thrusters fire in pulses: the base then follows commands up to a period of pulses later, or earlier.
        """
        return self.controller.delay == "auto" and not self.fires(robot)

    def fires(self, robot: RobotSpec) -> bool:
        """Return whether the base of the task's robot is pushed by thrusters in some stage."""
        return bool(robot.thrusters) and any(self.moved_by(stage, robot).is_pushed for stage in range(len(self.stages)))

    def retry_after(self, stage: int) -> tuple[int, int]:
        """Return to which stage the sequence returns where the object is missed at the end of a stage, or lost in it.

        Returns:
            The index of that stage, and how often at most; 0 times where the task declares none.
        """
        retry = self.stages[stage].if_missed
        if retry is None:
            return stage, 0
        return [each.name for each in self.stages].index(retry.back_to), retry.times

    @property
    def acts_in_task_space(self) -> bool:
        """Whether the control of any stage is the acceleration of poses."""
        return any(self.skills[stage.skill].input == "task" for stage in self.stages)

    @property
    def keeps_clear(self) -> bool:
        """Whether bodies keep clear of each other in any stage."""
        return any(self.clearance_of(stage) is not None for stage in range(len(self.stages)))

    def clearance_of(self, stage: int) -> ClearanceSpec | None:
        """Return how far apart bodies keep in a stage; None where nothing is asked for."""
        return self.stages[stage].clearance or self.clearance

    @property
    def held_stages(self) -> range:
        """The stages in which grippers hold the object; none of a task without one. See `ObjectSpec.held_stages`."""
        if self.object is None:
            return range(0)
        return self.object.held_stages([stage.name for stage in self.stages])

    @property
    def holds_to_the_end(self) -> bool:
        """Whether the object is still held when the last stage is over."""
        return len(self.stages) in self.held_stages

    @property
    def time_after_end(self) -> float:
        """For how long a run goes on after its last stage [s]: grippers that close only then are seen to hold."""
        closes_at_end = self.carrying_stages.start == len(self.stages)
        return 1.0 if closes_at_end else 0.0

    @property
    def measurement_noise(self) -> StateNoiseSpec:
        """The noise that the controller filters the measured state for."""
        declared = self.controller.measurement_noise
        return self.uncertainty.noise if declared is None else declared

    @property
    def sees_the_state(self) -> bool:
        """Whether the controller decides from the true state."""
        is_late = self.uncertainty.delay or self.uncertainty.jitter or self.controller.delay not in ("auto", 0.0)
        return not (self.uncertainty.measures_with_noise or self.measurement_noise.of_state or is_late)
