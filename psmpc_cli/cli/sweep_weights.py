"""`psmpc sweep-weights`: the closed loop under many pairs of priorities, and its table."""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Dask, Figures, Jobs, Resume
from psmpc_cli.cli.study import present, refuse_both, refuse_what_stands, resumable, watching_study
from psmpc_cli.cli.summary import number, print_table
from psmpc_cli.errors import InputError

if TYPE_CHECKING:
    from psmpc_cli.specs.load import Task
    from psmpc_cli.studies.weights import Sampling, SweepCells

MOST_ROWS = 49
"""Rows of the table; of more ratios so many are printed, evenly from the smallest to the largest."""

COLUMNS = ("completion_time", "control_effort", "final_error")


def sweep_weights(
    grid: Annotated[
        str | None,
        typer.Argument(
            help="Points of omega_1 by points of omega_2, such as 25x25; or a number of ratios, such as 49."
        ),
    ] = None,
    task: Annotated[
        str | None, typer.Argument(help="Task file or built-in task. Default: approach_capture.", show_default=False)
    ] = None,
    stages: Annotated[
        str, typer.Option(metavar="S,S+1", help="The two stages in a row whose priorities vary, by number or name.")
    ] = "1,2",
    bounds: Annotated[str, typer.Option("--range", metavar="LOW:HIGH", help="Range of both priorities.")] = "1e-3:1e3",
    epsilon: Annotated[
        str | None,
        typer.Option(metavar="E,E,...", help="Thresholds of the actual start. Default: the task's onset.series."),
    ] = None,
    sampling: Annotated[
        str | None, typer.Option(metavar="random:N", help="N random draws from the range (the task's seed), no grid.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=f"Results. {FOLDERS} Default: runs/<task>-sweep.h5."),
    ] = None,
    every_cell: Annotated[
        bool,
        typer.Option(
            "--every-cell", help="Compute every cell: cells with equal ratios of all priorities share no run."
        ),
    ] = False,
    resume: Resume = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier sweep and its figures.")] = False,
    changes: Changes = None,
    jobs: Jobs = None,
    dask: Dask = None,
    figures: Figures = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
) -> None:
    """Run the closed loop under many pairs of priorities: how they decide the actual start. Paper Fig. 6."""
    from psmpc_cli.figures.registry import draw
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.studies.runner import run_study
    from psmpc_cli.studies.sweep import weight_study
    from psmpc_cli.studies.weights import parse_stages, sweep_cells

    refuse_both(resume, force, jobs, dask)
    loaded, cells = _asked_for(grid, task, bounds, epsilon, sampling, tuple(changes or ()))
    study = weight_study(loaded, parse_stages(stages, loaded), cells, every_cell)
    path = output or Path("runs") / f"{loaded.spec.name}-sweep.h5"
    if not resume:
        refuse_what_stands(path, force, figures)
    ensure_feasible(loaded)
    with resumable(path), watching_study(quiet) as watch:
        results = run_study(study, path, jobs, dask, force, resume, watch)
    present(path, sweep_cells(results), print_sweep, partial(draw, "sweep"), figures, force or resume, quiet)


def _asked_for(
    grid: str | None,
    task: str | None,
    bounds: str,
    epsilon: str | None,
    sampling: str | None,
    changes: tuple[str, ...],
) -> "tuple[Task, Sampling]":
    """Return task and cells that the arguments describe; grid and task may be in either order.

    Raises:
        InputError: There is no sampling, or more than one.
        SpecError: The task does not hold.
    """
    from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task
    from psmpc_cli.studies.weights import grid_sampling, is_grid, parse_epsilons, parse_range, random_sampling

    if grid is not None and not is_grid(grid):
        grid, task = task, grid
    loaded = load_sweep_task(task or DEFAULT_TASK, changes, parse_epsilons(epsilon) if epsilon is not None else ())
    if (grid is None) == (sampling is None):
        found = "neither a grid nor --sampling" if grid is None else "both a grid and --sampling"
        raise InputError(f"found {found}, expected one: 25x25, a number of ratios such as 49, or --sampling random:100")
    limits = parse_range(bounds)
    if sampling is not None:
        return loaded, random_sampling(sampling, limits, loaded.spec.seed)
    return loaded, grid_sampling(str(grid), limits)


def print_sweep(cells: "SweepCells") -> None:
    """Print a sweep, complete or not: a row for each run, what became of the cells, and the recommended ratio."""
    from psmpc_cli.studies.weights import guidance

    _print_rows(cells)
    typer.echo(_states(cells))
    for reason, count in Counter(cells.of("reason")[cells.failed]).most_common():
        typer.echo(f"  {count} failed: {reason}")
    typer.echo(guidance(cells))
    typer.echo(f"sweep: {cells.results.path}")


def _print_rows(cells: "SweepCells") -> None:
    """Print a row for each run, or for each ratio where runs of one ratio are equal."""
    (first, second), groups = cells.names, cells.groups
    if not groups:
        return
    apart = len(groups) > len(np.unique([f"{cells.ratio[group[0]]:.9g}" for group in groups]))
    kept = np.unique(np.linspace(0, len(groups) - 1, min(len(groups), MOST_ROWS)).round().astype(int))
    typer.echo(f"actual start of {second} [s] by threshold epsilon")
    starts = tuple(f"{epsilon:g}" for epsilon in cells.epsilons)
    over = ("omega_1", "omega_2") if apart else ("omega_2/omega_1",)
    headings = (*over, *starts, f"{first} ends [s]", f"{second} ends [s]", "effort", "final error")
    print_table(headings, list(_rows(cells, [groups[k] for k in kept], apart)), left=0)
    if len(kept) < len(groups):
        typer.echo(f"{len(kept)} of {len(groups)} {'runs' if apart else 'ratios'}")


def _rows(cells: "SweepCells", groups: "Sequence[np.ndarray]", apart: bool) -> Iterator[Sequence[str]]:
    """Yield the medians over cells with equal runs; by both priorities if cells of one ratio are apart."""
    others = [cells.of(name) for name in COLUMNS]
    for group in groups:
        instant = np.median(cells.instant[group])
        starts = np.median(cells.of("actual_start")[group], axis=0)
        yield (
            *(f"{each:.4g}" for each in (cells.omega[group[0]] if apart else cells.ratio[group[:1]])),
            *(number(start, 1 if start < instant else 2) for start in starts),
            *(number(float(each), 2) for each in (instant, *(np.median(other[group]) for other in others))),
        )


def _states(cells: "SweepCells") -> str:
    """Say how many cells there are, what became of them, and how many solves that took."""
    meanings = cells.results.quantities["status"].meanings
    counts = np.bincount(cells.of("status"), minlength=len(meanings))
    parts = ", ".join(f"{count} {meaning}" for meaning, count in zip(meanings, counts, strict=True) if count)
    solves, failed = cells.count("solves"), cells.count("fallbacks")
    return f"{len(cells.ratio)} cells: {parts}; {solves} solves, {failed} of them failed"
