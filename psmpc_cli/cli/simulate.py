"""`psmpc simulate`: run a task in closed loop, or finish a run, write its log, draw its figures."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import FOLDERS, Changes
from psmpc_cli.cli.outputs import refuse_old_figures
from psmpc_cli.errors import InputError, RunError

if TYPE_CHECKING:
    from psmpc_cli.logs.comparison import Comparison
    from psmpc_cli.logs.run import Run
    from psmpc_cli.logs.schema import Sample
    from psmpc_cli.specs.overrides import Change

    Watch = Callable[[Sample], None]


def simulate(
    task: Annotated[
        str | None,
        typer.Argument(help="Task file, or the name of a built-in task such as 'transport'.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=f"Run file. {FOLDERS} Default: runs/<task>.h5."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the log and figures of an earlier run.")] = False,
    changes: Changes = None,
    controller: Annotated[str | None, typer.Option(help="Short for --set controller.kind=...")] = None,
    plant: Annotated[str | None, typer.Option(help="Short for --set plant.kind=...")] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures beside the log.")] = True,
    render: Annotated[
        bool, typer.Option("--render", help="Film the run with MuJoCo's renderer: render.gif, and an MP4 with ffmpeg.")
    ] = False,
    unfinished: Annotated[
        Path | None,
        typer.Option(
            "--continue",
            metavar="LOG",
            help="Finish a run that was killed or interrupted: it is repeated and checked against its log.",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Report every event of the run.")] = False,
) -> None:
    """Run a task in closed loop: log and figures go to runs/."""
    import logging

    from psmpc_cli.cli.summary import print_summary
    from psmpc_cli.figures.animation import offscreen_driver
    from psmpc_cli.figures.registry import default_directory
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.specs.overrides import Short

    if quiet and verbose:
        raise InputError("found both --quiet and --verbose, expected at most one of them")
    logging.getLogger("psmpc_cli").setLevel(logging.INFO if verbose else logging.ERROR if quiet else logging.WARNING)
    logging.getLogger("psmpc_cli.native").setLevel(logging.ERROR if quiet else logging.INFO)  # the first compilation
    short = {"controller": controller, "plant": plant}
    chosen = [Short(f"--{name}", f"{name}.kind", value) for name, value in short.items() if value is not None]
    overrides: list[Change] = [*(changes or []), *chosen]
    if unfinished is not None:
        path = output or unfinished
        run = _continued(unfinished, output, alone=not (task or overrides))
    elif task is not None:
        path, run = _new(task, overrides, output, (controller, plant), force)
    else:
        raise InputError("found no task: expected a task file, a built-in name such as transport, or --continue LOG")
    if figures or render:
        refuse_old_figures(default_directory(path), force)
    if render:
        offscreen_driver()
    exit_code = _watched(run, quiet)
    log = read_run(path)
    if not quiet:
        print_summary(log.summary(), path)
    if (figures or render) and len(log.time):
        _draw(log, default_directory(path), force, quiet, figures, render)
    if log.interrupted:
        raise typer.Exit(exit_code)
    if log.attributes["stuck"]:
        raise _stuck(log)


def _default_path(name: str, *variants: str | None) -> Path:
    """Return runs/<task>.h5, with the controller and plant asked for in its name."""
    return Path("runs") / ("-".join([name, *(v for v in variants if v is not None)]) + ".h5")


def _new(
    task: str, overrides: "Sequence[Change]", output: Path | None, variants: tuple[str | None, ...], force: bool
) -> "tuple[Path, Callable[[Watch], object]]":
    """Return the log of a new run, and what runs it."""
    from psmpc_cli.logs.files import check_output
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.simulation.run import simulate as run
    from psmpc_cli.specs.load import load_task

    loaded = load_task(task, overrides)
    path = output or _default_path(loaded.spec.name, *variants)
    check_output(path, force)

    def begin(watch: "Watch") -> object:
        ensure_feasible(loaded)
        return run(loaded, path, watch, force)

    return path, begin


def _continued(path: Path, output: Path | None, alone: bool) -> "Callable[[Watch], object]":
    """Return what finishes an unfinished run, by running it again from its beginning."""
    from psmpc_cli.logs.run import read_run
    from psmpc_cli.simulation.run import continue_run, ensure_unfinished

    if not alone:
        raise InputError(
            "--continue goes on with the task in the log: expected no task, --set, --controller or --plant beside it"
        )
    log = read_run(path)
    ensure_unfinished(log)

    def run(watch: "Watch") -> object:
        comparison = continue_run(log, output, watch)
        if comparison is not None and comparison.differences:
            _differs(log, comparison, output)
        return comparison

    return run


def _differs(log: "Run", comparison: "Comparison", output: Path | None) -> None:
    """Print how a repeated run differs from its log; where it was to take the log's place, exit."""
    from psmpc_cli.cli.rerun import print_differences
    from psmpc_cli.simulation.run import unequal_conditions

    print_differences(comparison)
    for condition in unequal_conditions(log):
        typer.echo(f"note: {condition}")
    if output is None:
        typer.echo(
            f"{log.path} was not continued, since the run differs from it when it is repeated, and stays as it was; "
            "with -o FILE the whole run goes to another file",
            err=True,
        )
        raise typer.Exit(1)


def _watched(run: "Callable[[Watch], object]", quiet: bool) -> int:
    """Run with the progress display; return the exit code of an interrupted run."""
    from psmpc_cli.cli.progress import watching
    from psmpc_cli.cli.termination import noticing_signals

    with noticing_signals() as interruption, watching(quiet) as show:

        def watch(sample: "Sample") -> None:
            show(sample)
            interruption.check()

        run(watch)
        return interruption.exit_code


def _stuck(log: "Run") -> RunError:
    """Return the error of a run that could not go on, with what the last solve's outcome advises."""
    from psmpc_cli.solvers import Outcome

    outcomes = [Outcome[str(status).upper()] for status in log["solver/status"][-1:]]
    advice = "".join(f" ({outcome.value})" for outcome in outcomes if not outcome.usable)
    return RunError(f"{log.attributes['end_reason']}{advice}; {log.path} holds the run up to then")


def _draw(log: "Run", directory: Path, force: bool, quiet: bool, figures: bool, render: bool) -> None:
    """Draw every figure of the log, film it, or both."""
    from psmpc_cli.figures.registry import draw

    films = ("render",) if render else ()
    drawn = draw("run", log, directory, only=None if figures else (), force=force, films=films)
    if not quiet:
        typer.echo(f"{len(drawn)} figures in {directory}" if figures else f"film in {directory}")
