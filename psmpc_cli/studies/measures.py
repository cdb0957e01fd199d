"""What studies keep of a run: tables of quantities, each with how it is read from the run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from psmpc_cli.logs.results import Quantity
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.problem import in_own_chart

Row = Mapping[str, Any]
"""The values of a cell by the names of their arrays."""


@dataclass(frozen=True)
class PerCell:
    """An array with a value for every cell, or with one for each entry of a further coordinate.

    Attributes:
        name, units, long_name: Of the array.
        read: What it is of a run's summary, such as `solves.count`, or what reads it from the run; by default what the
            summary has by the name of the array.
        along: The further coordinate.
        unfilled: The value until one is filled in: a number, a whole number or a text as the others.
        meanings: What the values 0, 1, ... of a code mean.
    """

    name: str
    units: str
    long_name: str
    read: str | Callable[[Run], Any] = ""
    along: str = ""
    unfilled: float | int | str = np.nan
    meanings: tuple[str, ...] = ()

    def array(self, dims: tuple[str, ...], sizes: Mapping[str, int]) -> Quantity:
        """Build the array with nothing filled in, for cells along dims and coordinates of these sizes."""
        dims = (*dims, self.along) if self.along else dims
        kind = "i4" if isinstance(self.unfilled, int) else None
        values = np.full([sizes[name] for name in dims], self.unfilled, kind)
        return Quantity(self.name, dims, values, self.units, self.long_name, self.meanings)


def _whole(name: str, long_name: str, read: str | Callable[[Run], Any] = "") -> PerCell:
    return PerCell(name, "1", long_name, read, unfilled=-1)


def _margin(kind: str, name: str) -> Callable[[Run], float]:
    """Read a margin to the limits of a kind; NaN if there are none."""
    return lambda run: next((getattr(each, name) for each in run.summary().limits if each.kind == kind), np.nan)


def _error_at_end(run: Run, stage: int) -> float:
    """Compute the error of a stage's end condition at the end of the run, over its tolerance. Paper eq. (18)."""
    problem, final = run.problem, run.final
    return problem.costs.end_error(*in_own_chart(problem.model, problem.stages[stage], final["Q"], final["v"]))


def _stage_cost(run: Run) -> np.ndarray:
    weights = run["cost/current_stage"] * float(np.asarray(run.attributes["sample_time"]))
    return np.bincount(run["window/first"], weights, minlength=len(run.stage_names))


_ENDS = PerCell("switch_time", "s", "instant that ended each stage", lambda run: run.stages["switch_time"], "stage")
_STARTS, _CURRENT = "actual start of each stage", "integral of the cost Lbar of each stage while it was the current one"
_FINAL = "largest error of the last stage's end condition at the end, over its tolerance"
_BEYOND = "tightest distance to a {} limit at a tick; negative beyond it"
_OVER = "the same distance to a {} limit, over half the limits' distance"
_MARGINS = "smallest distance of each monitor's signal to its bounds"
_VARIES = "total variation of the {} acceleration"
_MOST = "largest number of iterations of a solve"
_BASINS = "windows in which another guess of the instants than the last plan's won"

OUTCOME = (
    _whole("completed", "1 if the last stage met its end condition, 0 if not"),
    _whole("succeeded", "1 if it did and every monitor held on the true state, 0 if not"),
    PerCell("end_time", "s", "end of the run, whatever ended it", "duration"),
    _ENDS,
    PerCell("actual_start", "s", _STARTS, lambda run: run.stages["actual_start"], "stage"),
    PerCell("final_error", "1", _FINAL, lambda run: _error_at_end(run, -1)),
    PerCell("position_margin", "m, rad", _BEYOND.format("position"), _margin("position", "margin")),
    PerCell("velocity_margin", "m/s, rad/s", _BEYOND.format("velocity"), _margin("velocity", "margin")),
    PerCell("relative_position_margin", "1", _OVER.format("position"), _margin("position", "relative")),
    PerCell("relative_velocity_margin", "1", _OVER.format("velocity"), _margin("velocity", "relative")),
    PerCell("monitor_margin", "m, m/s", _MARGINS, lambda run: [v.margin for v in run.summary().monitors], "monitor"),
    _whole("unmeasured", "samples whose state was not measured, at least in part"),
)
"""What became of a run."""

SPENT = (
    PerCell("stage_cost", "s", _CURRENT, _stage_cost, "stage"),
    PerCell("control_effort", "m^2/s^3, rad^2/s^3", "integral of |u|^2"),
    PerCell("base_force", "N s", "integral of the norm of the base force"),
    PerCell("base_torque", "N m s", "integral of the norm of the base torque"),
    PerCell("variation_base_position", "m/s^2", _VARIES.format("base's linear")),
    PerCell("variation_base_angle", "rad/s^2", _VARIES.format("base's angular")),
    PerCell("variation_joints", "rad/s^2", _VARIES.format("joints'")),
    _whole("solves", "number of solves", "solves.count"),
    PerCell("iterations_median", "1", "median of the iterations of a solve", "solves.iterations"),
    _whole("iterations_largest", _MOST, lambda run: max(run["solver/iterations"], default=0)),
    PerCell("solve_time_median", "s", "median wall time of a solve", "solves.median"),
    PerCell("solve_time_largest", "s", "longest wall time of a solve", "solves.largest"),
    _whole("appended", "stages that entered the window"),
    _whole("postponed", "samples at which a stage was seen, but the window with it had no solution"),
    _whole("solves_failed", "failed solves after which the shifted plan went on", "failed_solves"),
    _whole("basin_changes", _BASINS, lambda run: run.summary().basins or 0),
)
"""What a run took."""

WHOLE_RUN = (*OUTCOME, *SPENT)
"""Everything that is known of a run to the end of its task."""


def second_stage(index: int) -> tuple[PerCell, ...]:
    """Build the quantities of the second of two stages in a row, whose index this is, for a run that ends with it."""

    def at_detection(run: Run, signal: np.ndarray) -> float:
        """Read a signal at the first sample with the switch in its window; NaN if there is none."""
        first = run["window/first"]
        found = np.flatnonzero((first < index) & (first + run["window/count"] > index))
        return float(signal[found[0]]) if len(found) else np.nan

    def final_error(run: Run) -> float:
        """Read the error at the planned switch time, as logged; without one, compute it where the run ended."""
        if np.isnan(run.stages["switch_time"][index]):
            return np.nan
        planned = float(run["deviation/end"][-1, index]) if len(run.time) else np.nan
        return planned if np.isfinite(planned) else _error_at_end(run, index)

    seen, planned = "first sample with the switch in the window", "optimized switching instant at that sample"
    starts, ends = "actual start of the second stage", "instant that ended the second stage"
    error = "largest error of the second stage's end condition at its end, over its tolerance"
    before = index - 1
    return (
        PerCell("detection_time", "s", seen, lambda run: at_detection(run, run.time)),
        PerCell("instant_at_detection", "s", planned, lambda run: at_detection(run, run["window/instants"][:, before])),
        _ENDS,
        PerCell("actual_start", "s", starts, lambda run: run.stages["actual_start_by_epsilon"][index], "epsilon"),
        PerCell("completion_time", "s", ends, lambda run: run.stages["switch_time"][index]),
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
    summary, row = run.summary(), {}
    for each in quantities:
        row[each.name] = attrgetter(each.read or each.name)(summary) if isinstance(each.read, str) else each.read(run)
    return {name: value for name, value in row.items() if np.size(value)}
