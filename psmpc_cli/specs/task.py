"""What a task is: skills and stages, how to run them, its object, and what the controller does not know.

Plain validated data in SI units.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Discriminator, Field, Tag

from psmpc_cli.specs.fields import (
    Angle,
    ArmName,
    Choice,
    Flag,
    Fraction,
    Intervals,
    Name,
    Names,
    NotNegative,
    Number,
    OneOrMore,
    OrByPart,
    Part,
    Positive,
    Row,
    Seconds,
    SideBySide,
    Size,
    Spec,
    Vector2,
    Whole,
    Width,
    known,
    listed,
)
from psmpc_cli.specs.robot import PartLimits

Parts = Mapping[str, tuple[float, ...]]
"""Numbers keyed by part name (`base`, then each arm's name, or `arms` for every arm)."""

_Coordinates = Mapping[Part, tuple[Angle, ...]]
_Extent = Annotated[tuple[Positive, Positive], listed("2 entries", 2)]
_Pose = Annotated[tuple[Number, Number, Angle], listed("3 entries", 3)]
_Fractions = OrByPart[Fraction, Part, Fraction]
_Control = OrByPart[Size, Part, tuple[Size, ...]]
_Tolerance = OrByPart[Width, Part, OneOrMore[Width]]
_ByArm = OrByPart[NotNegative, ArmName, OneOrMore[NotNegative]]
_Frames = Names[Annotated[str, known("frames")]]
_JointNames = Names[Annotated[str, known("joint coordinates")]]
_SkillName = Annotated[str, known("skills")]
_StageName = Annotated[str, known("stages")]
_Comparison = Annotated[tuple[_StageName, _StageName, Positive], listed("a comparison [stage, stage, ratio]", 3)]
_StageKey = Annotated[str, known("stages", "stage")]
_ControllerKey = Annotated[str, known("controllers", "controller")]


class ObjectSpec(Spec):
    """The target object."""

    shape: _Extent = Field(description="length and width, [l, w] [m]")
    pose: _Pose = Field(description="pose before it is taken, [x, y, angle] [m, rad]")
    taken_by: _StageName = Field(description="the stage at whose end it is taken")
    let_go_by: _StageName = Field(description="the stage at whose beginning it is let go")


class MonitorSpec(Spec):
    """A bound on a signal during a stage that decides whether the mission succeeded."""

    name: str = Field(min_length=1, description="what the bound means, such as object held")
    quantity: Literal["distance", "speed"] = Field(description="between two frames, or of one")
    of: _Frames = Field(description="base or arms: two for a distance, one for a speed")
    during: _StageName = Field(description="the stage in which it must hold")
    above_start_at_most: NotNegative | None = Field(None, description="rise above its value at the stage's start")
    below_start_at_most: NotNegative | None = Field(None, description="fall below its value at the stage's start")
    at_most: Number | None = Field(None, description="upper bound [m, m/s]")
    at_least: Number | None = Field(None, description="lower bound [m, m/s]")


class PublishedRun(Spec):
    """A published run to compare with."""

    switch_time: Mapping[_StageKey, Number] = Field({}, description="instants that end the stages, by name [s]")
    actual_start: Mapping[_StageKey, Number] = Field({}, description="actual starts of the stages, by name [s]")


class FrictionSpec(Spec):
    """Friction in the joints: the torque -viscous * rate - coulomb * tanh(rate / width)."""

    viscous: _ByArm = Field(0.0, description="one number or numbers by arm [N m s/rad]")
    coulomb: _ByArm = Field(0.0, description="one number or numbers by arm [N m]")
    width: Positive = Field(0.02, description="rate around 0 within which Coulomb friction turns over [rad/s]")


class NoiseSpec(Spec):
    """Standard deviations of what is measured, drawn anew for every coordinate at every tick."""

    position: NotNegative = Field(0.0, description="of the base's position [m]")
    angle: Size = Field(0.0, description="of the base's angle and the joints' [rad]")
    velocity: NotNegative = Field(0.0, description="of the base's velocity [m/s]")
    angular_velocity: Size = Field(0.0, description="of the rates of all angles [rad/s]")


class ImpulseSpec(Spec):
    """A blow to the base, even over one tick of the low-level loop."""

    at: NotNegative = Field(description="when it comes [s]")
    linear: Vector2 = Field((0.0, 0.0), description="impulse of the force, [x, y] [N s]")
    angular: Number = Field(0.0, description="impulse of the torque [N m s]")


class PayloadSpec(Spec):
    """What the task's object weighs; while held, it is part of the last links of the arms."""

    mass: Positive = Field(description="mass [kg]")
    inertia: NotNegative = Field(description="inertia about its centre of mass [kg m^2]")
    known: Flag = Field(False, description="whether the low-level law counts it in while it is held")
    share: OrByPart[NotNegative, ArmName, NotNegative] | None = Field(
        None, description="what each gripper holds of it, one number or numbers by arm; default equal shares"
    )


class UncertaintySpec(Spec):
    """How the real robot differs from the one the controller knows; what is random is drawn from the task's seed."""

    mass: _Fractions = Field(0.0, description="largest relative error of a body's mass, one number or numbers by part")
    inertia: _Fractions = Field(0.0, description="the same of its inertia about the centre of mass")
    centre_of_mass: OrByPart[NotNegative, Part, NotNegative] = Field(
        0.0, description="largest offset of a body's centre of mass along either axis, one number or by part [m]"
    )
    friction: FrictionSpec = Field(FrictionSpec(), description="friction in the joints")
    noise: NoiseSpec = Field(NoiseSpec(), description="noise of the measurement")
    delay: Whole = Field(0, ge=0, description="samples after which a control reaches the robot")
    force_limits: Mapping[Part, OneOrMore[Positive]] = Field(
        {}, description="largest force and torques [Fx, Fy, torque] of the base, torques of arms, by part [N, N m]"
    )
    impulse: ImpulseSpec | None = Field(None, description="a blow to the base")
    payload: PayloadSpec | None = Field(None, description="what the task's object weighs")

    @property
    def measures_with_noise(self) -> bool:
        """Whether the controller sees another state than the true one."""
        return any(value > 0 for value in self.noise.model_dump().values())

    @property
    def is_random(self) -> bool:
        """Whether any of it depends on the seed."""
        return self.measures_with_noise or any(
            _largest(of) > 0 for of in (self.mass, self.inertia, self.centre_of_mass)
        )

    @property
    def changes_the_plant(self) -> bool:
        """Whether anything but what the controller reads, and when it acts, differs from what it knows."""
        drawn = (self.mass, self.inertia, self.centre_of_mass, self.friction.viscous, self.friction.coulomb)
        others = self.force_limits or self.impulse or self.payload
        return bool(others) or any(_largest(value) > 0 for value in drawn)

    @property
    def in_force(self) -> bool:
        """Whether there is any of it."""
        return self.changes_the_plant or self.measures_with_noise or self.delay > 0


def _largest(value: float | Mapping[str, float] | Mapping[str, tuple[float, ...]]) -> float:
    """Return the largest of one number or numbers by part."""
    if not isinstance(value, Mapping):
        return value
    lists = (given if isinstance(given, tuple) else (given,) for given in value.values())
    return max((number for numbers in lists for number in numbers), default=0.0)


class HtmpcSpec(Spec):
    """The lexicographic controller, eq. (32)."""

    depth: Whole | None = Field(None, ge=1, description="levels a sample solves; default all remaining stages")
    constraint: Literal["cost", "error"] = Field("cost", description="what may not get worse: costs, or errors by node")
    tolerance: Positive = Field(1e-3, description="by how much a normalized cost, or an error, may get worse")


class ControllerSpec(Choice):
    """The controller and its objective; symbols as in docs/formulation.md."""

    kind: Literal["psmpc", "smpc", "hard", "htmpc"] = Field("psmpc", description="which controller")
    horizon: Positive = Field(4.0, description="prediction horizon T_h [s]")
    nodes: Intervals = Field(100, description="intervals a stage, N_s; auto: as many as `mesh_tolerance` needs")
    mesh_tolerance: Positive = Field(
        5e-3, le=0.1, description="nodes auto: by what part of J the cost may change with twice the nodes"
    )
    sample_time: Positive = Field(0.1, description="time between two solves [s]")
    pending_cost: NotNegative = Field(1.0, description="cost delta of every second a stage waits; 0 as printed")
    terminal_cost: NotNegative = Field(0.0, description="weight kappa of the last node's cost")
    zeta: Positive = Field(1e-3, description="what keeps the normalization from dividing by 0")
    normalization: Literal["nadir", "range", "none"] = Field("nadir", description="how costs are normalized, eq. (12)")
    discretization: Literal["exact", "euler"] = Field("exact", description="zero-order hold, or Euler as in eq. (20)")
    detection_margin: Number = Field(10.0, ge=1, description="tolerances within which a stage is predicted to end")
    multistart: Whole | None = Field(
        None, ge=1, le=100, description="guesses of the instants a window is solved from; default 1, the last plan's"
    )
    soft_limits: Flag | None = Field(
        None, description="limits on states give way where they must; default: where measurements are noisy"
    )
    known_delay: Whole = Field(
        0, ge=0, description="samples of `uncertainty.delay` that the controller foresees the state over"
    )
    offset_free: Flag = Field(False, description="estimate a constant disturbance and take it off the control")
    offset_gain: Positive = Field(0.3, le=1, description="offset_free: gain of the estimate's filter a sample")
    htmpc: HtmpcSpec = Field(HtmpcSpec(), description="what only the lexicographic controller needs")

    @property
    def uniform_nodes(self) -> int:
        """N_s where every stage is to have the same: as given, 100 as in the paper where it is automatic."""
        return 100 if self.nodes == "auto" else self.nodes


class SolverSpec(Choice):
    """The NLP back-end."""

    kind: Literal["sqp", "fatrop", "ipopt"] = Field("sqp", description="which solver")
    tolerance: Positive = Field(1e-8, le=1e-2, description="optimality tolerance of the scaled problem")
    max_iterations: Whole = Field(200, ge=1, description="iterations after which it gives up")
    iterations: Whole = Field(1, ge=1, description="sqp: iterations a sample from the shifted plan")
    deadline: Positive | None = Field(
        None, description="time after which a solve stops [s], sqp and ipopt; default none"
    )
    compiled: Flag = Field(True, description="sqp and plant rk4 as compiled C, where there is a compiler")


class PlantSpec(Choice):
    """The simulated physics."""

    kind: Literal["ideal", "rk4", "mujoco"] = Field("rk4", description="which physics")
    low_level_rate: Positive = Field(1000.0, description="rate of the computed-torque loop [Hz]")
    step: Positive | None = Field(None, description="step of the integrator [s]; default one tick of the loop")


class SkillWeights(SideBySide):
    """W_q or W_p by part, and W_r: one number for all controls, or numbers by part.

    In YAML the parts and `control` stand side by side.
    """

    parts: Mapping[Part, tuple[Size, ...]]
    control: _Control = Field(1.0, description="weights of the control, one number or numbers by part")


class SkillSpec(Spec):
    """A reusable cost and its limits. Paper eqs. (9), (10), (30), (31)."""

    space: Literal["joint", "task", "point"] = Field(
        description="joint: cost on Q, eq. (30); task: cost on xi, eq. (31); point: end-effectors point at points"
    )
    input: Literal["joint", "task"] = Field("joint", description="the control is the acceleration of Q or of xi")
    weights: SkillWeights = Field(description="weights by part, and of the control")
    limits: Mapping[Part, PartLimits] = Field({}, description="limits of this skill, within the task's")


class EndCondition(Spec):
    """When a stage is over, h of eq. (18): |error| <= tolerance, and where `velocity` is given |rate| <= velocity too.

    A coordinate is a part (`base`), `arms`, `all`, or one of a part (`base.x`, `arm_1.2`).
    """

    coordinates: Names[str] = Field(description="what must be at the target")
    tolerance: _Tolerance = Field(3e-3, description="how near, one number or numbers by part [m, rad]")
    velocity: Width | None = Field(None, description="how much at rest [m/s, rad/s]")
    hold: Seconds = Field(
        0.0, exclude_if=lambda hold: hold == 0, description="how long it must be met without a break [s]"
    )


class TrajectorySpec(SideBySide):
    """A target that moves: values by part at times since the stage began, linear between, the last one held.

    In YAML the parts and `times` stand side by side. Paper eq. (30), "along a desired trajectory".
    """

    times: tuple[Number, ...] = Field(min_length=2, description="times since the stage began, rising from 0 [s]")
    parts: Mapping[Part, tuple[Row, ...]]


def _way(value: object) -> str:
    """Tell a target that moves from one that does not."""
    if not isinstance(value, Mapping):
        return "trajectory" if isinstance(value, BaseModel) else "parts"
    rows = any(isinstance(item, list | tuple) and item and isinstance(item[0], list | tuple) for item in value.values())
    return "trajectory" if "times" in value or rows else "parts"


Target = Annotated[
    Annotated[_Coordinates, Tag("parts")] | Annotated[TrajectorySpec, Tag("trajectory")], Discriminator(_way)
]


class StageSpec(Spec):
    """One activation of a skill."""

    name: Name = Field(description="name of the stage")
    skill: _SkillName = Field(description="the skill to run, by name")
    priority: Positive = Field(1.0, description="relative importance omega, eq. (11)")
    target: Target = Field(
        description="joint: base pose and joint angles; task: base and end-effector poses; or a trajectory of them"
    )
    ends_when: EndCondition | None = Field(None, description="the condition that ends the stage, eq. (18)")
    at: Positive | None = Field(None, description="fixed time that ends the stage [s], instead of a condition")
    dwell: NotNegative = Field(0.0, description="shortest duration, that of a trajectory at least [s]")
    onset: _JointNames | None = Field(None, description="coordinates whose control marks the stage's actual start")
    angles: Literal["nearest", "exact"] = Field(
        "nearest", description="nearest: a target angle means the nearest equivalent one; exact: itself"
    )


class PrioritiesSpec(Spec):
    """Priorities of all stages from paired comparisons, instead of one at each stage; the first stage's is 1."""

    compare: tuple[_Comparison, ...] = Field(
        min_length=1, description="[a, b, r]: stage a is r times as important as stage b"
    )


class OnsetSpec(Choice):
    """What marks a stage's actual start: what it adds to the control, or how near the control is to its own optimum."""

    kind: Literal["control", "closeness"] = Field("control", description="what must reach the threshold")
    epsilon: Positive = Field(0.1, description="threshold, of a control [m/s^2, rad/s^2] or of closeness [1]")
    series: tuple[Positive, ...] = Field(
        (1e-4, 1e-3, 1e-2, 1e-1), description="further thresholds that are always evaluated"
    )


class LogSpec(Spec):
    """What the log holds beyond the samples."""

    ticks: Flag = Field(False, description="every tick of the low-level loop")
    plans: Flag = Field(True, description="every horizon's plan, for replay")
    shares: Flag = Field(True, description="each stage's share in the control, for some more solves a sample")


class TaskSpec(Spec):
    """A whole experiment."""

    name: Name = Field("", description="name of the task; default the file's stem")
    description: str = Field("", description="what it is, for people")
    robot: str = Field(min_length=1, description="a built-in robot's name, or a path relative to this file")
    initial: _Coordinates = Field(description="base pose and joint angles at the start [m, rad]")
    initial_velocity: _Coordinates = Field({}, description="their rates at the start [m/s, rad/s]; default rest")
    controller: ControllerSpec = Field(ControllerSpec(), description="the controller and its objective")
    solver: SolverSpec = Field(SolverSpec(), description="the NLP back-end")
    plant: PlantSpec = Field(PlantSpec(), description="the simulated physics")
    limits: Mapping[Part, PartLimits] = Field({}, description="limits of this task, within the robot's")
    skills: Mapping[Name, SkillSpec] = Field(min_length=1, description="the skills by name")
    stages: tuple[StageSpec, ...] = Field(min_length=1, description="the stages in their order")
    priorities: PrioritiesSpec | None = Field(
        None, description="priorities of all stages from paired comparisons, instead of one at each stage"
    )
    onset: OnsetSpec = Field(OnsetSpec(), description="what counts as the actual start of a stage")
    object: ObjectSpec | None = Field(None, description="the target object")
    uncertainty: UncertaintySpec = Field(UncertaintySpec(), description="what the controller does not know")
    monitors: tuple[MonitorSpec, ...] = Field((), description="what must hold for the mission to succeed")
    published: Mapping[_ControllerKey, PublishedRun] = Field(
        {}, description="published runs to compare with, by controller"
    )
    by_controller: Mapping[_ControllerKey, Mapping[str, Any]] = Field(
        {}, exclude=True, description="keys to change where a controller runs, by controller and path"
    )
    log: LogSpec = Field(LogSpec(), description="what the log holds beyond the samples")
    time_limit: Positive = Field(60.0, description="time after which the run is stopped [s]")
    seed: Whole = Field(0, ge=0, description="seed of everything random")

    @property
    def sees_the_state(self) -> bool:
        """Whether the controller decides from the true state."""
        return not (self.uncertainty.measures_with_noise or self.controller.known_delay)

    @property
    def limits_are_soft(self) -> bool:
        """Whether limits on the states may be violated at a cost."""
        soft = self.controller.soft_limits
        return self.uncertainty.measures_with_noise if soft is None else soft
