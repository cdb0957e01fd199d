"""A sweep as a table: a row a ratio of the priorities, what the cells came to, and the recommended ratio."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
import typer

from psmpc_cli.cli.summary import number, print_table
from psmpc_cli.logs.results import Results
from psmpc_cli.simulation.recommendation import recommend
from psmpc_cli.simulation.sweep_cells import SweepCells, along_ratio, sweep_cells

MOST_ROWS = 49
"""Rows of the table; of more ratios so many are printed, evenly from the smallest to the largest."""

COLUMNS = ("completion_time", "control_effort", "final_error")


def print_sweep(results: Results) -> None:
    """Print a sweep, complete or not.

    Raises:
        LogError: It does not say what ran.
    """
    cells = sweep_cells(results)
    first, second = cells.names
    rows = list(_rows(cells))
    if rows:
        kept = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_ROWS)).round().astype(int))
        typer.echo(f"actual start of {second} [s] by threshold epsilon")
        starts = tuple(f"{epsilon:g}" for epsilon in cells.epsilons)
        headings = ("omega_2/omega_1", *starts, f"{first} ends [s]", f"{second} ends [s]", "effort", "final error")
        print_table(headings, [rows[k] for k in kept], left=0)
        if len(kept) < len(rows):
            typer.echo(f"{len(kept)} of {len(rows)} ratios")
    typer.echo(_states(cells))
    for reason, count in Counter(cells.of("reason")[cells.failed]).most_common():
        typer.echo(f"  {count} failed: {reason}")
    best = recommend(cells)
    typer.echo(str(best) if best else "no ratio is recommended: none came to its end in every cell")
    typer.echo(f"sweep: {results.path}")


def _rows(cells: SweepCells) -> Iterator[Sequence[str]]:
    starts = [along_ratio(cells, start) for start in cells.of("actual_start").T]
    instant = along_ratio(cells, cells.instant)
    others = [along_ratio(cells, cells.of(name)) for name in COLUMNS]
    for k, ratio in enumerate(instant.ratio):
        yield (
            f"{ratio:.4g}",
            *(number(start.middle[k], 1 if start.middle[k] < instant.middle[k] else 2) for start in starts),
            *(number(column.middle[k], 2) for column in (instant, *others)),
        )


def _states(cells: SweepCells) -> str:
    """Say how many cells there are, what became of them, and how many solves that took."""
    meanings = cells.results.quantities["status"].meanings
    counts = np.bincount(cells.of("status"), minlength=len(meanings))
    parts = ", ".join(f"{count} {meaning}" for meaning, count in zip(meanings, counts, strict=True) if count)
    solves, failed = cells.count("solves"), cells.count("fallbacks")
    return f"{len(cells.ratio)} cells: {parts}; {solves} solves, {failed} of them failed"
