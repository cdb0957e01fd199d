"""What studies keep of a run: tables of quantities, each with how it is read from the run.

A quantity is a column of the study's results, its value read from a run; along `dims` besides the cells.
"""

from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import Any

import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import EFFORT_UNITS, PEAKS, SLIDING_PEAKS, Column
from psmpc_cli.ocp.problem import in_own_chart


def check_columns(results: Results, columns: Iterable[Column], dims: tuple[str, ...] = ()) -> None:
    """Make sure that arrays of a results file have the types and dimensions that their readers expect.

    Expected arrays that the results do not have are passed over.

    Args:
        results: The results of a study.
        columns: The expected arrays, with the dimensions that each has of its own.
        dims: Dimensions that all of them have before their own, such as that of the cells.

    Raises:
        LogError: An array has another type or other dimensions.
    """
    for column in columns:
        if (quantity := results.quantities.get(column.path)) is None:
            continue
        expected_dims = (*dims, *column.dims)
        dtype = quantity.values.dtype
        allowed_kinds = "UO" if column.dtype == "text" else np.dtype(column.dtype).kind
        if quantity.dims != expected_dims or dtype.kind not in allowed_kinds:
            raise LogError(
                f"{results.path}: /{column.path}: found {dtype} along ({', '.join(quantity.dims)}), "
                f"expected {column.dtype} along ({', '.join(expected_dims)})"
            )


def _column(name: str, units: str, long_name: str, read: str | Callable[[Run], Any] = "", **more: Any) -> Column:
    """Return a column of a study's results, with how its value is read from a run.

    Args:
        name: Name of the column.
        units: Unit of its values.
        long_name: What it is, in words.
        read: Function of a run, or attribute of the run's summary, by default the one with the name of the column.
        **more: Further arguments of `Column`.
    """
    source = read or name
    value = source if callable(source) else lambda run: attrgetter(source)(run.summary())
    return Column(name, units, long_name, value, **more)


def _integer(name: str, long_name: str, read: str | Callable[[Run], Any] = "") -> Column:
    """Return a column of whole numbers, which is -1 where the value is not known."""
    return _column(name, "1", long_name, read, dtype="i4", unknown=-1)


def _read_margin(kind: str, name: str) -> Callable[[Run], float]:
    """Read a margin to the limits of a kind; NaN if there are none."""
    return lambda run: next((getattr(each, name) for each in run.summary().limits if each.kind == kind), np.nan)


def _error_at_end(run: Run) -> float:
    """Compute the error of the last stage's end condition at the end, over its tolerance. Paper eq. (18)."""
    problem = run.problem
    final = run.final
    at_end = run.object_state_at(float(final["time"]))
    placed = in_own_chart(problem.model, problem.stages[-1], final["Q"], final["v"], object_state=at_end)
    return problem.costs.end_error(*placed)


def _read_end_errors(path: str) -> Callable[[Run], np.ndarray]:
    """Read the end errors of every stage, where it ended; NaN of stages that did not."""

    def read(run: Run) -> np.ndarray:
        errors = run[path]
        largest = np.max(errors, axis=0, initial=-np.inf, where=np.isfinite(errors))
        return np.where(np.isfinite(largest), largest, np.nan)

    return read


def _monitor_margins(run: Run) -> list[float]:
    return [verdict.margin for verdict in run.summary().monitors]


def _read_peak(name: str) -> Callable[[Run], float]:
    return lambda run: run.summary().peaks[name]


def _read_force(name: str, unknown: Any = np.nan) -> Callable[[Run], Any]:
    """Read what is known of the largest commanded force over its limit; `unknown` if forces have no limits."""
    return lambda run: getattr(run.summary().tightest_force, name, unknown)


def _read_nearest(name: str, unknown: Any = np.nan) -> Callable[[Run], Any]:
    """Read what is known of the two parts that came nearest to each other; `unknown` where nothing keeps clear."""

    def read(run: Run) -> Any:
        clearance = run.summary().clearance
        return unknown if clearance is None else getattr(clearance.nearest, name)

    return read


def _succeeded(run: Run) -> int:
    """Tell whether a mission succeeded: 1, 0, or -1 where it is not judged."""
    succeeded = run.summary().succeeded
    return -1 if succeeded is None else int(succeeded)


def _touched(run: Run) -> float:
    """Tell whether parts touched that keep clear: 1, 0, or NaN where nothing does."""
    clearance = run.summary().clearance
    return np.nan if clearance is None else float(bool(clearance.touched))


def _stage_cost(run: Run) -> np.ndarray:
    weights = run["cost/current_stage"] * float(np.asarray(run.attributes["sample_time"]))
    return np.bincount(run["window/first"], weights, minlength=len(run.stage_names))


def motion_between_hands(run: Run) -> tuple[float, float]:
    """Compute the largest change of the relative pose of two hands while both hold the object [m], [rad]."""
    held = np.flatnonzero(run["grasp/closed"].all(axis=1))
    model = run.problem.model
    one, other = (list(model.pose_rows).index(str(gripper)) for gripper in run["gripper"])
    poses = model.poses(run.Q[held])
    relative = [model.space.relative(each[other], each[one]) for each in poses]
    errors = np.array([model.space.pose_error(each, relative[0]) for each in relative])
    linear, angular = np.split(errors, [model.dimension], axis=1)
    return float(np.linalg.norm(linear, axis=1).max()), float(np.linalg.norm(angular, axis=1).max())


_ENDS = _column(
    "switch_time", "s", "switch time that ended each stage", lambda run: run.stages["switch_time"], dims=("stage",)
)
_STARTS = "actual start of each stage"
_CURRENT = "integral of the running cost of each stage, before normalization, while it was the current one"
_FINAL = "largest error of the last stage's end condition at the end of the run, divided by its tolerance"
_AT_ENDS = (
    "largest error of each stage's end condition but the last stage's, at the time at which the stage ended, "
    "divided by its tolerance"
)
_AND_NOISE = "as `end_error`, but divided by the tolerance plus 2 standard deviations of the measurement"
_BEYOND = "smallest distance to a {} limit at any tick; negative beyond the limit"
_OVER = "the same for a {} limit, divided by half the distance between the two limits"
_NEAREST = "smallest distance at any tick between parts that keep clear; negative where they touched"
_MARGINS = "smallest distance of each monitor's signal to its bounds, in the unit of the monitor"
_VARIES = "total variation of the {} acceleration"
_MOST = "largest number of iterations of a solve"
_BASINS = "windows in which the plan from another guess of the switch times was better than that from the last plan"

OUTCOME = (
    _integer("completed", "1 if the last stage met its end condition, 0 if not"),
    _integer(
        "succeeded", "1 if `completed` and every monitor held on the true state, 0 if not, -1 if not judged", _succeeded
    ),
    _column("end_time", "s", "end of the run, whatever ended it", "duration"),
    _ENDS,
    _column("actual_start", "s", _STARTS, lambda run: run.stages["actual_start"], dims=("stage",)),
    _column("final_error", "1", _FINAL, _error_at_end),
    _column("end_error", "1", _AT_ENDS, _read_end_errors("deviation/end"), dims=("stage",)),
    _column("end_error_noise", "1", _AND_NOISE, _read_end_errors("deviation/end_noise"), dims=("stage",)),
    _column("position_margin", "m, rad", _BEYOND.format("position"), _read_margin("position", "margin")),
    _column("velocity_margin", "m/s, rad/s", _BEYOND.format("velocity"), _read_margin("velocity", "margin")),
    _column("relative_position_margin", "1", _OVER.format("position"), _read_margin("position", "relative")),
    _column("relative_velocity_margin", "1", _OVER.format("velocity"), _read_margin("velocity", "relative")),
    _column("force_utilization", "1", "largest commanded force over its limit", _read_force("value")),
    _column("tightest_force", "1", "coordinate of that force", _read_force("where", ""), dtype="text"),
    _column("tightest_force_time", "s", "sample at which it was largest", _read_force("time")),
    _column("force_saturated", "1", "share of the time in which a force was cut at its limit", "saturated"),
    _column("smallest_clearance", "m", _NEAREST, _read_nearest("distance")),
    _column("nearest_parts", "1", "names of these parts", _read_nearest("pair", ""), dtype="text"),
    _column("nearest_parts_time", "s", "sample at which they were nearest", _read_nearest("time")),
    _column("touched", "1", "1 if parts touched that keep clear, 0 if not; NaN where nothing does", _touched),
    _integer("limits_dynamics", "1 if some stage has a limit of forces or accelerations, 0 if none has"),
    _column("monitor_margin", "m, m/s, 1", _MARGINS, _monitor_margins, dims=("monitor",)),
    _integer("unmeasured", "samples whose state was not measured, at least in part"),
)
"""What became of a run."""

EFFORT = (
    _column("stage_cost", "s", _CURRENT, _stage_cost, dims=("stage",)),
    _column(
        "control_effort", EFFORT_UNITS, "sum over samples of T_s |dv / T_s|^2, dv the integral of u over the sample"
    ),
    _column("squared_acceleration", EFFORT_UNITS, "integral of |u|^2"),
    _column("base_force", "N s", "integral of the norm of the base force"),
    _column("base_torque", "N m s", "integral of the norm of the base torque"),
    *(
        _column(f"peak_{name}", unit, meaning, _read_peak(name))
        for name, (unit, meaning) in (PEAKS | SLIDING_PEAKS).items()
    ),
    _column("variation_base_position", "m/s^2", _VARIES.format("base's linear")),
    _column("variation_base_angle", "rad/s^2", _VARIES.format("base's angular")),
    _column("variation_joints", "rad/s^2", _VARIES.format("turning joints'")),
    _column("variation_sliding", "m/s^2", _VARIES.format("sliding joints'")),
    _integer("solves", "number of solves", "solves.count"),
    _column("iterations_median", "1", "median of the iterations of a solve", "solves.iterations"),
    _integer("iterations_largest", _MOST, lambda run: max(run["solver/iterations"], default=0)),
    _column("solve_time_median", "s", "median wall time of a solve", "solves.median"),
    _column("solve_time_largest", "s", "longest wall time of a solve", "solves.largest"),
    _integer("appended", "stages that entered the window"),
    _integer("postponed", "samples at which a stage was detected, but the window with it had no solution"),
    _integer("solves_failed", "failed solves; the last plan was then followed further", "failed_solves"),
    _integer("basin_changes", _BASINS, lambda run: run.summary().basins or 0),
)
"""What a run took."""

WHOLE_RUN = (*OUTCOME, *EFFORT)
"""Everything that is known of a run to the end of its task."""


def why_ended(reason: str, monitors: Iterable[str], margins: Iterable[float]) -> str:
    """Describe why a run ended, and which monitors did not hold, by their margins."""
    broken = [name for name, margin in zip(monitors, margins, strict=True) if margin < 0]
    return reason + (f"; monitor did not hold: {', '.join(broken)}" if broken else "")


def over_weights(second: int) -> tuple[Column, ...]:
    """List the quantities that are read from each run of a sweep over the weights of two stages in a row. Paper Fig. 6.

    They are those of any whole run, except that the actual start is that of the second stage alone, for each threshold
    above which a stage's effect on the control counts as its start. In addition there are the times of detection, when
    the switch between the two stages first was in the controller's window, and the switch time that was planned then.

    Args:
        second: Index of the second of the two stages.
    """

    def at_detection(run: Run, signal: np.ndarray) -> float:
        """Read a signal (K,) at the first sample whose window holds both stages; NaN if there is no such sample."""
        first = run["window/first"]
        samples = np.flatnonzero((first < second) & (first + run["window/count"] > second))
        return float(signal[samples[0]]) if len(samples) else np.nan

    by_epsilon = "actual_start_by_epsilon"
    seen = "first sample at which the window holds the switch between the two stages"
    planned = "switch time that the plan has at that sample"
    starts = "actual start of the second of the two stages, for each threshold epsilon"
    ends = "switch time that ended the second stage"
    before = second - 1
    return (
        _column("detection_time", "s", seen, lambda run: at_detection(run, run.time)),
        _column("instant_at_detection", "s", planned, lambda run: at_detection(run, run["window/instants"][:, before])),
        _column("actual_start", "s", starts, lambda run: run.stages[by_epsilon][second], dims=("epsilon",)),
        _column("completion_time", "s", ends, lambda run: run.stages["switch_time"][second]),
        *(column for column in WHOLE_RUN if column.path != "actual_start"),
    )
