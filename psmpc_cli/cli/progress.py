"""The progress of a run: one live line on a terminal, plain lines elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from psmpc_cli.logs.schema import Sample

PLAIN_INTERVAL = 5.0
"""Simulated time between two plain lines [s]."""

Watcher = Callable[[Sample], None]


@contextmanager
def watching(quiet: bool) -> Iterator[Watcher]:
    """Give a watcher that shows simulated time, stage, instants ahead, real-time factor and failed solves."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console, line = Console(stderr=True), Line()
    if quiet:
        yield lambda sample: None
    elif not console.is_terminal:
        yield _plain(line)
    else:
        with Live(console=console, refresh_per_second=8, transient=True) as live:
            yield lambda sample: live.update(Text(line.of(sample), overflow="ellipsis", no_wrap=True))


def _plain(line: "Line") -> Watcher:
    """Return a watcher that prints a line every few simulated seconds and at every switch."""
    due = 0.0

    def watch(sample: Sample) -> None:
        nonlocal due
        text = line.of(sample)
        if sample.command.time >= due or sample.command.switches:
            typer.echo(text, err=True)
            due = sample.command.time + PLAIN_INTERVAL

    return watch


class Line:
    """Writes progress as one line; the real-time factor counts from the first sample on."""

    def __init__(self) -> None:
        self._began: float | None = None
        self._failed = 0

    def of(self, sample: Sample) -> str:
        """Return the line of a sample."""
        command, now = sample.command, time.monotonic()
        self._failed += "solve_failed" in command.events
        if self._began is None:
            self._began = now
        elapsed = now - self._began
        factor = f"{command.time / elapsed:.1f}" if elapsed > 0 and command.time > 0 else "-"
        ahead = ", ".join(f"{instant:.2f}" for instant in command.instants) or "none"
        return (
            f"{command.time:5.1f} s  {command.stage.name:<10} switches at: {ahead:<12} "
            f"{factor:>5} x real time  failed solves: {self._failed}"
        )
