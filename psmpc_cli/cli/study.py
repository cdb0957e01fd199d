"""What the commands of studies share: refused options, progress, signals, tables and figures."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from psmpc_cli.errors import InputError

if TYPE_CHECKING:
    from psmpc_cli.studies.runner import Progress, Watch

T = TypeVar("T")


def refuse_what_stands(path: Path, force: bool, figures: bool) -> None:
    """Refuse to write over an earlier study or its figures.

    Raises:
        InputError: There is one.
    """
    from psmpc_cli.cli.outputs import refuse_old_figures
    from psmpc_cli.figures.registry import default_directory
    from psmpc_cli.logs.files import check_output

    check_output(path, force)
    if figures:
        refuse_old_figures(default_directory(path), force)


def refuse_both(resume: bool, force: bool, jobs: int | None, dask: str | None) -> None:
    """Refuse --resume with --force, and --jobs with --dask.

    Raises:
        InputError: Both are given.
    """
    if resume and force:
        raise InputError("found both --resume and --force, expected at most one of them")
    if jobs is not None and dask is not None:
        raise InputError("found both --jobs and --dask, expected at most one: a cluster has as many workers as it has")


@contextmanager
def resumable(path: Path) -> Iterator[None]:
    """Let a signal end what fills in a file; what there is stays."""
    from psmpc_cli.cli.termination import stopping_on_signals

    with stopping_on_signals() as interruption:
        try:
            yield
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; {path} holds what was done: go on with --resume", err=True)
            raise typer.Exit(interruption.exit_code) from None


@contextmanager
def watching_study(quiet: bool, failed: str = "cells failed") -> "Iterator[Watch]":
    """Show how far a study has come: a bar with the estimated end on a terminal, a line for every run elsewhere.

    Args:
        quiet: Show nothing.
        failed: Follows the number of cells that failed.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if quiet:
        yield lambda progress: None
    elif not console.is_terminal:
        yield lambda progress: typer.echo(
            f"{progress.ended} of {progress.runs} runs{_outlook(progress, failed)}", err=True
        )
    else:
        columns = (
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("runs"),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
        )
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task("")
            yield lambda progress: bar.update(
                task, total=progress.runs, completed=progress.ended, description=_outlook(progress, failed)
            )


def _outlook(progress: "Progress", failed: str) -> str:
    failures = f", {progress.failed} {failed}" if progress.failed else ""
    if not 0 < progress.ended < progress.runs:
        return failures
    left = progress.elapsed / progress.ended * (progress.runs - progress.ended)
    return f"{failures}, about {left // 60:.0f} min {left % 60:.0f} s left"


def present(
    path: Path,
    results: T,
    table: Callable[[T], None],
    draw: Callable[..., list[Path]],
    figures: bool,
    force: bool,
    quiet: bool,
) -> None:
    """Print the table of a study's results and draw their figures beside its file."""
    from psmpc_cli.figures.registry import default_directory

    if not quiet:
        table(results)
    if figures:
        directory = default_directory(path)
        drawn = draw(results, directory, force=force)
        if not quiet:
            typer.echo(f"{len(drawn)} figures in {directory}")
