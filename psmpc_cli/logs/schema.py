"""The schema of a log: every dataset with its dimensions, units, meaning, and where its value comes from.

Writer, reader, CSV export and the tables of docs/log.md follow it: a new logged quantity is one row of `SCHEMA`.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from operator import attrgetter
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli.control.interface import Command
from psmpc_cli.logs.conditions import (
    ALWAYS,
    CLEARANCE,
    COMMANDED_AT_TICKS,
    DELAY,
    DISTURBANCE,
    FORCE_LIMITS,
    FREE_END,
    LEVELS,
    LOAD,
    MASSES,
    OBJECT,
    OBJECT_AT_TICKS,
    PAYLOAD,
    PLANS,
    PLUMES,
    ROUTES,
    SLIDING_JOINTS,
    SPATIAL,
    SPEED_RESERVE,
    TARGETS_CHANGE,
    TASK_INPUT,
    THRUSTERS,
    THRUSTERS_AT_TICKS,
    TICKS,
    TRIES,
    TRUE_STATE,
    UNCERTAIN,
    WHEELS,
    WHEELS_AT_TICKS,
    Condition,
    Recorded,
)
from psmpc_cli.ocp.window_record import record_of
from psmpc_cli.plant import Ticks
from psmpc_cli.plant.uncertainty import Contact
from psmpc_cli.specs.object import GRASP_LOADS
from psmpc_cli.specs.parts import ANGLE, LENGTH, PURE_NUMBER, units_of

FORMAT_VERSION = 5
"""Changes when a reader of the old format would misread the new one."""

OLDEST_FORMAT = 4
"""The oldest format that is read."""

RUN = "run"
COMPARISON = "comparison"
SWEEP = "sweep"
KEY_SWEEP = "sweep over keys"
PARETO = "pareto"
MONTE_CARLO = "monte-carlo"
"""Attribute `kind`: the log of one run (also where it is missing), a file of several, and the results of studies."""


@dataclass(frozen=True, eq=False)
class PendingSample:
    """What the metrics of a sample are computed from when they are first read; none is that of another sample.

    Attributes:
        command: What the controller decided.
        ticks: What the plant did until the next sample.
        presence: How much of each waiting stage is in the control, by its index.
        shares: Share of each stage in the applied control, by its index.
        state: True state (nq + n,), before anything is taken up or let go.
        in_force: The command that acts when the sample begins, an earlier one where commands are late.
        u: Accelerations that reached the robot over the ticks (M, n).
        contact: Effect of taking up or letting go at the sample; None without a payload.
        object_balance: Momentum and kinetic energy of an object with a mass at the end of the sample; 0 without one.
        expected_balance: Momentum and energy of robot and object then, by impulse and work since the start of the run.
    """

    command: Command
    ticks: Ticks
    presence: Mapping[int, float]
    shares: Mapping[int, float]
    state: np.ndarray
    in_force: Command
    u: np.ndarray
    contact: Contact | None
    object_balance: np.ndarray | float
    expected_balance: np.ndarray

    @property
    def commanded(self) -> np.ndarray:
        """Generalized forces that the law commanded at the ticks (M, n); those applied where a plant cuts none."""
        commanded = self.ticks.commanded
        return self.ticks.F if commanded is None else commanded


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample of the closed loop.

    Attributes:
        pending: What its metrics are computed from.
        number: Of the sample, from 0.
        stages: Number of stages of the task.
        measure: Computes the metrics of some samples of its run, by path of the log; changes nothing.
        measured: The metrics, once they are read.
    """

    pending: PendingSample
    number: int
    stages: int
    measure: Callable[[Sequence[PendingSample]], Sequence[Mapping[str, Any]]] = field(repr=False)
    measured: dict[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        return (
            f"<Sample {self.number} at {self.command.time:g} s: stage {self.command.stage.name}, {self.n} coordinates>"
        )

    @property
    def command(self) -> Command:
        """What the controller decided."""
        return self.pending.command

    @property
    def ticks(self) -> Ticks:
        """What the plant did until the next sample."""
        return self.pending.ticks

    @property
    def metrics(self) -> Mapping[str, Any]:
        """What was measured of both, by the paths of the log; values by stage are mappings from its index."""
        measure_together([self])
        return MappingProxyType(self.measured)

    @property
    def n(self) -> int:
        """Number of velocities."""
        return len(self.command.disturbance)

    @property
    def presence(self) -> Mapping[int, float]:
        """How much of each waiting stage is in the control, by its index."""
        return self.pending.presence

    @property
    def tick_numbers(self) -> np.ndarray:
        """Numbers of the sample's ticks (M,), counted from the start of the run."""
        ticks = len(self.ticks.F)
        return self.number * ticks + np.arange(ticks)


def measure_together(samples: Sequence[Sample]) -> None:
    """Compute those metrics of samples of one run that were not read yet: all at once takes less time, to the bit."""
    unmeasured = [sample for sample in samples if not sample.measured]
    if unmeasured:
        rows = unmeasured[0].measure([sample.pending for sample in unmeasured])
        for sample, row in zip(unmeasured, rows, strict=True):
            sample.measured.update(row)


Q_COORDINATE = "Q_coordinate"
"""Scale of Q (nq,) in the logs of spatial robots; `coordinate` is that of v (n,), and of a planar robot's Q too."""


@dataclass(frozen=True)
class Column:
    """One dataset of a log.

    Attributes:
        path: Its path in the file.
        units: SI units.
        long_name: What it is.
        value: Its row or rows, from a sample; None in a dataset that does not grow. Of a study's results: from a run.
        dtype: NumPy type, or `text`.
        dims: Paths of the dimension scales of its dimensions; a scale has its own path alone. The first is `time` in a
            dataset with a row a sample, `ticks/tick` in one with a row a tick; the others do not grow. See `layout`.
        only: The condition under which logs have it.
        unknown: Its value until another is known.
        since: Format version of the first logs that have it; in older ones it is unknown throughout.
    """

    path: str
    units: str
    long_name: str
    value: Callable[[Any], Any] | None = None
    dtype: str = "f8"
    dims: tuple[str, ...] = ()
    only: Condition = ALWAYS
    unknown: float = float("nan")
    since: int = OLDEST_FORMAT

    @property
    def is_scale(self) -> bool:
        """Whether other datasets have it as a dimension."""
        return self.dims == (self.path,)

    @property
    def ragged(self) -> bool:
        """Whether its rows have lengths of their own, which `<path>_length` holds."""
        return self.dims[1:] == (f"{self.path}_element",)

    @property
    def parts(self) -> "tuple[Column, ...]":
        """All datasets that the column consists of: itself, and two more if its rows have different lengths.

        These two are the lengths of its rows, and the scale of its second dimension, which is the index along a row.
        """
        if not self.ragged:
            return (self,)
        lengths = replace(
            self,
            path=f"{self.path}_length",
            units="1",
            long_name=f"number of elements in each row of {self.path}",
            dtype="i4",
            dims=("time",),
        )
        scale = self.dims[1]
        index = replace(lengths, path=scale, long_name=f"index into a row of {self.path}", dims=(scale,))
        return self, lengths, index


ValueReader = str | Callable[[Any], Any]
"""What reads a value of a sample: a function, or the path of an attribute such as `command.time`."""


def _reader(value: ValueReader) -> Callable[[Any], Any]:
    """Make a function of what reads a value of a sample."""
    return attrgetter(value) if isinstance(value, str) else value


def _metric(path: str) -> Callable[[Any], Any]:
    """Make the function that reads a metric of a sample, which is measured when it is first read."""
    return lambda sample: sample.metrics[path]


def _column(path: str, units: str, long_name: str, value: ValueReader = "", dtype: str = "f8", **more: Any) -> Column:
    """Define a dataset: read by `value`; without one a metric where it has a row a sample, or known from elsewhere."""
    measured = _metric(path) if more.get("dims", ())[:1] == ("time",) else None
    return Column(path, units, long_name, _reader(value) if value else measured, dtype, **more)


def _window(path: str, units: str, long_name: str, values: ValueReader) -> Column:
    """Define a dataset along all stages whose values a sample has for the stages in its window alone."""
    read = _reader(values)

    def row(sample: Sample) -> list[float]:
        sequence = sample.command.sequence
        values_in_window = read(sample)[: sequence.count]
        values_of_stages = [np.nan] * sample.stages
        values_of_stages[sequence.first : sequence.first + len(values_in_window)] = values_in_window
        return values_of_stages

    return Column(path, units, f"{long_name}; NaN outside the window", row, dims=("time", "stage"))


def _by_stage(path: str, units: str, long_name: str, values: ValueReader = "", **more: Any) -> Column:
    """Define a dataset along all stages whose values a sample has by stage index; by default a metric."""
    read = _reader(values or _metric(path))
    unknown = more.get("unknown", np.nan)

    def row(sample: Sample) -> list[float]:
        by_stage = read(sample)
        return [by_stage.get(stage, unknown) for stage in range(sample.stages)]

    return Column(path, units, long_name, row, dims=("time", "stage"), **more)


def _level(name: str, units: str, long_name: str, value: ValueReader, **more: Any) -> Column:
    """Define a dataset along all stages whose values are those of the levels of HTMPC, the current stage first."""
    read = _reader(value)

    def values(sample: Sample) -> Any:
        return dict(enumerate(map(read, sample.command.levels), start=sample.command.sequence.first))

    return _by_stage(f"levels/{name}", units, long_name, values, only=LEVELS, **more)


def _costs(sample: Sample) -> ArrayLike:
    """Return the costs of the stages in the window; none where the solve failed, since they are of no plan in force."""
    return () if "solve_failed" in sample.command.events else sample.command.solution.costs_of_stages


def _nodes_after_end(sample: Sample) -> int:
    """Return the intervals of a stage that the window has again after its planned end; 0 of other windows."""
    window = sample.command.solution.window
    return sum(window.nodes[window.count :])


def _optimum(level: Any) -> float:
    """Return the cost that a level minimizes, that of its last stage; NaN where it did not converge."""
    return float(level.costs_of_stages[-1]) if level.outcome.usable else np.nan


def _level_costs(sample: Sample) -> Mapping[int, float]:
    """Return the cost of each stage at the last level that converged."""
    costs = [level.costs_of_stages for level in sample.command.levels if level.outcome.usable]
    return dict(enumerate(costs[-1], start=sample.command.sequence.first)) if costs else {}


def _level_rises(sample: Sample) -> Mapping[int, float]:
    """Return by what part of it the cost of each stage is higher at the last level than at its own."""
    first = sample.command.sequence.first
    costs = _level_costs(sample)
    return {stage: costs[stage] / _optimum(sample.command.levels[stage - first]) - 1 for stage in costs}


def _event(name: str, long_name: str, only: Condition = ALWAYS) -> Column:
    """Define the dataset that flags the samples of an event of the controller."""
    return Column(f"events/{name}", "1", long_name, lambda s: name in s.command.events, "i1", ("time",), only)


def _plan(name: str, long_name: str, value: ValueReader) -> Column:
    """Define a dataset of vectors of the solves, whose lengths differ with the stages and nodes of the windows."""
    return _column(f"plan/{name}", "1", long_name, value, dims=("time", f"plan/{name}_element"), only=PLANS)


def _tick_of_object(dim: str, name: str, units: str, long_name: str, value: ValueReader) -> Column:
    """Define a dataset of the object with a mass, or of its grasps, with a row a tick."""
    path = f"ticks/{name}"
    dims = ("ticks/tick", dim)
    return _column(path, units, f"{long_name} at every tick", value, dims=dims, only=OBJECT_AT_TICKS)


def _load_of_grasp(number: int, load: str) -> Column:
    """Define the dataset of a load on the grasps."""
    what = f"largest filtered {load} until the next sample"
    return _by_gripper(
        f"grasp/{load}", GRASP_LOADS[load], what, lambda s: s.ticks.target_object.load[:, :, number].max(axis=0)
    )


def _tick_of_grasp_load(number: int, load: str) -> Column:
    """Define the dataset of a load on the grasps at every tick."""
    what = f"filtered {load} on each grasp"
    return _tick_of_object("gripper", load, GRASP_LOADS[load], what, lambda s: s.ticks.target_object.load[:, :, number])


def _scale(path: str, units: str, long_name: str, dtype: str = "text", only: Condition = ALWAYS) -> Column:
    """Define what runs along a dimension of other datasets."""
    return Column(path, units, long_name, None, dtype, (path,), only)


POSITION_UNITS = "m, rad"
VELOCITY_UNITS = "m/s, rad/s"
ACCELERATION_UNITS = "m/s^2, rad/s^2"
FORCE_UNITS = "N, N m"
OF_COORDINATES = (
    "coordinate",
    Q_COORDINATE,
    "pose_coordinate",
    "momentum",
    "object_coordinate",
    "object_axis",
    "grasp_axis",
    "grasp/measure",
)
"""Scales whose entries are lengths and angles, so that columns along them have units of their own."""

COLUMN_UNITS = "column_units"
"""Attribute of datasets along such a scale: the unit of each of their columns."""

EFFORT_UNITS = "m^2/s^3, rad^2/s^3"

PEAKS = {
    "base_force": ("N", "largest norm of the force on the base"),
    "base_torque": ("N m", "largest norm of the torque on the base"),
    "joint_torque": ("N m", "largest torque of a joint that turns"),
    "base_acceleration": ("m/s^2", "largest norm of the base's commanded linear acceleration"),
    "base_angular_acceleration": ("rad/s^2", "largest norm of the base's commanded angular acceleration"),
    "joint_acceleration": ("rad/s^2", "largest commanded acceleration of a joint that turns"),
}
SLIDING_PEAKS = {
    "sliding_force": ("N", "largest force of a joint that slides"),
    "sliding_acceleration": ("m/s^2", "largest commanded acceleration of a joint that slides"),
}
"""Units and meanings of the largest forces and commanded accelerations at ticks; the latter of joints that slide."""

NEW_TARGETS = "new_targets"
"""Attribute of logs of runs whose targets may change: those that did as JSON, with `time` [s], `stage` and `target`."""

KEEP_GOING = "keep_going"
"""Attribute of logs: whether a mission that could no longer succeed went on to its time limit."""

SLIDING = "sliding"
"""Attribute of logs: the names of the joint coordinates that are lengths, after commas."""

_sampled = partial(_column, dims=("time",))
_sampled_count = partial(_column, dims=("time",), dtype="i4")
_sampled_coordinates = partial(_column, dims=("time", Q_COORDINATE))
BASE_AXES = ", the base's along the axes of the inertial frame (its limits are along its own)"
"""What descriptions of generalized forces say of the force on the base."""

_sampled_velocities = partial(_column, dims=("time", "coordinate"))
_sampled_momentum = partial(_column, dims=("time", "momentum"))
_sampled_limited = partial(_column, only=FORCE_LIMITS)
_by_wheel = partial(_column, dims=("time", "wheel"), only=WHEELS)
_tick_of_wheels = partial(_column, dims=("ticks/tick", "wheel"), only=WHEELS_AT_TICKS)
_by_thruster = partial(_column, dims=("time", "thruster"), only=THRUSTERS)
_impulse_of_thrusters = partial(_column, dims=("time", "momentum"), only=THRUSTERS)
_sampled_clearance = partial(_column, dims=("time", "clearance/pair"), only=CLEARANCE)
_sampled_disturbance = partial(_column, dims=("time", "coordinate"), only=DISTURBANCE)
_ticks_coordinates = partial(_column, dims=("ticks/tick", Q_COORDINATE), only=TICKS)
_ticks_velocities = partial(_column, dims=("ticks/tick", "coordinate"), only=TICKS)
_object_pose = partial(_column, dims=("time", "object_coordinate"), only=OBJECT)
_object_twist = partial(_column, dims=("time", "object_axis"), only=OBJECT)
_by_gripper = partial(_column, dims=("time", "gripper"), only=OBJECT)
_of_object = partial(_column, only=OBJECT)
_of_stage = partial(_column, dims=("stage",))
_final_coordinates = partial(_column, dims=(Q_COORDINATE,))
_final_velocities = partial(_column, dims=("coordinate",))
_of_load = partial(_column, dims=("time",), only=LOAD)
_moments_of_load = partial(_column, dims=("time", "load/moment"), only=LOAD)
_of_estimated_body = partial(_column, dims=("time", "masses/body"), only=MASSES)
_of_arm = partial(_column, dims=("time", "masses/arm"), only=MASSES)
_of_monitor = partial(_column, dims=("monitors/name",))
_of_body = partial(_column, dims=("uncertainty/body",), only=UNCERTAIN)
_offset_of_body = partial(_column, dims=("uncertainty/body", "uncertainty/axis"), only=UNCERTAIN)
_miss_of_gripper = partial(_column, dims=("gripper", "grasp/measure"), only=OBJECT)
_reason_of_opening = partial(_column, dims=("gripper",), only=OBJECT, dtype="i1", unknown=-1)
_grasp_wrench = partial(_column, dims=("time", "grasp_axis"), only=OBJECT)
_level_metric = partial(_by_stage, only=LEVELS)
_level_flag = partial(_level, dtype="i1", unknown=-1)

SCHEMA = (
    # what runs along the dimensions
    _sampled("time", "s", "sample time", "command.time"),
    _column("ticks/tick", "1", "number of the tick, from 0", "tick_numbers", "i8", dims=("ticks/tick",), only=TICKS),
    _scale("coordinate", "1", "generalized coordinate"),
    _scale(Q_COORDINATE, "1", "coordinate of Q, with the attitude as unit quaternion", only=SPATIAL),
    _scale("pose_coordinate", "1", "pose coordinate"),
    _scale("stage", "1", "stage"),
    _scale("momentum", "1", "component of momentum"),
    _scale("stages/epsilon", ACCELERATION_UNITS, "threshold on a stage's presence that marks its actual start", "f8"),
    _scale("monitors/name", "1", "name of the monitor"),
    _scale("wheel", "1", "reaction wheel, by its number in the robot's file", only=WHEELS),
    _scale("uncertainty/body", "1", "body", only=UNCERTAIN),
    _scale("uncertainty/axis", "1", "axis of the body", only=UNCERTAIN),
    _scale("thruster", "1", "thruster, by its number in the robot's file", only=THRUSTERS),
    _scale("clearance/pair", "1", "two parts that keep clear of each other", only=CLEARANCE),
    _scale("clearance/point", "1", "coordinate of the nearest points of two parts", only=CLEARANCE),
    _scale("object_coordinate", "1", "coordinate of the object's pose", only=OBJECT),
    _scale("object_axis", "1", "component of the object's velocity", only=OBJECT),
    _scale("object/moment", "1", "principal moment of inertia", only=OBJECT),
    _scale("load/moment", "1", "principal moment of inertia of the load", only=LOAD),
    _scale("masses/body", "1", "body of the robot", only=MASSES),
    _scale("masses/arm", "1", "arm", only=MASSES),
    _scale("gripper", "1", "arm whose gripper takes the object", only=OBJECT),
    _scale("grasp_axis", "1", "component of a gripper's force and moment", only=OBJECT),
    _scale("grasp/measure", "1", "what a gripper has to be near in, to close", only=OBJECT),
    # a row a sample
    _sampled_coordinates(
        "state/Q",
        POSITION_UNITS,
        "generalized coordinates, as the controller saw them",
        lambda s: s.command.state[: -s.n],
    ),
    _sampled_velocities(
        "state/Qdot",
        VELOCITY_UNITS,
        "generalized velocities, as the controller saw them",
        lambda s: s.command.state[-s.n :],
    ),
    _column(
        "delay/expected",
        "s",
        "by how much later than the sample its command is expected to act, which is when the window begins",
        "command.delay",
        dims=("time",),
        only=DELAY,
    ),
    _column(
        "delay/deviation",
        "s",
        "standard deviation of that; 0 where it is given, infinite before anything tells of it",
        "command.delay_deviation",
        dims=("time",),
        only=DELAY,
    ),
    _of_load("load/mass", "kg", "mass that the load is taken to have", lambda s: s.command.load.numbers[0]),
    _of_load("load/mass_deviation", "kg", "standard deviation of that", lambda s: s.command.load.deviation[0]),
    _moments_of_load(
        "load/inertia", "kg m^2", "its principal moments of inertia, likewise", lambda s: s.command.load.numbers[1:]
    ),
    _moments_of_load(
        "load/inertia_deviation", "kg m^2", "standard deviations of those", lambda s: s.command.load.deviation[1:]
    ),
    _of_estimated_body(
        "masses/mass_factor", "1", "estimated mass over the described one", lambda s: s.command.inertia.mass_factor
    ),
    _of_estimated_body(
        "masses/mass_deviation", "1", "standard deviation of that", lambda s: s.command.inertia.mass_deviation
    ),
    _of_estimated_body(
        "masses/inertia_factor",
        "1",
        "estimated inertia over the described one",
        lambda s: s.command.inertia.inertia_factor,
    ),
    _of_estimated_body(
        "masses/inertia_deviation", "1", "standard deviation of that", lambda s: s.command.inertia.inertia_deviation
    ),
    _of_arm(
        "masses/held_mass",
        "kg",
        "mass that the low-level law counts with in the gripper, beside a known load",
        lambda s: s.command.law.parameters.held_mass,
    ),
    _of_arm("masses/held_inertia", "kg m^2", "its inertia, likewise", lambda s: s.command.law.parameters.held_inertia),
    _sampled_velocities("control/u", ACCELERATION_UNITS, "applied acceleration over the first tick"),
    _sampled_velocities(
        "force/F",
        FORCE_UNITS,
        "generalized force of the low-level controller at the sample" + BASE_AXES,
        lambda s: s.ticks.F[0],
    ),
    _sampled_velocities(
        "force/own_axes", FORCE_UNITS, "the same, the base's along its own axes, as its limits are", since=5
    ),
    _sampled_limited(
        "force/utilization",
        "1",
        "largest force that the law commands until the next sample over its limit, the base's along its own axes; NaN "
        "without one",
        dims=("time", "coordinate"),
    ),
    _sampled_limited(
        "force/saturated",
        "1",
        "share of the ticks until the next sample at which a force is cut at its limit",
        dims=("time",),
    ),
    _by_thruster(
        "thrusters/impulse", "N s", "impulse of each thruster until the next sample", "ticks.thrusters.impulses"
    ),
    _by_thruster(
        "thrusters/firings",
        "1",
        "how often each thruster begins to fire until the next sample",
        "ticks.thrusters.firings",
        dtype="i4",
    ),
    _impulse_of_thrusters(
        "thrusters/owed",
        "N s, N m s",
        "impulse that the law wanted of the thrusters until the next sample and that they have not given yet, along "
        "the base's own axes, about its origin",
        "ticks.thrusters.owed",
    ),
    _impulse_of_thrusters(
        "thrusters/refused",
        "N s, N m s",
        "impulse that it wanted and that no thrusts can give, likewise",
        "ticks.thrusters.refused",
    ),
    _column(
        "thrusters/shut",
        "1",
        "share of the ticks until the next sample at which each thruster is shut because of its plume",
        "ticks.thrusters.shut",
        dims=("time", "thruster"),
        only=PLUMES,
    ),
    _by_wheel(
        "wheels/momentum", "N m s", "angular momentum that each wheel stores, with the base's turn about its axis"
    ),
    _by_wheel("wheels/torque", "N m", "torque of its motor that is furthest from 0 until the next sample"),
    _sampled_clearance(
        "clearance/distance",
        "m",
        "smallest distance of two parts at the ticks until the next sample, negative where they overlap; NaN where "
        "they may touch",
    ),
    _sampled_clearance("clearance/margin", "m", "that distance less what the task keeps"),
    _column(
        "clearance/points",
        "m",
        "the points of both parts that are then nearest to each other, in the inertial frame",
        dims=("time", "clearance/pair", "clearance/point"),
        only=CLEARANCE,
    ),
    _column(
        "route/progress",
        "1",
        "share of the length of the current stage's route that the robot has passed or sees clear way to; NaN without "
        "a route",
        "command.route_progress",
        dims=("time",),
        only=ROUTES,
    ),
    _column("pose/xi", POSITION_UNITS, "poses of base and end-effectors", dims=("time", "pose_coordinate")),
    _sampled("pose/condition", "1", "condition number of J_C, lengths in metres", only=TASK_INPUT),
    _sampled_count("window/first", "1", "index of the current stage", "command.sequence.first"),
    _sampled_count("window/count", "1", "number of stages in the window", "command.sequence.count"),
    _window("window/instants", "s", "planned switch time that ends each stage", "command.switch_times"),
    _window("window/cost", "1", "normalized cost integral of each stage", _costs),
    _sampled_count(
        "window/basin",
        "1",
        "index of the guess whose plan was taken, 0 for the last plan; -1 if there was one guess only",
        "command.solution.basin",
    ),
    _window("window/nodes", "1", "intervals N_s of each stage", "command.solution.window.nodes"),
    _sampled_count(
        "window/nodes_after_end",
        "1",
        "intervals of the current stage after its planned end, where the window holds it on both sides; else 0",
        _nodes_after_end,
        only=FREE_END,
    ),
    _by_stage(
        "window/presence", ACCELERATION_UNITS, "how much a later stage acts on the control already; NaN if not computed"
    ),
    _by_stage("window/share", "1", "share of each stage in the applied control; NaN where it has none"),
    _event("appended", "a stage entered the window"),
    _event("postponed", "a stage was detected, but the window with it had no solution yet"),
    _event("solve_failed", "the solve failed, and the last plan was followed further"),
    _event("braking", "the plan was used up and the robot braked to rest"),
    _event("unmeasured", "the measured state was not finite, and the one that the plan predicts replaced it"),
    _event("load_dropped", "what had been found out of the load was given up for the prior", LOAD),
    _event(
        "near_singular",
        "J_C was too near a singular one for the law in task space, and that in joint space acted",
        only=TASK_INPUT,
    ),
    _event("retargeted", "a stage has another target since the sample before", only=TARGETS_CHANGE),
    _event("missed", "grippers report that they missed or lost the object, or took too long", only=TRIES),
    _event("returned", "the sequence returned to an earlier stage, for another try", only=TRIES),
    _by_stage(
        "window/ended_at",
        "s",
        "switch time of a stage that ended since the sample before; NaN of the others",
        lambda s: {switch.stage: switch.time for switch in s.command.switches},
        only=TRIES,
    ),
    _sampled("solver/status", "1", "outcome of the solve", lambda s: s.command.outcome.name.lower(), "S16"),
    _sampled("solver/warm", "1", "the solve started from the last solution, shifted", "command.solution.warm", "i1"),
    _sampled_count("solver/iterations", "1", "iterations of the solve", "command.iterations"),
    _sampled("solver/wall_time", "s", "wall time of the solve alone", "command.solve_time"),
    _sampled("solver/objective", "1", "objective J", "command.solution.J"),
    _window("normalization/nadir", "1", "divisor of each window stage's cost", "command.solution.window.scale"),
    _sampled("cost/current_stage", "1", "cost Lbar of the current stage"),
    _sampled_velocities(
        "margin/position", POSITION_UNITS, "smallest distance to a position limit until the next sample"
    ),
    _sampled_velocities(
        "margin/velocity", VELOCITY_UNITS, "smallest distance to a velocity limit until the next sample"
    ),
    _sampled_velocities("margin/planned_position", POSITION_UNITS, "the same of the planned position", since=5),
    _sampled_velocities("margin/planned_velocity", VELOCITY_UNITS, "the same of the planned velocity", since=5),
    _sampled_velocities(
        "margin/speed_reserve",
        VELOCITY_UNITS,
        "by how much the plan was to stay below a velocity limit, the larger of both sides",
        only=SPEED_RESERVE,
    ),
    _sampled("effort/control", EFFORT_UNITS, "T_s |dv / T_s|^2, dv the integral of u over the sample"),
    _sampled("effort/squared_acceleration", EFFORT_UNITS, "integral of |u|^2 until the next sample"),
    _sampled("effort/base_force", "N s", "integral of the norm of the base force"),
    _sampled("effort/base_torque", "N m s", "integral of the norm of the base torque, without that of wheels"),
    *(_sampled(f"peak/{name}", unit, f"{meaning} until the next sample") for name, (unit, meaning) in PEAKS.items()),
    *(
        _sampled(f"peak/{name}", unit, f"{meaning} until the next sample", only=SLIDING_JOINTS)
        for name, (unit, meaning) in SLIDING_PEAKS.items()
    ),
    _sampled_velocities("deviation/Q", POSITION_UNITS, "generalized coordinates at the next sample less the plan's"),
    _sampled_velocities("deviation/Qdot", VELOCITY_UNITS, "generalized velocities at the next sample less the plan's"),
    _by_stage("deviation/end", "1", "error of an end condition over its tolerance, where its stage ends"),
    _by_stage("deviation/end_noise", "1", "the same over its tolerance plus 2 sigma of its measurement"),
    _sampled_momentum("balance/momentum", "N s, N m s", "momentum less the integral of the external wrench"),
    _sampled("balance/energy", "J", "kinetic energy less the work of the generalized forces"),
    _level("objective", "1", "optimum of the cost each level minimizes; NaN where none converged", _optimum),
    _level_metric("levels/cost", "1", "cost of each level's stage at the last level that converged", _level_costs),
    _level_metric(
        "levels/rise",
        "1",
        "by what part of its optimum the cost of each level is higher at the last level that converged",
        _level_rises,
    ),
    _level("wall_time", "s", "wall time of each level's solve alone; NaN where there was none", "wall_time"),
    _level_flag("solved", "1", "1 if the level converged, 0 if not, -1 if there was none", "outcome.usable"),
    _sampled_coordinates("state/Q_true", POSITION_UNITS, "generalized coordinates, true", only=TRUE_STATE),
    _sampled_velocities("state/Qdot_true", VELOCITY_UNITS, "generalized velocities, true", only=TRUE_STATE),
    _sampled("payload/held", "1", "whether the grippers hold the payload from the sample on", dtype="i1", only=PAYLOAD),
    _sampled("payload/energy", "J", "kinetic energy gained by taking it up or letting it go", only=PAYLOAD),
    _sampled_disturbance(
        "control/disturbance", ACCELERATION_UNITS, "estimated disturbance, taken off the control", "command.disturbance"
    ),
    _object_pose("object/pose", POSITION_UNITS, "pose of the object", lambda s: s.ticks.target_object.pose[0]),
    _object_twist(
        "object/velocity",
        VELOCITY_UNITS,
        "velocity of the object, angular about its own axes",
        lambda s: s.ticks.target_object.v[0],
    ),
    *(_load_of_grasp(number, load) for number, load in enumerate(GRASP_LOADS)),
    _by_gripper("grasp/closed", "1", "whether each gripper is closed", lambda s: s.ticks.target_object.closed[0], "i1"),
    _grasp_wrench(
        "grasp/wrench",
        FORCE_UNITS,
        "force and moment of each gripper on the object, at the gripper, in the inertial frame",
        lambda s: s.ticks.target_object.wrench[0].ravel(),
    ),
    _plan("guess", "plan it started from: switch times, states, accelerations", "command.solution.guess.flat"),
    _plan("guess_multipliers", "multipliers each solve started from; may be empty", "command.solution.guess_duals"),
    _plan(
        "parameters",
        "how long the stage has lasted, how long its end still has to hold, then priorities, offsets, scales and signs",
        lambda sample: record_of(sample.command.solution.window),
    ),
    _plan("solution", "solution of each solve, as plan/guess", "command.solution.plan.flat"),
    # a row a tick
    _column("ticks/time", "s", "tick time", lambda s: s.ticks.time[:-1], dims=("ticks/tick",), only=TICKS),
    _ticks_coordinates(
        "ticks/Q", POSITION_UNITS, "generalized coordinates at every tick", lambda s: s.ticks.states[:-1, : -s.n]
    ),
    _ticks_velocities(
        "ticks/Qdot", VELOCITY_UNITS, "generalized velocities at every tick", lambda s: s.ticks.states[:-1, -s.n :]
    ),
    _ticks_velocities("ticks/F", FORCE_UNITS, "generalized force held from the tick on" + BASE_AXES, "ticks.F"),
    _ticks_velocities(
        "ticks/commanded",
        FORCE_UNITS,
        "generalized force that the law commands, before it is cut at its limits" + BASE_AXES,
        "pending.commanded",
        only=COMMANDED_AT_TICKS,
    ),
    _column(
        "ticks/thrust",
        "N",
        "thrust of each thruster from the tick on",
        "ticks.thrusters.thrusts",
        dims=("ticks/tick", "thruster"),
        only=THRUSTERS_AT_TICKS,
    ),
    _tick_of_wheels(
        "ticks/wheel_momentum",
        "N m s",
        "angular momentum that each wheel stores at every tick",
        lambda s: s.ticks.wheels.momentum[:-1],
    ),
    _tick_of_wheels("ticks/motor_torque", "N m", "torque of its motor from the tick on", "ticks.wheels.torque"),
    _tick_of_object(
        "object_coordinate",
        "object_pose",
        POSITION_UNITS,
        "pose of the object",
        lambda s: s.ticks.target_object.pose[:-1],
    ),
    *(_tick_of_grasp_load(number, load) for number, load in enumerate(GRASP_LOADS)),
    # what does not grow
    _of_stage("stages/name", "1", "name of the stage", dtype="text"),
    _of_stage("stages/priority", "1", "priority omega of the stage"),
    _of_stage(
        "stages/switch_time",
        "s",
        "switch time that ends the stage, the last time where it comes again; NaN if it never ended",
    ),
    _of_stage("stages/actual_start", "s", "first sample at which the stage acts on the control; NaN if never"),
    _of_stage("stages/early", "1", "whether it acts before the stage before it has ended", dtype="i1", unknown=0),
    _column("stages/actual_start_by_epsilon", "s", "actual start for each threshold", dims=("stage", "stages/epsilon")),
    # not `time`: netCDF readers would take it for the dimension of that name
    _column("final/end_time", "s", "end of the run; NaN if it was stopped before"),
    _final_coordinates("final/Q", POSITION_UNITS, "generalized coordinates at the end of the run"),
    _final_velocities("final/Qdot", VELOCITY_UNITS, "generalized velocities at the end of the run"),
    _column(
        "final/xi", POSITION_UNITS, "poses of base and end-effectors at the end of the run", dims=("pose_coordinate",)
    ),
    _final_coordinates(
        "final/Q_true", POSITION_UNITS, "generalized coordinates at the end of the run, true", only=TRUE_STATE
    ),
    _final_velocities(
        "final/Qdot_true", VELOCITY_UNITS, "generalized velocities at the end of the run, true", only=TRUE_STATE
    ),
    _of_monitor("monitors/held", "1", "1 if the monitor held, 0 if not, -1 if not known", dtype="i1", unknown=-1),
    _of_monitor("monitors/margin", "m, m/s, 1", "smallest distance of the signal to its bounds, in its unit"),
    _of_monitor("monitors/unit", "1", "unit of the signal and its margin", dtype="text"),
    _of_object("object/mass", "kg", "true mass of the object"),
    _of_object("object/inertia", "kg m^2", "its true inertia", dims=("object/moment",)),
    _of_object("object/left_at", "s", "time at which the first gripper opened in the last try; NaN if none did"),
    _of_object("object/left_pose", POSITION_UNITS, "pose of the object then", dims=("object_coordinate",)),
    _of_object("object/left_velocity", VELOCITY_UNITS, "velocity of the object then", dims=("object_axis",)),
    _of_object("final/object_pose", POSITION_UNITS, "pose of the object at the end", dims=("object_coordinate",)),
    _of_object("final/object_velocity", VELOCITY_UNITS, "its velocity at the end", dims=("object_axis",)),
    _of_object(
        "grasp/closed_at", "s", "time at which each gripper closed in the last try; NaN if never", dims=("gripper",)
    ),
    _miss_of_gripper(
        "grasp/missed_by",
        f"{POSITION_UNITS}, {VELOCITY_UNITS}",
        "how far each gripper was from its grasp when it was to close, in the last try",
    ),
    _of_object(
        "grasp/opened_at", "s", "time at which each gripper opened in the last try; NaN if never", dims=("gripper",)
    ),
    _reason_of_opening(
        "grasp/lost", "1", "why each gripper opened: 1 a load beyond its strength, 0 to let go, -1 if it did not"
    ),
    _of_body("uncertainty/mass_factor", "1", "true mass over the described one"),
    _of_body("uncertainty/inertia_factor", "1", "true inertia over the described one"),
    _offset_of_body("uncertainty/centre_of_mass", "m", "offset of the true centre of mass from the described one"),
)
"""Every dataset of a log, scales first."""

MOMENTUM = {2: ("x", "y", "angular"), 3: ("x", "y", "z", "angular_x", "angular_y", "angular_z")}
"""Components of the momentum in the plane and in space: linear, and angular about the inertial origin."""


def sliding_of(attributes: Mapping[str, Any]) -> list[str]:
    """Return the names of the joint coordinates that are lengths, from the attributes of a log."""
    return [name for name in str(attributes.get(SLIDING, "")).split(", ") if name]


def units_of_columns(column: Column, names: Sequence[str], sliding: Collection[str]) -> list[str] | None:
    """Return the unit of each column of a dataset that mixes lengths and angles, such as Q.

    Args:
        column: The dataset. Its `units` are either two, of lengths and of angles ("m, rad"), or one for each of its
            columns, separated by commas.
        names: Names of its columns: coordinates such as `base.x`, or names of joints.
        sliding: Names of the joint coordinates that are lengths.

    Returns:
        The units in the order of the columns; None for a dataset whose columns all have the same unit.
    """
    units = column.units.split(", ")
    if column.is_scale or len(units) == 1 or column.dims[-1:] not in [(dim,) for dim in OF_COORDINATES]:
        return None
    if len(units) == len(names):
        return units
    unit_of_lengths, unit_of_angles = units
    by_kind = {LENGTH: unit_of_lengths, ANGLE: unit_of_angles, PURE_NUMBER: "1"}  # no unit: parts of a quaternion
    parts_and_axes = (name.rpartition(".") for name in names)  # "base.x" is the axis x of the part base
    return [by_kind[units_of(part, axis, sliding)] for part, _, axis in parts_and_axes]


def conditions_of(recorded: Recorded) -> frozenset[Condition]:
    """Return the conditions that hold of what is recorded; its log has the datasets that have one of them."""
    return frozenset(condition for condition in {column.only for column in SCHEMA} if condition.holds(recorded))


def condition_of(path: str) -> Condition | None:
    """Return the condition under which logs have a dataset; None where no log has one of this path."""
    return next((part.only for column in SCHEMA for part in column.parts if part.path == path), None)


@lru_cache
def layout(Q_has_a_scale: bool) -> tuple[Column, ...]:
    """Return the datasets of a log.

    Args:
        Q_has_a_scale: Whether Q has a scale of its own, as in space, or is along `coordinate` as v is.
    """
    if Q_has_a_scale:
        return SCHEMA
    dims = [tuple("coordinate" if dim == Q_COORDINATE else dim for dim in column.dims) for column in SCHEMA]
    along_v = (replace(column, dims=own) for column, own in zip(SCHEMA, dims, strict=True))
    return tuple(column for column in along_v if column.path != Q_COORDINATE)


def columns(along: str, Q_has_a_scale: bool = True) -> tuple[Column, ...]:
    """Return the datasets along a dimension, without scales.

    Args:
        along: Path of the scale of their first dimension; empty for the datasets that do not grow.
        Q_has_a_scale: As for `layout`.
    """
    return tuple(
        column
        for column in layout(Q_has_a_scale)
        if not column.is_scale and (column.dims[:1] == (along,) if along else column.value is None)
    )
