"""What studies keep of a run: tables of quantities, each with how it is read from the run and its summary."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from psmpc_cli.logs.results import Quantity
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary

Row = Mapping[str, Any]
"""The values of a cell by the names of their arrays."""


Reader = Callable[[Run, Summary], Any]


@dataclass(frozen=True)
class PerCell:
    """An array with a value for every cell, or with one for each entry of a further coordinate.

    Attributes:
        name, units, long_name: Of the array.
        read: Reads it from a run and its summary; by default it is what the summary has by that name.
        along: The further coordinate.
        whole: Whether the values are whole numbers, -1 until they are filled in; others are NaN.
    """

    name: str
    units: str
    long_name: str
    read: Reader | None = None
    along: str = ""
    whole: bool = False

    def value(self, run: Run, summary: Summary) -> Any:
        """Read the quantity."""
        return getattr(summary, self.name) if self.read is None else self.read(run, summary)

    def unfilled(self, dims: tuple[str, ...], shape: tuple[int, ...], along: Mapping[str, int]) -> Quantity:
        """Build the array with nothing filled in, for cells along dims of this shape and coordinates of these sizes."""
        extra = (self.along,) if self.along else ()
        size = (*shape, *(along[name] for name in extra))
        values = np.full(size, -1, "i4") if self.whole else np.full(size, np.nan)
        return Quantity(self.name, (*dims, *extra), values, self.units, self.long_name)


def _limit(kind: str, name: str) -> Reader:
    def read(run: Run, summary: Summary) -> float:
        found = [getattr(limit, name) for limit in summary.limits if limit.kind == kind]
        return float(found[0]) if found else np.nan

    return read


def _error_at_end(run: Run, stage: int) -> float:
    """Compute the error of a stage's end condition at the end of the run, over its tolerance. Paper eq. (18)."""
    x = np.concatenate([run.final["Q"], run.final["v"]])
    return run.problem.costs.end_error(run.problem.stages[stage], x)


def _stage_cost(run: Run, summary: Summary) -> np.ndarray:
    weights = run["cost/current_stage"] * float(np.asarray(run.attributes["sample_time"]))
    return np.bincount(run["window/first"], weights, minlength=len(run.stage_names))


def _variation(group: str) -> Reader:
    return lambda _, summary: getattr(summary.variation, group)


def _whole(name: str, long_name: str, read: Reader | None = None) -> PerCell:
    return PerCell(name, "1", long_name, read, whole=True)


def _by_stage(name: str, long_name: str, read: Reader) -> PerCell:
    return PerCell(name, "s", long_name, read, "stage")


_ENDS = _by_stage("switch_time", "instant that ended each stage", lambda run, _: run.stages["switch_time"])
_FINAL = "largest error of the last stage's end condition at the end, over its tolerance"
_BEYOND = "tightest distance to a {} limit at a tick; negative beyond it"
_OVER = "the same distance to a {} limit, over half the limits' distance"
_MARGINS = "smallest distance of each monitor's signal to its bounds"
_VARIES = "total variation of the {} acceleration"
_FAILED = "failed solves after which the shifted plan went on"
_MOST = "largest number of iterations of a solve"

OUTCOME = (
    _whole("completed", "1 if the last stage met its end condition, 0 if not"),
    _whole("succeeded", "1 if it did and every monitor held on the true state, 0 if not"),
    PerCell("end_time", "s", "end of the run, whatever ended it", lambda _, summary: summary.duration),
    _ENDS,
    _by_stage("actual_start", "actual start of each stage", lambda run, _: run.stages["actual_start"]),
    PerCell("final_error", "1", _FINAL, lambda run, _: _error_at_end(run, -1)),
    PerCell("position_margin", "m, rad", _BEYOND.format("position"), _limit("position", "margin")),
    PerCell("velocity_margin", "m/s, rad/s", _BEYOND.format("velocity"), _limit("velocity", "margin")),
    PerCell("relative_position_margin", "1", _OVER.format("position"), _limit("position", "relative")),
    PerCell("relative_velocity_margin", "1", _OVER.format("velocity"), _limit("velocity", "relative")),
    PerCell("monitor_margin", "m, m/s", _MARGINS, lambda _, summary: [v.margin for v in summary.monitors], "monitor"),
    _whole("unmeasured", "samples whose state was not measured, at least in part"),
)
"""What became of a run."""

SPENT = (
    _by_stage("stage_cost", "integral of the cost Lbar of each stage while it was the current one", _stage_cost),
    PerCell("control_effort", "m^2/s^3, rad^2/s^3", "integral of |u|^2"),
    PerCell("base_force", "N s", "integral of the norm of the base force"),
    PerCell("base_torque", "N m s", "integral of the magnitude of the base torque"),
    PerCell("variation_base_position", "m/s^2", _VARIES.format("base's linear"), _variation("base_position")),
    PerCell("variation_base_angle", "rad/s^2", _VARIES.format("base's angular"), _variation("base_angle")),
    PerCell("variation_joints", "rad/s^2", _VARIES.format("joints'"), _variation("joints")),
    _whole("solves", "number of solves", lambda _, summary: summary.solves.count),
    PerCell("iterations_median", "1", "median of the iterations of a solve", lambda _, s: s.solves.iterations),
    _whole("iterations_largest", _MOST, lambda run, _: max(run["solver/iterations"], default=0)),
    PerCell("solve_time_median", "s", "median wall time of a solve", lambda _, summary: summary.solves.median),
    PerCell("solve_time_largest", "s", "longest wall time of a solve", lambda _, summary: summary.solves.largest),
    _whole("appended", "stages that entered the window"),
    _whole("postponed", "samples at which a stage was seen, but the window with it had no solution"),
    _whole("solves_failed", _FAILED, lambda _, summary: summary.failed_solves),
    _whole(
        "basin_changes",
        "windows in which another guess of the instants than the last plan's won",
        lambda _, summary: summary.basins or 0,
    ),
)
"""What a run took."""

WHOLE_RUN = (*OUTCOME, *SPENT)
"""Everything that is known of a run to the end of its task."""


def second_stage(index: int) -> tuple[PerCell, ...]:
    """Build the quantities of the second of two stages in a row, for a run that ends with it.

    Args:
        index: Its index.
    """

    def detected(run: Run) -> np.ndarray:
        """Find the first sample with the switch in its window (1,); (0,) if there is none."""
        first = run["window/first"]
        return np.flatnonzero((first < index) & (first + run["window/count"] > index))[:1]

    def detection_time(run: Run, _: Summary) -> float:
        return float(np.append(run.time[detected(run)], np.nan)[0])

    def instant_at_detection(run: Run, _: Summary) -> float:
        return float(np.append(run["window/instants"][detected(run), index - 1], np.nan)[0])

    def final_error(run: Run, _: Summary) -> float:
        """Read the error at the planned switch time, as logged; without one, compute it where the run ended."""
        if np.isnan(run.stages["switch_time"][index]):
            return np.nan
        planned = float(run["deviation/end"][-1, index]) if len(run.time) else np.nan
        return planned if np.isfinite(planned) else _error_at_end(run, index)

    error = "largest error of the second stage's end condition at its end, over its tolerance"
    starts, ends = "actual start of the second stage", "instant that ended the second stage"
    return (
        PerCell("detection_time", "s", "first sample with the switch in the window", detection_time),
        PerCell("instant_at_detection", "s", "optimized switching instant at that sample", instant_at_detection),
        _ENDS,
        PerCell("actual_start", "s", starts, lambda run, _: run.stages["actual_start_by_epsilon"][index], "epsilon"),
        PerCell("completion_time", "s", ends, lambda run, _: run.stages["switch_time"][index]),
        PerCell("final_error", "1", error, final_error),
        *SPENT,
    )


def measure_run(run: Run) -> tuple[Row, str]:
    """Measure a run to the end of its task, with why it ended; a mission that fails is no failure to measure it."""
    return {**_row(WHOLE_RUN, run), "reason": run.summary().reason}, ""


def measure_second_stage(index: int, run: Run) -> tuple[Row, str]:
    """Measure a run to the end of the second of two studied stages; it failed if it did not reach that."""
    reached = np.isfinite(run.stages["switch_time"][index])
    return _row(second_stage(index), run), "" if reached else run.summary().reason


def _row(quantities: Sequence[PerCell], run: Run) -> Row:
    """Read quantities from a run; those along a coordinate without entries are left out."""
    summary = run.summary()
    values = {quantity.name: quantity.value(run, summary) for quantity in quantities}
    return {name: value for name, value in values.items() if np.size(value)}
