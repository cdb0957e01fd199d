"""What commands print of runs and studies: summaries, comparisons, sweeps, audits as tables."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from psmpc_cli.cli.common import BAD, GOOD, WARNING, echo, escaped
from psmpc_cli.logs.comparison import Comparison
from psmpc_cli.logs.numbers import EMPTY, TIME, format_number, format_quantiles, last_place
from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.report.texts import (
    MEASURES,
    NO_LIMITS,
    WHY_RATES_EXCEED,
    Measure,
    Shown,
    brief_measures,
    describe_mission,
    describe_verdict,
    filled_columns,
    measure_rows,
    stage_rows,
    warnings_of,
)
from psmpc_cli.simulation.gradient_audit import AD_TOLERANCE, DIFFERENCE_TOLERANCE, audit_gradients
from psmpc_cli.simulation.replay import unequal_conditions
from psmpc_cli.simulation.run import build_experiment, converging
from psmpc_cli.specs.document import counted
from psmpc_cli.specs.load import Task
from psmpc_cli.studies import fronts
from psmpc_cli.studies.compare import describe_terms, recommend_controller
from psmpc_cli.studies.front_movement import FrontMovement
from psmpc_cli.studies.monte_carlo import MonteCarloRuns
from psmpc_cli.studies.sweep import SweepCells, recommend

Row = Sequence[str]

ALL_WITH_VERBOSE = " (-v prints all that was measured)"
"""What a short output says of the rest."""

MOST_ROWS = 49
"""Rows of a sweep's table; of more runs so many are printed, evenly from the smallest to the largest ratio."""


MOST_SHORT = 11
"""Rows of the table of a short output, so that with its headings it has twelve."""


def print_table(headings: Row, rows: Sequence[Row], left_aligned: int = 2) -> None:
    """Print a table: as wide as the terminal, or of 160 columns into a file.

    Args:
        headings: Names of the columns, empty for a table without them.
        rows: Cells by row; columns without any content are left out.
        left_aligned: Number of columns that are aligned left, the first ones.
    """
    headings, rows = filled_columns(headings, rows)
    table = Table(box=None, show_header=any(headings), pad_edge=False)
    for i, heading in enumerate(headings):
        table.add_column(Text(heading), justify="right" if i >= left_aligned else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(escaped(cell)) for cell in row))
    terminal = Console()
    console = terminal if terminal.is_terminal else Console(width=160)
    with console.capture() as capture:
        console.print(table)
    typer.echo("\n".join(line.rstrip() for line in capture.get().splitlines()))  # may have the style of headings


def print_summary(run: Run, verbose: bool) -> None:
    """Print the summary of a run.

    It says how the mission went, warns of what may make the run unfit to judge by, and has a table of the stages. The
    measures that matter most follow, or all of them, and all stages, if `verbose`.
    """
    summary = run.summary()
    echo(describe_mission(summary), colour=_colour_of(summary))
    for warning in warnings_of(summary):
        echo(f"warning: {warning}", colour=WARNING)
    headings, rows = stage_rows(summary)
    shown = rows if verbose else rows[:MOST_SHORT]
    print_table(headings, shown)
    if len(shown) < len(rows):
        echo(f"{counted(len(rows) - len(shown), 'more stage', 'more stages')}: -v shows all")
    if verbose:
        print_table(("", ""), list(measure_rows(summary)))
    else:
        echo("\n".join(brief_measures(summary)))
    if not summary.limits_dynamics:
        echo(NO_LIMITS)
    echo(f"log: {run.path}{'' if verbose else ALL_WITH_VERBOSE}")


def _colour_of(summary: Summary) -> str:
    """Return the colour of how a mission went."""
    return {True: GOOD, False: BAD, None: WARNING}[summary.succeeded if summary.ended else None]


def print_comparison(runs: Mapping[str, Run], path: Path, verbose: bool) -> None:
    """Print runs of one task, most often one of each controller: the recommended one, then a row for each.

    Why a mission did not succeed is printed for every run, other missions and warnings only with `verbose`. So is the
    table of all that was measured, with differences to the first run. Where all priorities are equal, psmpc and smpc
    differ in nothing, which is said.

    Args:
        runs: The runs by name.
        path: The one file that holds them all.
        verbose: Whether all that was measured is printed.
    """
    summaries = {name: run.summary() for name, run in runs.items()}
    recommended = recommend_controller(summaries)
    echo(recommended.sentence, colour=WARNING if recommended.name is None else GOOD)
    for name, summary in summaries.items():
        if summary.succeeded is not True or verbose:
            echo(f"{name}: {describe_mission(summary)}", colour=_colour_of(summary))
        for warning in warnings_of(summary) if verbose else ():
            echo(f"{name}: warning: {warning}", colour=WARNING)
    rows = [[name, *(text_of(summary) for _, text_of in COMPARED)] for name, summary in summaries.items()]
    print_table(("controller", *(heading for heading, _ in COMPARED)), rows)
    echo(describe_terms(runs))
    if verbose:
        _print_all_compared(summaries)
    if not any(summary.limits_dynamics for summary in summaries.values()):
        echo(NO_LIMITS)
    if {"psmpc", "smpc"} <= set(summaries) and len({stage.priority for stage in summaries["psmpc"].stages}) == 1:
        echo("psmpc and smpc are the same controller for this task: all its priorities are equal")
    echo(f"logs: {path}{'' if verbose else ALL_WITH_VERBOSE}")


def _describe_outcome(summary: Summary) -> str:
    """Write how a mission went in two words at most."""
    outcomes = {True: "succeeded", False: "failed", None: "not judged"}
    return outcomes[summary.succeeded] if summary.ended else "not finished"


COMPARED: tuple[tuple[str, Callable[[Summary], str]], ...] = (
    ("mission", _describe_outcome),
    ("ends\n[s]", lambda run: format_number(run.duration, TIME) if run.ended else "-"),
    ("early\nstarts", lambda run: format_number(sum(stage.early for stage in run.stages))),
    ("effort [m^2/s^3,\nrad^2/s^3]", lambda run: format_number(run.control_effort)),
    ("base force\nat most [N]", lambda run: format_number(run.peaks["base_force"])),
    ("solve time,\np99 [ms]", lambda run: format_number(1e3 * run.solves.p99)),
    ("warnings", lambda run: format_number(sum(1 for _ in warnings_of(run)))),
)
"""Columns of a short comparison behind the controller: heading, and what is read of a run."""


def _print_all_compared(summaries: Mapping[str, Summary]) -> None:
    """Print all that was measured of runs side by side, with differences to the first one."""
    first, *others = summaries
    rows = [row for row in _comparison_rows(list(summaries.values())) if any(cell not in EMPTY for cell in row[1:])]
    print_table(("", *summaries), rows, left_aligned=1)
    if others:
        echo(f"in parentheses: difference to {first}")
    if any("[" in cell for row in rows for cell in row[1:]):
        echo("in brackets: published")


def _comparison_rows(runs: Sequence[Summary]) -> Iterator[Row]:
    """Yield the rows of a comparison of runs of one task, each a heading and then a cell for every run.

    Rows come for every stage (its actual start, end and duration), for the run and its measures, and for its monitors.
    Cells after the first have their difference to it in parentheses; what the paper has published is in brackets.
    """
    # zip(*...) turns the stages of each run into the runs of each stage; all runs have the same stages
    for stages in zip(*(run.stages for run in runs), strict=True):
        name = stages[0].name
        published_starts = [stage.published_start for stage in stages]
        starts = _texts_with_differences([stage.actual_start for stage in stages], TIME, published_starts)
        early = ("early " if stage.early else "" for stage in stages)
        yield f"{name} actually starts [s]", *map("".join, zip(early, starts, strict=True))
        published_ends = [stage.published_switch for stage in stages]
        ends = _texts_with_differences([stage.switch_time for stage in stages], TIME, published_ends)
        yield f"{name} ends [s]", *ends
        yield f"{name} lasts [s]", *_texts_with_differences([stage.duration for stage in stages], TIME)
    yield "end of the run [s]", *_texts_with_differences([run.duration for run in runs], TIME)
    for measure in MEASURES:
        if Shown.COMPARED in measure.shown:
            yield measure.heading, *_texts_of_measure(measure, runs)
    for verdicts in zip(*(run.monitors for run in runs), strict=True):
        yield f"monitor: {verdicts[0].name}", *map(describe_verdict, verdicts)


def _texts_of_measure(measure: Measure, runs: Sequence[Summary]) -> list[str]:
    """Write a measure of every run, numbers with their differences."""
    values = [measure.read(run) for run in runs]
    numbers = [value for value in values if not isinstance(value, str)]
    return _texts_with_differences(numbers, measure.resolution) if numbers else [str(value or "-") for value in values]


def _texts_with_differences(values: Sequence[float], resolution: float, published: Sequence[float] = ()) -> list[str]:
    """Write numbers, those after the first with their difference to it, such as `8.21 (+0.3) [8.5]`.

    Args:
        values: One of each run; NaN where it was not measured.
        resolution: Smallest difference between values that means something, in their unit.
        published: The values that were published; NaN where none was. None at all if left out.
    """
    texts = [format_number(value, resolution) for value in values]
    for i, value in enumerate(values[1:], start=1):
        difference = value - values[0]
        if math.isnan(difference):
            continue
        # a difference has the last digit of the larger number; counts differ exactly
        step = 0.0 if isinstance(difference, int) else 10.0 ** last_place(max(values[0], value, key=abs), resolution)
        texts[i] += " (=)" if texts[i] == texts[0] else f" ({format_number(difference, step, sign='+')})"
    # all published values are times, which are given to a tenth of a second
    marks = ["" if math.isnan(value) else f" [{format_number(value, 0.1)}]" for value in published] or [""] * len(texts)
    return list(map("".join, zip(texts, marks, strict=True)))


def print_differences(comparison: Comparison, log: Run) -> None:
    """Print where a repeated run differs from its log, and why it need not be equal, if anything explains that.

    Args:
        comparison: The datasets of the two logs, compared one by one.
        log: The log of the run that was repeated.
    """
    if not comparison.differences:
        echo(f"equal: all {comparison.compared} datasets but the wall times")
        return
    rows = []
    for dataset in comparison.differences:
        largest = "" if math.isnan(dataset.largest) else f"{dataset.largest:.1e}"
        text = f"{largest} ({dataset.what})" if largest and dataset.what else dataset.what or largest
        rows.append((dataset.path, dataset.units, text, "" if dataset.row < 0 else str(dataset.row)))
    print_table(("dataset", "units", "largest difference", "first in row"), rows)
    echo(f"differs: {len(rows)} of {comparison.compared} datasets; wall times were not compared")
    for condition in unequal_conditions(log):
        echo(f"note: {condition}")


def print_sweep(cells: SweepCells, verbose: bool) -> None:
    """Print a sweep over the priorities of two stages, complete or not.

    The recommended ratio of the priorities comes first, with the reason; then a table of runs, the number of cells by
    status, and the reasons of failures with the number of times. Each row of the table is one run: cells of equal ratio
    have the same optimum, and may share a run.

    Args:
        cells: The results of the sweep, one cell for each pair of priorities.
        verbose: Whether the table has up to `MOST_ROWS` rows instead of `MOST_SHORT`, with the starts by every
            threshold of the actual start, end errors, and why a mission failed.
    """
    recommended = recommend(cells)
    echo(recommended.headline, colour=WARNING if recommended.ratio is None else GOOD)
    echo(recommended.reason)
    if len(cells.run_by_ratio):
        _print_runs_of_sweep(cells, verbose)
    solves = cells.count("solves")
    failed = cells.count("solves_failed")
    echo(f"{len(cells.ratio)} cells: {_count_by_status(cells.results)}; {solves} solves, {failed} of them failed")
    for reason, times in Counter(cells.quantity("reason")[cells.failed]).most_common():
        echo(f"  {times} failed: {reason}")
    echo(f"sweep: {cells.results.path}{'' if verbose else ALL_WITH_VERBOSE}")


def print_key_sweep(results: Results) -> None:
    """Print what became of each run of a sweep over keys, complete or not."""
    succeeded = results["succeeded"]
    axes = [results[key] for key in results.quantities["succeeded"].dims]
    rows = [
        (*(str(axis[i]) for axis, i in zip(axes, cell, strict=True)), *_texts_of_run_end(results, cell))
        for cell in np.ndindex(succeeded.shape)
    ]
    echo(f"{int(np.nansum(succeeded))} of {succeeded.size} runs succeeded: {_count_by_status(results)}")
    keys = results.quantities["succeeded"].dims
    print_table((*keys, "succeeded", "end [s]", "why"), rows[:MOST_ROWS], left_aligned=len(keys) + 1)
    if len(rows) > MOST_ROWS:
        echo(f"{len(rows) - MOST_ROWS} more runs in {results.path}")


def _texts_of_run_end(results: Results, cell: tuple[int, ...]) -> Row:
    """Write whether a run of a study succeeded, when it ended and why; nothing of one that was not run."""
    if not np.isfinite(results["end_time"][cell]):
        return "", "", str(results["reason"][cell])
    return (
        "yes" if results["succeeded"][cell] == 1 else "no",
        f"{results['end_time'][cell]:.2f}",
        str(results["reason"][cell]),
    )


def _count_by_status(results: Results) -> str:
    """Write how many cells of a study there are of every status."""
    meanings = results.quantities["status"].meanings
    counts = [np.count_nonzero(results["status"] == code) for code in range(len(meanings))]
    return ", ".join(f"{n} {name}" for n, name in zip(counts, meanings, strict=True) if n)


def _print_runs_of_sweep(cells: SweepCells, verbose: bool) -> None:
    """Print a row for each run of a sweep, failed or not; of many runs for some, evenly spread over the ratios.

    The first columns are the ratio of the two priorities, or both of them if several runs have the same ratio.
    """
    first, second = cells.names  # of the two stages
    runs = cells.run_by_ratio  # numbers of the cells that were run, by rising ratio
    most = MOST_ROWS if verbose else MOST_SHORT
    # ratios are compared as texts of 9 digits, so that rounding does not tell equal ones apart
    shares_ratios = len(runs) > len(np.unique([f"{ratio:.9g}" for ratio in cells.ratio[runs]]))
    kept = runs[np.unique(np.linspace(0, len(runs) - 1, min(len(runs), most)).round().astype(int))]
    ends = [cells.first_switch, cells.quantity("completion_time")]  # of the first and the second stage
    thresholds = range(len(cells.epsilons)) if verbose else [cells.shown_threshold]
    rows = []
    for run in kept:
        starts = cells.quantity("actual_start")[run][thresholds]
        row = [f"{value:.4g}" for value in (cells.omega[run] if shares_ratios else [cells.ratio[run]])]
        # an early start depends on the threshold, and is written to a tenth
        row += [format_number(start, 0.1 if start < cells.first_switch[run] else TIME) for start in starts]
        row += [format_number(float(values[run]), TIME) for values in ends]
        row.append(format_number(float(cells.mission_end[run]), TIME) if cells.succeeded[run] else "failed")
        row += [format_number(float(cells.quantity(name)[run])) for name in ("control_effort", "peak_base_force")]
        if verbose:
            row += [format_number(float(cells.end_error[run]), 0.01), cells.why(run)]
        rows.append(row)
    ratio_headings = ("omega_1", "omega_2") if shares_ratios else ("omega_2/omega_1",)
    if verbose:
        echo(f"actual start of {second} [s] by threshold epsilon")
        start_headings = [f"{epsilon:g}" for epsilon in cells.epsilons]
    else:
        start_headings = [f"{second}\nstarts [s]"]
    measured = (f"{first}\nends [s]", f"{second}\nends [s]", "mission\nends [s]", "effort [m^2/s^3,\nrad^2/s^3]")
    last_headings = ("end error\n[tolerance]", "why") if verbose else ()
    print_table(
        (*ratio_headings, *start_headings, *measured, "base force\nat most [N]", *last_headings), rows, left_aligned=0
    )
    if len(kept) < len(runs):
        echo(f"{len(kept)} of {len(runs)} {'runs' if shares_ratios else 'ratios'}")


def print_monte_carlo(runs: MonteCarloRuns, verbose: bool) -> None:
    """Print a Monte Carlo study, complete or not: the success rate, the spread of the runs, and the worst of them.

    Args:
        runs: The results of the study, one run for each seed of the task's uncertainty.
        verbose: Whether the quantiles of all quantities are printed, not only those of the first `MOST_SHORT`.
    """
    rate, *cautions = _describe_success(runs)
    echo(rate)
    for caution in cautions:
        echo(f"warning: {caution}", colour=WARNING)
    rows = [
        (name, format_number(len(values)), *format_quantiles(values, (0.05, 0.5, 0.95)))
        for name, values in runs.spread()
    ]
    shown = rows if verbose else rows[:MOST_SHORT]
    print_table(("over the runs that have it", "runs", "5 %", "50 %", "95 %"), shown, left_aligned=1)
    if len(shown) < len(rows):
        echo(f"{counted(len(rows) - len(shown), 'more quantity', 'more quantities')}: -v shows all")
    if runs.is_without_limits:
        echo(NO_LIMITS)
        if runs.exceeded("velocity").any():
            echo(WHY_RATES_EXCEED)
    if worst := [int(run) for run in runs.worst(count=5)]:
        echo("worst runs: failed, latest, largest error")
        rows = []
        for run in worst:
            seed = str(runs["seed"][run])
            outcome = "failed" if runs.failed[run] else "succeeded" if runs.succeeded[run] else "not judged"
            end = format_number(float(runs["end_time"][run]), TIME)
            error = format_number(float(runs["final_error"][run]))
            rows.append((seed, outcome, end, error, runs.why(run)))
        print_table(("seed", "", "ends [s]", "final error [tolerances]", "why"), rows)
        echo(f"repeat one: {runs.command(worst[0])}")
    echo(f"study: {runs.results.path}")


def _describe_success(runs: MonteCarloRuns) -> list[str]:
    """Write sentences on how the runs of a Monte Carlo study went.

    Returns:
        First how many of the runs that were made succeeded, the rate with its confidence interval, and the number of
        runs by status. Then a warning for each kind of limit that runs exceeded, and one if runs touched what they were
        to keep clear of.
    """
    made = int(runs.made.sum())
    succeeded = int(runs.succeeded.sum())
    states = _count_by_status(runs.results)
    if not made:
        return [f"no run was made yet: {states}"]
    low, high = runs.interval
    rate = f"{100 * succeeded / made:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
    sentences = [f"{succeeded} of {made} runs succeeded: {rate} ({states})"]
    for kind in ("position", "velocity"):
        beyond = runs.exceeded(kind)  # by how much of the limit, by run; 0 for a run within it
        if count := np.count_nonzero(beyond):
            sentences.append(f"{count} of {made} exceeded a {kind} limit, by up to {100 * beyond.max():.2g} %")
    if runs.keeps_clear.any() and (count := np.count_nonzero(runs["touched"] == 1)):
        sentences.append(f"{count} of {made} touched what they keep clear of")
    return sentences


def print_fronts(results: Results) -> None:
    """Print a Pareto study: how the fronts move, and a row for each sample."""
    movement = FrontMovement(results) if "weighted_J_1" in results.quantities else None
    if movement is not None:
        echo(movement.over_ratio)
    print_table(fronts.HEADINGS, fronts.front_texts(results), left_aligned=0)
    echo(fronts.NOTE)
    for sentence in movement.over_time if movement is not None else ():
        echo(sentence)
    echo(f"results: {results.path}")


def print_gradients(task: Task) -> bool:
    """Audit the gradient of the cost by every switch time of a task, and print the audit.

    The adjoint's gradient is compared with algorithmic differentiation (AD) and with finite differences of the cost.

    Returns:
        Whether it agrees with both references at every switch, and the costate formula approaches it on finer meshes.
    """
    audits = audit_gradients(build_experiment(converging(task)))
    nodes = task.spec.controller.uniform_nodes
    echo("Gradient of the cost by the switching instant")
    rows = []
    for audit in audits:
        gaps = (f"{gap:.1e}" for gap in (audit.to_differentiation, audit.to_differences, *audit.costate_gaps))
        rows.append((" to ".join(audit.switch), f"{audit.gradient:.4f}", *gaps, "yes" if audit.holds else "NO"))
    headings = ("switch", "dJ/dt_s [1/s]", "adjoint - AD", "adjoint - differences")
    print_table((*headings, f"costate gap, N_s = {nodes}", f"N_s = {2 * nodes}", "agrees"), rows, left_aligned=1)
    echo(
        f"Differences are relative; expected: at most {AD_TOLERANCE:g} and {DIFFERENCE_TOLERANCE:g}. The costate "
        "formula's gap, taken at an optimum without limits and end conditions, halves with twice the nodes."
    )
    return all(audit.holds for audit in audits)
