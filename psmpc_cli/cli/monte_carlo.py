"""`psmpc monte-carlo`: the closed loop many times, each with other random numbers."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Dask, Figures, Jobs, Resume
from psmpc_cli.cli.study import calls_of, present, refuse_both, refuse_what_stands, resumable

MOST = 100_000
"""Most runs of a study."""


def monte_carlo(
    task: Annotated[str, typer.Argument(help="Task file or built-in task, with an uncertainty.")],
    runs: Annotated[
        int, typer.Option(min=1, max=MOST, metavar="N", help="How many runs, each with a seed of its own.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=f"Results. {FOLDERS} Default: runs/<task>-monte-carlo.h5."),
    ] = None,
    resume: Resume = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier results and their figures.")] = False,
    changes: Changes = None,
    jobs: Jobs = None,
    dask: Dask = None,
    figures: Figures = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
) -> None:
    """Run a task many times, each with another seed for its uncertainty: how often it succeeds, and how runs spread."""
    from psmpc_cli.cli.sweep_progress import watching_sweep
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.studies.monte_carlo import load_monte_carlo, run_monte_carlo

    refuse_both(resume, force)
    study = load_monte_carlo(task, tuple(changes or ()), runs)
    path = output or Path("runs") / f"{study.task.spec.name}-monte-carlo.h5"
    if not resume:
        refuse_what_stands(path, force, figures)
    ensure_feasible(study.task)
    calls = calls_of(jobs, dask)
    with resumable(path), watching_sweep(quiet, "failed") as watch:
        run_monte_carlo(study, path, calls, force, resume, watch)
    _show(path, figures, force or resume, quiet)


def _show(path: Path, figures: bool, force: bool, quiet: bool) -> None:
    """Print the table of the runs and draw their figures."""
    from psmpc_cli.cli.monte_carlo_table import print_monte_carlo
    from psmpc_cli.figures.registry import draw
    from psmpc_cli.simulation.monte_carlo_runs import read_monte_carlo

    present(path, read_monte_carlo(path), print_monte_carlo, partial(draw, "monte_carlo"), figures, force, quiet)
