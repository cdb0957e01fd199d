"""A comparison as one table: a row a measure, a column a controller."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import typer

from psmpc_cli.cli.summary import number, outcome, print_table, reasons
from psmpc_cli.logs.summary import StageSummary, Summary, Verdict

Row = Sequence[str]


def print_comparison(summaries: Mapping[str, Summary], path: Path) -> None:
    """Print the summaries of several runs of one task side by side."""
    runs = list(summaries.values())
    mission = ("mission", *(outcome(run) for run in runs))
    rows = [*_stages(runs), *_measures(runs), *_solves(runs), *_monitors(runs), mission]
    print_table(("", *summaries), rows, left=1)
    if any("[" in cell for row in rows for cell in row[1:]):
        typer.echo("in brackets: published")
    for name, summary in summaries.items():
        typer.echo(f"{name}: mission {outcome(summary)}: {reasons(summary)}, after {summary.duration:.1f} s")
    typer.echo(f"logs: {path}")


def _stages(runs: Sequence[Summary]) -> Iterator[Row]:
    for i, stage in enumerate(runs[0].stages):
        yield f"{stage.name} actually starts [s]", *(_start(run.stages[i]) for run in runs)
        yield f"{stage.name} ends [s]", *(_end(run.stages[i]) for run in runs)
        yield f"{stage.name} lasts [s]", *(number(run.stages[i].duration, 2) for run in runs)


def _measures(runs: Sequence[Summary]) -> Iterator[Row]:
    yield "end of the run [s]", *(f"{run.duration:.2f}" for run in runs)
    yield "control effort, integral of |u|^2", *(f"{run.control_effort:.2f}" for run in runs)
    yield "base thrusters, force [N s]", *(f"{run.base_force:.2f}" for run in runs)
    yield "base thrusters, torque [N m s]", *(f"{run.base_torque:.2f}" for run in runs)
    yield "variation of u, base position [m/s^2]", *(f"{run.variation.base_position:.2f}" for run in runs)
    yield "variation of u, base angle [rad/s^2]", *(f"{run.variation.base_angle:.2f}" for run in runs)
    yield "variation of u, joints [rad/s^2]", *(f"{run.variation.joints:.2f}" for run in runs)
    for kind in ("position", "velocity"):
        yield f"tightest {kind} margin, of the limit", *(_margin(run, kind) for run in runs)


def _solves(runs: Sequence[Summary]) -> Iterator[Row]:
    for name, label in (("median", "median"), ("p95", "p95"), ("p99", "p99"), ("largest", "maximum")):
        yield f"solve time, {label} [ms]", *(number(1e3 * getattr(run.solves, name), 1) for run in runs)
    yield "solves longer than a sample", *(str(run.missed) for run in runs)
    yield "fall-backs to the shifted plan", *(str(run.failed_solves) for run in runs)
    if any(run.unsolved_levels is not None for run in runs):
        yield "levels not solved", *("-" if run.unsolved_levels is None else str(run.unsolved_levels) for run in runs)


def _monitors(runs: Sequence[Summary]) -> Iterator[Row]:
    for i, monitor in enumerate(runs[0].monitors):
        yield f"monitor: {monitor.name}", *(_verdict(run.monitors[i]) for run in runs)


def _start(stage: StageSummary) -> str:
    early = "early " if stage.early else ""
    return f"{early}{number(stage.actual_start, 2)}{_published(stage.published_start)}"


def _end(stage: StageSummary) -> str:
    return f"{number(stage.switch_time, 2)}{_published(stage.published_switch)}"


def _published(value: float) -> str:
    return "" if math.isnan(value) else f" [{value:.1f}]"


def _margin(run: Summary, kind: str) -> str:
    """Return the smallest margin to a kind of limit in percent of the limit, and its coordinate."""
    found = [limit for limit in run.limits if limit.kind == kind]
    return f"{100 * found[0].relative:.3f} % {found[0].coordinate}" if found else "-"


def _verdict(verdict: Verdict) -> str:
    if verdict.held:
        return f"held by {verdict.margin:.3f}"
    return "not judged" if math.isnan(verdict.broken_at) else f"BROKEN at {verdict.broken_at:.1f} s"
