"""`psmpc sweep-weights`: the closed loop under many pairs of priorities."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Dask, Figures, Jobs, Resume
from psmpc_cli.cli.study import calls_of, present, refuse_both, refuse_what_stands, resumable
from psmpc_cli.errors import InputError

if TYPE_CHECKING:
    from psmpc_cli.logs.results import Results
    from psmpc_cli.studies.parallel import Calls
    from psmpc_cli.studies.sampling import Sampling
    from psmpc_cli.studies.sweep_file import Sweep


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
        bool, typer.Option("--every-cell", help="Compute every cell from its beginning: share no runs, no beginnings.")
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
    from psmpc_cli.ocp.feasibility import ensure_feasible

    refuse_both(resume, force)
    sweep = _asked_for(grid, task, stages, bounds, epsilon, sampling, every_cell, tuple(changes or ()))
    path = output or Path("runs") / f"{sweep.task.spec.name}-sweep.h5"
    if not resume:
        refuse_what_stands(path, force, figures)
    ensure_feasible(sweep.task)
    _run(sweep, path, calls_of(jobs, dask), force, resume, quiet)
    _show(path, figures, force or resume, quiet)


def _show(path: Path, figures: bool, force: bool, quiet: bool) -> None:
    """Print the table of a sweep and draw its figures."""
    from psmpc_cli.cli.sweep_table import print_sweep
    from psmpc_cli.figures.registry import draw
    from psmpc_cli.simulation.sweep_cells import sweep_cells
    from psmpc_cli.studies.sweep_file import read_sweep

    def drawing(results: "Results", directory: Path, force: bool) -> list[Path]:
        return draw("sweep", sweep_cells(results), directory, force=force)

    present(path, read_sweep(path), print_sweep, drawing, figures, force, quiet)


def _asked_for(
    grid: str | None,
    task: str | None,
    stages: str,
    bounds: str,
    epsilon: str | None,
    sampling: str | None,
    every_cell: bool,
    changes: tuple[str, ...],
) -> "Sweep":
    """Return the sweep that the arguments describe; with --sampling the only argument is the task."""
    from psmpc_cli.studies.sampling import is_grid, parse_epsilons
    from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, parse_stages
    from psmpc_cli.studies.sweep_file import Sweep

    if grid is not None and task is None and not is_grid(grid):
        grid, task = None, grid
    loaded = load_sweep_task(task or DEFAULT_TASK, changes, parse_epsilons(epsilon) if epsilon is not None else ())
    cells = _cells(grid, sampling, bounds, loaded.spec.seed)
    return Sweep(loaded, parse_stages(stages, loaded), cells, every_cell)


def _cells(grid: str | None, sampling: str | None, bounds: str, seed: int) -> "Sampling":
    from psmpc_cli.studies.sampling import grid_sampling, parse_range, random_sampling

    if (grid is None) == (sampling is None):
        found = "neither a grid nor --sampling" if grid is None else "both a grid and --sampling"
        raise InputError(f"found {found}, expected one: 25x25, a number of ratios such as 49, or --sampling random:100")
    limits = parse_range(bounds)
    return random_sampling(sampling, limits, seed) if sampling is not None else grid_sampling(str(grid), limits)


def _run(sweep: "Sweep", path: Path, calls: "Calls", force: bool, resume: bool, quiet: bool) -> None:
    """Run the sweep under the eyes of the progress display; a signal ends it, and what there is stays."""
    from psmpc_cli.cli.sweep_progress import watching_sweep
    from psmpc_cli.studies.sweep import run_sweep

    with resumable(path), watching_sweep(quiet) as watch:
        run_sweep(sweep, path, calls, force, resume, watch)
