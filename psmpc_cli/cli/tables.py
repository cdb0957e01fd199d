"""Files of runs and studies as tables and figures: what commands print, and draw beside their files."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from psmpc_cli.errors import LogError
from psmpc_cli.logs.files import kind_of
from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.run import Run, read_comparison, read_run
from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, RUN, SWEEP
from psmpc_cli.logs.summary import Largest, SolveSummary, Summary, Verdict
from psmpc_cli.studies import fronts
from psmpc_cli.studies.monte_carlo import STATUS, MonteCarloRuns
from psmpc_cli.studies.weights import SweepCells, recommend

if TYPE_CHECKING:
    from psmpc_cli.logs.comparison import Comparison

Row = Sequence[str]

PLAIN_WIDTH = 160
"""Columns of a table that goes into a file."""

NOTHING = ("", "-")
"""Cells without content; a column that has no others is not printed."""

DETAIL, ALONE = "detail", "alone"

MOST_ROWS = 49
"""Rows of a sweep's table; of more runs so many are printed, evenly from the smallest to the largest ratio."""

WORST = 5
"""Number of the worst runs of a Monte Carlo study that are printed."""


def _solves(solves: SolveSummary) -> str:
    times = (solves.median, solves.p95, solves.p99, solves.largest)
    return " / ".join(f"{1e3 * time:.1f}" for time in times) if solves.count else "none"


def _largest(*found: Largest | None) -> str:
    return " / ".join(f"{each.where}: {each.value:.3g} at {each.time:.1f} s" for each in found if each is not None)


def _margin(summary: Summary, kind: str) -> str:
    """Write the smallest margin to a kind of limit, in percent of the limit, and its coordinate."""
    found = (limit for limit in summary.limits if limit.kind == kind)
    return next((f"{100 * each.relative:.3f} % ({each.margin:.1e}) {each.coordinate}" for each in found), "")


def _end_errors(summary: Summary) -> str:
    if summary.end_errors is None:
        return ""
    return "{:.4f} as the controller saw it, {:.4f} true".format(*summary.end_errors)


MEASURES: tuple[tuple[str, Callable[[Summary], float | str], int, str], ...] = (
    ("solve time, median / p95 / p99 / max [ms]", lambda run: _solves(run.solves), 0, ""),
    ("the same, windows with a switch [ms]", lambda run: _solves(run.switching_solves), 0, DETAIL),
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
    ("farthest beyond a limit, any tick", lambda run: _largest(*run.deviations.beyond_limits) or "none", 0, ALONE),
    ("farthest off the plan in a sample", lambda run: _largest(*run.deviations.off_plan), 0, DETAIL + ALONE),
    ("end error over tolerance, planned switches", lambda run: _largest(run.deviations.end_condition), 0, DETAIL),
    ("end error over tolerance, at the end", _end_errors, 0, ALONE),
    ("control effort, integral of |u|^2", lambda run: run.control_effort, 2, ""),
    ("base thrusters, force [N s]", lambda run: run.base_force, 2, ""),
    ("base thrusters, torque [N m s]", lambda run: run.base_torque, 2, ""),
    ("variation of u, base position [m/s^2]", lambda run: run.variation.base_position, 2, DETAIL),
    ("variation of u, base angle [rad/s^2]", lambda run: run.variation.base_angle, 2, DETAIL),
    ("variation of u, joints [rad/s^2]", lambda run: run.variation.joints, 2, DETAIL),
    ("drift of momentum [N s]", lambda run: number(run.momentum_error, 1, "e"), 0, DETAIL),
    ("drift of the energy balance [J]", lambda run: number(run.energy_error, 1, "e"), 0, DETAIL),
)
"""Rows of a run's summary and of a comparison: name, value (a comparison shows the differences of numbers), decimals,
and where it is shown: `DETAIL`, not in a short summary; `ALONE`, not in a comparison."""


def number(value: float, digits: int, form: str = "f") -> str:
    """Write a number with so many decimals, a dash for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}{form}}"


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


def read_file(path: Path) -> tuple[str, Any, Callable[[Any], None]]:
    """Read a file written by psmpc; return its kind, its content, and what prints the content.

    Raises:
        LogError: The file is missing, damaged or of another program.
    """
    kinds: Mapping[str, tuple[Callable[[Path], Any], Callable[[Any], None]]] = {
        RUN: (read_run, print_summary),
        COMPARISON: (read_comparison, partial(print_comparison, path=path)),
        SWEEP: (lambda path: SweepCells(read_results(path, SWEEP)), print_sweep),
        PARETO: (lambda path: read_results(path, PARETO), print_fronts),
        MONTE_CARLO: (lambda path: MonteCarloRuns(read_results(path, MONTE_CARLO)), print_monte_carlo),
    }
    kind = kind_of(path)
    if kind not in kinds:
        raise LogError(f"{path}: found a {kind}, expected one of: {', '.join(kinds)}")
    read, show = kinds[kind]
    return kind, read(path), show


def present(path: Path, figures: bool, force: bool, quiet: bool) -> None:
    """Print the table of a study's file and draw its figures beside it."""
    kind, results, show = read_file(path)
    if not quiet:
        show(results)
    if figures:
        draw_beside(path, kind, results, force, quiet)


def draw_beside(
    path: Path, kind: str, subject: Any, force: bool, quiet: bool, figures: bool = True, films: Collection[str] = ()
) -> None:
    """Draw the figures of a file's content into its folder of figures, its films, or both, and say so."""
    from psmpc_cli.figures.registry import default_directory, draw

    directory = default_directory(path)
    only = None if figures else ()
    drawn = draw(kind.replace("-", "_"), subject, directory, only=only, force=force, films=films)
    if not quiet:
        typer.echo(f"{len(drawn)} figures in {directory}" if figures else f"film in {directory}")


def print_summary(run: Run, verbose: bool = False) -> None:
    """Print a run: how the mission went, its stages, what was measured; all of it if `verbose`."""
    summary = run.summary()
    typer.echo(describe_mission(summary))
    headings = ("stage", "priority", "actual start [s]", "published start", "ends [s]", "published end")
    stages = [
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
    print_table((*headings, "grippers apart [m]"), stages)
    rows = [
        (label, value if isinstance(value := of(summary), str) else number(value, digits))
        for label, of, digits, where in MEASURES
        if verbose or DETAIL not in where
    ]
    rows += [(f"monitor: {verdict.name}", _verdict(verdict)) for verdict in summary.monitors]
    print_table(None, [row for row in rows if row[1] not in NOTHING])
    typer.echo(f"log: {run.path}")


def describe_mission(summary: Summary) -> str:
    """Write whether the mission succeeded, why the run ended, and which monitors did not hold."""
    outcome = ("succeeded" if summary.succeeded else "failed") if summary.ended else "not finished"
    broken = [verdict.name for verdict in summary.monitors if not (verdict.held or math.isnan(verdict.broken_at))]
    monitors = f"; monitor did not hold: {', '.join(broken)}" if broken else ""
    return f"mission {outcome}: {summary.reason}{monitors}, after {summary.duration:.1f} s"


def _verdict(verdict: Verdict) -> str:
    if verdict.held:
        return f"held, margin {verdict.margin:.3f}"
    return (
        "not judged" if math.isnan(verdict.broken_at) else f"BROKEN at {verdict.broken_at:.1f} s ({verdict.margin:.3f})"
    )


def print_comparison(runs: Mapping[str, Run], path: Path) -> None:
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
    for stages in zip(*(run.stages for run in runs), strict=True):
        name, published = stages[0].name, [each.published_start for each in stages]
        starts = _differences([each.actual_start for each in stages], 2, published)
        early = ("early " if each.early else "" for each in stages)
        yield f"{name} actually starts [s]", *map("".join, zip(early, starts, strict=True))
        published = [each.published_switch for each in stages]
        yield f"{name} ends [s]", *_differences([each.switch_time for each in stages], 2, published)
        yield f"{name} lasts [s]", *_differences([each.duration for each in stages], 2)
    yield "end of the run [s]", *_differences([run.duration for run in runs], 2)
    for label, of, digits, where in MEASURES:
        if ALONE not in where:
            values = [of(run) for run in runs]
            numbers = [value for value in values if not isinstance(value, str)]
            yield label, *(_differences(numbers, digits) if numbers else [str(value or "-") for value in values])
    for verdicts in zip(*(run.monitors for run in runs), strict=True):
        yield f"monitor: {verdicts[0].name}", *map(_verdict, verdicts)


def _differences(values: Sequence[float], digits: int, published: Sequence[float] = ()) -> list[str]:
    """Write numbers, those after the first with their difference to it, each with what was published of it."""
    texts = [number(value, digits) for value in values]
    for i, value in enumerate(values[1:], start=1):
        if not math.isnan(value - values[0]):
            texts[i] += " (=)" if texts[i] == texts[0] else f" ({value - values[0]:+.{digits}f})"
    marks = ["" if math.isnan(value) else f" [{value:.1f}]" for value in published] or [""] * len(texts)
    return list(map("".join, zip(texts, marks, strict=True)))


def print_differences(comparison: "Comparison", conditions: Sequence[str]) -> None:
    """Print how a repeated run differs from its log, and the conditions under which that is to be expected."""
    rows = []
    for each in comparison.differences:
        largest = "" if math.isnan(each.largest) else f"{each.largest:.1e}"
        text = f"{largest} ({each.what})" if largest and each.what else each.what or largest
        rows.append((each.path, each.units, text, "" if each.row < 0 else str(each.row)))
    print_table(("dataset", "units", "largest difference", "first in row"), rows)
    typer.echo(f"differs: {len(rows)} of {comparison.compared} datasets; wall times were not compared")
    for condition in conditions:
        typer.echo(f"note: {condition}")


def print_sweep(cells: SweepCells) -> None:
    """Print a sweep over weights, complete or not: a row for each run, the cells by status, the recommended ratio."""
    if cells.groups:
        _print_groups(cells)
    meanings = cells.results.quantities["status"].meanings
    counts = np.bincount(cells.of("status"), minlength=len(meanings))
    parts = ", ".join(f"{count} {meaning}" for meaning, count in zip(meanings, counts, strict=True) if count)
    solves, failed = cells.count("solves"), cells.count("solves_failed")
    typer.echo(f"{len(cells.ratio)} cells: {parts}; {solves} solves, {failed} of them failed")
    for reason, count in Counter(cells.of("reason")[cells.failed]).most_common():
        typer.echo(f"  {count} failed: {reason}")
    typer.echo(recommend(cells).sentence)
    typer.echo(f"sweep: {cells.results.path}")


def _print_groups(cells: SweepCells) -> None:
    """Print a row for each run of a sweep, or for each ratio if runs of one ratio are equal."""
    (first, second), groups = cells.names, cells.groups
    apart = len(groups) > len(np.unique([f"{cells.ratio[group[0]]:.9g}" for group in groups]))
    kept = np.unique(np.linspace(0, len(groups) - 1, min(len(groups), MOST_ROWS)).round().astype(int))
    rows = []
    for group in (groups[k] for k in kept):
        instant, starts = np.median(cells.instant[group]), np.median(cells.of("actual_start")[group], axis=0)
        others = (np.median(cells.of(name)[group]) for name in ("completion_time", "control_effort", "final_error"))
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


def print_monte_carlo(runs: MonteCarloRuns) -> None:
    """Print a Monte Carlo study, complete or not: the success rate, the spread of the runs, and the worst of them."""
    typer.echo(_success(runs))
    rows = [(name, str(count), *(number(value, 3) for value in at)) for name, count, at in runs.quantiles()]
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


def _success(runs: MonteCarloRuns) -> str:
    """Write how many runs succeeded, how sure the rate is, the runs by status, and how many exceeded limits."""
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


def print_fronts(results: Results) -> None:
    """Print a Pareto study: a row for each sample, and how the fronts move."""
    print_table(fronts.HEADINGS, fronts.front_texts(results), left=0)
    typer.echo(fronts.NOTE)
    if "weighted_J_1" in results.quantities:
        movement = fronts.front_movement(results)
        typer.echo("\n".join((movement.over_ratio, *movement.over_time)))
    if "constrained_off_weighted" in results.quantities:
        off = results["constrained_off_weighted"]
        typer.echo(
            f"epsilon constraints lie at most {np.nanmax(off, initial=0.0):.1e} of a front above the chords of the "
            f"weighted sums, which miss such parts, and at most {-np.nanmin(off, initial=0.0):.1e} below their lines"
        )
    typer.echo(f"results: {results.path}")
