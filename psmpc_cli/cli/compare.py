"""`psmpc compare`: run several controllers on one task and lay the results side by side."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Figures, Jobs

if TYPE_CHECKING:
    from collections.abc import Mapping

    from psmpc_cli.specs.load import LoadedTask


def compare(
    task: Annotated[str, typer.Argument(help="Task file, or the name of a built-in task such as 'transport'.")],
    controllers: Annotated[
        str, typer.Option(metavar="KIND,...", help="Which controllers, in the order of the table.")
    ] = "psmpc,smpc,htmpc,hard",
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help=f"File of all logs. {FOLDERS} Default: runs/<task>-comparison.h5."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier comparison and its figures.")] = False,
    changes: Changes = None,
    jobs: Jobs = None,
    figures: Figures = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
) -> None:
    """Run controllers on the identical task, and lay their results side by side: a table, one file, figures."""
    from psmpc_cli.cli.comparison import print_comparison
    from psmpc_cli.cli.outputs import refuse_old_figures
    from psmpc_cli.experiment.summary import summarize
    from psmpc_cli.figures.comparison.draw import draw_comparison
    from psmpc_cli.figures.draw import default_directory
    from psmpc_cli.logs.comparison import read_comparison
    from psmpc_cli.logs.new_file import refuse
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.studies.compare import compared_tasks, controllers_in

    tasks = compared_tasks(task, controllers_in(controllers), changes or [])
    first = next(iter(tasks.values()))
    path = output or Path("runs") / f"{first.spec.name}-comparison.h5"
    directory = default_directory(path)
    refuse(path, force)
    if figures:
        refuse_old_figures(directory, force)
    ensure_feasible(first)
    _compare(tasks, path, force, jobs, quiet)
    logs = read_comparison(path)
    if not quiet:
        print_comparison({name: summarize(log) for name, log in logs.items()}, path)
    if figures:
        drawn = draw_comparison(logs, directory, force=force)
        if not quiet:
            typer.echo(f"{len(drawn)} figures in {directory}")


def _compare(tasks: "Mapping[str, LoadedTask]", path: Path, force: bool, jobs: int | None, quiet: bool) -> None:
    """Run the comparison under the eyes of the progress display; a signal ends it, and nothing is written."""
    from psmpc_cli.cli.parallel import watching_runs
    from psmpc_cli.cli.termination import stopping_on_signals
    from psmpc_cli.studies.compare import compare as run_comparison

    with stopping_on_signals() as interruption, watching_runs(quiet) as runs:
        try:
            run_comparison(tasks, path, force, jobs, runs.began, runs.done)
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; no comparison was written", err=True)
            raise typer.Exit(interruption.exit_code) from None
