"""What studies keep of a run: tables of quantities, each with how it is read from the run and its summary."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from psmpc_cli.logs.read import Log as Run
from psmpc_cli.logs.results import Quantity
from psmpc_cli.ocp.problem import StageCosts, build_stages
from psmpc_cli.robot.model import build_model
from psmpc_cli.simulation.measures import end_error
from psmpc_cli.simulation.summary import LimitSummary, Summary, summarize, task_of

Row = Mapping[str, Any]
"""The values of a cell by the names of their arrays."""


@dataclass(frozen=True)
class PerCell:
    """An array with a value for every cell, or with one for each entry of a further coordinate.

    Attributes:
        name, units, long_name: Of the array.
        value: Reads it from a run and its summary.
        along: The further coordinate.
        whole: Whether the values are whole numbers, -1 until they are filled in; others are NaN.
    """

    name: str
    units: str
    long_name: str
    value: Callable[[Run, Summary], Any]
    along: str = ""
    whole: bool = False

    def unfilled(self, dims: tuple[str, ...], shape: tuple[int, ...], along: Mapping[str, int]) -> Quantity:
        """Build the array with nothing filled in, for cells along dims of this shape and coordinates of these sizes."""
        extra = (self.along,) if self.along else ()
        size = (*shape, *(along[name] for name in extra))
        values = np.full(size, -1, "i4") if self.whole else np.full(size, np.nan)
        return Quantity(self.name, (*dims, *extra), values, self.units, self.long_name)


def _limit(kind: str, name: str) -> Callable[[Run, Summary], float]:
    def value(run: Run, summary: Summary) -> float:
        found: list[LimitSummary] = [limit for limit in summary.limits if limit.kind == kind]
        return float(getattr(found[0], name)) if found else np.nan

    return value


def _error_at_end(run: Run, stage: int) -> float:
    """Compute the error of a stage's end condition at the end of the run, over its tolerance. Paper eq. (18)."""
    true = "_true" if "Q_true" in run.final else ""
    x = np.concatenate([run.final[f"Q{true}"], run.final[f"Qdot{true}"]])
    task = task_of(run)
    model = build_model(task.robot)
    return end_error(StageCosts(model), build_stages(task.spec, task.robot, model)[stage], x)


OUTCOME = (
    PerCell(
        "completed", "1", "1 if the last stage met its end condition, 0 if not", lambda r, s: s.completed, whole=True
    ),
    PerCell(
        "succeeded",
        "1",
        "1 if it did and every monitor held on the true state, 0 if not",
        lambda r, s: s.succeeded,
        whole=True,
    ),
    PerCell("end_time", "s", "end of the run, whatever ended it", lambda r, s: s.duration),
    PerCell("switch_time", "s", "instant that ended each stage", lambda r, s: r.stages["switch_time"], "stage"),
    PerCell("actual_start", "s", "actual start of each stage", lambda r, s: r.stages["actual_start"], "stage"),
    PerCell(
        "final_error",
        "1",
        "largest error of the last stage's end condition at the end, over its tolerance",
        lambda r, s: _error_at_end(r, -1),
    ),
    PerCell(
        "position_margin",
        "m, rad",
        "tightest distance to a position limit at a tick; negative beyond it",
        _limit("position", "margin"),
    ),
    PerCell(
        "velocity_margin",
        "m/s, rad/s",
        "tightest distance to a velocity limit at a tick; negative beyond it",
        _limit("velocity", "margin"),
    ),
    PerCell(
        "relative_position_margin",
        "1",
        "the same distance to a position limit, over half the limits' distance",
        _limit("position", "relative"),
    ),
    PerCell(
        "relative_velocity_margin",
        "1",
        "the same distance to a velocity limit, over half the limits' distance",
        _limit("velocity", "relative"),
    ),
    PerCell(
        "monitor_margin",
        "m, m/s",
        "smallest distance of each monitor's signal to its bounds",
        lambda r, s: [verdict.margin for verdict in s.monitors],
        "monitor",
    ),
    PerCell(
        "unmeasured",
        "1",
        "samples whose state was not measured, at least in part",
        lambda r, s: s.unmeasured,
        whole=True,
    ),
)
"""What became of a run."""

SPENT = (
    PerCell(
        "stage_cost",
        "s",
        "integral of the cost Lbar of each stage while it was the current one",
        lambda r, s: _stage_cost(r),
        "stage",
    ),
    PerCell("control_effort", "m^2/s^3, rad^2/s^3", "integral of |u|^2", lambda r, s: s.control_effort),
    PerCell("base_force", "N s", "integral of the norm of the base force", lambda r, s: s.base_force),
    PerCell("base_torque", "N m s", "integral of the magnitude of the base torque", lambda r, s: s.base_torque),
    PerCell(
        "variation_base_position",
        "m/s^2",
        "total variation of the base's linear acceleration",
        lambda r, s: s.variation.base_position,
    ),
    PerCell(
        "variation_base_angle",
        "rad/s^2",
        "total variation of the base's angular acceleration",
        lambda r, s: s.variation.base_angle,
    ),
    PerCell(
        "variation_joints", "rad/s^2", "total variation of the joints' acceleration", lambda r, s: s.variation.joints
    ),
    PerCell("solves", "1", "number of solves", lambda r, s: s.solves.count, whole=True),
    PerCell("iterations_median", "1", "median of the iterations of a solve", lambda r, s: s.solves.iterations),
    PerCell(
        "iterations_largest",
        "1",
        "largest number of iterations of a solve",
        lambda r, s: max(r["solver/iterations"], default=0),
        whole=True,
    ),
    PerCell("solve_time_median", "s", "median wall time of a solve", lambda r, s: s.solves.median),
    PerCell("solve_time_largest", "s", "longest wall time of a solve", lambda r, s: s.solves.largest),
    PerCell("appended", "1", "stages that entered the window", lambda r, s: s.appended, whole=True),
    PerCell(
        "postponed",
        "1",
        "samples at which a stage was seen, but the window with it had no solution",
        lambda r, s: s.postponed,
        whole=True,
    ),
    PerCell(
        "fallbacks",
        "1",
        "failed solves after which the shifted plan went on",
        lambda r, s: s.fallbacks,
        whole=True,
    ),
    PerCell(
        "basin_changes",
        "1",
        "windows in which another guess of the instants than the last plan's won",
        lambda r, s: s.basins or 0,
        whole=True,
    ),
)
"""What a run took."""

WHOLE_RUN = (*OUTCOME, *SPENT)
"""Everything that is known of a run to the end of its task."""


def _stage_cost(run: Run) -> np.ndarray:
    weights = run["cost/current_stage"] * float(np.asarray(run.attributes["sample_time"]))
    return np.bincount(run["window/first"], weights, minlength=len(run.stage_names))


def second_stage(index: int) -> tuple[PerCell, ...]:
    """Build the quantities of the second of two stages in a row, for a run that ends with it.

    Args:
        index: Its index.
    """

    def detected(run: Run, summary: Summary) -> int | None:
        """Return the first sample with the switch in its window."""
        first = run["window/first"]
        found = np.flatnonzero((first < index) & (first + run["window/count"] > index))
        return int(found[0]) if len(found) else None

    def detection_time(run: Run, summary: Summary) -> float:
        sample = detected(run, summary)
        return np.nan if sample is None else float(run.time[sample])

    def instant_at_detection(run: Run, summary: Summary) -> float:
        sample = detected(run, summary)
        return np.nan if sample is None else float(run["window/instants"][sample, index - 1])

    def final_error(run: Run, summary: Summary) -> float:
        """Read the error at the planned switch time, as logged; without one, compute it where the run ended."""
        if np.isnan(run.stages["switch_time"][index]):
            return np.nan
        planned = float(run["deviation/end"][-1, index]) if len(run.time) else np.nan
        return planned if np.isfinite(planned) else _error_at_end(run, index)

    return (
        PerCell("detection_time", "s", "first sample with the switch in the window", detection_time),
        PerCell("instant_at_detection", "s", "optimized switching instant at that sample", instant_at_detection),
        PerCell("switch_time", "s", "instant that ended each stage", lambda r, s: r.stages["switch_time"], "stage"),
        PerCell(
            "actual_start",
            "s",
            "actual start of the second stage",
            lambda r, s: r.stages["actual_start_by_epsilon"][index],
            "epsilon",
        ),
        PerCell(
            "completion_time",
            "s",
            "instant that ended the second stage",
            lambda r, s: r.stages["switch_time"][index],
        ),
        PerCell(
            "final_error",
            "1",
            "largest error of the second stage's end condition at its end, over its tolerance",
            final_error,
        ),
        *SPENT,
    )


def measure_run(run: Run) -> tuple[Row, str]:
    """Measure a run to the end of its task, with why it ended; a mission that fails is no failure to measure it."""
    return {**_row(WHOLE_RUN, run), "reason": summarize(run).reason}, ""


def measure_second_stage(index: int, run: Run) -> tuple[Row, str]:
    """Measure a run to the end of the second of two studied stages; it failed if it did not reach that."""
    reached = np.isfinite(run.stages["switch_time"][index])
    return _row(second_stage(index), run), "" if reached else summarize(run).reason


def _row(quantities: Sequence[PerCell], run: Run) -> Row:
    """Read quantities from a run; those along a coordinate without entries are left out."""
    summary = summarize(run)
    values = {quantity.name: quantity.value(run, summary) for quantity in quantities}
    return {name: value for name, value in values.items() if np.size(value)}
