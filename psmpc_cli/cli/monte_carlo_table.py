"""A Monte Carlo study as tables: the success rate, how runs spread, and the worst of them."""

import numpy as np
import typer

from psmpc_cli.cli.summary import number, print_table
from psmpc_cli.simulation.monte_carlo_runs import STATUS, MonteCarloRuns

WORST = 5
"""How many of the worst runs are named."""

DIGITS = 3
"""Decimals of a quantile."""


def print_monte_carlo(runs: MonteCarloRuns) -> None:
    """Print a study, complete or not."""
    typer.echo(_success(runs))
    rows = [(each.name, str(each.runs), *(number(value, DIGITS) for value in each.at)) for each in runs.quantiles()]
    print_table(("over the runs that have it", "runs", "5 %", "50 %", "95 %"), rows, left=1)
    if len(worst := runs.worst(WORST)):
        typer.echo("worst runs: failed, latest, largest error")
        print_table(("seed", "", "ends [s]", "final error", "why"), [_row(runs, int(run)) for run in worst])
        typer.echo(f"repeat one: {runs.command(int(worst[0]))}")
    typer.echo(f"study: {runs.results.path}")


def _success(runs: MonteCarloRuns) -> str:
    """Say how many runs succeeded, how sure the rate is, and what became of all runs."""
    made, succeeded = int(runs.made.sum()), int(runs.succeeded.sum())
    counts = zip(STATUS, np.bincount(runs["status"], minlength=len(STATUS)), strict=True)
    states = ", ".join(f"{count} {meaning}" for meaning, count in counts if count)
    if not made:
        return f"no run was made yet: {states}"
    low, high = runs.interval
    rate = f"{100 * succeeded / made:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
    return f"{succeeded} of {made} runs succeeded: {rate} ({states})"


def _row(runs: MonteCarloRuns, run: int) -> tuple[str, ...]:
    word = "failed" if runs.failed[run] else "succeeded"
    end, error = number(float(runs["end_time"][run]), 2), number(float(runs["final_error"][run]), DIGITS)
    return str(runs["seed"][run]), word, end, error, runs.why(run)
