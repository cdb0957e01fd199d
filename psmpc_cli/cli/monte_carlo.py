"""`psmpc monte-carlo`: the closed loop many times, each with other random numbers, and its tables."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Dask, Figures, Jobs, Resume
from psmpc_cli.cli.study import present, refuse_both, refuse_what_stands, resumable, watching_study
from psmpc_cli.cli.summary import number, print_table

if TYPE_CHECKING:
    from psmpc_cli.studies.monte_carlo import MonteCarloRuns

MOST = 100_000
"""Most runs of a study."""

WORST = 5
"""How many of the worst runs are named."""

DIGITS = 3
"""Decimals of a quantile."""


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
    from psmpc_cli.figures.registry import draw
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.studies.monte_carlo import MonteCarloRuns, monte_carlo_study
    from psmpc_cli.studies.runner import run_study

    refuse_both(resume, force, jobs, dask)
    study = monte_carlo_study(task, runs, tuple(changes or ()))
    path = output or Path("runs") / f"{study.task.spec.name}-monte-carlo.h5"
    if not resume:
        refuse_what_stands(path, force, figures)
    ensure_feasible(study.task)
    with resumable(path), watching_study(quiet, "failed") as watch:
        made = MonteCarloRuns(run_study(study, path, jobs, dask, force, resume, watch))
    present(path, made, print_monte_carlo, partial(draw, "monte_carlo"), figures, force or resume, quiet)


def print_monte_carlo(runs: "MonteCarloRuns") -> None:
    """Print a study, complete or not."""
    typer.echo(_success(runs))
    rows = [(each.name, str(each.runs), *(number(value, DIGITS) for value in each.at)) for each in runs.quantiles()]
    print_table(("over the runs that have it", "runs", "5 %", "50 %", "95 %"), rows, left=1)
    if len(worst := runs.worst(WORST)):
        typer.echo("worst runs: failed, latest, largest error")
        print_table(("seed", "", "ends [s]", "final error", "why"), [_row(runs, int(run)) for run in worst])
        typer.echo(f"repeat one: {runs.command(int(worst[0]))}")
    typer.echo(f"study: {runs.results.path}")


def _success(runs: "MonteCarloRuns") -> str:
    """Say how many runs succeeded, how sure the rate is, what became of all runs, and which exceeded limits."""
    from psmpc_cli.studies.monte_carlo import STATUS

    made, succeeded = int(runs.made.sum()), int(runs.succeeded.sum())
    counts = zip(STATUS, np.bincount(runs["status"], minlength=len(STATUS)), strict=True)
    states = ", ".join(f"{count} {meaning}" for meaning, count in counts if count)
    if not made:
        return f"no run was made yet: {states}"
    low, high = runs.interval
    rate = f"{100 * succeeded / made:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
    return "; ".join([f"{succeeded} of {made} runs succeeded: {rate} ({states})", *_exceeded(runs, made)])


def _exceeded(runs: "MonteCarloRuns", made: int) -> Iterator[str]:
    """Yield how many runs exceeded a limit of each kind, and by how much."""
    for kind in ("position", "velocity"):
        if count := np.count_nonzero(beyond := runs.exceeded(kind)):
            yield f"{count} of {made} exceeded a {kind} limit, by up to {100 * beyond.max():.2g} %"


def _row(runs: "MonteCarloRuns", run: int) -> tuple[str, ...]:
    word = "failed" if runs.failed[run] else "succeeded"
    end, error = number(float(runs["end_time"][run]), 2), number(float(runs["final_error"][run]), DIGITS)
    return str(runs["seed"][run]), word, end, error, runs.why(run)
