"""A run's summary as sentences and rows of text, for tables in a terminal and on a page."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from psmpc_cli.logs.schema import PEAKS, SLIDING_PEAKS
from psmpc_cli.logs.summary import FAR_BEYOND, CaptureSummary, Largest, SolveSummary, Summary
from psmpc_cli.logs.verdicts import NearestParts, Verdict
from psmpc_cli.specs.object import GRASP_LOADS
from psmpc_cli.specs.task import NOTHING_TOUCHED

Row = tuple[str, ...]

EMPTY = ("", "-")
"""Cells without content."""

ROUNDING = 1e-9
"""A stage of one sample lasts this much less at most, by rounding [s]."""

DETAIL = "detail"
"""Marks what a short summary leaves out."""

ALONE = "alone"
"""Marks what a comparison leaves out."""


OF_PLAN = 0.95
"""From this share on a violation of a limit counts as the plan's alone, and to the rest of it as none of the plan's."""


def _solves(solves: SolveSummary) -> str:
    """Write median, 95th and 99th percentile and maximum of the wall times [ms]."""
    times = (solves.median, solves.p95, solves.p99, solves.largest)
    return " / ".join(f"{1e3 * time:.1f}" for time in times) if solves.count else "none"


def _largest(*found: Largest | None) -> str:
    """Write the largest values that there are, each with where and when."""
    return " / ".join(_one_of_largest(each) for each in found if each is not None)


def _one_of_largest(found: Largest) -> str:
    """Write a largest value with its unit, where and when."""
    unit = "" if found.unit == "1" else f" {found.unit}"
    return f"{found.where}: {found.value:.3g}{unit} at {found.time:.1f} s"


def _violations(*found: Largest) -> str:
    """Write violations of limits, each with what part of it the plan has."""
    return " / ".join(f"{_largest(each)}, {_cause(each)}" for each in found)


def _cause(violation: Largest) -> str:
    """Write whose a violation of a limit is, the plan's or that of the motion that follows it."""
    share = violation.planned / violation.value
    if share > OF_PLAN:
        return "as planned"
    return "off the plan" if share < 1 - OF_PLAN else f"{violation.planned:.3g} {violation.unit} of it planned"


def _beyond_limits(summary: Summary) -> str:
    """Write the largest violations of limits, with what the closing of grippers has to do with them."""
    closing = summary.closing_samples
    at_closing = [each.sample in closing and each.where.endswith("velocity") for each in summary.beyond_limits]
    text = _violations(*summary.beyond_limits) or "none"
    if not any(at_closing) or summary.capture is None:
        return text
    speeds = _closing_speeds(summary.capture)
    reason = f"the grasps stop grippers that move by {speeds} against the object at once, which no plan contains"
    which = "" if all(at_closing) else f"{summary.beyond_limits[at_closing.index(True)].where} "
    others = _violations(*summary.beyond_limits_elsewhere) or "none"
    return f"{text}; {which}as the grippers close: {reason}; in other samples: {others}"


def _closing_speeds(capture: CaptureSummary) -> str:
    """Write how fast grippers moved against their grasps when they were to close."""
    _, _, v, omega = capture.missed_by
    return f"{1e3 * v:.1f} mm/s, {math.degrees(omega):.2f} deg/s"


def _margin(summary: Summary, kind: str) -> str:
    """Write the smallest margin to a kind of limit, in percent of the limit, and its coordinate."""
    found = (limit for limit in summary.limits if limit.kind == kind)
    return next(
        (f"{100 * each.relative:.3f} % ({each.margin:.1e} {each.unit}) {each.coordinate}" for each in found), ""
    )


def _closing_error(capture: CaptureSummary | None) -> str:
    """Write by how much grippers were apart from their grasps when they were to close."""
    if capture is None or math.isnan(capture.missed_by[0]):
        return ""
    r, phi, *_ = capture.missed_by
    apart = f"{1e3 * r:.1f} mm, {math.degrees(phi):.2f} deg, {_closing_speeds(capture)}"
    return apart if math.isfinite(capture.closed_at) else f"{apart}: outside their envelope"


def _loads(capture: CaptureSummary | None) -> str:
    """Write the largest loads on a grasp."""
    if capture is None:
        return ""
    return ", ".join(f"{load} {capture.loads[load]:.3g} {unit}" for load, unit in GRASP_LOADS.items())


ACCELERATIONS = ("base_acceleration", "base_angular_acceleration", "joint_acceleration")
"""The commanded accelerations among the peaks: the base's linear and angular one, and a joint's."""

WHY_RATES_EXCEED = (
    "cause of the exceeded velocities: where nothing bounds forces or accelerations, velocities jump within a tick, "
    "and joints of a robot that is not as the controller knows it are dragged along; less so with limits "
    "(docs/mobility.md)"
)
"""What a study of uncertain runs without limits says of velocities beyond theirs; docs/monte_carlo.md has numbers."""

NO_LIMITS = "limits of forces and accelerations: none declared: nothing bounds the largest values above"
"""Remark on runs of a task that declares none."""


def _peaks(summary: Summary, *names: str) -> str:
    """Write peaks of one row; nothing where they are not known, or all 0, those of a base without thrusters."""
    values = [summary.peaks[name] for name in names]
    return " / ".join(f"{value:.3g}" for value in values) if all(map(math.isfinite, values)) and any(values) else ""


def describe_tightest_force(summary: Summary) -> str:
    """Write which commanded force came nearest to its limit, or farthest beyond it, in percent of it, and when."""
    force = summary.tightest_force
    return "" if force is None else f"{force.where}: {100 * force.value:.1f} % at {force.time:.1f} s"


def _nearest(parts: NearestParts) -> str:
    """Write how near two parts came to each other, when, and how far that is from what the task keeps."""
    return f"{parts.pair}: {1e3 * parts.distance:.1f} mm at {parts.time:.1f} s, margin {1e3 * parts.margin:.1f} mm"


def _smallest_distance(summary: Summary) -> str:
    """Write which two parts that keep clear came nearest to each other."""
    return "" if summary.clearance is None else _nearest(summary.clearance.nearest)


def _smallest_margin(summary: Summary) -> str:
    """Write which two parts came nearest to their margin, or farthest inside it, where it is not the nearest two."""
    found = summary.clearance
    return "" if found is None or found.tightest == found.nearest else _nearest(found.tightest)


def _departure(capture: CaptureSummary | None) -> str:
    """Write when and how an object left the grippers, or is held at the end, and how far from its destination."""
    held_to_the_end = capture is not None and math.isnan(capture.left_at) and math.isfinite(capture.distance)
    if capture is None or (math.isnan(capture.left_at) and not held_to_the_end):
        return ""
    how = f"LOST by {', '.join(capture.lost)}" if capture.lost else "let go"
    how = "still held" if held_to_the_end else f"{how} at {capture.left_at:.2f} s"
    where = ""
    if not math.isnan(capture.distance):
        where = f"{1e3 * capture.distance:.1f} mm and {math.degrees(capture.angle):.2f} deg from its destination, "
    return f"{how}, {where}at {1e3 * capture.speed:.1f} mm/s"


def _end_errors(summary: Summary) -> str:
    """Write the last stage's end errors over tolerance, of the state that was seen and of the true one."""
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
    ("largest commanded force, of its limit", describe_tightest_force, 0, ""),
    ("forces cut at their limits [% of the time]", lambda run: 100 * run.saturated, 1, ""),
    (f"forces beyond {100 * FAR_BEYOND:g} % of a limit [% of the time]", lambda run: 100 * run.far_beyond, 1, ""),
    ("smallest distance of parts, any tick", _smallest_distance, 0, ""),
    ("smallest margin of clearance, any tick", _smallest_margin, 0, ""),
    ("farthest beyond a limit, any tick", _beyond_limits, 0, ALONE),
    ("farthest off the plan in a sample", lambda run: _largest(*run.off_plan), 0, DETAIL + ALONE),
    ("end error over tolerance, at switches", lambda run: _largest(run.end_condition), 0, DETAIL),
    ("end error over tolerance, at the end", _end_errors, 0, ALONE),
    ("grippers from their grasps at closing", lambda run: _closing_error(run.capture), 0, ""),
    ("largest filtered loads on a grasp", lambda run: _loads(run.capture), 0, ""),
    ("object leaves the grippers", lambda run: _departure(run.capture), 0, ""),
    ("control effort, sum of T_s |dv/T_s|^2", lambda run: run.control_effort, 2, ""),
    ("integral of |u|^2", lambda run: run.squared_acceleration, 2, DETAIL),
    ("largest force, torque of the base [N, N m]", lambda run: _peaks(run, "base_force", "base_torque"), 0, ""),
    ("largest torque of a joint [N m]", lambda run: run.peaks["joint_torque"], 2, ""),
    ("largest force, acceleration of a sliding joint [N, m/s^2]", lambda run: _peaks(run, *SLIDING_PEAKS), 0, ""),
    ("largest accelerations [m/s^2, rad/s^2, rad/s^2]", lambda run: _peaks(run, *ACCELERATIONS), 0, ""),
    ("base thrusters, force [N s]", lambda run: run.base_force or math.nan, 2, ""),
    ("base thrusters, torque [N m s]", lambda run: run.base_torque or math.nan, 2, ""),
    ("variation of u, base position [m/s^2]", lambda run: run.variation_base_position, 2, DETAIL),
    ("variation of u, base angle [rad/s^2]", lambda run: run.variation_base_angle, 2, DETAIL),
    ("variation of u, joints [rad/s^2]", lambda run: run.variation_joints, 2, DETAIL),
    ("variation of u, sliding joints [m/s^2]", lambda run: run.variation_sliding or math.nan, 2, DETAIL),
    ("drift of momentum [N s]", lambda run: number(run.momentum_error, 1, "e"), 0, DETAIL),
    ("drift of the energy balance [J]", lambda run: number(run.energy_error, 1, "e"), 0, DETAIL),
)
"""Rows of a run's summary and of a comparison: name, value (a comparison shows the differences of numbers), decimals,
and where it is shown: `DETAIL`, not in a short summary; `ALONE`, not in a comparison."""


def number(value: float, digits: int, form: str = "f") -> str:
    """Write a number with so many decimals, a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}{form}}"


def filled_columns(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> tuple[Sequence[str], list[Sequence[Any]]]:
    """Leave out the columns of a table that have no content in any row; the first one and a table without rows stay."""
    cells = list(rows)
    kept = [i for i in range(len(headings)) if i == 0 or not cells or any(row[i] not in EMPTY for row in cells)]
    return [headings[i] for i in kept], [[row[i] for i in kept] for row in cells]


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
    """Write whether the mission succeeded, what touched, why the run ended, and which monitors did not hold."""
    broken = {each.name: each.instead for each in summary.monitors if each.is_judged and not each.held}
    outcomes = {True: "succeeded", False: "failed", None: "not judged"}
    outcome = outcomes[summary.succeeded] if summary.ended else "not finished"
    touch = broken.pop(NOTHING_TOUCHED) if summary.clearance is not None and summary.clearance.touched else ""
    first = f"{touch}; " if touch else ""
    monitors = f"; monitor did not hold: {', '.join(broken)}" if broken else ""
    return f"mission {outcome}: {first}{summary.reason}{monitors}, after {summary.duration:.1f} s"


def describe_brief_stages(summary: Summary) -> str:
    """Name the stages that lasted less than a sample, which tables round to nothing; empty if there is none."""
    brief = [stage for stage in summary.stages if stage.duration < summary.sample_time - ROUNDING]
    lasted = ", ".join(f"stage {stage.name} lasted {1e3 * stage.duration:.2g} ms" for stage in brief)
    return f"{lasted}, less than a sample of {1e3 * summary.sample_time:g} ms" if brief else ""


def describe_forces(summary: Summary) -> str:
    """Write how near forces come to their limits, or what a run without limits asks for; empty if it is not known."""
    if force := describe_tightest_force(summary):
        cut = number(100 * summary.saturated, 1)
        far = number(100 * summary.far_beyond, 1)
        beyond = f"beyond {100 * FAR_BEYOND:g} % of a limit {far} % of the time"
        return f"largest commanded force, of its limit: {force}; forces cut {cut} % of the time, {beyond}"
    peaks = {name: peak for name, peak in summary.peaks.items() if math.isfinite(peak) and peak > 0}
    if summary.limits_dynamics or not peaks:
        return ""
    units = {name: unit for name, (unit, _) in (PEAKS | SLIDING_PEAKS).items()}
    asked_for = ", ".join(f"{name.replace('_', ' ')} {peak:.3g} {units[name]}" for name, peak in peaks.items())
    return f"no limit of forces or accelerations is declared; the largest are: {asked_for}"


def describe_verdict(verdict: Verdict) -> str:
    """Write whether a monitor held, what happened instead where it did not, and its smallest margin."""
    if not verdict.is_judged:
        return "not judged"
    outcome = "held"
    if not verdict.held:
        outcome = f"BROKEN: {verdict.instead}" if verdict.instead else f"BROKEN at {verdict.broken_at:.1f} s"
    unit = "" if verdict.unit == "1" else f" {verdict.unit}"
    margin = f", margin {verdict.margin:.3f}{unit}" if math.isfinite(verdict.margin) else ""
    details = f" ({verdict.details})" if verdict.details else ""
    return f"{outcome}{margin}{details}"
