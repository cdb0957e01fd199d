"""The summary of a run: what is computed from the datasets of its log, given by their paths."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from psmpc_cli.control.identification.delay import LONGEST as LONGEST_DELAY
from psmpc_cli.control.identification.delay import STEP
from psmpc_cli.logs.schema import PEAKS, SLIDING_PEAKS, sliding_of
from psmpc_cli.logs.verdicts import (
    Arrays,
    Verdict,
    largest_loads,
    object_when_let_go,
    position_of,
    samples_of_returns,
    summarize_clearance,
    verdicts,
)
from psmpc_cli.ocp.problem import Problem, in_own_chart
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.actuators.thrusters import Thrusters
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.specs.parts import CoordinateUnits
from psmpc_cli.specs.robots.robot import Limits
from psmpc_cli.specs.task import PublishedRun, TaskSpec

NO_SHARE = 0.01
"""A stage with no larger share in the control than this does not visibly act on it [1]."""


EXCEEDED = 1e-6
"""How far beyond a limit, as a part of it, counts as exceeding it: less is rounding."""

WARNED_OF = 1e-3
"""How far beyond a limit, as a part of it, is worth a warning: samples and ticks leave a little less."""

FAR_BEYOND = 1.05
"""Commanded force over its limit beyond which more is cut than small peaks at the limit [1]."""

LEVEL_ACCURACY = 1e-5
"""By what part of a cost solvers leave its bound in a level violated."""


@dataclass(frozen=True)
class StageSummary:
    """When a stage of a run started and ended [s], with published values to compare with; NaN where unknown.

    Attributes:
        actual_start: A start that `early_starts` does not count is the switch time of the stage before.
        duration: Time from the switch time of the stage before to its own [s]; of a stage to which the sequence
            returned, from then on.
        tries: How often the sequence came to it, 1 where it never returned to an earlier stage; the times are of the
            last try.
    """

    name: str
    priority: float
    actual_start: float
    published_start: float
    early: bool
    switch_time: float
    published_switch: float
    duration: float
    tries: int


@dataclass(frozen=True)
class SolveSummary:
    """Statistics of the solves of a run, of all windows or of those with a switch.

    Attributes:
        count: Number of solves.
        median, p95, p99, largest: Quantiles of their wall times, and the largest one [s].
        iterations: Median of their iterations.
    """

    count: int
    median: float
    p95: float
    p99: float
    largest: float
    iterations: float


@dataclass(frozen=True)
class LimitSummary:
    """The smallest margin to a kind of limit over all ticks of a run.

    Attributes:
        kind: `position` or `velocity`.
        coordinate: The coordinate that comes nearest to its limit.
        margin: Its distance from the limit.
        unit: Of the margin.
        relative: The margin over half the distance of the two limits.
    """

    kind: str
    coordinate: str
    margin: float
    unit: str
    relative: float


@dataclass(frozen=True)
class Largest:
    """The largest value of a quantity.

    Attributes:
        value: The value.
        where: The coordinate, its velocity, or the stage.
        time: When it occurred [s], or the time of the sample after which it was measured.
        sample: The sample in whose horizon, or after whose state, it occurred.
        unit: Of the value.
        planned: Of a violated limit, by how much the plan of that sample violates it, in the same unit; NaN of other
            quantities.
    """

    value: float
    where: str
    time: float
    sample: int
    unit: str = "1"
    planned: float = np.nan


class CaptureSummary:
    """What became of an object with a mass, in the last try; NaN where it never came to that.

    Attributes:
        closed_at: When its last gripper closed [s].
        missed_by: Largest distance [m], angle [rad], velocity [m/s] and angular velocity [rad/s] of a gripper from its
            grasp when it was to close.
        loads: Largest filtered loads on a grasp, by `GRASP_LOADS` [N, N, N m].
        lost: Arms whose grippers were pulled open.
        left_at: When the first gripper opened [s].
        distance, angle: Of the object from its destination then [m], [rad]; of one that is held to the end, at the end.
        speed: Of the object then [m/s].
    """

    def __init__(self, task: TaskSpec, arrays: Arrays) -> None:
        """Read from the datasets of a log when and how the object was taken, lost and let go.

        Args:
            task: The task, with the destination of the object.
            arrays: Datasets of the log by path. Those of grasps are of the last try to take the object.
        """
        _, pose, v = object_when_let_go(task, arrays)
        space = space_of_pose(len(pose))
        linear = slice(space.dimension)
        angular = slice(space.dimension, None)
        destination = task.body.destination
        # how far the object was from its destination when it was let go, or at the end if it is held so long
        error = np.full(len(v), np.nan) if destination is None else space.pose_error(pose, destination.pose)
        # when the last gripper closed, and the largest errors and loads of any
        self.closed_at = float(np.max(arrays["grasp/closed_at"]))
        self.missed_by: tuple[float, ...] = tuple(arrays["grasp/missed_by"].max(axis=0).tolist())
        self.loads = largest_loads(arrays)
        self.lost: tuple[str, ...] = tuple(arrays["gripper"][arrays["grasp/lost"] == 1].tolist())
        self.left_at = float(arrays["object/left_at"])
        self.distance = float(np.linalg.norm(error[linear]))
        self.angle = float(np.linalg.norm(error[angular]))
        self.speed = float(np.linalg.norm(v[linear]))

    def __repr__(self) -> str:
        return f"CaptureSummary({', '.join(f'{name}={value!r}' for name, value in vars(self).items())})"


@dataclass(frozen=True)
class ThrusterSummary:
    """What thrusters did over a run.

    Attributes:
        impulse: Sum of their impulses [N s].
        firings: How often they began to fire, all together.
        propellant: Mass of what they used [kg]; NaN where a specific impulse is not known.
        owed: The largest impulse that they had not given at a sample: of force [N s] and of torque [N m s].
        refused: Sums over the run of the impulses that no thrusts can give, likewise.
        shut: For how long thrusters were shut because of their plumes, by name, those that were [s]; None where no
            stage avoids plumes.
    """

    impulse: float
    firings: int
    propellant: float
    owed: tuple[float, float]
    refused: tuple[float, float]
    shut: Mapping[str, float] | None = None


@dataclass(frozen=True)
class WheelSummary:
    """What reaction wheels did over a run.

    Attributes:
        momentum: The angular momentum at a sample that was the largest part of what its wheel may store [1], which
            wheel it is of, and when.
        torque: The motor torque that was the largest part of what its motor can give [1], likewise.
    """

    momentum: Largest | None
    torque: Largest | None


@dataclass(frozen=True)
class FloatingStage:
    """A stage in which nothing pushes the base, at its samples.

    Attributes:
        name: Its name.
        linear, angular: Largest changes of the momentum of robot and wheels since its first sample [N s], and about the
            inertial origin [N m s]. What an object that is taken hands over, or a blow, is part of it.
        distance, angle: How far the base is at its last sample from where it was at the first [m], [rad].
    """

    name: str
    linear: float
    angular: float
    distance: float
    angle: float


class Summary:
    """The results of a run.

    Attributes:
        ended: The run came to an end; it was neither killed nor interrupted.
        completed: The last stage met its end condition.
        succeeded: It did, and every monitor held; None where it is not judged: it did, no monitor was broken, and of
            one at least it is not known whether it held.
        reason: Why the run stopped.
        duration: Simulated time [s].
        stages: By stage.
        sample_time: Of the controller [s].
        solves, switching_solves: All solves, and those of windows with a switch.
        missed: Samples whose solve took longer than the sample time.
        returned_at: When the sequence returned to an earlier stage, because the object was missed or lost [s].
        appended, postponed, failed_solves: How often each happened.
        unmeasured: Samples whose state was not measured, at least in part.
        basins: How often another guess of the switch times than the last plan's won; None if there was no other.
        unsolved_levels: Levels of a lexicographic controller that did not converge; None under any other.
        level_rise: Largest part by which later levels raised the cost of an earlier one; NaN without levels.
        raised_levels: How many they raised further than the tolerance allows; None where not costs are kept.
        limits: The tightest position and velocity margins.
        control_effort: Sum over samples of T_s |dv / T_s|^2, dv the integral of the commanded accelerations.
        squared_acceleration: Integral of |u|^2, which grows where the last interval before a switch shrinks.
        base_force, base_torque: Integrals of their norms [N s], [N m s].
        peaks: Largest forces and commanded accelerations at a tick, by `PEAKS` and `SLIDING_PEAKS`; NaN where there are
            none, or they are not known.
        tightest_force: The largest force that the law commanded over its limit [1], which coordinate it is of, and the
            sample in which it was; None where forces have no limits, or are not known.
        saturated: Share of the time in which a force was cut at its limit [1]; NaN where forces have no limits.
        far_beyond: Share of the samples in which a force was commanded beyond `FAR_BEYOND` of its limit [1]; NaN where
            forces have no limits.
        limits_dynamics: Some stage has a limit of forces or accelerations, or the base has thrusters.
        wheels: What reaction wheels did; None of a robot without any.
        floating: Stages in which nothing pushed the base, in their order.
        thrusters: What thrusters did; None where none fire.
        variation_base_position, variation_base_angle, variation_joints, variation_sliding: Total variation of the
            control at the samples, sum_k |u_{k+1} - u_k|, over the coordinates of each group [m/s^2], [rad/s^2], of
            joints that turn [rad/s^2] and of those that slide [m/s^2].
        momentum_error, energy_error: Largest drift of the balances of momentum and energy.
        monitors: The verdicts.
        distances: Distance between the first two end-effectors at the end of each stage [m]; NaN with one arm.
        off_plan: Largest deviations of a position and of a velocity at a sample from the prediction of the plan before.
        largest_condition: The largest condition number of J_C at a sample of a stage with `input: task` [1]; None
            without such a stage.
        near_singular: Samples of such stages at which it was too large for the law in task space.
        beyond_limits: Largest violations of a position and of a velocity limit at a tick, where there are any.
        closing_samples: The samples in which a gripper closes, numbered from 0.
        beyond_limits_elsewhere: The largest violations outside these samples, where there are any.
        compiled: Whether solver and plant ran as compiled code.
        delay: After how long commands were expected to act at the end of the run, and the standard deviation of that
            [s]; None where `controller.delay` is 0, or nothing told of a delay.
        delay_is_cut_off: The delay that was found out came to the longest one that is tried.
        unknown_delay: The delay of the task that was not looked for, since thrusters fire in pulses [s].
        load: Mass that a load was found to have when it was held last, and the standard deviation of that [kg]; None
            where it is not found out.
        end_condition: Largest error over tolerance where a stage ended; None without one.
        end_errors: Error of the last stage's end condition over its tolerance at the end, of the state seen and of the
            true state; None without noise.
        capture: What became of an object with a mass; None without one.
        clearance: How near parts came that keep clear; None where none do, or where it is not known.
    """

    def __init__(self, arrays: Arrays, attributes: Mapping[str, Any], problem: Problem) -> None:
        """Summarize a run from the datasets and attributes of its log, and the problem it solved."""
        self._read_outcome(arrays, attributes, problem)
        self._read_solves(arrays, problem)
        self._read_efforts(arrays, attributes)
        self._read_actuators(arrays, problem)
        self._read_deviations(arrays, problem)
        self._read_estimates(arrays, problem)
        self.limits = _tightest_limits(arrays, problem.stages, problem.model.units)
        self.distances = _distances_of_end_effectors(arrays)
        self.capture = CaptureSummary(problem.spec, arrays) if "grasp/pull" in arrays else None
        self.clearance = summarize_clearance(arrays)

    def _read_outcome(self, arrays: Arrays, attributes: Mapping[str, Any], problem: Problem) -> None:
        """Read how the run ended, whether the mission succeeded, and when each stage ended.

        It sets attributes that `Summary` describes.

        Args:
            arrays: Datasets of the log by path.
            attributes: Attributes of the log.
            problem: The problem that the run solved.
        """
        spec = problem.spec
        time = arrays["time"]
        end = float(arrays["final/end_time"])  # NaN of a run that was killed or interrupted
        self.compiled = bool(attributes.get("compiled", False))
        self.ended = bool(np.isfinite(end))
        self.completed = bool(attributes["finished"])
        self.monitors = verdicts(spec, arrays)
        self.succeeded = _succeeded(self.completed, self.monitors)
        self.reason = str(attributes["end_reason"]) or "the run was killed, or goes on"
        self.duration = end if self.ended else float(time[-1]) if len(time) else 0.0
        # times that the paper gives for this controller, to compare with
        published = spec.published.get(str(attributes["controller"]), PublishedRun())
        self.stages = _summarize_stages(arrays, spec.onset.epsilon, published)
        self.returned_at: tuple[float, ...] = tuple(time[list(samples_of_returns(arrays))].tolist())

    def _read_solves(self, arrays: Arrays, problem: Problem) -> None:
        """Read how the solves went: their times, events, local optima, and the priority levels of HTMPC.

        HTMPC solves at each sample for one stage after the other, its levels; a later level has to keep the costs of
        the earlier ones. The attributes that are set are described in `Summary`.

        Args:
            arrays: Datasets of the log by path. `window/basin` is the number of the guess from which the best optimum
                was found: 0 of the last plan, -1 where no other was tried. `levels/rise` is by what part of it later
                levels raised the cost of a stage.
            problem: The problem that the run solved.
        """
        controller = problem.spec.controller
        samples = len(arrays["time"])
        self.sample_time = controller.sample_time
        self.solves = _summarize_solves(arrays, is_chosen=np.ones(samples, bool))
        has_switch = np.asarray(np.isfinite(arrays["window/instants"]).any(axis=1))
        self.switching_solves = _summarize_solves(arrays, is_chosen=has_switch)
        self.missed = int(np.sum(arrays["solver/wall_time"] > controller.sample_time))
        # samples at which a stage entered the window, or was seen but could not be solved for yet
        self.appended = int(arrays["events/appended"].sum())
        self.postponed = int(arrays["events/postponed"].sum())
        self.failed_solves = int(arrays["events/solve_failed"].sum())
        self.unmeasured = int(arrays["events/unmeasured"].sum())
        chosen_guess = arrays["window/basin"]
        self.basins = int(np.sum(chosen_guess > 0)) if np.any(chosen_guess >= 0) else None
        levels_solved = arrays.get("levels/solved")  # 1 where a level converged, 0 where not, -1 where there was none
        self.unsolved_levels = None if levels_solved is None else int(np.sum(levels_solved == 0))
        level_rise = arrays.get("levels/rise", np.full((samples, 0), np.nan))
        self.level_rise = float(np.nanmax(level_rise, initial=-np.inf)) if np.isfinite(level_rise).any() else np.nan
        keeps_costs = controller.traits.has_levels and controller.htmpc.constraint == "cost"
        is_raised = level_rise > controller.htmpc.tolerance + LEVEL_ACCURACY
        self.raised_levels = int(np.sum(is_raised)) if keeps_costs else None

    def _read_efforts(self, arrays: Arrays, attributes: Mapping[str, Any]) -> None:
        """Read what controls and forces the run took, how near forces came to limits, and how controls varied.

        It sets attributes that `Summary` describes.

        Args:
            arrays: Datasets of the log by path. `force/utilization` (K, n) is the commanded force over its limit;
                `force/saturated` (K,) is the fraction of a sample's ticks in which the plant cut a force at its limit.
            attributes: Attributes of the log, which name the joints that slide.
        """
        time = arrays["time"]
        coordinates = tuple(arrays["coordinate"])
        self.control_effort = float(arrays["effort/control"].sum())
        self.squared_acceleration = float(arrays["effort/squared_acceleration"].sum())
        self.base_force = float(arrays["effort/base_force"].sum())
        self.base_torque = float(arrays["effort/base_torque"].sum())
        # datasets that a log lacks, of a robot without sliding joints or without limits of forces, count as unknown
        peaks = {name: arrays.get(f"peak/{name}", np.array([np.nan])) for name in (*PEAKS, *SLIDING_PEAKS)}
        self.peaks = {name: float(np.max(values, initial=0.0)) for name, values in peaks.items()}
        utilization = arrays.get("force/utilization", np.full((len(time), len(coordinates)), np.nan))
        saturated = arrays.get("force/saturated", np.zeros(0))  # empty where forces have no limits
        self.tightest_force = largest(utilization, coordinates, time)
        self.saturated = float(np.mean(saturated)) if len(saturated) else np.nan
        self.far_beyond = float(np.mean((utilization > FAR_BEYOND).any(axis=1))) if len(saturated) else np.nan
        variation_of_coordinates = np.abs(np.diff(arrays["control/u"], axis=0)).sum(axis=0)  # total variation (n,)
        (
            self.variation_base_position,
            self.variation_base_angle,
            self.variation_joints,
            self.variation_sliding,
        ) = variation_by_group(variation_of_coordinates, coordinates, sliding_of(attributes))

    def _read_actuators(self, arrays: Arrays, problem: Problem) -> None:
        """Read what thrusters and wheels did, and where nothing acted on the base."""
        self.wheels = _summarize_wheels(arrays, problem, arrays["time"])
        self.floating = tuple(_floating_stages(arrays, problem))
        self.limits_dynamics = any(_limits_dynamics(stage.limits) for stage in problem.stages)
        self.limits_dynamics |= problem.spec.fires(problem.model.spec)
        self.thrusters = _summarize_thrusters(arrays, problem)

    def _read_deviations(self, arrays: Arrays, problem: Problem) -> None:
        """Read how far the motion was from plans, limits, end conditions and the balances of physics.

        Grippers that close stop against the object at once, which no plan contains. So violations of limits are also
        read without the samples in which one closes. The attributes that are set are described in `Summary`.

        Args:
            arrays: Datasets of the log by path. `balance/...` is how far momentum and energy are from what impulse and
                work make them; `margin/...` the distance to a limit, negative beyond it; `deviation/...` the distance
                from the plan, and the error of an end condition over its tolerance.
            problem: The problem that the run solved.
        """
        time = arrays["time"]
        self.momentum_error, self.energy_error = (
            float(np.max(np.abs(arrays[f"balance/{name}"]), initial=0.0)) if len(time) else np.nan
            for name in ("momentum", "energy")
        )
        self.near_singular = int(np.sum(arrays.get("events/near_singular", 0)))
        self.largest_condition = _largest_condition(arrays, problem.stages)
        self.closing_samples = _closing_samples(arrays)

        coordinates = tuple(arrays["coordinate"])
        column_names = {"position": coordinates, "velocity": tuple(f"{name} velocity" for name in coordinates)}
        units = {quantity: [getattr(unit, quantity) for unit in problem.model.units] for quantity in column_names}
        deviations = (
            largest(np.abs(arrays["deviation/Q"]), column_names["position"], time, units=units["position"]),
            largest(np.abs(arrays["deviation/Qdot"]), column_names["velocity"], time, units=units["velocity"]),
        )
        self.off_plan = tuple(deviation for deviation in deviations if deviation is not None)

        is_elsewhere = ~np.isin(np.arange(len(time)), self.closing_samples)[:, None]  # where no gripper closes (K, 1)
        violations = list[Largest | None]()
        violations_elsewhere = list[Largest | None]()
        for quantity, names in column_names.items():
            excess = -arrays[f"margin/{quantity}"]
            excess_elsewhere = np.where(is_elsewhere, excess, np.nan)
            violations.append(_largest_violation(arrays, quantity, excess, names, units[quantity]))
            violations_elsewhere.append(_largest_violation(arrays, quantity, excess_elsewhere, names, units[quantity]))
        self.beyond_limits = tuple(
            violation for violation in violations if violation is not None and violation.value > 0
        )
        self.beyond_limits_elsewhere = tuple(
            violation for violation in violations_elsewhere if violation is not None and violation.value > 0
        )
        self.end_condition = largest(arrays["deviation/end"], tuple(arrays["stages/name"]), time)
        self.end_errors = _end_errors(arrays, problem)

    def _read_estimates(self, arrays: Arrays, problem: Problem) -> None:
        """Read the estimates of the delay of commands and of the mass of the load."""
        spec = problem.spec
        self.delay = _last_delay(arrays)
        longest = arrays.get("delay/expected", np.zeros(0)).max(initial=0.0)
        self.delay_is_cut_off = spec.controller.delay == "auto" and bool(longest >= LONGEST_DELAY - STEP)
        looked_for = spec.controller.delay != "auto" or spec.finds_delay(problem.model.spec)
        self.unknown_delay = 0.0 if looked_for else spec.uncertainty.delay
        self.load = _mass_of_load(arrays)

    def __repr__(self) -> str:
        outcomes = {True: "succeeded", False: "did not succeed", None: "not judged"}
        outcome = f"{outcomes[self.succeeded]}: {self.reason}"
        return f"<Summary of {len(self.stages)} stages over {self.duration:g} s, {outcome}>"


def _mass_of_load(arrays: Arrays) -> tuple[float, float] | None:
    """Return the estimated mass of the load when it was held last, and its standard deviation [kg]; None if unknown."""
    if "load/mass" not in arrays:
        return None
    if "payload/held" in arrays:
        held = np.flatnonzero(arrays["payload/held"])
    elif "grasp/closed" in arrays:
        held = np.flatnonzero(arrays["grasp/closed"].all(axis=1))
    else:
        return None
    if not len(held):
        return None
    return float(arrays["load/mass"][held[-1]]), float(arrays["load/mass_deviation"][held[-1]])


def _summarize_thrusters(arrays: Arrays, problem: Problem) -> ThrusterSummary | None:
    """Summarize impulses and propellant of thrusters over a run, and the impulses that they could not give.

    Args:
        arrays: Datasets of the log by path. Impulses that are owed are wanted by the low-level law and not given yet,
            since pulses last whole ticks; refused ones cannot be given at all. Thrusters are shut where their plumes
            would reach something.
        problem: The problem that the run solved.

    Returns:
        The summary; None where no thrusters fire.
    """
    if "thrusters/impulse" not in arrays:
        return None
    impulses = arrays["thrusters/impulse"].sum(axis=0)  # of each thruster [N s]
    linear = slice(problem.model.dimension)
    angular = slice(problem.model.dimension, None)
    owed_linear, owed_angular = (
        np.linalg.norm(arrays["thrusters/owed"][:, part], axis=1) for part in (linear, angular)
    )
    refused_linear, refused_angular = (
        np.linalg.norm(arrays["thrusters/refused"][:, part], axis=1) for part in (linear, angular)
    )
    shut_times = None  # [s], by name
    if "thrusters/shut" in arrays:
        # in the log: the fraction of each sample in which a thruster was shut
        seconds = problem.spec.controller.sample_time * arrays["thrusters/shut"].sum(axis=0)
        by_name = dict(zip(arrays["thruster"].tolist(), seconds.tolist(), strict=True))
        shut_times = {name: time for name, time in by_name.items() if time}
    return ThrusterSummary(
        impulse=float(impulses.sum()),
        firings=int(arrays["thrusters/firings"].sum()),
        propellant=Thrusters.of(problem.model.spec.thrusters).propellant(impulses),
        owed=(float(owed_linear.max(initial=0.0)), float(owed_angular.max(initial=0.0))),
        refused=(float(refused_linear.sum()), float(refused_angular.sum())),
        shut=shut_times,
    )


def _floating_stages(arrays: Arrays, problem: Problem) -> Iterator[FloatingStage]:
    """Yield how the momentum changed, and how the base moved, in stages in which nothing pushes the base.

    There the momentum of robot and wheels should stay, and the base reacts to the arms.

    Args:
        arrays: Datasets of the log by path.
        problem: The problem that the run solved.

    Yields:
        For each such stage: the largest changes of momentum since its first sample, and the displacement of the base
        from its first sample to its last.
    """
    model = problem.model
    space = model.space
    for stage in problem.stages:
        samples = np.flatnonzero(arrays["window/first"] == stage.index)  # at which it is the current stage
        is_floating = stage.moved_by.moves and not stage.moved_by.is_pushed
        if not (is_floating and len(samples)):
            continue
        # the true state, where the log has it besides the one that the controller saw
        Q, v = (arrays.get(f"state/{name}_true", arrays[f"state/{name}"])[samples] for name in ("Q", "Qdot"))
        momentum = model.momentum(Q, v)
        if "wheels/momentum" in arrays:
            wheels = Wheels.of(model.spec)
            momentum_and_energy = wheels.momentum_and_energy(Q, arrays["wheels/momentum"][samples])
            momentum = momentum + momentum_and_energy[:, :-1]
        is_known = np.isfinite(momentum).all(axis=1)
        if not is_known.any():
            continue
        momentum_change = momentum[is_known] - momentum[is_known][0]
        first_base, last_base = Q[is_known][[0, -1]][:, space.base_coordinates]
        base_displacement = space.pose_error(last_base, first_base)
        linear, angular = np.split(momentum_change, [model.dimension], axis=1)
        distance, angle = (float(np.linalg.norm(part)) for part in np.split(base_displacement, [model.dimension]))
        yield FloatingStage(
            name=stage.name,
            linear=float(np.linalg.norm(linear, axis=1).max()),
            angular=float(np.linalg.norm(angular, axis=1).max()),
            distance=distance,
            angle=angle,
        )


def _summarize_wheels(arrays: Arrays, problem: Problem, time: np.ndarray) -> WheelSummary | None:
    """Summarize what reaction wheels did; None of a robot without any."""
    if "wheels/momentum" not in arrays:
        return None
    wheels = Wheels.of(problem.model.spec)
    names = tuple(arrays["wheel"])
    stored, torque = (
        largest(np.abs(arrays[f"wheels/{name}"]) / most, names, time)
        for name, most in (("momentum", wheels.momentum), ("torque", wheels.torque))
    )
    return WheelSummary(stored, torque)


def _last_delay(arrays: Arrays) -> tuple[float, float] | None:
    """Return the last delay that commands were expected to have, and its standard deviation [s]; None if unknown."""
    expected, deviation = (arrays.get(f"delay/{name}", np.zeros(0)) for name in ("expected", "deviation"))
    if not len(deviation) or not np.isfinite(deviation[-1]):
        return None
    return float(expected[-1]), float(deviation[-1])


def _succeeded(completed: bool, monitors: Sequence[Verdict]) -> bool | None:
    """Tell whether a mission succeeded; None where that depends on monitors that are not judged."""
    is_broken = any(verdict.is_judged and not verdict.held for verdict in monitors)
    if is_broken or not completed:
        return False
    return True if all(verdict.held for verdict in monitors) else None


def variation_by_group(
    by_coordinate: np.ndarray, coordinates: tuple[str, ...], sliding: Collection[str] = ()
) -> tuple[float, float, float, float]:
    """Sum the total variations of the coordinates of each group, since those of different units cannot be added.

    Args:
        by_coordinate: Total variation of the control of each coordinate (n,).
        coordinates: Names of the coordinates.
        sliding: Names of the joint coordinates that are lengths.

    Returns:
        The sums over the base's position, the base's angle, joints that turn, and joints that slide.
    """
    is_of_base = np.array([name.startswith("base.") for name in coordinates], bool)
    is_position = np.array([name in ("base.x", "base.y", "base.z") for name in coordinates], bool)
    is_sliding = np.array([name in sliding for name in coordinates], bool)
    position = float(by_coordinate[is_position].sum())
    angle = float(by_coordinate[is_of_base & ~is_position].sum())
    turning_joints = float(by_coordinate[~is_of_base & ~is_sliding].sum())
    sliding_joints = float(by_coordinate[is_sliding].sum())
    return position, angle, turning_joints, sliding_joints


def early_starts(arrays: Arrays, threshold: float) -> np.ndarray:
    """Tell which of the S stages act on the control before their switch time, and at more than one sample.

    A stage that waits in the window acts at a sample if its presence (how much it changes the control) reaches the
    threshold of actual starts, or if its share in the control is more than `NO_SHARE`. One that acts at a single sample
    before the switch to it has no early start: nothing comes of it. Where its shares are not known, an early start
    stands as logged.

    Args:
        arrays: Datasets of the log by path.
        threshold: Presence from which a stage has started, in the units of `window/presence`.

    Returns:
        Whether each stage started early (S,).
    """
    last_return = max(samples_of_returns(arrays), default=0)  # to an earlier stage: what was before does not count
    is_since_return = (np.arange(len(arrays["time"])) >= last_return)[:, None]
    # negated, so that it holds too where the stage before has not ended: its switch time is NaN
    is_before_switch = ~(arrays["time"][:, None] >= _begin_times(arrays)) & is_since_return
    share = np.where(is_before_switch, arrays["window/share"], np.nan)
    presence = np.where(is_before_switch, arrays["window/presence"], np.nan)
    acts = (share > NO_SHARE) | (presence >= threshold)
    acts_repeatedly = np.count_nonzero(acts, axis=0) > 1
    is_share_unknown = np.isnan(share).all(axis=0)
    return np.asarray(arrays["stages/early"].astype(bool) & (acts_repeatedly | is_share_unknown))


def _begin_times(arrays: Arrays) -> np.ndarray:
    """Return when the stages begin (S,) [s]; of a stage to which the sequence returned, when it did so last."""
    end_of_stage_before = np.r_[0.0, arrays["stages/switch_time"][:-1]]
    begin_times = end_of_stage_before.copy()
    for sample in samples_of_returns(arrays):
        stage = int(arrays["window/first"][sample])
        begin_times[stage:] = end_of_stage_before[stage:]
        begin_times[stage] = arrays["time"][sample]
    return np.asarray(begin_times)


def _summarize_stages(arrays: Arrays, threshold: float, published: PublishedRun) -> tuple[StageSummary, ...]:
    """Summarize when each stage started and ended, with the published values of the same controller beside them.

    Args:
        arrays: Datasets of the log by path.
        threshold: Presence from which a stage has started; presence is how much it changes the control while it waits.
        published: Published times by name of the stage.

    Returns:
        A summary of each stage, in their order.
    """
    switch_time = arrays["stages/switch_time"]
    early = early_starts(arrays, threshold)
    acts_only_once = arrays["stages/early"].astype(bool) & ~early
    begin_times = _begin_times(arrays)
    # a stage that acts only once starts when the one before ends after all, see `early_starts`
    actual_start = np.where(acts_only_once, begin_times, arrays["stages/actual_start"])
    duration = switch_time - begin_times
    # stages to which the sequence returned after a try to take the object; a stage from there on is tried once more
    returned_to = arrays["window/first"][list(samples_of_returns(arrays))]
    return tuple(
        StageSummary(
            name=str(name),
            priority=float(arrays["stages/priority"][stage]),
            actual_start=float(actual_start[stage]),
            published_start=published.actual_start.get(str(name), np.nan),
            early=bool(early[stage]),
            switch_time=float(switch_time[stage]),
            published_switch=published.switch_time.get(str(name), np.nan),
            duration=float(duration[stage]),
            tries=1 + int(np.count_nonzero(returned_to <= stage)),
        )
        for stage, name in enumerate(arrays["stages/name"])
    )


def _summarize_solves(arrays: Arrays, is_chosen: np.ndarray) -> SolveSummary:
    """Summarize wall times and iterations of the solves at some samples.

    Args:
        arrays: Datasets of the log by path.
        is_chosen: Whether each of the K samples counts (K,).

    Returns:
        Number of solves, quantiles of wall times [s], and the median of iterations; NaN if no sample counts.
    """
    wall_time = arrays["solver/wall_time"][is_chosen]
    iterations = arrays["solver/iterations"][is_chosen]
    if not len(wall_time):
        return SolveSummary(count=0, median=np.nan, p95=np.nan, p99=np.nan, largest=np.nan, iterations=np.nan)
    median, p95, p99, largest_time = np.percentile(wall_time, [50, 95, 99, 100])
    return SolveSummary(
        count=len(wall_time),
        median=median,
        p95=p95,
        p99=p99,
        largest=largest_time,
        iterations=float(np.median(iterations)),
    )


def _tightest_limits(
    arrays: Arrays, stages: tuple[Stage, ...], units: Sequence[CoordinateUnits]
) -> tuple[LimitSummary, ...]:
    """Find the coordinate that comes nearest to its limit, relative to that limit, of positions and of velocities.

    Margins are relative to half the distance of the lower and the upper limit in the stage of the sample, or absolute
    where there is only one limit.

    Args:
        arrays: Datasets of the log by path.
        stages: All stages of the task, with their limits.
        units: Units of each coordinate.

    Returns:
        One summary for positions and one for velocities; none for a quantity that has no limits.
    """
    tightest = []
    for quantity in ("position", "velocity"):
        margin = arrays[f"margin/{quantity}"]  # at K samples (K, n), negative beyond a limit
        if not np.isfinite(margin).any():
            continue
        width_by_stage = [
            getattr(stage.limits, f"{quantity}_high") - getattr(stage.limits, f"{quantity}_low") for stage in stages
        ]
        half_width = np.array(width_by_stage)[arrays["window/first"]] / 2  # of the current stage at each sample (K, n)
        has_two_limits = np.isfinite(half_width) & (half_width > 0)
        # infinite where a coordinate has no limit, so that it is not the smallest
        relative = np.where(np.isfinite(margin), margin / np.where(has_two_limits, half_width, 1.0), np.inf)
        sample, column = (int(index) for index in np.unravel_index(np.argmin(relative), relative.shape))
        tightest.append(
            LimitSummary(
                kind=quantity,
                coordinate=str(arrays["coordinate"][column]),
                margin=float(margin[sample, column]),
                unit=getattr(units[column], quantity),
                relative=float(relative[sample, column]),
            )
        )
    return tuple(tightest)


def _limits_dynamics(limits: Limits) -> bool:
    """Tell whether a force or an acceleration has a limit."""
    bounds = (limits.force_low, limits.force_high, limits.acceleration_low, limits.acceleration_high)
    return bool(np.isfinite(bounds).any())


def _closing_samples(arrays: Arrays) -> tuple[int, ...]:
    """Return the samples from which on, until the next one, a gripper closes, in the last try and in those before."""
    if "grasp/closed_at" not in arrays:
        return ()
    closed_at = arrays["grasp/closed_at"]
    last_try = np.searchsorted(arrays["time"], closed_at[np.isfinite(closed_at)], side="right") - 1
    closes = (np.diff(arrays["grasp/closed"].astype(int), axis=0) > 0).any(axis=1)
    return tuple(np.union1d(last_try, np.flatnonzero(closes)).tolist())


def _end_errors(arrays: Arrays, problem: Problem) -> tuple[float, float] | None:
    """Compute the error of the final state in the end condition of the last stage, over its tolerance.

    The controller ends the stage by the state that it sees; the true state may miss the condition.

    Args:
        arrays: Datasets of the log by path.
        problem: The problem that the run solved.

    Returns:
        The error of the state that the controller saw, and of the true one, 1 where the condition is just met; None
        where the log has no true state, or the run has not ended.
    """
    if "final/Q_true" not in arrays or np.isnan(arrays["final/end_time"]):
        return None
    object_state = None
    if "final/object_pose" in arrays:
        object_state = arrays["final/object_pose"], arrays["final/object_velocity"]
    errors = []
    for suffix in ("", "_true"):
        Q = arrays[f"final/Q{suffix}"]
        v = arrays[f"final/Qdot{suffix}"]
        stage, x = in_own_chart(problem.model, problem.stages[-1], Q, v, object_state=object_state)
        errors.append(problem.costs.end_error(stage, x))
    error_of_seen, error_of_true = errors
    return error_of_seen, error_of_true


def _largest_violation(
    arrays: Arrays, kind: str, excess: np.ndarray, names: Sequence[str], units: Sequence[str]
) -> Largest | None:
    """Find where a kind of limit is violated most, and by how much the plan violates it there.

    Args:
        arrays: Datasets of the log by path.
        kind: `position` or `velocity`.
        excess: By how much each coordinate is beyond its limit at K samples (K, n), negative within it; NaN where a
            sample or a coordinate does not count.
        names: Names of the columns.
        units: Units of the columns.

    Returns:
        The largest excess, which is negative if no limit is violated; None if all are NaN.
    """
    violation = largest(excess, names, arrays["time"], units=units)
    if violation is None:
        return None
    planned_excess = -arrays[f"margin/planned_{kind}"][violation.sample, list(names).index(violation.where)]
    return replace(violation, planned=max(float(planned_excess), 0.0))


def _largest_condition(arrays: Arrays, stages: tuple[Stage, ...]) -> Largest | None:
    """Find the largest condition number of J_C in stages whose control is the acceleration of poses."""
    if "pose/condition" not in arrays:
        return None
    in_task_space = np.array([stage.input == "task" for stage in stages])[arrays["window/first"]]
    condition = np.where(in_task_space, arrays["pose/condition"], np.nan)
    return largest(condition[:, None], ("J_C",), arrays["time"])


def _distances_of_end_effectors(arrays: Arrays) -> tuple[float, ...]:
    """Compute the distance between the first two end-effectors where each stage ends [m], which shows a lost object."""
    names = list(arrays["pose_coordinate"])
    time = np.append(arrays["time"], arrays["final/end_time"])
    arms = [name.removesuffix(".x") for name in names if name.endswith(".x") and name != "base.x"]
    if len(arms) < 2 or len(time) < 2:
        return (np.nan,) * len(arrays["stages/name"])
    xi = np.vstack([arrays["pose/xi"], arrays["final/xi"]])
    difference = position_of(xi, names, arms[0]) - position_of(xi, names, arms[1])
    distance = np.linalg.norm(difference, axis=1)
    is_known = np.isfinite(time)  # the end of a run that was stopped is not
    return tuple(float(np.interp(t, time[is_known], distance[is_known])) for t in arrays["stages/switch_time"])


def largest(
    values: np.ndarray,
    names: Sequence[str],
    time: np.ndarray,
    sample: int | None = None,
    units: Sequence[str] | None = None,
) -> Largest | None:
    """Find the largest value in a table, with its column, time and sample, for summaries.

    Args:
        values: The values (T, columns); NaN where one is not known.
        names: What each column is of, such as a coordinate.
        time: Times of the rows (T,) [s].
        sample: The sample that all rows belong to; by default each row is a sample, numbered from 0.
        units: Units of the columns; by default they have none.

    Returns:
        The value and where it is; None if no value is finite.
    """
    known_values = np.where(np.isnan(values), -np.inf, values)
    if not np.isfinite(known_values).any():
        return None
    row, column = (int(index) for index in np.unravel_index(int(np.argmax(known_values)), known_values.shape))
    return Largest(
        value=float(known_values[row, column]),
        where=str(names[column]),
        time=float(time[row]),
        sample=row if sample is None else sample,
        unit="1" if units is None else units[column],
    )
