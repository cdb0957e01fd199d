"""`psmpc compare`: run several controllers on one task and lay the results side by side."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Figures, Jobs
from psmpc_cli.cli.study import present, refuse_what_stands

if TYPE_CHECKING:
    from collections.abc import Mapping

    from psmpc_cli.logs.run import Run
    from psmpc_cli.specs.load import Task


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
    from psmpc_cli.figures.registry import draw
    from psmpc_cli.logs.run import read_comparison
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.studies.compare import compared_tasks, controllers_in

    tasks = compared_tasks(task, controllers_in(controllers), changes or [])
    first = next(iter(tasks.values()))
    path = output or Path("runs") / f"{first.spec.name}-comparison.h5"
    refuse_what_stands(path, force, figures)
    ensure_feasible(first)
    _compare(tasks, path, force, jobs, quiet)

    def table(logs: "Mapping[str, Run]") -> None:
        print_comparison({name: log.summary() for name, log in logs.items()}, path)

    def drawing(logs: "Mapping[str, Run]", directory: Path, force: bool) -> list[Path]:
        return draw("comparison", dict(logs), directory, force=force)

    present(path, read_comparison(path), table, drawing, figures, force, quiet)


def _compare(tasks: "Mapping[str, Task]", path: Path, force: bool, jobs: int | None, quiet: bool) -> None:
    """Run the comparison under the eyes of the progress display; a signal ends it, and nothing is written."""
    from psmpc_cli.cli.parallel import watching_runs
    from psmpc_cli.cli.termination import stopping_on_signals
    from psmpc_cli.studies.compare import compare_tasks

    with stopping_on_signals() as interruption, watching_runs(quiet) as runs:
        try:
            compare_tasks(tasks, path, force, jobs, runs.began, runs.done)
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; no comparison was written", err=True)
            raise typer.Exit(interruption.exit_code) from None
