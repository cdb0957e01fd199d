"""The progress of a sweep: a bar with the estimated end on a terminal, a line for every run elsewhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from psmpc_cli.studies.sweep import SweepProgress

Watcher = Callable[[SweepProgress], None]


@contextmanager
def watching_sweep(quiet: bool, failed: str = "cells failed") -> Iterator[Watcher]:
    """Give what a sweep tells how far it has come; `failed` is said of the number of those that failed."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if quiet:
        yield lambda progress: None
    elif not console.is_terminal:
        yield lambda progress: typer.echo(describe(progress, failed), err=True)
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


def describe(progress: SweepProgress, failed: str) -> str:
    """Return how far a sweep has come, and when it may end."""
    return f"{progress.ended} of {progress.runs} runs{_outlook(progress, failed)}"


def _outlook(progress: SweepProgress, failed: str) -> str:
    failures = f", {progress.failed} {failed}" if progress.failed else ""
    if not 0 < progress.ended < progress.runs:
        return failures
    left = progress.elapsed / progress.ended * (progress.runs - progress.ended)
    return f"{failures}, about {left // 60:.0f} min {left % 60:.0f} s left"
