"""The progress of runs and studies, and how signals end them: a live display on a terminal, plain lines elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from psmpc_cli.errors import Interruption, deferred_signals

if TYPE_CHECKING:
    from psmpc_cli.logs.schema import Sample
    from psmpc_cli.studies.runner import Progress

PLAIN_INTERVAL = 5.0
"""Simulated time between two plain lines [s]."""


@contextmanager
def ending_on_signals(outcome: str) -> Iterator[Interruption]:
    """Let a signal end what is done inside with one message, `outcome`, and the exit code of the signal."""
    with deferred_signals() as interruption:
        try:
            yield interruption
        except KeyboardInterrupt as reason:
            typer.echo(f"psmpc: {reason}; {outcome}", err=True)
            raise typer.Exit(interruption.exit_code) from None


@contextmanager
def live_line(quiet: bool) -> Iterator[Callable[..., None]]:
    """Provide what shows a line: in place of the one before on a terminal; elsewhere as a further line, if `due`."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True, quiet=quiet)
    if console.is_terminal:
        with Live(console=console, refresh_per_second=8, transient=True) as live:
            yield lambda text, due=True: live.update(Text(text, overflow="ellipsis", no_wrap=True))
    else:
        yield lambda text, due=True: typer.echo(text, err=True) if due and not quiet else None


@contextmanager
def watched_run(quiet: bool) -> "Iterator[tuple[Callable[[Sample], None], Interruption]]":
    """Provide a watcher that shows the progress of a run and ends it after the sample at which a signal came.

    Its line has time, stage, planned switch times, real-time factor since the first sample, and failed solves.
    """
    began, due, failed = 0.0, 0.0, 0
    with deferred_signals() as interruption, live_line(quiet) as show:

        def watch(sample: "Sample") -> None:
            nonlocal began, due, failed
            command, now = sample.command, time.monotonic()
            began = began or now
            failed += "solve_failed" in command.events
            factor = f"{command.time / (now - began):.1f}" if command.time > 0 else "-"
            ahead = ", ".join(f"{instant:.2f}" for instant in command.instants) or "none"
            is_due = command.time >= due or bool(command.switches)
            due = command.time + PLAIN_INTERVAL if is_due else due
            show(
                f"{command.time:5.1f} s  {command.stage.name:<10} planned switch times: {ahead:<12} "
                f"{factor:>5} x real time  failed solves: {failed}",
                is_due,
            )
            interruption.check()

        yield watch, interruption


def describe_progress(progress: "Progress") -> str:
    """Write how many runs of a study have ended, and the estimated time to its end."""
    text = f"{progress.ended} of {progress.runs} runs"
    text += f", {progress.failed} failed" if progress.failed else ""
    if 0 < progress.ended < progress.runs:
        left = progress.elapsed / progress.ended * (progress.runs - progress.ended)
        text += f", about {left // 60:.0f} min {left % 60:.0f} s left"
    return text
