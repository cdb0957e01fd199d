"""A comparison as one table: a row a measure, a column a controller."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import typer

from psmpc_cli.cli.summary import number, outcome, print_table, reasons
from psmpc_cli.experiment.monitors import Verdict
from psmpc_cli.experiment.summary import StageSummary, Summary

Row = Sequence[str]


def print_comparison(summaries: Mapping[str, Summary], path: Path) -> None:
    """Print the summaries of several runs of one task side by side."""
    runs = list(summaries.values())
    rows = [*_stages(runs), *_measures(runs), *_solves(runs), *_monitors(runs), _row("mission", runs, outcome)]
    print_table(("", *summaries), rows, left=1)
    if any("[" in cell for row in rows for cell in row[1:]):
        typer.echo("in brackets: published")
    for name, summary in summaries.items():
        typer.echo(f"{name}: mission {outcome(summary)}: {reasons(summary)}, after {summary.duration:.1f} s")
    typer.echo(f"logs: {path}")


def _stages(runs: Sequence[Summary]) -> Iterator[Row]:
    for i, stage in enumerate(runs[0].stages):
        yield _row(f"{stage.name} actually starts [s]", runs, lambda run, i=i: _start(run.stages[i]))
        yield _row(f"{stage.name} ends [s]", runs, lambda run, i=i: _end(run.stages[i]))
        yield _row(f"{stage.name} lasts [s]", runs, lambda run, i=i: number(run.stages[i].duration, 2))


def _measures(runs: Sequence[Summary]) -> Iterator[Row]:
    yield _row("end of the run [s]", runs, lambda run: f"{run.duration:.2f}")
    yield _row("control effort, integral of |u|^2", runs, lambda run: f"{run.control_effort:.2f}")
    yield _row("base thrusters, force [N s]", runs, lambda run: f"{run.base_force:.2f}")
    yield _row("base thrusters, torque [N m s]", runs, lambda run: f"{run.base_torque:.2f}")
    yield _row("variation of u, base position [m/s^2]", runs, lambda run: f"{run.variation.base_position:.2f}")
    yield _row("variation of u, base angle [rad/s^2]", runs, lambda run: f"{run.variation.base_angle:.2f}")
    yield _row("variation of u, joints [rad/s^2]", runs, lambda run: f"{run.variation.joints:.2f}")
    for kind in ("position", "velocity"):
        yield _row(f"tightest {kind} margin, of the limit", runs, lambda run, kind=kind: _margin(run, kind))


def _solves(runs: Sequence[Summary]) -> Iterator[Row]:
    for name, label in (("median", "median"), ("p95", "p95"), ("p99", "p99"), ("largest", "maximum")):
        yield _row(f"solve time, {label} [ms]", runs, lambda run, name=name: number(1e3 * getattr(run.solves, name), 1))
    yield _row("solves longer than a sample", runs, lambda run: str(run.missed))
    yield _row("fall-backs to the shifted plan", runs, lambda run: str(run.fallbacks))
    if any(run.unsolved_levels is not None for run in runs):
        yield _row(
            "levels not solved", runs, lambda run: "-" if run.unsolved_levels is None else str(run.unsolved_levels)
        )


def _monitors(runs: Sequence[Summary]) -> Iterator[Row]:
    for i, monitor in enumerate(runs[0].monitors):
        yield _row(f"monitor: {monitor.name}", runs, lambda run, i=i: _verdict(run.monitors[i]))


def _row(label: str, runs: Sequence[Summary], cell: Callable[[Summary], str]) -> Row:
    return (label, *(cell(run) for run in runs))


def _start(stage: StageSummary) -> str:
    early = "early " if stage.premature else ""
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
