"""A run's summary as tables."""

import math
from pathlib import Path

from rich.console import Console
from rich.table import Table

from psmpc_cli.experiment.summary import SolveSummary, Summary


def print_summary(summary: Summary, path: Path) -> None:
    """Print the summary of a run."""
    console = Console(highlight=False)
    console.print(_stages(summary))
    console.print(_measures(summary))
    mission = "succeeded" if summary.succeeded else "failed"
    console.print(f"mission {mission}: {_reasons(summary)}, after {summary.duration:.1f} s", soft_wrap=True)
    console.print(f"log: {path}", soft_wrap=True, markup=False)


def _stages(summary: Summary) -> Table:
    table = Table("stage", "priority", box=None, title_justify="left", pad_edge=False)
    for heading in ("actual start [s]", "published", "ends [s]", "published", "grippers apart [m]"):
        table.add_column(heading, justify="right")
    for stage, distance in zip(summary.stages, summary.distances, strict=True):
        early = " (early)" if stage.premature else ""
        table.add_row(
            stage.name,
            f"{stage.priority:g}",
            _number(stage.actual_start, 2) + early,
            _number(stage.published_start, 1),
            _number(stage.switch_time, 2),
            _number(stage.published_switch, 1),
            _number(distance, 3),
        )
    return table


def _measures(summary: Summary) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    rows = [
        ("solve time, all windows", _solves(summary.solves)),
        ("solve time, windows with a switch", _solves(summary.switching_solves)),
        ("solves longer than a sample", str(summary.missed)),
        ("stages appended / postponed", f"{summary.appended} / {summary.postponed}"),
        ("fall-backs to the shifted plan", str(summary.fallbacks)),
        *(
            (f"tightest {limit.kind} margin", _limit(limit.coordinate, limit.margin, limit.relative))
            for limit in summary.limits
        ),
        ("control effort, integral of |u|^2", f"{summary.control_effort:.2f}"),
        ("base thrusters, force / torque", f"{summary.base_force:.2f} N s / {summary.base_torque:.2f} N m s"),
        ("drift of momentum / energy balance", f"{summary.momentum_error:.1e} N s / {summary.energy_error:.1e} J"),
    ]
    for verdict in summary.monitors:
        state = f"held, margin {verdict.margin:.3f}" if verdict.held else _broken(verdict.broken_at, verdict.margin)
        rows.append((f"monitor: {verdict.name}", state))
    for row in rows:
        table.add_row(*row)
    return table


def _reasons(summary: Summary) -> str:
    broken = [verdict.name for verdict in summary.monitors if not verdict.held]
    return summary.reason + (f"; monitor did not hold: {', '.join(broken)}" if broken else "")


def _broken(at: float, margin: float) -> str:
    return "its stage never ran" if math.isnan(at) else f"BROKEN at {at:.1f} s, by up to {-margin:.3f}"


def _limit(coordinate: str, margin: float, relative: float) -> str:
    return f"{coordinate}: {margin:.2e} ({100 * relative:.3f} % of the limit)"


def _solves(solves: SolveSummary) -> str:
    if not solves.count:
        return "none"
    times = " / ".join(f"{1e3 * t:.1f}" for t in (solves.median, solves.p95, solves.p99, solves.largest))
    return f"median / p95 / p99 / max {times} ms, {solves.iterations:.0f} iterations, {solves.count} solves"


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
