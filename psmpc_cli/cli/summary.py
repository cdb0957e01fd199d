"""A run's summary: a table of its stages, a table of what was measured, and how the mission went."""

import math
from collections.abc import Sequence
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from psmpc_cli.logs.summary import Deviations, Largest, SolveSummary, Summary, Verdict

PLAIN_WIDTH = 160
"""Columns of a table that goes into a file."""

STAGE_HEADINGS = ("stage", "priority", "actual start [s]", "published", "ends [s]", "published", "grippers apart [m]")


def print_summary(summary: Summary, path: Path) -> None:
    """Print the summary of a run."""
    print_table(STAGE_HEADINGS, _stages(summary))
    print_table(None, _measures(summary))
    typer.echo(f"mission {outcome(summary)}: {reasons(summary)}, after {summary.duration:.1f} s")
    typer.echo(f"log: {path}")


def _stages(summary: Summary) -> list[Sequence[str]]:
    return [
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


def _measures(summary: Summary) -> list[Sequence[str]]:
    return [
        ("solve time, all windows", _solves(summary.solves)),
        ("solve time, windows with a switch", _solves(summary.switching_solves)),
        ("solves longer than a sample", str(summary.missed)),
        ("stages appended / postponed", f"{summary.appended} / {summary.postponed}"),
        ("fall-backs to the shifted plan", str(summary.failed_solves)),
        *([("samples not measured", str(summary.unmeasured))] if summary.unmeasured else []),
        *([] if summary.basins is None else [("basins", f"changed {summary.basins} times")]),
        *([] if summary.unsolved_levels is None else [("levels not solved", str(summary.unsolved_levels))]),
        *(
            (f"tightest {limit.kind} margin", _limit(limit.coordinate, limit.margin, limit.relative))
            for limit in summary.limits
        ),
        *_deviations(summary.deviations),
        *_end(summary),
        ("control effort, integral of |u|^2", f"{summary.control_effort:.2f}"),
        ("base thrusters, force / torque", f"{summary.base_force:.2f} N s / {summary.base_torque:.2f} N m s"),
        ("variation of the control", _variation(summary)),
        (
            "drift of momentum / energy balance",
            f"{_drift(summary.momentum_error)} N s / {_drift(summary.energy_error)} J",
        ),
        *((f"monitor: {verdict.name}", _verdict(verdict)) for verdict in summary.monitors),
    ]


def _deviations(deviations: Deviations) -> list[Sequence[str]]:
    """Return what the motion has of its own: off the plan, beyond a limit, off an end condition."""
    rows: list[Sequence[str]] = []
    if deviations.off_plan:
        rows.append(("farthest off the plan in a sample", " / ".join(map(_largest, deviations.off_plan))))
    beyond = " / ".join(map(_largest, deviations.beyond_limits)) or "none"
    rows.append(("farthest beyond a limit, any tick", beyond))
    if (end := deviations.end_condition) is not None:
        said = f"{end.where}: {end.value:.4f} of its tolerance at {end.time:.1f} s"
        rows.append(("end error at a planned hand-over", said))
    return rows


def _end(summary: Summary) -> list[Sequence[str]]:
    """Return how near the end the last stage came, where what the controller saw is not what is true."""
    if summary.end_errors is None:
        return []
    seen, true = summary.end_errors
    return [("end error at the end", f"{seen:.4f} of its tolerance as the controller saw it, {true:.4f} true")]


def _largest(largest: Largest) -> str:
    return f"{largest.where}: {largest.value:.1e} at {largest.time:.1f} s"


def _variation(summary: Summary) -> str:
    variation = summary.variation
    return (
        f"base {variation.base_position:.2f} m/s^2 and {variation.base_angle:.2f} rad/s^2, "
        f"joints {variation.joints:.2f} rad/s^2"
    )


def outcome(summary: Summary) -> str:
    """Return how the mission went, in a word."""
    if not summary.ended:
        return "not finished"
    return "succeeded" if summary.succeeded else "failed"


def reasons(summary: Summary) -> str:
    """Return why the run ended, and which monitors did not hold."""
    broken = [verdict.name for verdict in summary.monitors if not (verdict.held or math.isnan(verdict.broken_at))]
    return summary.reason + (f"; monitor did not hold: {', '.join(broken)}" if broken else "")


def _verdict(verdict: Verdict) -> str:
    if verdict.held:
        return f"held, margin {verdict.margin:.3f}"
    if math.isnan(verdict.broken_at):
        return "not judged, no sample in its stage"
    return f"BROKEN at {verdict.broken_at:.1f} s, by up to {-verdict.margin:.3f}"


def _limit(coordinate: str, margin: float, relative: float) -> str:
    return f"{coordinate}: {margin:.2e} ({100 * relative:.3f} % of the limit)"


def _solves(solves: SolveSummary) -> str:
    if not solves.count:
        return "none"
    times = " / ".join(f"{1e3 * t:.1f}" for t in (solves.median, solves.p95, solves.p99, solves.largest))
    return f"median / p95 / p99 / max {times} ms, {solves.iterations:.0f} iterations, {solves.count} solves"


def number(value: float, digits: int) -> str:
    """Return a number with so many digits, a dash where there is none."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _drift(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1e}"


def print_table(headings: Sequence[str] | None, rows: Sequence[Sequence[str]], left: int = 2) -> None:
    """Print a table: as wide as the terminal, or wide into a file; its first `left` columns begin at the left."""
    table = Table(box=None, show_header=headings is not None, pad_edge=False)
    for column, heading in enumerate(headings or ("", "")):
        table.add_column(Text(heading), justify="right" if headings and column >= left else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    terminal = Console()
    console = terminal if terminal.is_terminal else Console(width=PLAIN_WIDTH)
    with console.capture() as capture:
        console.print(table)
    typer.echo("\n".join(line.rstrip() for line in capture.get().splitlines()))
