"""What a task is: skills and stages, how to run them, its object, and what the controller does not know.

Plain validated data in SI units.
"""

import re
from collections.abc import Mapping
from enum import StrEnum
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from psmpc_cli.specs import fields
from psmpc_cli.specs.controller import (
    CONTROLLERS,
    ControllerSpec,
    PlantSpec,
    SolverSpec,
    controller_faults,
    plant_faults,
    solver_faults,
)
from psmpc_cli.specs.document import choice, quoted
from psmpc_cli.specs.fields import (
    Choice,
    Fields,
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
    RoutesSpec,
    names_of_parts,
    pair_name,
)
from psmpc_cli.specs.object import NO_BODY, ObjectBody, ObjectSpec, complete
from psmpc_cli.specs.parts import (
    MOBILITIES,
    PLUMES,
    Context,
    Mobility,
    MobilityTraits,
    in_joint_space,
    stands_for,
)
from psmpc_cli.specs.priorities import comparison_faults
from psmpc_cli.specs.robots.robot import LimitsByPart, PartLimits, RobotSpec, limits_of_part, wider
from psmpc_cli.specs.stages import (
    PlumesOrDefault,
    SkillSpec,
    StageName,
    StageSpec,
    fixed_time_faults,
    mount_faults,
    repeated_fixed_times,
    skill_faults,
    unchanged_momenta,
)
from psmpc_cli.specs.uncertainty import StateNoiseSpec, UncertaintySpec

_Comparison = Annotated[tuple[StageName, StageName, fields.Positive], listed("a comparison [stage, stage, ratio]", 3)]


_StageKey = Annotated[str, one_of(lambda context: context.stages, "stage")]


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
    during: StageName = Field(description="the stage in which it must hold")
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
    """Yield errors for names of entries of a list that an earlier entry has."""
    first: dict[str, int] = {}
    for i, entry in enumerate(entries):
        if first.setdefault(entry.name, i) != i:
            found = f"{quoted(entry.name)} again (first at {key}[{first[entry.name]}])"
            yield (i, "name"), expected("a name of its own", found)


def _may_have_routes(routes: RoutesSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for routes of a robot that cannot follow them, or round nothing."""
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
    """Yield errors for obstacles with names that parts of the robot have, or the object."""
    taken = [*context.sizes, OBJECT]
    for i, obstacle in enumerate(obstacles):
        if obstacle.name in taken:
            yield (i, "name"), expected(f"a name other than {', '.join(taken)}", quoted(obstacle.name))


def _within_the_robots(limits: Mapping[str, PartLimits], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for limits of a task that are wider than its robot's."""
    yield from wider(limits, {"the robot's": context.robot_limits}, context.sizes)


def _monitor_faults(monitor: MonitorSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of a monitor, by which a task judges a measured quantity of a run.

    A monitor needs a bound. It is about frames of the robot that exist, two different ones for a distance and one for a
    speed; or, for a clearance, about none or two parts, see `_monitored_clearance_faults`.

    Args:
        monitor: A valid entry of the key `monitors` of a task.
        earlier_fields: The valid keys of the task before it.
        context: What is known of the robot and the rest of the task.

    Yields:
        Path of the value from the entry on, and its error.
    """
    bounds = ("above_start_at_most", "below_start_at_most", "at_most", "at_least")
    if all(getattr(monitor, bound) is None for bound in bounds):
        yield (), expected(f"one of {', '.join(bounds)}", "no bound", at_key=True)
    is_clearance = monitor.quantity == "clearance"
    # names that may be given; none where the robot is not valid, and then no name is wrong
    possible = names_of_parts(context) if is_clearance else list(context.sizes)
    unknown = [i for i, name in enumerate(monitor.of) if possible and name not in possible]
    yield from ((("of", i), flaw(choice(monitor.of[i], possible))) for i in unknown)
    if is_clearance:
        yield from _monitored_clearance_faults(monitor, earlier_fields)
        return
    wanted = 2 if monitor.quantity == "distance" else 1
    different = len(set(monitor.of))
    has_wanted_frames = different == len(monitor.of) == wanted
    if not unknown and not has_wanted_frames:
        yield ("of",), expected("two different frames for a distance, one for a speed")


def _monitored_clearance_faults(monitor: MonitorSpec, earlier_fields: Fields) -> RuleErrors:
    """Yield errors for a monitor of a clearance not about two parts, or of a stage in which nothing keeps clear."""
    if len(monitor.of) not in (0, 2):
        yield ("of",), expected("two parts for a clearance, or [] for all pairs")
    if not ("stages" in earlier_fields and "clearance" in earlier_fields):
        return
    of_stage = any(stage.clearance for stage in earlier_fields["stages"] if stage.name == monitor.during)
    if not (earlier_fields["clearance"] or of_stage):
        wanted = f'distance or speed, or "clearance" in the task or in {quoted(monitor.during)}'
        yield ("quantity",), expected(f"{wanted}: nothing keeps clear there")


def _uncertainty_faults(spec: UncertaintySpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors of a task's uncertainty: what the plant, the object or the controller make impossible.

    Errors are a delay beyond the horizon; anything but noise and delays with a plant without forces; an impulse after
    the time limit or on a fixed base; a payload without an object, or beside the mass of an object; a payload whose
    load is estimated along with masses; errors of an object without a mass; and shares of limits that there are not.

    Args:
        spec: The valid key `uncertainty` of a task.
        earlier_fields: The valid keys of the task before it.
        context: What is known of the robot and the rest of the task.

    Yields:
        Path of the value from `uncertainty` on, and its error.
    """
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
    if spec.carried.is_estimated and controller is not None and controller.masses == "estimated":
        wanted = "true or false: with controller.masses: estimated what grippers hold is found out, too"
        yield ("payload", "known"), expected(wanted)
    if spec.object and not has_mass:
        yield ("object",), expected('an "object" with a mass', "no such object", at_key=True)
    yield from (
        _force_share_faults(spec.force_share, earlier_fields["limits"], context) if "limits" in earlier_fields else ()
    )


def _force_share_faults(
    given: float | Mapping[str, tuple[float, ...]], limits: Mapping[str, PartLimits], context: Context
) -> RuleErrors:
    """Yield errors of `force_share`, the part of a force limit that actuators really give, where there is no limit.

    A share of 1 is no error anywhere.

    Args:
        given: One share for the whole robot, or shares by part.
        limits: Limits of the task.
        context: What is known of the robot, with its own limits.

    Yields:
        Path of the value from `uncertainty` on, and its error.
    """
    sources = (context.robot_limits, limits)
    # the parts with a force limit, from which the base is taken if nothing turns it
    limited = [part for part in context.sizes if any(limits_of_part(source, part, "force") for source in sources)]
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


_Monitor = Annotated[MonitorSpec, validated_by(_monitor_faults)]


def _prior_of_a_load(target_object: ObjectSpec, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for a prior of a load where none is to be found out."""
    controller = earlier_fields.get("controller")
    estimated = target_object.grasp is not None and target_object.grasp.is_estimated
    payload = context.file.value(("uncertainty", "payload", "known"))
    if controller and controller.load_prior and not (estimated or payload == fields.ESTIMATED):
        key = "object.grasp.known" if target_object.grasp else "uncertainty.payload.known"
        wanted = f"{key}: estimated, or no controller.load_prior"
        found = None if target_object.grasp else "an object without a grasp"
        yield ("grasp", "known") if target_object.grasp else (), expected(wanted, found, at_key=found is not None)


def _names_of_checks(monitors: tuple[MonitorSpec, ...], earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for monitors with the name of what is judged besides."""
    keeps_clear = earlier_fields.get("clearance") or any(stage.clearance for stage in earlier_fields.get("stages", ()))
    target_object = earlier_fields.get("object")
    taken = [NOTHING_TOUCHED] if keeps_clear else []
    taken += [check.value for check in ObjectCheck] if target_object and target_object.mass else []
    for i, monitor in enumerate(monitors):
        if monitor.name in taken:
            yield (i, "name"), expected(f"a name other than {', '.join(taken)}", quoted(monitor.name))


def _fixed_base_rests(velocity: Any, earlier_fields: Fields, context: Context) -> RuleErrors:
    """Yield errors for an initial velocity of a base that stands still."""
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
    plumes: PlumesOrDefault = Field(None, description=f"{PLUMES}; default ignored")
    initial: Annotated[Mapping[fields.Part, fields.Numbers], in_joint_space(required=True, positions=True)] = Field(
        description="base pose and joint coordinates at the start [m, rad]"
    )
    initial_velocity: Annotated[
        Mapping[fields.Part, tuple[fields.Coordinate, ...]], in_joint_space(), validated_by(_fixed_base_rests)
    ] = Field({}, description="their rates at the start [m/s, rad/s]; default rest")
    controller: Annotated[ControllerSpec, validated_by(controller_faults)] = Field(
        ControllerSpec(), description="the controller and its objective"
    )
    solver: Annotated[SolverSpec, validated_by(solver_faults)] = Field(SolverSpec(), description="the NLP back-end")
    plant: Annotated[PlantSpec, validated_by(plant_faults)] = Field(PlantSpec(), description="the simulated physics")
    time_limit: fields.Positive = Field(60.0, description="time after which the run is stopped [s]")
    limits: Annotated[LimitsByPart, validated_by(_within_the_robots)] = Field(
        {}, description="limits of this task, within the robot's"
    )
    skills: Annotated[Mapping[fields.Name, SkillSpec], Field(min_length=1), validated_by(skill_faults)] = Field(
        description="the skills by name"
    )
    stages: Annotated[
        tuple[StageSpec, ...],
        Field(min_length=1),
        validated_by(partial(_own_names, "stages")),
        validated_by(fixed_time_faults),
        validated_by(unchanged_momenta),
        validated_by(mount_faults),
        validated_by(repeated_fixed_times),
    ] = Field(description="the stages in their order")
    priorities: Annotated[PrioritiesSpec, validated_by(comparison_faults)] | None = Field(
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
    uncertainty: Annotated[UncertaintySpec, validated_by(_uncertainty_faults)] = Field(
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
        return self.body.grasp.is_estimated or self.uncertainty.carried.is_estimated

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

    def stages_on_mount(self, robot: RobotSpec) -> tuple[int, ...]:
        """Return the stages in which a mount holds the base of a robot that moves in others; none of a fixed robot."""
        held = [stage for stage in range(len(self.stages)) if not self.moved_by(stage, robot).moves]
        return tuple(held) if robot.moved_by.moves else ()

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

    def timeout_of(self, stage: int) -> float:
        """Return after which duration a stage that has not taken the object has missed it [s]; infinite without one."""
        retry = self.stages[stage].if_missed
        return np.inf if retry is None or retry.timeout is None else retry.timeout

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
