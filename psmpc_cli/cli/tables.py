"""Results as tables: runs, comparisons, repeated runs, sweeps, Monte Carlo studies and Pareto fronts."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from psmpc_cli.logs.summary import SolveSummary, StageSummary, Summary

if TYPE_CHECKING:
    from psmpc_cli.logs.comparison import Comparison, Difference
    from psmpc_cli.logs.results import Results
    from psmpc_cli.logs.run import Run
    from psmpc_cli.logs.summary import Largest, Verdict
    from psmpc_cli.studies.monte_carlo import MonteCarloRuns
    from psmpc_cli.studies.weights import SweepCells

Row = Sequence[str]

PLAIN_WIDTH = 160
"""Columns of a table that goes into a file."""

NOTHING = ("", "-")
"""Cells without content; a column that has no others is not printed."""

STAGE_HEADINGS = (
    "stage",
    "priority",
    "actual start [s]",
    "published start",
    "ends [s]",
    "published end",
    "grippers apart [m]",
)

COMPARED: tuple[tuple[str, Callable[[Summary], float], int], ...] = (
    ("end of the run [s]", lambda run: run.duration, 2),
    ("control effort, integral of |u|^2", lambda run: run.control_effort, 2),
    ("base thrusters, force [N s]", lambda run: run.base_force, 2),
    ("base thrusters, torque [N m s]", lambda run: run.base_torque, 2),
    ("variation of u, base position [m/s^2]", lambda run: run.variation.base_position, 2),
    ("variation of u, base angle [rad/s^2]", lambda run: run.variation.base_angle, 2),
    ("variation of u, joints [rad/s^2]", lambda run: run.variation.joints, 2),
    ("solve time, median [ms]", lambda run: 1e3 * run.solves.median, 1),
    ("solve time, p95 [ms]", lambda run: 1e3 * run.solves.p95, 1),
    ("solve time, p99 [ms]", lambda run: 1e3 * run.solves.p99, 1),
    ("solve time, maximum [ms]", lambda run: 1e3 * run.solves.largest, 1),
    ("solves longer than a sample", lambda run: run.missed, 0),
    ("failed solves", lambda run: run.failed_solves, 0),
    ("levels not solved", lambda run: math.nan if run.unsolved_levels is None else run.unsolved_levels, 0),
)
"""Rows of a comparison: name, measure, decimals."""

MOST_ROWS = 49
"""Rows of a sweep's table; of more runs so many are printed, evenly from the smallest to the largest ratio."""

SWEEP_COLUMNS = ("completion_time", "control_effort", "final_error")

WORST = 5
"""Number of the worst runs of a Monte Carlo study that are printed."""


def print_table(headings: Row | None, rows: Sequence[Row], left: int = 2) -> None:
    """Print a table: as wide as the terminal, or wide into a file.

    Args:
        headings: Names of the columns; None for a table of two columns without headings.
        rows: Cells by row; columns without any content are left out.
        left: Number of columns that are aligned left.
    """
    kept = [
        column
        for column in range(len(headings or ("", "")))
        if column == 0 or not rows or any(row[column] not in NOTHING for row in rows)
    ]
    table = Table(box=None, show_header=headings is not None, pad_edge=False)
    for column in kept:
        heading = Text(headings[column] if headings else "")
        table.add_column(heading, justify="right" if headings and column >= left else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(row[column]) for column in kept))
    terminal = Console()
    console = terminal if terminal.is_terminal else Console(width=PLAIN_WIDTH)
    with console.capture() as capture:
        console.print(table)
    typer.echo("\n".join(line.rstrip() for line in capture.get().splitlines()))


def number(value: float, digits: int) -> str:
    """Write a number with so many decimals, a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def print_summary(run: "Run", verbose: bool = False) -> None:
    """Print a run: how the mission went, its stages, what was measured; all of it if `verbose`."""
    summary = run.summary()
    typer.echo(describe_mission(summary))
    print_table(STAGE_HEADINGS, [_stage(*each) for each in zip(summary.stages, summary.distances, strict=True)])
    print_table(None, [*_measures(summary), *(_details(summary) if verbose else ())])
    typer.echo(f"log: {run.path}")


def describe_mission(summary: Summary) -> str:
    """Write whether the mission succeeded, why the run ended, and which monitors did not hold."""
    outcome = ("succeeded" if summary.succeeded else "failed") if summary.ended else "not finished"
    broken = [verdict.name for verdict in summary.monitors if not (verdict.held or math.isnan(verdict.broken_at))]
    monitors = f"; monitor did not hold: {', '.join(broken)}" if broken else ""
    return f"mission {outcome}: {summary.reason}{monitors}, after {summary.duration:.1f} s"


def _stage(stage: StageSummary, distance: float) -> Row:
    return (
        stage.name,
        f"{stage.priority:g}",
        number(stage.actual_start, 2) + (" (early)" if stage.early else ""),
        number(stage.published_start, 1),
        number(stage.switch_time, 2),
        number(stage.published_switch, 1),
        number(distance, 3),
    )


def _measures(summary: Summary) -> Iterator[Row]:
    """Yield what tells whether a run can be trusted and what it costs."""
    yield "solve time", _solves(summary.solves)
    yield "solves longer than a sample", str(summary.missed)
    yield "failed solves", str(summary.failed_solves)
    if summary.unmeasured:
        yield "samples not measured", str(summary.unmeasured)
    if summary.unsolved_levels:
        yield "levels not solved", str(summary.unsolved_levels)
    for limit in summary.limits:
        margin = f"{limit.coordinate}: {limit.margin:.2e} ({100 * limit.relative:.3f} % of the limit)"
        yield f"tightest {limit.kind} margin", margin
    yield "farthest beyond a limit, any tick", " / ".join(map(_largest, summary.deviations.beyond_limits)) or "none"
    if summary.end_errors is not None:
        seen, true = summary.end_errors
        yield "end error at the end", f"{seen:.4f} of its tolerance as the controller saw it, {true:.4f} true"
    yield "control effort, integral of |u|^2", f"{summary.control_effort:.2f}"
    yield "base thrusters, force / torque", f"{summary.base_force:.2f} N s / {summary.base_torque:.2f} N m s"
    for verdict in summary.monitors:
        yield f"monitor: {verdict.name}", _verdict(verdict, f", by up to {-verdict.margin:.3f}")


def _details(summary: Summary) -> Iterator[Row]:
    """Yield what tells how the controller worked."""
    variation, deviations = summary.variation, summary.deviations
    yield "solve time, windows with a switch", _solves(summary.switching_solves)
    yield "stages appended / postponed", f"{summary.appended} / {summary.postponed}"
    if summary.basins is not None:
        yield "other guesses of the switch times chosen", str(summary.basins)
    if deviations.off_plan:
        yield "farthest off the plan in a sample", " / ".join(map(_largest, deviations.off_plan))
    if (end := deviations.end_condition) is not None:
        yield "end error at a planned switch time", f"{end.where}: {end.value:.4f} of its tolerance at {end.time:.1f} s"
    yield (
        "variation of the control",
        f"base {variation.base_position:.2f} m/s^2 and {variation.base_angle:.2f} rad/s^2, "
        f"joints {variation.joints:.2f} rad/s^2",
    )
    drifts = ("-" if math.isnan(each) else f"{each:.1e}" for each in (summary.momentum_error, summary.energy_error))
    yield "drift of momentum / energy balance", "{} N s / {} J".format(*drifts)


def _solves(solves: SolveSummary) -> str:
    if not solves.count:
        return "none"
    times = " / ".join(f"{1e3 * t:.1f}" for t in (solves.median, solves.p95, solves.p99, solves.largest))
    return f"median / p95 / p99 / max {times} ms, {solves.iterations:.0f} iterations, {solves.count} solves"


def _largest(largest: "Largest") -> str:
    return f"{largest.where}: {largest.value:.1e} at {largest.time:.1f} s"


def _verdict(verdict: "Verdict", by: str = "") -> str:
    if verdict.held:
        return f"held, margin {verdict.margin:.3f}"
    return "not judged" if math.isnan(verdict.broken_at) else f"BROKEN at {verdict.broken_at:.1f} s{by}"


def print_comparison(runs: "Mapping[str, Run]", path: Path) -> None:
    """Print runs of one task side by side, with differences to the first one."""
    summaries = {name: run.summary() for name, run in runs.items()}
    first, *others = summaries
    for name, summary in summaries.items():
        typer.echo(f"{name}: {describe_mission(summary)}")
    rows = [row for row in _compared(list(summaries.values())) if any(cell not in NOTHING for cell in row[1:])]
    print_table(("", *summaries), rows, left=1)
    if others:
        typer.echo(f"in parentheses: difference to {first}")
    if any("[" in cell for row in rows for cell in row[1:]):
        typer.echo("in brackets: published")
    if {"psmpc", "smpc"} <= set(summaries) and len({stage.priority for stage in summaries["psmpc"].stages}) == 1:
        typer.echo("psmpc and smpc are the same controller for this task: all its priorities are equal")
    typer.echo(f"logs: {path}")


def _compared(runs: Sequence[Summary]) -> Iterator[Row]:
    """Yield the rows of a comparison: a measure of every run."""
    for i, stage in enumerate(runs[0].stages):
        stages = [run.stages[i] for run in runs]
        starts = _differences([each.actual_start for each in stages], 2, [each.published_start for each in stages])
        early = ("early " if each.early else "" for each in stages)
        yield f"{stage.name} actually starts [s]", *map("".join, zip(early, starts, strict=True))
        published = [each.published_switch for each in stages]
        yield f"{stage.name} ends [s]", *_differences([each.switch_time for each in stages], 2, published)
        yield f"{stage.name} lasts [s]", *_differences([each.duration for each in stages], 2)
    for label, measure, digits in COMPARED:
        yield label, *_differences([measure(run) for run in runs], digits)
    for kind in ("position", "velocity"):
        yield f"tightest {kind} margin, of the limit", *(_tightest(run, kind) for run in runs)
    for i, monitor in enumerate(runs[0].monitors):
        yield f"monitor: {monitor.name}", *(_verdict(run.monitors[i]) for run in runs)


def _differences(values: Sequence[float], digits: int, published: Sequence[float] = ()) -> list[str]:
    """Write numbers, those after the first with their difference to it, each with what was published of it."""
    texts = [number(value, digits) for value in values]
    for i, value in enumerate(values[1:], start=1):
        if not math.isnan(value - values[0]):
            texts[i] += " (=)" if texts[i] == texts[0] else f" ({value - values[0]:+.{digits}f})"
    marks = ["" if math.isnan(value) else f" [{value:.1f}]" for value in published] or [""] * len(texts)
    return list(map("".join, zip(texts, marks, strict=True)))


def _tightest(run: Summary, kind: str) -> str:
    """Write the smallest margin to a kind of limit in percent of the limit, and its coordinate."""
    found = [limit for limit in run.limits if limit.kind == kind]
    return f"{100 * found[0].relative:.3f} % {found[0].coordinate}" if found else "-"


def print_differences(comparison: "Comparison", conditions: Sequence[str]) -> None:
    """Print how a repeated run differs from its log, and the conditions under which that is to be expected."""

    def row(each: "Difference") -> Row:
        largest = "" if math.isnan(each.largest) else f"{each.largest:.1e}"
        text = f"{largest} ({each.what})" if largest and each.what else each.what or largest
        return each.path, each.units, text, "" if each.row < 0 else str(each.row)

    headings = ("dataset", "units", "largest difference", "first in row")
    print_table(headings, [row(each) for each in comparison.differences])
    count = f"{len(comparison.differences)} of {comparison.compared} datasets"
    typer.echo(f"differs: {count}; wall times were not compared")
    for condition in conditions:
        typer.echo(f"note: {condition}")


def print_sweep(cells: "SweepCells") -> None:
    """Print a sweep over weights, complete or not: a row for each run, the cells by status, the recommended ratio."""
    from psmpc_cli.studies.weights import guidance

    _print_groups(cells)
    meanings = cells.results.quantities["status"].meanings
    counts = np.bincount(cells.of("status"), minlength=len(meanings))
    parts = ", ".join(f"{count} {meaning}" for meaning, count in zip(meanings, counts, strict=True) if count)
    solves, failed = cells.count("solves"), cells.count("fallbacks")
    typer.echo(f"{len(cells.ratio)} cells: {parts}; {solves} solves, {failed} of them failed")
    for reason, count in Counter(cells.of("reason")[cells.failed]).most_common():
        typer.echo(f"  {count} failed: {reason}")
    typer.echo(guidance(cells))
    typer.echo(f"sweep: {cells.results.path}")


def _print_groups(cells: "SweepCells") -> None:
    """Print a row for each run of a sweep, or for each ratio if runs of one ratio are equal."""
    (first, second), groups = cells.names, cells.groups
    if not groups:
        return
    apart = len(groups) > len(np.unique([f"{cells.ratio[group[0]]:.9g}" for group in groups]))
    kept = np.unique(np.linspace(0, len(groups) - 1, min(len(groups), MOST_ROWS)).round().astype(int))
    rows = []
    for group in (groups[k] for k in kept):
        instant, starts = np.median(cells.instant[group]), np.median(cells.of("actual_start")[group], axis=0)
        others = (np.median(cells.of(name)[group]) for name in SWEEP_COLUMNS)
        weights = cells.omega[group[0]] if apart else cells.ratio[group[:1]]
        rows.append(
            (
                *(f"{each:.4g}" for each in weights),
                *(number(start, 1 if start < instant else 2) for start in starts),
                *(number(float(each), 2) for each in (instant, *others)),
            )
        )
    typer.echo(f"actual start of {second} [s] by threshold epsilon")
    over = ("omega_1", "omega_2") if apart else ("omega_2/omega_1",)
    epsilons = (f"{epsilon:g}" for epsilon in cells.epsilons)
    print_table((*over, *epsilons, f"{first} ends [s]", f"{second} ends [s]", "effort", "final error"), rows, left=0)
    if len(kept) < len(groups):
        typer.echo(f"{len(kept)} of {len(groups)} {'runs' if apart else 'ratios'}")


def print_monte_carlo(runs: "MonteCarloRuns") -> None:
    """Print a Monte Carlo study, complete or not: the success rate, the spread of the runs, and the worst of them."""
    typer.echo(_success(runs))
    rows = [(each.name, str(each.runs), *(number(value, 3) for value in each.at)) for each in runs.quantiles()]
    print_table(("over the runs that have it", "runs", "5 %", "50 %", "95 %"), rows, left=1)
    worst = [int(run) for run in runs.worst(WORST)]
    if worst:
        typer.echo("worst runs: failed, latest, largest error")
        columns = [
            (
                str(runs["seed"][run]),
                "failed" if runs.failed[run] else "succeeded",
                number(float(runs["end_time"][run]), 2),
                number(float(runs["final_error"][run]), 3),
                runs.why(run),
            )
            for run in worst
        ]
        print_table(("seed", "", "ends [s]", "final error", "why"), columns)
        typer.echo(f"repeat one: {runs.command(worst[0])}")
    typer.echo(f"study: {runs.results.path}")


def _success(runs: "MonteCarloRuns") -> str:
    """Write how many runs succeeded, how sure the rate is, the runs by status, and how many exceeded limits."""
    from psmpc_cli.studies.monte_carlo import STATUS

    made, succeeded = int(runs.made.sum()), int(runs.succeeded.sum())
    counts = zip(STATUS, np.bincount(runs["status"], minlength=len(STATUS)), strict=True)
    states = ", ".join(f"{count} {meaning}" for meaning, count in counts if count)
    if not made:
        return f"no run was made yet: {states}"
    low, high = runs.interval
    rate = f"{100 * succeeded / made:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
    parts = [f"{succeeded} of {made} runs succeeded: {rate} ({states})"]
    for kind in ("position", "velocity"):
        beyond = runs.exceeded(kind)
        if count := np.count_nonzero(beyond):
            parts.append(f"{count} of {made} exceeded a {kind} limit, by up to {100 * beyond.max():.2g} %")
    return "; ".join(parts)


def print_fronts(results: "Results") -> None:
    """Print a Pareto study: a row for each sample, and how the fronts move."""
    from psmpc_cli.studies.fronts import HEADINGS, NOTE, WEIGHTED, front_movement, front_rows, front_texts, methods_in

    print_table(HEADINGS, [front_texts(row) for row in front_rows(results)], left=0)
    typer.echo(NOTE)
    if WEIGHTED in methods_in(results):
        movement = front_movement(results)
        for sentence in (movement.over_ratio, *movement.over_time):
            typer.echo(sentence)
    if "constrained_off_weighted" in results.quantities:
        off = results["constrained_off_weighted"]
        typer.echo(
            f"epsilon constraints lie at most {np.nanmax(off, initial=0.0):.1e} of a front above the chords of the "
            f"weighted sums, which miss such parts, and at most {-np.nanmin(off, initial=0.0):.1e} below their lines"
        )
    typer.echo(f"results: {results.path}")
