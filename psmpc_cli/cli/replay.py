"""`psmpc replay`: solve one horizon of a logged run again."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from psmpc_cli.simulation.replay import Replay

EQUAL = 1e-6
"""Up to which difference a solve counts as repeated."""

HEADINGS = ("", "logged", "again", "difference")


def replay(
    log: Annotated[Path, typer.Argument(help="A log written by psmpc simulate.")],
    step: Annotated[int, typer.Option("--step", metavar="K", help="Number of the sample, from 0.")],
    solver: Annotated[str | None, typer.Option(help="Another solver than the run's.")] = None,
) -> None:
    """Solve one horizon of a run again, from its log alone, and compare it with what was logged."""
    from psmpc_cli.cli.summary import print_table
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.replay import replay as solve_again

    loaded = read_run(log)
    replayed = solve_again(loaded, step, solver)
    window = replayed.logged.window
    stages = ", ".join(stage.name for stage in window.stages)
    typer.echo(
        f"sample {step} of {len(loaded.time)}, {window.start:.2f} s: window of {stages}; "
        f"solver {replayed.experiment.task.solver.kind}"
    )
    for remark in replayed.remarks:
        typer.echo(f"note: {remark}")
    typer.echo("\n".join(replayed.iterations))
    if replayed.largest_priority != 1:
        typer.echo(f"objective in the lines above: J over the largest priority, {replayed.largest_priority:g}")
    rows = [
        (each.name, f"{each.logged:.9g}", f"{each.again:.9g}", f"{each.difference:.1e}") for each in replayed.compared
    ]
    print_table(HEADINGS, [*rows, ("largest of a control in the plan", "", "", f"{replayed.apart:.1e}")], left=1)
    typer.echo(_verdict(replayed, int(loaded["solver/iterations"][step])))


def _verdict(replayed: "Replay", iterations: int) -> str:
    """Say how the two solves ended, and whether they agree."""
    before, after = replayed.logged.outcome, replayed.solution.outcome
    ended = f"{before.name.lower()} after {iterations} iterations"
    again = f"{after.name.lower()} after {replayed.solution.iterations}"
    why = "" if replayed.same_solver else ", by another solver"
    if replayed.largest <= EQUAL:
        return f"the log is repeated to {EQUAL:g}{why}: {ended}, again {again}"
    return f"differs from the log by up to {replayed.largest:.1e}{why}: {ended}, again {again}"
