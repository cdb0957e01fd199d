"""A run's summary as sentences and rows of text, for tables in a terminal and on a page."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Flag
from typing import Any

from psmpc_cli.logs.numbers import EMPTY, TIME, format_number, with_unit
from psmpc_cli.logs.schema import EFFORT_UNITS, PEAKS, SLIDING_PEAKS
from psmpc_cli.logs.summary import FAR_BEYOND, WARNED_OF, CaptureSummary, Largest, SolveSummary, Summary
from psmpc_cli.logs.verdicts import NearestParts, Verdict
from psmpc_cli.specs.document import counted
from psmpc_cli.specs.object import GRASP_LOADS
from psmpc_cli.specs.task import NOTHING_TOUCHED

Row = tuple[str, ...]

ROUNDING = 1e-9
"""A stage of one sample lasts this much less at most, by rounding [s]."""

OF_PLAN = 0.95
"""From this share on a violation of a limit counts as the plan's alone, and to the rest of it as none of the plan's."""


def _describe_load(run: Summary) -> float | str:
    """Write the mass that a load was found to have, and its standard deviation [kg]; NaN of none."""
    if run.load is None:
        return math.nan
    mass, deviation = run.load
    return f"{format_number(mass, 0.01)} ± {format_number(deviation, 0.01)}"


def _describe_delay(run: Summary) -> float | str:
    """Write the delay that commands were expected to have, and its standard deviation [ms]; NaN of none."""
    if run.delay is None or run.delay[0] == 0.0:
        return math.nan
    delay, deviation = (1000 * seconds for seconds in run.delay)
    return f"{format_number(delay, 1.0)} ± {format_number(deviation, 0.1)}" if deviation else format_number(delay, 1.0)


def _describe_solve_times(solves: SolveSummary) -> str:
    """Write median, 95th and 99th percentile and maximum of the wall times [ms]."""
    times = (solves.median, solves.p95, solves.p99, solves.largest)
    return " / ".join(format_number(1e3 * time) for time in times) if solves.count else ""


def _describe_largest(*found: Largest | None) -> str:
    """Write the largest values that there are, each with where and when."""
    return " / ".join(_describe_one(each) for each in found if each is not None)


def _describe_one(found: Largest) -> str:
    """Write a largest value with its unit, where and when."""
    return f"{found.where}: {with_unit(format_number(found.value), found.unit)} at {format_number(found.time, 0.1)} s"


def _describe_violations(*found: Largest) -> str:
    """Write violations of limits, each with what part of it the plan has."""
    return " / ".join(f"{_describe_largest(each)}, {_describe_cause(each)}" for each in found)


def _describe_cause(violation: Largest) -> str:
    """Write whose a violation of a limit is, the plan's or that of the motion that follows it."""
    share = violation.planned / violation.value
    if share > OF_PLAN:
        return "as planned"
    if share < 1 - OF_PLAN:
        return "off the plan"
    return f"{format_number(violation.planned)} {violation.unit} of it planned"


def _describe_limit_violations(summary: Summary) -> list[str]:
    """Write the largest violations of position and velocity limits, and whether the closing of grippers explains them.

    When grippers close on a moving object, their velocity against it ends at once, and other velocities jump with it.
    A violation of a velocity limit at such a sample is no fault of the controller. It is named with this reason, and
    followed by the largest violations in all other samples.

    Returns:
        A text for each of `summary.beyond_limits`, in their order; none if all limits were kept.
    """
    texts = []
    for violation in summary.beyond_limits:
        text = _describe_violations(violation)
        is_at_closing = violation.sample in summary.closing_samples and violation.where.endswith("velocity")
        if is_at_closing:
            speeds = _describe_object(summary, _describe_closing_speeds)
            reason = (
                f"the grasps stop grippers that move by {speeds} against the object at once, which no plan contains"
            )
            violations_elsewhere = _describe_violations(*summary.beyond_limits_elsewhere) or "none"
            text = f"{text}; as the grippers close: {reason}; in other samples: {violations_elsewhere}"
        texts.append(text)
    return texts


def _describe_object(summary: Summary, text: Callable[[CaptureSummary], str]) -> str:
    """Write what became of an object with a mass; nothing without one."""
    return text(summary.capture) if summary.capture else ""


def _describe_closing_speeds(outcome: CaptureSummary) -> str:
    """Write how fast grippers moved against their grasps when they were to close."""
    _, _, v, omega = outcome.missed_by
    return f"{format_number(1e3 * v)} mm/s, {format_number(math.degrees(omega))} deg/s"


def _describe_margin(summary: Summary, kind: str) -> str:
    """Write the smallest margin to a kind of limit, in percent of the limit, and its coordinate."""
    limits = (limit for limit in summary.limits if limit.kind == kind)
    return next(
        (
            f"{format_number(100 * each.relative)} % ({format_number(each.margin)} {each.unit}) {each.coordinate}"
            for each in limits
        ),
        "",
    )


def _describe_closing_error(outcome: CaptureSummary) -> str:
    """Write by how much grippers were apart from their grasps when they were to close."""
    r, phi, *_ = outcome.missed_by
    if math.isnan(r):
        return ""
    apart = f"{format_number(1e3 * r)} mm, {format_number(math.degrees(phi))} deg, {_describe_closing_speeds(outcome)}"
    return apart if math.isfinite(outcome.closed_at) else f"{apart}: outside their envelope"


def _describe_loads(outcome: CaptureSummary) -> str:
    """Write the largest loads on a grasp."""
    return ", ".join(f"{load} {format_number(outcome.loads[load])} {unit}" for load, unit in GRASP_LOADS.items())


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


def _describe_peaks(summary: Summary, *names: str) -> str:
    """Write peaks of one row; nothing where they are not known, or all 0, those of a base without thrusters."""
    values = [summary.peaks[name] for name in names]
    if not (all(map(math.isfinite, values)) and any(values)):
        return ""
    return " / ".join(f"{format_number(summary.peaks[name])} {(PEAKS | SLIDING_PEAKS)[name][0]}" for name in names)


def describe_tightest_force(summary: Summary) -> str:
    """Write which commanded force came nearest to its limit, or farthest beyond it, in percent of it, and when."""
    force = summary.tightest_force
    return (
        ""
        if force is None
        else f"{force.where}: {format_number(100 * force.value, 0.1)} % at {format_number(force.time, 0.1)} s"
    )


def _describe_condition(summary: Summary) -> str:
    """Write the largest condition number of J_C under the law in task space, and when."""
    largest = summary.largest_condition
    return "" if largest is None else f"{format_number(largest.value)} at {format_number(largest.time, 0.1)} s"


def _describe_thrusters(summary: Summary) -> str:
    """Write how often thrusters fired, their impulse and the propellant that they used."""
    fired = summary.thrusters
    if fired is None:
        return ""
    propellant = "" if math.isnan(fired.propellant) else f", {format_number(1e3 * fired.propellant)} g of propellant"
    return f"{format_number(fired.impulse)} N s in {counted(fired.firings, 'firing', 'firings')}{propellant}"


def _describe_impulse(summary: Summary, kind: str) -> str:
    """Write what thrusters `owed` or `refused` of the impulse that was wanted of them."""
    if summary.thrusters is None:
        return ""
    force, torque = getattr(summary.thrusters, kind)
    return f"{format_number(force)} N s, {format_number(torque)} N m s"


def _describe_shut_thrusters(summary: Summary) -> str:
    """Write which thrusters were shut because of their plumes, and for how long."""
    if summary.thrusters is None or summary.thrusters.shut is None:
        return ""
    of_each = (f"{name} for {format_number(seconds, 0.1)} s" for name, seconds in summary.thrusters.shut.items())
    return ", ".join(of_each) or "none"


def _describe_floating(summary: Summary) -> str:
    """Write by how much momentum and base changed in the stages in which nothing pushed the base."""
    return "; ".join(
        f"{stage.name}: {format_number(stage.linear, 1e-4)} N s, {format_number(stage.angular, 1e-4)} N m s, "
        f"base by {format_number(1e3 * stage.distance, 0.1)} mm, {format_number(math.degrees(stage.angle), 0.1)} deg"
        for stage in summary.floating
    )


def _describe_wheels(largest: Largest | None) -> str:
    """Write what part of its limit a wheel came to, and when."""
    return (
        ""
        if largest is None
        else f"{largest.where}: {format_number(100 * largest.value, 0.1)} % at {format_number(largest.time, 0.1)} s"
    )


def _describe_returns(returned_at: Sequence[float]) -> str:
    """Write how often and when the sequence returned to an earlier stage to try again."""
    if not returned_at:
        return ""
    times = ", ".join(f"{format_number(time, 0.1)} s" for time in returned_at)
    return f"{counted(len(returned_at), 'time', 'times')}: at {times}"


def _describe_nearest(parts: NearestParts) -> str:
    """Write how near two parts came to each other, when, and how far that is from what the task keeps."""
    return (
        f"{parts.pair}: {format_number(1e3 * parts.distance, 0.1)} mm at {format_number(parts.time, 0.1)} s, "
        f"margin {format_number(1e3 * parts.margin, 0.1)} mm"
    )


def _describe_smallest_distance(summary: Summary) -> str:
    """Write which two parts that keep clear came nearest to each other."""
    return "" if summary.clearance is None else _describe_nearest(summary.clearance.nearest)


def _describe_smallest_margin(summary: Summary) -> str:
    """Write which two parts came nearest to their margin, or farthest inside it, where it is not the nearest two."""
    clearance = summary.clearance
    return "" if clearance is None or clearance.tightest == clearance.nearest else _describe_nearest(clearance.tightest)


def _describe_departure(outcome: CaptureSummary) -> str:
    """Write when and how an object left the grippers, or is held at the end, and how far from its destination."""
    has_left = math.isfinite(outcome.left_at)
    has_distance = math.isfinite(outcome.distance)
    if not (has_left or has_distance):
        return ""
    how = f"LOST by {', '.join(outcome.lost)}" if outcome.lost else "let go"
    how = f"{how} at {format_number(outcome.left_at, TIME)} s" if has_left else "still held"
    distance = f"{format_number(1e3 * outcome.distance)} mm and {format_number(math.degrees(outcome.angle))} deg"
    where = f"{distance} from its destination, " if has_distance else ""
    return f"{how}, {where}at {format_number(1e3 * outcome.speed)} mm/s"


def _describe_end_errors(summary: Summary) -> str:
    """Write the last stage's end errors over tolerance, of the state that was seen and of the true one."""
    if summary.end_errors is None:
        return ""
    seen, true = summary.end_errors
    return f"{format_number(seen)} as the controller saw it, {format_number(true)} true"


class Shown(Flag):
    """Where a measure is shown besides the whole summary of a run.

    Attributes:
        BRIEF: In the short summary.
        COMPARED: In the whole comparison.
    """

    NOWHERE = 0
    BRIEF = 1
    COMPARED = 2


BOTH = Shown.BRIEF | Shown.COMPARED


@dataclass(frozen=True)
class Measure:
    """A row of a run's summary and of a comparison.

    Attributes:
        label: What is measured.
        read: Reads it from a summary, as a number or a text; a comparison shows differences of numbers.
        unit: Unit of the number, or of the numbers in the text.
        shown: Where it is shown besides the whole summary.
        resolution: Resolution to which a number is written, as for `format_number`.
    """

    label: str
    read: Callable[[Summary], float | str]
    unit: str = ""
    shown: Shown = Shown.COMPARED
    resolution: float = 0.0

    @property
    def heading(self) -> str:
        """Its label with its unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def text(self, summary: Summary) -> str:
        """Write what was measured of a run, with its unit."""
        value = self.read(summary)
        return with_unit(value if isinstance(value, str) else format_number(value, self.resolution), self.unit)


FORCES_FAR_BEYOND = f"forces beyond {100 * FAR_BEYOND:g} % of a limit"

LEVELS_RAISED = "levels whose cost later ones raised beyond the tolerance"

MEASURES: tuple[Measure, ...] = (
    Measure("end of the run", lambda run: run.reason, shown=Shown.NOWHERE),
    Measure("solve time, median / p95 / p99 / max", lambda run: _describe_solve_times(run.solves), "ms", BOTH),
    Measure("the same, windows with a switch", lambda run: _describe_solve_times(run.switching_solves), "ms"),
    Measure("solver and plant", lambda run: "compiled code" if run.compiled else "interpreted", shown=Shown.NOWHERE),
    Measure("solves", lambda run: run.solves.count),
    Measure("iterations of a solve, median", lambda run: run.solves.iterations, resolution=0.5),
    Measure("solves longer than a sample", lambda run: run.missed),
    Measure("failed solves", lambda run: run.failed_solves),
    Measure("samples not measured", lambda run: run.unmeasured or math.nan),
    Measure("delay of commands, at the end", _describe_delay, "ms", BOTH),
    Measure("estimated mass of the load", _describe_load, "kg", BOTH),
    Measure("levels not solved", lambda run: math.nan if run.unsolved_levels is None else run.unsolved_levels),
    Measure("largest rise of a level's cost by later levels", lambda run: 100 * run.level_rise, "%", resolution=1e-3),
    Measure(LEVELS_RAISED, lambda run: math.nan if run.raised_levels is None else run.raised_levels),
    Measure("stages appended", lambda run: run.appended),
    Measure("stages postponed", lambda run: run.postponed),
    Measure("other guesses of the switch times chosen", lambda run: math.nan if run.basins is None else run.basins),
    Measure("tightest position margin, of the limit", lambda run: _describe_margin(run, "position")),
    Measure("tightest velocity margin, of the limit", lambda run: _describe_margin(run, "velocity")),
    Measure("largest commanded force, of its limit", describe_tightest_force, shown=BOTH),
    Measure("forces cut at their limits", lambda run: 100 * run.saturated, "% of the time", resolution=0.1),
    Measure(FORCES_FAR_BEYOND, lambda run: 100 * run.far_beyond, "% of the time", resolution=0.1),
    Measure(
        "largest momentum of a wheel, of its limit",
        lambda run: "" if run.wheels is None else _describe_wheels(run.wheels.momentum),
        shown=BOTH,
    ),
    Measure(
        "largest torque of a wheel's motor, of its limit",
        lambda run: "" if run.wheels is None else _describe_wheels(run.wheels.torque),
    ),
    Measure("largest condition number of J_C", _describe_condition, shown=BOTH),
    Measure("smallest distance of parts, any tick", _describe_smallest_distance, shown=BOTH),
    Measure("smallest margin of clearance, any tick", _describe_smallest_margin),
    Measure(
        "farthest beyond a limit, any tick",
        lambda run: " / ".join(_describe_limit_violations(run)) or "none",
        "",
        Shown.NOWHERE,
    ),
    Measure("farthest off the plan in a sample", lambda run: _describe_largest(*run.off_plan), shown=Shown.NOWHERE),
    Measure("end error over tolerance, at switches", lambda run: _describe_largest(run.end_condition)),
    Measure("end error over tolerance, at the end", _describe_end_errors, shown=Shown.NOWHERE),
    Measure("grasp tried again", lambda run: _describe_returns(run.returned_at), shown=BOTH),
    Measure("grippers from their grasps at closing", lambda run: _describe_object(run, _describe_closing_error)),
    Measure("largest filtered loads on a grasp", lambda run: _describe_object(run, _describe_loads)),
    Measure("object leaves the grippers", lambda run: _describe_object(run, _describe_departure), shown=BOTH),
    Measure("control effort, sum of T_s |dv/T_s|^2", lambda run: run.control_effort, EFFORT_UNITS, BOTH),
    Measure("integral of |u|^2", lambda run: run.squared_acceleration, EFFORT_UNITS),
    Measure(
        "largest force, torque of the base", lambda run: _describe_peaks(run, "base_force", "base_torque"), shown=BOTH
    ),
    Measure("largest torque of a joint", lambda run: run.peaks["joint_torque"], "N m"),
    Measure("largest force, acceleration of a sliding joint", lambda run: _describe_peaks(run, *SLIDING_PEAKS)),
    Measure("largest accelerations", lambda run: _describe_peaks(run, *ACCELERATIONS)),
    Measure("base thrusters, force", lambda run: run.base_force or math.nan, "N s"),
    Measure("base thrusters, torque", lambda run: run.base_torque or math.nan, "N m s"),
    Measure("thrusters, impulse", _describe_thrusters, shown=BOTH),
    Measure("thrusters shut because of plumes", _describe_shut_thrusters, shown=BOTH),
    Measure("largest impulse wanted and not yet given", lambda run: _describe_impulse(run, "owed")),
    Measure("impulse wanted that no thrusts can give", lambda run: _describe_impulse(run, "refused")),
    Measure("changes of momentum, and of the base, where it floats", _describe_floating, shown=BOTH),
    Measure("variation of u, base position", lambda run: run.variation_base_position, "m/s^2"),
    Measure("variation of u, base angle", lambda run: run.variation_base_angle, "rad/s^2"),
    Measure("variation of u, joints", lambda run: run.variation_joints, "rad/s^2"),
    Measure("variation of u, sliding joints", lambda run: run.variation_sliding or math.nan, "m/s^2"),
    Measure("drift of momentum", lambda run: run.momentum_error, "N s"),
    Measure("drift of the energy balance", lambda run: run.energy_error, "J"),
)
"""Rows of a run's summary and of a comparison."""


def filled_columns(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> tuple[Sequence[str], list[Sequence[Any]]]:
    """Leave out the columns of a table that have no content in any row; the first one and a table without rows stay."""
    cells = list(rows)
    kept = [i for i in range(len(headings)) if i == 0 or not cells or any(row[i] not in EMPTY for row in cells)]
    return [headings[i] for i in kept], [[row[i] for i in kept] for row in cells]


def stage_rows(summary: Summary) -> tuple[Row, list[Row]]:
    """Build the table of a run's stages: when each started and ended, beside the times that the paper publishes.

    A run may return to an earlier stage to try again, for instance when a grasp was lost. Then each row says which try
    of the stage its times are of.

    Args:
        summary: Summary of the run.

    Returns:
        The headings, and a row of texts for each stage. A text is empty where nothing is known.
    """
    headings = (
        "stage",
        "try",
        "priority",
        "actual start [s]",
        "published start [s]",
        "ends [s]",
        "published end [s]",
        "grippers apart [m]",
    )
    tried_again = bool(summary.returned_at)
    rows: list[Row] = [
        (
            stage.name,
            f"{stage.tries} of {1 + len(summary.returned_at)}" if tried_again else "",
            f"{stage.priority:g}",
            format_number(stage.actual_start, TIME) + (" (early)" if stage.early else ""),
            format_number(stage.published_start, 0.1),
            format_number(stage.switch_time, TIME),
            format_number(stage.published_switch, 0.1),
            format_number(distance, 0.001),
        )
        for stage, distance in zip(summary.stages, summary.distances, strict=True)
    ]
    return headings, rows


def measure_rows(summary: Summary) -> Iterator[Row]:
    """Yield all that was measured of a run, a name and a value with its unit each."""
    for measure in MEASURES:
        if (text := measure.text(summary)) not in EMPTY:
            yield measure.label, text
    for verdict in summary.monitors:
        yield f"monitor: {verdict.name}", describe_verdict(verdict)


def brief_measures(summary: Summary) -> Iterator[str]:
    """Yield what a short summary says of a run besides its stages, a line each."""
    for measure in MEASURES:
        if Shown.BRIEF in measure.shown and (text := measure.text(summary)) not in EMPTY:
            yield f"{measure.label}: {text}"


def describe_mission(summary: Summary) -> str:
    """Write whether the mission succeeded and when, or what touched, why the run ended, and which monitors broke."""
    duration = f"{format_number(summary.duration, 0.1)} s"
    if summary.ended and summary.succeeded:
        return f"Mission succeeded in {duration}"
    broken = {each.name: each.instead for each in summary.monitors if each.is_judged and not each.held}
    outcome = "not finished" if not summary.ended else "not judged" if summary.succeeded is None else "failed"
    touch = broken.pop(NOTHING_TOUCHED) if summary.clearance is not None and summary.clearance.touched else ""
    first = f"{touch}; " if touch else ""
    monitors = f"; monitor did not hold: {', '.join(broken)}" if broken else ""
    return f"Mission {outcome}: {first}{summary.reason}{monitors}, after {duration}"


def warnings_of(summary: Summary) -> Iterator[str]:
    """Yield a text for everything in a run that needs its user's attention, whether its mission succeeded or not.

    They are broken monitors, exceeded limits and margins, late or failed solves, missing measurements, and stages
    shorter than a sample.

    Args:
        summary: Summary of the run.
    """
    for verdict in summary.monitors:
        if verdict.is_judged and not verdict.held:
            yield f"monitor {verdict.name}: {describe_verdict(verdict)}"
    if summary.clearance is not None and summary.clearance.tightest.margin < 0:
        yield f"a margin of clearance was not kept: {_describe_nearest(summary.clearance.tightest)}"
    # small violations between the times at which the optimization sees limits need no warning
    exceeded = {limit.kind for limit in summary.limits if limit.relative < -WARNED_OF}
    for violation, text in zip(summary.beyond_limits, _describe_limit_violations(summary), strict=True):
        quantity = "velocity" if violation.where.endswith(" velocity") else "position"
        if quantity in exceeded:
            yield f"a limit was exceeded: {text}"
    if summary.delay_is_cut_off:
        yield "commands come later than the controller can estimate: give the delay, controller.delay"
    if summary.unknown_delay:
        late = format_number(1e3 * summary.unknown_delay)
        yield (
            f"commands came {late} ms late and the controller took them for on time, as pulses of thrusters cannot be "
            "told from a delay: give it, controller.delay"
        )
    if summary.far_beyond > 0:
        share = with_unit(format_number(100 * summary.far_beyond, 0.1), "% of the time")
        yield f"{FORCES_FAR_BEYOND} were commanded, {share}"
    if summary.missed:
        yield f"{summary.missed} of {summary.solves.count} solves came late: they took longer than a sample of " + (
            f"{format_number(1e3 * summary.sample_time)} ms"
        )
    if summary.unmeasured:
        yield f"{summary.unmeasured} of {summary.solves.count} samples came without a measurement"
    if summary.near_singular:
        yield (
            f"{summary.near_singular} of {summary.solves.count} samples were too near a singular posture for the law "
            f"in task space (condition number of J_C {_describe_condition(summary)}): the law in joint space was used"
        )
    if summary.failed_solves:
        yield f"{summary.failed_solves} of {summary.solves.count} solves failed"
    if summary.unsolved_levels:
        yield f"{summary.unsolved_levels} levels were not solved"
    if summary.raised_levels:
        yield f"{LEVELS_RAISED}: {summary.raised_levels}"
    if brief := _describe_brief_stages(summary):
        yield brief


def _describe_brief_stages(summary: Summary) -> str:
    """Name the stages that lasted less than a sample, which tables round to nothing; empty if there is none."""
    brief = [stage for stage in summary.stages if stage.duration < summary.sample_time - ROUNDING]
    lasted = ", ".join(f"stage {stage.name} lasted {format_number(1e3 * stage.duration)} ms" for stage in brief)
    return f"{lasted}, less than a sample of {format_number(1e3 * summary.sample_time)} ms" if brief else ""


def describe_forces(summary: Summary) -> str:
    """Write how near forces come to their limits, or what a run without limits asks for; empty if it is not known."""
    if force := describe_tightest_force(summary):
        cut = format_number(100 * summary.saturated, 0.1)
        far = format_number(100 * summary.far_beyond, 0.1)
        beyond = f"beyond {100 * FAR_BEYOND:g} % of a limit {far} % of the time"
        return f"largest commanded force, of its limit: {force}; forces cut {cut} % of the time, {beyond}"
    peaks = {name: peak for name, peak in summary.peaks.items() if math.isfinite(peak) and peak > 0}
    if summary.limits_dynamics or not peaks:
        return ""
    units = {name: unit for name, (unit, _) in (PEAKS | SLIDING_PEAKS).items()}
    asked_for = ", ".join(
        f"{name.replace('_', ' ')} {format_number(peak)} {units[name]}" for name, peak in peaks.items()
    )
    return f"no limit of forces or accelerations is declared; the largest are: {asked_for}"


def describe_verdict(verdict: Verdict) -> str:
    """Write whether a monitor held, what happened instead where it did not, and its smallest margin."""
    if not verdict.is_judged:
        return "not judged"
    outcome = "held"
    if not verdict.held:
        outcome = (
            f"BROKEN: {verdict.instead}" if verdict.instead else f"BROKEN at {format_number(verdict.broken_at, 0.1)} s"
        )
    margin = (
        f", margin {with_unit(format_number(verdict.margin, 0.001), verdict.unit)}"
        if math.isfinite(verdict.margin)
        else ""
    )
    details = f" ({verdict.details})" if verdict.details else ""
    return f"{outcome}{margin}{details}"
