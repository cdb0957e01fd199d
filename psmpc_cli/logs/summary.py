"""The summary of a run: what is computed from the datasets of its log, given by their paths."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from psmpc_cli.ocp.problem import Problem, in_own_chart
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.specs.object import CaptureSpec
from psmpc_cli.specs.task import OBJECT_CHECKS, MonitorSpec, PublishedRun, TaskSpec

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class StageSummary:
    """One stage: when it started and ended [s], and the published values where there are any; NaN where unknown.

    `duration` is the time from the switch time of the stage before it to its own [s].
    """

    name: str
    priority: float
    actual_start: float
    published_start: float
    early: bool
    switch_time: float
    published_switch: float
    duration: float


@dataclass(frozen=True)
class SolveSummary:
    """Wall time of the solves [s] and iterations, over all windows or those with a switch in them."""

    count: int
    median: float
    p95: float
    p99: float
    largest: float
    iterations: float


@dataclass(frozen=True)
class LimitSummary:
    """The smallest margin to a kind of limit over all ticks, its coordinate, and it over half the limits' distance."""

    kind: str
    coordinate: str
    margin: float
    relative: float


@dataclass(frozen=True)
class Verdict:
    """Whether a monitor held, and by what margin: the smallest distance of the signal to its bounds.

    Attributes:
        margin: In the signal's unit; negative where it was broken; NaN where no sample falls into the stage.
        broken_at: First sample at which it was broken [s], NaN if it held.
    """

    name: str
    held: bool
    margin: float
    broken_at: float


@dataclass(frozen=True)
class Largest:
    """The largest value of a quantity.

    Attributes:
        value: [m, rad, m/s, rad/s], or [1] for an end condition.
        where: The coordinate, its velocity, or the stage.
        time: When, or of the sample after which it was measured [s].
        sample: In the horizon, or in the closed loop after the state, of which sample.
    """

    value: float
    where: str
    time: float
    sample: int


class _Computed:
    """What is computed when it is made, shown by its attributes."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in vars(self).items())})"


class CaptureSummary(_Computed):
    """What became of an object with a mass; NaN where it never came to that.

    Attributes:
        closed_at: When its last gripper closed [s].
        missed_by: Largest distance [m], angle [rad], velocity [m/s] and angular velocity [rad/s] of a gripper from its
            grasp when it was to close.
        pull: Largest filtered pull on a grasp [N].
        lost: Arms whose grippers were pulled open.
        left_at: When the first gripper opened [s].
        distance, angle: Of the object from its destination then [m], [rad].
        speed: Of the object then [m/s].
    """

    def __init__(self, task: TaskSpec, arrays: Arrays) -> None:
        """Take it from the datasets of a log."""
        destination = task.capture.destination if task.capture else None
        pose = arrays["object/left_pose"]
        v = arrays["object/left_velocity"]
        space = space_of_pose(len(pose))
        d = space.dimension
        error = np.full(len(v), np.nan)
        if destination is not None:
            error = space.pose_error(pose, destination.pose)
        self.closed_at = float(np.max(arrays["grasp/closed_at"]))
        self.missed_by: tuple[float, ...] = tuple(arrays["grasp/missed_by"].max(axis=0).tolist())
        self.pull = float(np.max(arrays["grasp/pull"], initial=0.0))
        self.lost: tuple[str, ...] = tuple(arrays["gripper"][arrays["grasp/lost"] == 1].tolist())
        self.left_at = float(arrays["object/left_at"])
        self.distance = float(np.linalg.norm(error[:d]))
        self.angle = float(np.linalg.norm(error[d:]))
        self.speed = float(np.linalg.norm(v[:d]))


class Summary(_Computed):
    """The results of a run.

    Attributes:
        ended: The run came to an end; it was neither killed nor interrupted.
        completed: The last stage met its end condition.
        succeeded: It did, and every monitor held.
        reason: Why the run stopped.
        duration: Simulated time [s].
        stages: By stage.
        solves, switching_solves: All solves, and those of windows with a switch.
        missed: Samples whose solve took longer than the sample time.
        appended, postponed, failed_solves: How often each happened.
        unmeasured: Samples whose state was not measured, at least in part.
        basins: How often another guess of the switch times than the last plan's won; None if there was no other.
        unsolved_levels: Levels of a lexicographic controller that did not converge; None under any other.
        limits: The tightest position and velocity margins.
        control_effort: Integral of |u|^2.
        base_force, base_torque: Integrals of their norms [N s], [N m s].
        variation_base_position, variation_base_angle, variation_joints: Total variation of the control at the samples,
            sum_k |u_{k+1} - u_k|, over the coordinates of each group [m/s^2], [rad/s^2].
        momentum_error, energy_error: Largest drift of the balances of momentum and energy.
        monitors: The verdicts.
        distances: Distance between the first two end-effectors at the end of each stage [m]; NaN with one arm.
        off_plan: Largest deviations of a position and of a velocity at a sample from the prediction of the plan before.
        beyond_limits: Largest violations of a position and of a velocity limit at a tick, where there are any.
        compiled: Whether solver and plant ran as compiled code.
        end_condition: Largest error over tolerance where a stage ended; None without one.
        end_errors: Error of the last stage's end condition over its tolerance at the end, of the state seen and of the
            true state; None without noise.
        capture: What became of an object with a mass; None without one.
    """

    def __init__(self, arrays: Arrays, attributes: Mapping[str, Any], problem: Problem) -> None:
        """Summarize a run from the datasets and attributes of its log, and the problem it solved."""
        spec = problem.spec
        time = arrays["time"]
        end = float(arrays["final/end_time"])
        self.compiled = bool(attributes.get("compiled", False))
        self.ended = bool(np.isfinite(end))
        self.completed = bool(attributes["finished"])
        self.monitors = verdicts(spec, arrays)
        self.succeeded = self.completed and all(verdict.held for verdict in self.monitors)
        self.reason = str(attributes["end_reason"]) or "the run was killed, or goes on"
        self.duration = end if self.ended else float(time[-1]) if len(time) else 0.0
        self.stages = _stages(arrays, spec.published.get(str(attributes["controller"]), PublishedRun()))
        self.solves = _solves(arrays, np.ones(len(time), bool))
        self.switching_solves = _solves(arrays, arrays["window/count"] > 1)
        self.missed = int(np.sum(arrays["solver/wall_time"] > spec.controller.sample_time))
        self.appended, self.postponed, self.failed_solves, self.unmeasured = (
            int(arrays[f"events/{name}"].sum()) for name in ("appended", "postponed", "solve_failed", "unmeasured")
        )
        basin = arrays["window/basin"]
        levels = arrays.get("levels/solved")
        self.basins = int(np.sum(basin > 0)) if np.any(basin >= 0) else None
        self.unsolved_levels = None if levels is None else int(np.sum(levels == 0))
        self.limits = _limits(arrays, problem.stages)
        self.control_effort, self.base_force, self.base_torque = (
            float(arrays[f"effort/{name}"].sum()) for name in ("control", "base_force", "base_torque")
        )
        coordinates = tuple(arrays["coordinate"])
        varied = variation(np.abs(np.diff(arrays["control/u"], axis=0)).sum(axis=0), coordinates)
        self.variation_base_position, self.variation_base_angle, self.variation_joints = varied
        self.momentum_error, self.energy_error = (
            float(np.max(np.abs(arrays[f"balance/{name}"]), initial=0.0)) if len(time) else np.nan
            for name in ("momentum", "energy")
        )
        self.distances = _distances(arrays)
        velocities = tuple(f"{name} velocity" for name in coordinates)
        kinds = (("Q", "position", coordinates), ("Qdot", "velocity", velocities))
        self.off_plan = tuple(
            filter(None, (largest(np.abs(arrays[f"deviation/{q}"]), names, time) for q, _, names in kinds))
        )
        beyond = (largest(-arrays[f"margin/{kind}"], names, time) for _, kind, names in kinds)
        self.beyond_limits = tuple(each for each in beyond if each is not None and each.value > 0)
        self.end_condition = largest(arrays["deviation/end"], tuple(arrays["stages/name"]), time)
        self.end_errors = _end_errors(arrays, problem)
        self.capture = CaptureSummary(spec, arrays) if "grasp/pull" in arrays else None


def verdicts(task: TaskSpec, arrays: Arrays) -> tuple[Verdict, ...]:
    """Judge a task's monitors, and what becomes of an object with a mass, by the datasets of a log."""
    monitored = (judge_monitor(monitor, arrays) for monitor in task.monitors)
    of_object = _object_checks(task.capture, arrays) if task.capture else ()
    return (*monitored, *of_object)


def _object_checks(target_object: CaptureSpec, arrays: Arrays) -> Iterator[Verdict]:
    """Judge whether every gripper closed, none was pulled open, and the object left where and as slow as it should.

    The margin of the second is in N, those of the others are over what is allowed; unlike a monitor that is not judged
    an object that was never let go is not delivered.
    """
    grasp = target_object.grasp
    destination = target_object.destination
    allowed = np.array([getattr(grasp.envelope, name) for name in arrays["grasp/measure"]])
    missed = arrays["grasp/missed_by"]
    end = float(arrays["time"][-1]) if len(arrays["time"]) else np.nan
    margin = float(np.min(1 - missed / allowed))
    taken = bool(np.isfinite(arrays["grasp/closed_at"]).all())
    yield Verdict(OBJECT_CHECKS[0], taken, margin, np.nan if taken else end)
    lost = arrays["grasp/lost"] == 1
    first = float(np.min(arrays["grasp/opened_at"][lost])) if lost.any() else np.nan
    held = grasp.largest_pull - float(np.max(arrays["grasp/pull"], initial=-np.inf))
    yield Verdict(OBJECT_CHECKS[1], taken and not lost.any(), held, first)
    if destination is None:
        return
    left = float(arrays["object/left_at"])
    space = space_of_pose(len(destination.pose))
    error = space.pose_error(arrays["object/left_pose"], destination.pose)
    over = np.abs(error) / destination.tolerance
    linear = arrays["object/left_velocity"][: space.dimension]
    margin = 1 - float(max(*over, np.linalg.norm(linear) / destination.speed))
    delivered = taken and not lost.any() and margin >= 0
    yield Verdict(OBJECT_CHECKS[2], delivered, margin, np.nan if delivered else left if np.isfinite(left) else end)


def signal(monitor: MonitorSpec, arrays: Arrays) -> np.ndarray:
    """Compute the monitored signal at every sample (K,): distance [m] between two frames, or speed [m/s] of frames.

    Speed is that of the frame's position between samples, the largest of the named frames.
    """
    poses = arrays["pose/xi"]
    names = list(arrays["pose_coordinate"])
    positions = [_position(poses, names, name) for name in monitor.of]
    if monitor.quantity == "distance":
        origin = positions[1] if len(positions) > 1 else _position(poses, names, "base")
        return np.asarray(np.linalg.norm(positions[0] - origin, axis=1))
    if len(arrays["time"]) < 2:
        return np.zeros(len(arrays["time"]))
    steps = [np.linalg.norm(np.gradient(position, axis=0), axis=1) for position in positions]
    return np.asarray(np.max(steps, axis=0) / np.gradient(arrays["time"]))


def variation(by_coordinate: np.ndarray, coordinates: tuple[str, ...]) -> tuple[float, float, float]:
    """Sum the total variation of each coordinate (n,) over base position, base angle and joints."""
    base = np.array([name.startswith("base.") for name in coordinates], bool)
    position = np.array([name in ("base.x", "base.y", "base.z") for name in coordinates], bool)
    at, angles, joints = (float(by_coordinate[group].sum()) for group in (position, base & ~position, ~base))
    return at, angles, joints


def _stages(arrays: Arrays, published: PublishedRun) -> tuple[StageSummary, ...]:
    names = arrays["stages/name"].tolist()
    switch = arrays["stages/switch_time"]
    known = published.actual_start, published.switch_time
    starts, ends = ([times.get(name, np.nan) for name in names] for times in known)
    priority, actual, early = (arrays[f"stages/{name}"].tolist() for name in ("priority", "actual_start", "early"))
    durations = np.diff(switch, prepend=0.0).tolist()
    columns = zip(names, priority, actual, starts, map(bool, early), switch.tolist(), ends, durations, strict=True)
    return tuple(StageSummary(*row) for row in columns)


def _solves(arrays: Arrays, chosen: np.ndarray) -> SolveSummary:
    wall_time = arrays["solver/wall_time"][chosen]
    iterations = arrays["solver/iterations"][chosen]
    if not len(wall_time):
        return SolveSummary(0, np.nan, np.nan, np.nan, np.nan, np.nan)
    median, p95, p99, longest = np.percentile(wall_time, [50, 95, 99, 100])
    return SolveSummary(len(wall_time), median, p95, p99, longest, float(np.median(iterations)))


def _limits(arrays: Arrays, stages: tuple[Stage, ...]) -> tuple[LimitSummary, ...]:
    """Find for positions and velocities the coordinate whose margin is smallest relative to its limit."""
    tightest = []
    for kind in ("position", "velocity"):
        margin = arrays[f"margin/{kind}"]
        if not np.isfinite(margin).any():
            continue
        spans = [getattr(stage.limits, f"{kind}_high") - getattr(stage.limits, f"{kind}_low") for stage in stages]
        width = np.array(spans)[arrays["window/first"]] / 2
        bounded = np.isfinite(width) & (width > 0)
        relative = np.where(np.isfinite(margin), margin / np.where(bounded, width, 1.0), np.inf)
        row, column = np.unravel_index(np.argmin(relative), relative.shape)
        coordinate = str(arrays["coordinate"][column])
        tightest.append(LimitSummary(kind, coordinate, float(margin[row, column]), float(relative[row, column])))
    return tuple(tightest)


def _end_errors(arrays: Arrays, problem: Problem) -> tuple[float, float] | None:
    """Compute the last stage's end errors of the final state, as the controller saw it and true."""
    if "final/Q_true" not in arrays or np.isnan(arrays["final/end_time"]):
        return None
    states = ((arrays[f"final/Q{which}"], arrays[f"final/Qdot{which}"]) for which in ("", "_true"))
    seen, true = (problem.costs.end_error(*in_own_chart(problem.model, problem.stages[-1], Q, v)) for Q, v in states)
    return seen, true


def _distances(arrays: Arrays) -> tuple[float, ...]:
    names = list(arrays["pose_coordinate"])
    time = np.append(arrays["time"], arrays["final/end_time"])
    arms = [name.removesuffix(".x") for name in names if name.endswith(".x") and name != "base.x"]
    if len(arms) < 2 or len(time) < 2:
        return (np.nan,) * len(arrays["stages/name"])
    xi = np.vstack([arrays["pose/xi"], arrays["final/xi"]])
    apart = _position(xi, names, arms[0]) - _position(xi, names, arms[1])
    known = np.isfinite(time)
    distance = np.linalg.norm(apart, axis=1)
    return tuple(float(np.interp(t, time[known], distance[known])) for t in arrays["stages/switch_time"])


def largest(values: np.ndarray, names: Sequence[str], time: np.ndarray, sample: int | None = None) -> Largest | None:
    """Find the largest of values (T, names) at times (T,) [s], of a sample or each of its own; None if all are NaN."""
    found = np.where(np.isnan(values), -np.inf, values)
    if not np.isfinite(found).any():
        return None
    row, column = (int(at) for at in np.unravel_index(int(np.argmax(found)), found.shape))
    return Largest(float(found[row, column]), str(names[column]), float(time[row]), row if sample is None else sample)


def judge_monitor(monitor: MonitorSpec, arrays: Arrays) -> Verdict:
    """Judge a monitor by the datasets of a log."""
    during = arrays["window/first"] == list(arrays["stages/name"]).index(monitor.during)
    if not during.any():
        return Verdict(monitor.name, False, np.nan, np.nan)
    values = signal(monitor, arrays)[during]
    time = arrays["time"][during]
    margins = [side * (bound - values) for bound, side in monitor_bounds(monitor, float(values[0]))]
    margin = np.min(margins, axis=0, initial=np.inf)
    broken = np.flatnonzero(~(margin >= 0))  # a signal that is not a number holds no bound
    broken_at = float(time[broken[0]]) if len(broken) else np.nan
    return Verdict(monitor.name, not len(broken), float(margin.min()), broken_at)


def monitor_bounds(monitor: MonitorSpec, start: float) -> list[tuple[float, int]]:
    """List the bounds of a monitored signal that begins with a value, each with 1 for an upper, -1 for a lower one."""
    beside = ((monitor.above_start_at_most, 1), (monitor.below_start_at_most, -1))
    bounds = ((monitor.at_most, 1), (monitor.at_least, -1))
    found = [(start + side * apart, side) for apart, side in beside if apart is not None]
    return found + [(bound, side) for bound, side in bounds if bound is not None]


def _position(xi: np.ndarray, names: list[str], frame: str) -> np.ndarray:
    """Return the positions (K, dimension) of a frame from poses (K, m)."""
    axes = [f"{frame}.{axis}" for axis in "xyz"]
    return xi[:, [names.index(name) for name in axes if name in names]]
