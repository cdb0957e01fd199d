"""`psmpc simulate`: run a task in closed loop, write its log, draw its figures."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.outputs import refuse_old_figures
from psmpc_cli.errors import InputError, RunError

if TYPE_CHECKING:
    from psmpc_cli.experiment.loop import Ending
    from psmpc_cli.logs.read import Log
    from psmpc_cli.specs.load import LoadedTask


def simulate(
    task: Annotated[str, typer.Argument(help="Task file, or the name of a built-in task such as 'transport'.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Log file. Default: runs/<task>.h5.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the log and figures of an earlier run.")] = False,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change any key of the task; repeatable.")
    ] = None,
    controller: Annotated[str | None, typer.Option(help="Short for --set controller.kind=...")] = None,
    plant: Annotated[str | None, typer.Option(help="Short for --set plant.kind=...")] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures beside the log.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Report every event of the run.")] = False,
) -> None:
    """Run a task in closed loop: log and figures go to runs/."""
    import logging

    from psmpc_cli.cli.summary import print_summary
    from psmpc_cli.experiment.summary import summarize
    from psmpc_cli.figures.draw import default_directory
    from psmpc_cli.logs.create import refuse
    from psmpc_cli.logs.read import read_log
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.specs.load import load_task

    if quiet and verbose:
        raise InputError("found both --quiet and --verbose, expected at most one of them")
    logging.getLogger("psmpc_cli").setLevel(logging.INFO if verbose else logging.ERROR if quiet else logging.WARNING)
    chosen = {"controller.kind": controller, "plant.kind": plant}
    overrides = [*(changes or []), *(f"{path}={value}" for path, value in chosen.items() if value is not None)]
    loaded = load_task(task, overrides)
    path = output or _default_path(loaded.spec.name, controller, plant)
    refuse(path, force)
    if figures:
        refuse_old_figures(default_directory(path), force)
    ensure_feasible(loaded)
    ending, exit_code = _run(loaded, path, force, quiet)
    log = read_log(path)
    if not quiet:
        print_summary(summarize(log), path)
    if figures and len(log.time):
        _draw(log, default_directory(path), force, quiet)
    if ending is None:
        raise typer.Exit(exit_code)
    if ending.stuck:
        raise _stuck(ending, log)


def _default_path(name: str, *variants: str | None) -> Path:
    """Return runs/<task>.h5, with the controller and plant asked for in its name."""
    return Path("runs") / ("-".join([name, *(v for v in variants if v is not None)]) + ".h5")


def _run(loaded: "LoadedTask", path: Path, force: bool, quiet: bool) -> "tuple[Ending | None, int]":
    """Run a task under the eyes of the progress display; return its ending, and the exit code if there is none."""
    from psmpc_cli.cli.progress import watching
    from psmpc_cli.cli.termination import noticing_signals
    from psmpc_cli.experiment.run import Progress, run

    with noticing_signals() as interruption, watching(quiet) as show:

        def watch(progress: Progress) -> None:
            show(progress)
            interruption.check()

        return run(loaded, path, force, watch), interruption.exit_code


def _stuck(ending: "Ending", log: "Log") -> RunError:
    """Return the error of a run that could not go on, with what the last solve's outcome advises."""
    from psmpc_cli.solvers import Outcome

    advice = Outcome[str(log["solver/status"][-1]).upper()].value
    return RunError(f"{ending.reason} ({advice}); {log.path} holds the run up to then")


def _draw(log: "Log", directory: Path, force: bool, quiet: bool) -> None:
    """Draw every figure of the log."""
    from psmpc_cli.figures.draw import draw

    drawn = draw(log, directory, force=force)
    if not quiet:
        typer.echo(f"{len(drawn)} figures in {directory}")
