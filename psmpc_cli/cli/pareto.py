"""`psmpc pareto`: the fronts between the costs of two stages at several samples of a run, Fig. 7 of the paper."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from psmpc_cli.cli.options import FOLDERS, Changes, Figures, Jobs
from psmpc_cli.cli.study import present, refuse_what_stands
from psmpc_cli.errors import InputError, RunError

if TYPE_CHECKING:
    from psmpc_cli.specs.load import Task
    from psmpc_cli.studies.pareto import Question

PREPARED = ("log.plans=true", "log.shares=false")
"""What the closed loop logs: the windows themselves, and no more than they need."""


def pareto(
    task: Annotated[
        str, typer.Argument(help="Task file, the name of a built-in task, or the log of a run with its plans.")
    ] = "approach_capture",
    stages: Annotated[
        str, typer.Option(metavar="A,B", help="The two stages in a row that are studied, by number or name.")
    ] = "1,2",
    at: Annotated[
        str | None,
        typer.Option(metavar="T,...", help="Sampling instants [s]. Default: five, from detection to the switch."),
    ] = None,
    points: Annotated[int, typer.Option(metavar="N", help="Points of each front, by each method.")] = 25,
    method: Annotated[str, typer.Option(help="weighted-sum, epsilon-constraint or both.")] = "both",
    free_instant: Annotated[
        bool, typer.Option("--free-instant", help="Make the switching instant a third criterion.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=f"Results. {FOLDERS} Default: runs/<task>-pareto.h5."),
    ] = None,
    log: Annotated[Path | None, typer.Option(metavar="FILE", help="Keep the log of the closed loop here.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite earlier results and figures.")] = False,
    changes: Changes = None,
    jobs: Jobs = None,
    figures: Figures = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
) -> None:
    """Find what two stages cost at each other's expense: Pareto fronts at several samples of a run."""
    from psmpc_cli.cli.fronts import print_fronts
    from psmpc_cli.figures.registry import draw
    from psmpc_cli.logs.files import check_output
    from psmpc_cli.studies.fronts import read_pareto
    from psmpc_cli.studies.pareto import Question, ensure_answerable, parse_times

    question = Question(stages, parse_times(at), points, method, free_instant)
    ensure_answerable(question)
    subject = _subject(task, changes or [], log, stages)
    name = subject.stem if isinstance(subject, Path) else subject.spec.name
    path = output or Path("runs") / f"{name}-pareto.h5"
    refuse_what_stands(path, force, figures)
    if log is not None:
        check_output(log, force)
    with _log_of(subject, log, quiet) as run:
        _solve(run, question, path, force, jobs, quiet)
    table = partial(print_fronts, path=path)
    present(path, read_pareto(path), table, partial(draw, "pareto"), figures, force, quiet)


def _subject(reference: str, changes: list[str], log: Path | None, stages: str) -> "Path | Task":
    """Return the log or the task that is studied.

    Raises:
        InputError: The task of a log is to be changed, or the stages are no two in a row.
        SpecError: The task does not hold.
    """
    from psmpc_cli.ocp.feasibility import ensure_feasible
    from psmpc_cli.specs.load import load_task
    from psmpc_cli.studies.pareto import is_log
    from psmpc_cli.studies.weights import parse_stages

    if is_log(reference):
        if changes or log is not None:
            raise InputError(f"{reference} is the log of a run: it is studied as it ran, without --set and --log")
        return Path(reference)
    loaded = load_task(reference, [*changes, *PREPARED])
    parse_stages(stages, loaded)
    ensure_feasible(loaded)
    return loaded


@contextmanager
def _log_of(subject: "Path | Task", keep: Path | None, quiet: bool) -> Iterator[Path]:
    """Give the log to study: the one there is, or that of a closed loop, which is run now."""
    from tempfile import TemporaryDirectory

    if isinstance(subject, Path):
        yield subject
        return
    with TemporaryDirectory(prefix="psmpc-pareto-") as directory:
        path = keep or Path(directory) / "run.h5"
        _run(subject, path, quiet)
        yield path


def _run(loaded: "Task", path: Path, quiet: bool) -> None:
    """Run the closed loop; a signal ends it, and nothing is studied.

    Raises:
        RunError: It could not go on.
    """
    from psmpc_cli.cli.progress import watching
    from psmpc_cli.cli.termination import noticing_signals
    from psmpc_cli.logs.schema import Sample
    from psmpc_cli.simulation.run import simulate

    with noticing_signals() as interruption, watching(quiet) as show:

        def watch(sample: Sample) -> None:
            show(sample)
            interruption.check()

        run = simulate(loaded, path, watch, force=True)
        if run.interrupted:
            typer.echo("psmpc: interrupted; no results were written", err=True)
            raise typer.Exit(interruption.exit_code)
    if run.attributes["stuck"]:
        raise RunError(f"the closed loop could not go on: {run.attributes['end_reason']}")


def _solve(log: Path, question: "Question", path: Path, force: bool, jobs: int | None, quiet: bool) -> None:
    """Find the fronts and say which samples are done; a signal ends it, and nothing is written."""
    from psmpc_cli.cli.termination import stopping_on_signals
    from psmpc_cli.studies.pareto import solve_pareto

    def done(instant: float, ended: int, count: int) -> None:
        if not quiet:
            typer.echo(f"front at {instant:.1f} s done, {ended} of {count}", err=True)

    with stopping_on_signals() as interruption:
        try:
            solve_pareto(log, question, path, jobs, force, done)
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; no results were written", err=True)
            raise typer.Exit(interruption.exit_code) from None
