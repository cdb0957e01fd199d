"""The progress of a run: one live line on a terminal, plain lines elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from psmpc_cli.simulation.run import Progress

PLAIN_INTERVAL = 5.0
"""Simulated time between two plain lines [s]."""

Watcher = Callable[[Progress], None]


@contextmanager
def watching(quiet: bool) -> Iterator[Watcher]:
    """Give a watcher that shows simulated time, stage, instants ahead, real-time factor and fall-backs."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console, line = Console(stderr=True), Line()
    if quiet:
        yield lambda progress: None
    elif not console.is_terminal:
        yield _plain(line)
    else:
        with Live(console=console, refresh_per_second=8, transient=True) as live:
            yield lambda progress: live.update(Text(line.of(progress), overflow="ellipsis", no_wrap=True))


def _plain(line: "Line") -> Watcher:
    """Return a watcher that prints a line every few simulated seconds and at every switch."""
    due = 0.0

    def watch(progress: Progress) -> None:
        nonlocal due
        text = line.of(progress)
        if progress.record.time >= due or progress.record.switches:
            typer.echo(text, err=True)
            due = progress.record.time + PLAIN_INTERVAL

    return watch


class Line:
    """Writes progress as one line; the real-time factor counts from the first sample on."""

    def __init__(self) -> None:
        self._began: float | None = None

    def of(self, progress: Progress) -> str:
        """Return the line of a sample."""
        record, now = progress.record, time.monotonic()
        if self._began is None:
            self._began = now
        elapsed = now - self._began
        factor = f"{record.time / elapsed:.1f}" if elapsed > 0 and record.time > 0 else "-"
        ahead = ", ".join(f"{instant:.2f}" for instant in record.instants) or "none"
        return (
            f"{record.time:5.1f} s  {progress.stage:<10} switches at: {ahead:<12} "
            f"{factor:>5} x real time  fall-backs: {progress.fallbacks}"
        )
