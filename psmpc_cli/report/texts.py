"""A run's summary as sentences and rows of text, for tables in a terminal and on a page."""

import math
from collections.abc import Callable, Iterator

from psmpc_cli.logs.summary import CaptureSummary, Largest, SolveSummary, Summary, Verdict

Row = tuple[str, ...]

DETAIL = "detail"
ALONE = "alone"


def _solves(solves: SolveSummary) -> str:
    times = (solves.median, solves.p95, solves.p99, solves.largest)
    return " / ".join(f"{1e3 * time:.1f}" for time in times) if solves.count else "none"


def _largest(*found: Largest | None) -> str:
    return " / ".join(f"{each.where}: {each.value:.3g} at {each.time:.1f} s" for each in found if each is not None)


def _margin(summary: Summary, kind: str) -> str:
    """Write the smallest margin to a kind of limit, in percent of the limit, and its coordinate."""
    found = (limit for limit in summary.limits if limit.kind == kind)
    return next((f"{100 * each.relative:.3f} % ({each.margin:.1e}) {each.coordinate}" for each in found), "")


def _missed(capture: CaptureSummary | None) -> str:
    """Write by how much grippers were apart from their grasps when they were to close."""
    if capture is None or math.isnan(capture.missed_by[0]):
        return ""
    r, phi, v, omega = capture.missed_by
    apart = f"{1e3 * r:.1f} mm, {math.degrees(phi):.2f} deg, {1e3 * v:.1f} mm/s, {math.degrees(omega):.2f} deg/s"
    return apart if math.isfinite(capture.closed_at) else f"{apart}: outside their envelope"


def _left(capture: CaptureSummary | None) -> str:
    """Write when and how an object left the grippers, and how far from its destination."""
    if capture is None or math.isnan(capture.left_at):
        return ""
    how = f"LOST by {', '.join(capture.lost)}" if capture.lost else "let go"
    where = f"{1e3 * capture.distance:.1f} mm and {math.degrees(capture.angle):.2f} deg from its destination, "
    where = "" if math.isnan(capture.distance) else where
    return f"{how} at {capture.left_at:.2f} s, {where}at {1e3 * capture.speed:.1f} mm/s"


def _end_errors(summary: Summary) -> str:
    if summary.end_errors is None:
        return ""
    return "{:.4f} as the controller saw it, {:.4f} true".format(*summary.end_errors)


MEASURES: tuple[tuple[str, Callable[[Summary], float | str], int, str], ...] = (
    ("solve time, median / p95 / p99 / max [ms]", lambda run: _solves(run.solves), 0, ""),
    ("the same, windows with a switch [ms]", lambda run: _solves(run.switching_solves), 0, DETAIL),
    ("solver and plant", lambda run: "compiled code" if run.compiled else "interpreted", 0, ALONE),
    ("solves", lambda run: run.solves.count, 0, DETAIL),
    ("iterations of a solve, median", lambda run: run.solves.iterations, 0, DETAIL),
    ("solves longer than a sample", lambda run: run.missed, 0, ""),
    ("failed solves", lambda run: run.failed_solves, 0, ""),
    ("samples not measured", lambda run: run.unmeasured or math.nan, 0, ""),
    ("levels not solved", lambda run: math.nan if run.unsolved_levels is None else run.unsolved_levels, 0, ""),
    ("stages appended", lambda run: run.appended, 0, DETAIL),
    ("stages postponed", lambda run: run.postponed, 0, DETAIL),
    ("other guesses of the switch times chosen", lambda run: math.nan if run.basins is None else run.basins, 0, ""),
    ("tightest position margin, of the limit", lambda run: _margin(run, "position"), 0, ""),
    ("tightest velocity margin, of the limit", lambda run: _margin(run, "velocity"), 0, ""),
    ("farthest beyond a limit, any tick", lambda run: _largest(*run.beyond_limits) or "none", 0, ALONE),
    ("farthest off the plan in a sample", lambda run: _largest(*run.off_plan), 0, DETAIL + ALONE),
    ("end error over tolerance, at switches", lambda run: _largest(run.end_condition), 0, DETAIL),
    ("end error over tolerance, at the end", _end_errors, 0, ALONE),
    ("grippers from their grasps at closing", lambda run: _missed(run.capture), 0, ""),
    ("largest filtered pull on a grasp [N]", lambda run: math.nan if run.capture is None else run.capture.pull, 2, ""),
    ("object leaves the grippers", lambda run: _left(run.capture), 0, ""),
    ("control effort, integral of |u|^2", lambda run: run.control_effort, 2, ""),
    ("base thrusters, force [N s]", lambda run: run.base_force, 2, ""),
    ("base thrusters, torque [N m s]", lambda run: run.base_torque, 2, ""),
    ("variation of u, base position [m/s^2]", lambda run: run.variation_base_position, 2, DETAIL),
    ("variation of u, base angle [rad/s^2]", lambda run: run.variation_base_angle, 2, DETAIL),
    ("variation of u, joints [rad/s^2]", lambda run: run.variation_joints, 2, DETAIL),
    ("drift of momentum [N s]", lambda run: number(run.momentum_error, 1, "e"), 0, DETAIL),
    ("drift of the energy balance [J]", lambda run: number(run.energy_error, 1, "e"), 0, DETAIL),
)
"""Rows of a run's summary and of a comparison: name, value (a comparison shows the differences of numbers), decimals,
and where it is shown: `DETAIL`, not in a short summary; `ALONE`, not in a comparison."""


def number(value: float, digits: int, form: str = "f") -> str:
    """Write a number with so many decimals, a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}{form}}"


def stage_rows(summary: Summary) -> tuple[Row, list[Row]]:
    """Build the table of a run's stages: its headings, and a row for each stage."""
    headings = ("stage", "priority", "actual start [s]", "published start", "ends [s]", "published end")
    rows: list[Row] = [
        (
            stage.name,
            f"{stage.priority:g}",
            number(stage.actual_start, 2) + (" (early)" if stage.early else ""),
            number(stage.published_start, 1),
            number(stage.switch_time, 2),
            number(stage.published_switch, 1),
            number(distance, 3),
        )
        for stage, distance in zip(summary.stages, summary.distances, strict=True)
    ]
    return (*headings, "grippers apart [m]"), rows


def measure_rows(summary: Summary, verbose: bool = False) -> Iterator[Row]:
    """Yield what was measured of a run, a name and a value each; all of it if `verbose`."""
    for label, of, digits, where in MEASURES:
        value = of(summary)
        text = value if isinstance(value, str) else number(value, digits)
        if (verbose or DETAIL not in where) and text not in ("", "-"):
            yield label, text
    for verdict in summary.monitors:
        yield f"monitor: {verdict.name}", describe_verdict(verdict)


def describe_mission(summary: Summary) -> str:
    """Write whether the mission succeeded, why the run ended, and which monitors did not hold."""
    outcome = ("succeeded" if summary.succeeded else "failed") if summary.ended else "not finished"
    broken = [verdict.name for verdict in summary.monitors if not (verdict.held or math.isnan(verdict.broken_at))]
    monitors = f"; monitor did not hold: {', '.join(broken)}" if broken else ""
    return f"mission {outcome}: {summary.reason}{monitors}, after {summary.duration:.1f} s"


def describe_verdict(verdict: Verdict) -> str:
    """Write whether a monitor held, and its smallest margin."""
    if verdict.held:
        return f"held, margin {verdict.margin:.3f}"
    return (
        "not judged" if math.isnan(verdict.broken_at) else f"BROKEN at {verdict.broken_at:.1f} s ({verdict.margin:.3f})"
    )
