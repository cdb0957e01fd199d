"""`psmpc simulate`: run a task in closed loop, write its log, draw its figures."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from psmpc_cli.logs.read import Log


def simulate(
    task: Annotated[str, typer.Argument(help="Task file, or the name of a built-in task such as 'transport'.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Log file. Default: runs/<task>.h5.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the log and figures of an earlier run.")] = False,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change any key of the task; repeatable.")
    ] = None,
    controller: Annotated[str | None, typer.Option(help="Controller: psmpc, smpc or hard.")] = None,
    plant: Annotated[str | None, typer.Option(help="Plant: rk4 or ideal.")] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures beside the log.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Report every event of the run.")] = False,
) -> None:
    """Run a task in closed loop: log and figures go to runs/."""
    import logging

    from psmpc_cli.cli.progress import watching
    from psmpc_cli.cli.summary import print_summary
    from psmpc_cli.cli.termination import raised_on_termination
    from psmpc_cli.errors import RunError
    from psmpc_cli.experiment.run import run
    from psmpc_cli.experiment.summary import summarize
    from psmpc_cli.logs.read import read_log
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.specs.load import load_task

    logging.getLogger("psmpc_cli").setLevel(logging.INFO if verbose else logging.ERROR if quiet else logging.WARNING)
    chosen = {"controller.kind": controller, "plant.kind": plant}
    overrides = [*(changes or []), *(f"{path}={value}" for path, value in chosen.items() if value is not None)]
    loaded = load_task(task, overrides)
    ensure_feasible(loaded)
    path = output or _default_path(loaded.spec.name, controller, plant)
    directory = path.with_suffix("")
    if figures:
        _refuse_old_figures(directory, force)
    with raised_on_termination() as interruption, watching(loaded, quiet) as watch:
        ending = run(loaded, path, force, watch)
    log = read_log(path)
    if not quiet:
        print_summary(summarize(log), path)
    if figures and len(log.time):
        _draw(log, directory, force, quiet)
    if ending is None:
        raise typer.Exit(interruption.exit_code)
    if ending.stuck:
        raise RunError(f"{ending.reason}; {path} holds the run up to then")


def _default_path(name: str, *variants: str | None) -> Path:
    """Return runs/<task>.h5, with the controller and plant asked for in its name."""
    return Path("runs") / ("-".join([name, *(v for v in variants if v is not None)]) + ".h5")


def _refuse_old_figures(directory: Path, force: bool) -> None:
    """Find out before the run, not after it, that figures would be overwritten."""
    from psmpc_cli.errors import InputError

    if not force and directory.is_dir() and any(directory.iterdir()):
        raise InputError(
            f"{directory} holds figures already: choose another log with -o, overwrite with --force, or use --no-figures"
        )


def _draw(log: "Log", directory: Path, force: bool, quiet: bool) -> None:
    """Draw every figure of the log."""
    from psmpc_cli.figures import draw

    drawn = draw(log, directory, ("png",), force=force)
    if not quiet:
        typer.echo(f"{len(drawn)} figures in {directory}")
