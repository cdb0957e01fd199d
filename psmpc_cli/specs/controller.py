"""What decides and what is simulated: the controller, its solver and the plant of a task. Validated data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationError, ValidationInfo, model_validator

from psmpc_cli.specs import fields
from psmpc_cli.specs.document import quoted
from psmpc_cli.specs.fields import (
    Choice,
    Fields,
    RuleErrors,
    Spec,
    expected,
)
from psmpc_cli.specs.object import Moments
from psmpc_cli.specs.parts import (
    Context,
)
from psmpc_cli.specs.uncertainty import StateNoiseSpec

ControllerKind = Literal["psmpc", "smpc", "hard", "htmpc"]


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
    speed_reserve: fields.NotNegative = Field(
        0.0,
        exclude_if=lambda value: value == 0.0,
        description="how far plans stay below limits of speed, over how far measured speeds were off the plans of late",
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


def controller_faults(controller: ControllerSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for times of a controller that do not fit each other, and meshes that it cannot have."""
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


def solver_faults(solver: SolverSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors where the settings of a solver do not fit it or the controller.

    A solver by costates cannot have controller htmpc, only such a solver has a choice of gradients, and a solver that
    cannot stop early has no deadline.

    Args:
        solver: The valid key `solver` of a task.
        earlier_fields: The valid keys of the task before it.
        context: The rest of the description, which this rule does not need.

    Yields:
        Path of the key from `solver` on, and its error.
    """
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


def plant_faults(plant: PlantSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors where a plant does not fit the controller's sample time, or the robot.

    A sample has to be a whole number of ticks of the low-level law, and a tick a whole number of integration steps.
    Only a plant that computes forces moves bases that are not free-flying, and only a robot with thrusters has a key
    for them.

    Args:
        plant: The valid key `plant` of a task.
        earlier_fields: The valid keys of the task before it.
        context: What is known of the robot.

    Yields:
        Path of the key from `plant` on, and its error.
    """
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
