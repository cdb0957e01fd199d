"""The progress of a sweep: a bar with the estimated end on a terminal, a line for every run elsewhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from psmpc_cli.studies.sweep import SweepProgress

Watcher = Callable[[SweepProgress], None]


@contextmanager
def watching_sweep(quiet: bool) -> Iterator[Watcher]:
    """Give what a sweep tells how far it has come."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if quiet:
        yield lambda progress: None
    elif not console.is_terminal:
        yield lambda progress: typer.echo(describe(progress), err=True)
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
                task, total=progress.runs, completed=progress.ended, description=_outlook(progress)
            )


def describe(progress: SweepProgress) -> str:
    """Return how far a sweep has come, and when it may end."""
    return f"{progress.ended} of {progress.runs} runs{_outlook(progress)}"


def _outlook(progress: SweepProgress) -> str:
    failed = f", {progress.failed} cells failed" if progress.failed else ""
    if not 0 < progress.ended < progress.runs:
        return failed
    left = progress.elapsed / progress.ended * (progress.runs - progress.ended)
    return f"{failed}, about {left // 60:.0f} min {left % 60:.0f} s left"
