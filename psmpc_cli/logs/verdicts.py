"""What decides whether a mission succeeded: monitors, that nothing touched, and what became of the object."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.specs.document import counted
from psmpc_cli.specs.object import GRASP_LOADS, ObjectBody
from psmpc_cli.specs.task import NOTHING_TOUCHED, MonitorSpec, ObjectCheck, TaskSpec

Arrays = Mapping[str, np.ndarray]
"""The datasets of a log by their paths."""


@dataclass(frozen=True)
class Verdict:
    """Whether a monitor held, and by what margin.

    Attributes:
        name: The monitor.
        held: Whether it held.
        margin: Smallest distance of the signal to its bounds; negative where a bound was broken; NaN where no sample
            falls into the stage; infinite where nothing is bounded.
        unit: Of the margin, `1` where it is over what is allowed.
        broken_at: First sample at which a bound was broken [s]; NaN if it held.
        instead: What became of the object where a check of it did not hold; empty for a monitor.
        details: The values behind the margin, where it is the smallest of several.
    """

    name: str
    held: bool
    margin: float
    unit: str
    broken_at: float
    instead: str = ""
    details: str = ""

    @property
    def is_judged(self) -> bool:
        """Whether it is known that it held or did not."""
        return self.held or bool(np.isfinite(self.broken_at))


@dataclass(frozen=True)
class NearestParts:
    """Two parts that keep clear, at a sample of a run.

    Attributes:
        pair: Their names, by `pair_name`.
        distance: Their smallest distance at the ticks of the sample, negative where they overlap [m].
        margin: That less what the task keeps [m].
        time: Of the sample [s].
        sample: Its number.
    """

    pair: str
    distance: float
    margin: float
    time: float
    sample: int


@dataclass(frozen=True)
class ClearanceSummary:
    """How near parts that keep clear came to each other.

    Attributes:
        nearest: The two with the smallest distance, when it was.
        tightest: The two with the smallest margin; others where the task keeps different margins in its stages.
        touched: Pairs that touched.
        touched_at: Sample at which the first one did [s]; NaN if none did.
    """

    nearest: NearestParts
    tightest: NearestParts
    touched: tuple[str, ...]
    touched_at: float

    @property
    def touch(self) -> str:
        """Which parts touched, how deep and when; empty if none did."""
        if not self.touched:
            return ""
        deepest = self.nearest
        text = f"{deepest.pair} touched, {-1e3 * deepest.distance:.1f} mm deep at {deepest.time:.1f} s"
        further = [f"first touch at {self.touched_at:.1f} s"] if self.touched_at < deepest.time else []
        more = len(self.touched) - 1
        further += [counted(more, "more pair touched", "more pairs touched")] if more else []
        return f"{text} ({'; '.join(further)})" if further else text


def verdicts(task: TaskSpec, arrays: Arrays) -> tuple[Verdict, ...]:
    """Judge by the datasets of a log what decides whether a mission succeeded, see `TaskSpec.judged`."""
    monitored = [judge_touch(arrays)] if task.keeps_clear else []
    monitored += [judge_monitor(monitor, arrays) for monitor in task.monitors]
    if "grasp/pull" in arrays:
        return (*monitored, *_object_checks(task, task.body, arrays))
    # nobody knows what became of the object in a loop of the user's own
    return (*monitored, *(Verdict(name, False, np.nan, "1", np.nan) for name in task.object_checks))


def summarize_clearance(arrays: Arrays) -> ClearanceSummary | None:
    """Find which of the parts that keep clear came nearest to each other in a run.

    Args:
        arrays: Datasets of the log by path. Read are distances, and distances less the margin to keep, (K, P) [m], of P
            pairs of parts at K samples; NaN where a pair is not measured.

    Returns:
        The nearest pair, the pair nearest to its margin, and the pairs that touched (distance below 0) with the first
        time; None if no distance is known.
    """
    distances = arrays.get("clearance/distance")
    if distances is None or not np.isfinite(distances).any():
        return None
    margins = arrays["clearance/margin"]

    def parts_with_smallest(values: np.ndarray) -> NearestParts:
        sample, pair = (int(index) for index in np.unravel_index(int(np.nanargmin(values)), values.shape))
        return NearestParts(
            pair=str(arrays["clearance/pair"][pair]),
            distance=float(distances[sample, pair]),
            margin=float(margins[sample, pair]),
            time=float(arrays["time"][sample]),
            sample=sample,
        )

    is_touching = distances < 0  # False where a distance is NaN
    touching_samples = np.flatnonzero(is_touching.any(axis=1))
    return ClearanceSummary(
        nearest=parts_with_smallest(distances),
        tightest=parts_with_smallest(margins),
        touched=tuple(arrays["clearance/pair"][is_touching.any(axis=0)].tolist()),
        touched_at=float(arrays["time"][touching_samples[0]]) if len(touching_samples) else np.nan,
    )


def judge_touch(arrays: Arrays) -> Verdict:
    """Judge whether parts that keep clear touched, which decides with other verdicts whether a mission succeeded.

    Args:
        arrays: Datasets of the log by path.

    Returns:
        The verdict; its margin is the smallest distance [m]. If no distance is known, as in a loop without ticks, it is
        not judged (margin NaN). If the task excepts every pair, nothing can touch, so it holds (margin infinite).
    """
    clearance = summarize_clearance(arrays)
    if clearance is None:
        has_no_pairs = "clearance/pair" in arrays and not len(arrays["clearance/pair"])
        return Verdict(
            name=NOTHING_TOUCHED,
            held=has_no_pairs,
            margin=np.inf if has_no_pairs else np.nan,
            unit="m",
            broken_at=np.nan,
        )
    return Verdict(
        name=NOTHING_TOUCHED,
        held=not clearance.touched,
        margin=clearance.nearest.distance,
        unit="m",
        broken_at=clearance.touched_at,
        instead=clearance.touch,
    )


def samples_of_returns(arrays: Arrays) -> tuple[int, ...]:
    """Return the samples at which the sequence returned to an earlier stage, because the object was missed or lost."""
    return tuple(np.flatnonzero(arrays.get("events/returned", np.zeros(0))).tolist())


def largest_loads(arrays: Arrays) -> dict[str, float]:
    """Return the largest filtered loads on a grasp in the last try, by `GRASP_LOADS`."""
    last_try = slice(max(samples_of_returns(arrays), default=0), None)
    return {load: float(np.max(arrays[f"grasp/{load}"][last_try], initial=0.0)) for load in GRASP_LOADS}


def object_when_let_go(task: TaskSpec, arrays: Arrays) -> tuple[float, np.ndarray, np.ndarray]:
    """Return when the object left the grippers [s], and its pose and velocity then; at the end if it is held so long.

    Args:
        task: The task, which says whether the object is held to the end.
        arrays: Datasets of the log by path.
    """
    left = float(arrays["object/left_at"])
    if np.isfinite(left) or not task.holds_to_the_end:
        return left, arrays["object/left_pose"], arrays["object/left_velocity"]
    return float(arrays["final/end_time"]), arrays["final/object_pose"], arrays["final/object_velocity"]


def _object_checks(task: TaskSpec, target_object: ObjectBody, arrays: Arrays) -> Iterator[Verdict]:
    """Judge whether the object was taken, not lost, and delivered: let go where it should be, and slowly enough.

    Args:
        task: The task.
        target_object: Its object, with the envelope and strength of grasps and its destination.
        arrays: Datasets of the log by path.

    Yields:
        A verdict for each of the three; the last only if the object has a destination. Margins are relative to what is
        allowed; that of the grasps is the smallest of their loads. An object due for release but still held was not
        delivered.
    """
    grasp = target_object.grasp
    destination = target_object.destination
    # largest distance, angle and velocities of a gripper from its grasp with which it can close, and those that it had
    envelope = np.array([getattr(grasp.envelope, name) for name in arrays["grasp/measure"]])
    missed_by = arrays["grasp/missed_by"]
    end = float(arrays["time"][-1]) if len(arrays["time"]) else np.nan
    is_closed = np.isfinite(arrays["grasp/closed_at"])
    is_taken = bool(is_closed.all())
    yield Verdict(
        name=ObjectCheck.TAKEN.value,
        held=is_taken,
        margin=float(np.min(1 - missed_by / envelope)),
        unit="1",
        broken_at=np.nan if is_taken else end,
        instead="" if is_taken else _why_not_taken(arrays, end),
    )
    is_lost = arrays["grasp/lost"] == 1
    lost_at = float(np.min(arrays["grasp/opened_at"][is_lost])) if is_lost.any() else np.nan
    pulled_open = f"{', '.join(arrays['gripper'][is_lost])} pulled open at {lost_at:.1f} s" if is_lost.any() else ""
    loads = largest_loads(arrays)
    strength = dict(zip(GRASP_LOADS, grasp.largest_loads, strict=True))
    yield Verdict(
        name=ObjectCheck.NOT_LOST.value,
        held=is_taken and not is_lost.any(),
        margin=min(1 - loads[load] / strength[load] for load in GRASP_LOADS),
        unit="1",
        broken_at=lost_at,
        instead=pulled_open,
        details=_loads_over_strength(loads, strength),
    )
    if destination is None:
        return
    left_at, pose, v = object_when_let_go(task, arrays)
    space = space_of_pose(len(destination.pose))
    error = space.pose_error(pose, destination.pose)
    error_over_tolerance = np.abs(error) / destination.tolerance
    linear_velocity = v[: space.dimension]
    margin = 1 - float(max(*error_over_tolerance, np.linalg.norm(linear_velocity) / destination.speed))
    delivered = is_taken and not is_lost.any() and margin >= 0
    release = "held to the end" if task.holds_to_the_end else "let go"
    what_happened = f"{release} at {left_at:.1f} s, too far from its destination or too fast"
    if not np.isfinite(left_at):
        what_happened = f"still held at {end:.1f} s, when the run ended"
    if is_lost.any():
        what_happened = pulled_open
    if not is_taken:
        what_happened = "it was not taken"
    yield Verdict(
        name=ObjectCheck.DELIVERED.value,
        held=delivered,
        margin=margin,
        unit="1",
        broken_at=np.nan if delivered else left_at if np.isfinite(left_at) else end,
        instead="" if delivered else what_happened,
    )


def _loads_over_strength(loads: Mapping[str, float], strength: Mapping[str, float]) -> str:
    """Write the largest loads on a grasp, and what it holds of each."""
    ratios = []
    for load, unit in GRASP_LOADS.items():
        bound = f" of {strength[load]:g}" if np.isfinite(strength[load]) else ""
        ratios.append(f"{load} {loads[load]:.3g}{bound} {unit}")
    return ", ".join(ratios)


def _why_not_taken(arrays: Arrays, end: float) -> str:
    """Say which grippers did not close on an object, and why: they were too far away, or the run ended before [s]."""
    grippers = arrays["gripper"]
    tried = np.isfinite(arrays["grasp/missed_by"]).all(axis=1)
    too_far = grippers[tried & ~np.isfinite(arrays["grasp/closed_at"])]
    if len(too_far):
        return f"{', '.join(too_far)} outside the envelope when the grippers were to close"
    return f"the run ended at {end:.1f} s, before {', '.join(grippers[~tried])} had to close"


def monitored_signal(monitor: MonitorSpec, arrays: Arrays) -> np.ndarray:
    """Compute the signal that a monitor watches, at each of K samples: distance [m], speed [m/s] or clearance [m].

    Distance is that between two frames, or of one from the base. Speed is that of a frame's position, by differences
    between samples, the largest of the named frames. Clearance is the smallest distance of the pairs at the ticks until
    the next sample; NaN where all of them may touch.

    Args:
        monitor: What is monitored, of which frames or parts.
        arrays: Datasets of the log by path.

    Returns:
        The signal (K,).
    """
    if monitor.quantity == "clearance":
        return _smallest_distances(monitor, arrays)
    poses = arrays["pose/xi"]
    names = list(arrays["pose_coordinate"])
    positions = [position_of(poses, names, name) for name in monitor.of]
    if monitor.quantity == "distance":
        origin = positions[1] if len(positions) > 1 else position_of(poses, names, "base")
        return np.asarray(np.linalg.norm(positions[0] - origin, axis=1))
    if len(arrays["time"]) < 2:  # too few for a difference
        return np.zeros(len(arrays["time"]))
    # displacements by sample, and below the time by sample: their quotient is the speed
    displacements = [np.linalg.norm(np.gradient(position, axis=0), axis=1) for position in positions]
    return np.asarray(np.max(displacements, axis=0) / np.gradient(arrays["time"]))


def _smallest_distances(monitor: MonitorSpec, arrays: Arrays) -> np.ndarray:
    """Return the smallest distance of the pairs that a monitor is about, at every sample (K,) [m]."""
    pairs = arrays.get("clearance/pair", np.zeros(0))
    is_about = np.array([monitor.is_about(str(pair)) for pair in pairs], bool)
    distances = arrays.get("clearance/distance", np.full((len(arrays["time"]), 0), np.nan))
    return np.asarray(np.fmin.reduce(distances[:, is_about], axis=1, initial=np.nan))


def judge_monitor(monitor: MonitorSpec, arrays: Arrays) -> Verdict:
    """Judge whether a monitored signal kept its bounds at all samples of the stage in which it is watched.

    Args:
        monitor: The signal, its stage and its bounds. A bound may be relative to the signal's first value there.
        arrays: Datasets of the log by path.

    Returns:
        The verdict; it does not hold (with a margin of NaN) where the stage was never reached.
    """
    watched_stage = list(arrays["stages/name"]).index(monitor.during)
    is_watched = arrays["window/first"] == watched_stage  # at each sample: whether that stage is the current one
    values = monitored_signal(monitor, arrays)
    if monitor.quantity == "clearance":
        is_watched &= ~np.isnan(values)  # parts that may touch are not measured
    if not is_watched.any():
        return Verdict(name=monitor.name, held=False, margin=np.nan, unit=monitor.unit, broken_at=np.nan)
    values = values[is_watched]
    time = arrays["time"][is_watched]
    margins = [side * (bound - values) for bound, side in monitor_bounds(monitor, start=float(values[0]))]
    smallest_margins = np.min(margins, axis=0, initial=np.inf)  # of the bounds, at each sample
    is_broken = ~(smallest_margins >= 0)  # negated, so that a signal that is not a number breaks its bounds
    broken_samples = np.flatnonzero(is_broken)
    return Verdict(
        name=monitor.name,
        held=not len(broken_samples),
        margin=float(smallest_margins.min()),
        unit=monitor.unit,
        broken_at=float(time[broken_samples[0]]) if len(broken_samples) else np.nan,
    )


def monitor_bounds(monitor: MonitorSpec, start: float) -> list[tuple[float, int]]:
    """List the bounds of a monitored signal, each with 1 for an upper and -1 for a lower bound.

    Args:
        monitor: The monitor.
        start: Value of the signal at the start of the stage, to which some bounds are relative.
    """
    relative = ((monitor.above_start_at_most, 1), (monitor.below_start_at_most, -1))
    bounds = ((monitor.at_most, 1), (monitor.at_least, -1))
    bounds_from_start = [(start + side * apart, side) for apart, side in relative if apart is not None]
    return bounds_from_start + [(bound, side) for bound, side in bounds if bound is not None]


def position_of(xi: np.ndarray, names: list[str], frame: str) -> np.ndarray:
    """Return the positions (K, dimension) [m] of a frame from poses xi (K, m), whose m columns have these names."""
    axes = [f"{frame}.{axis}" for axis in "xyz"]
    return xi[:, [names.index(name) for name in axes if name in names]]
