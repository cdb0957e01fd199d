"""The progress of a run: one live line on a terminal, plain lines elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from psmpc_cli.experiment.run import Progress
from psmpc_cli.specs.load import LoadedTask

PLAIN_INTERVAL = 5.0
"""Simulated time between two plain lines [s]."""


@contextmanager
def watching(loaded: LoadedTask, quiet: bool) -> Iterator[Callable[[Progress], None]]:
    """Give a watcher that shows simulated time, stage, instants ahead, real-time factor and fall-backs."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True)
    if quiet:
        yield lambda progress: None
        return
    began = time.monotonic()
    if not console.is_terminal:
        yield _plain(console.print, began)
        return
    with Live(console=console, refresh_per_second=8, transient=True) as live:
        yield lambda progress: live.update(Text(_line(progress, began)))


def _plain(show: Callable[[str], None], began: float) -> Callable[[Progress], None]:
    """Return a watcher that shows a line every few simulated seconds and at every switch."""
    due = 0.0

    def watch(progress: Progress) -> None:
        nonlocal due
        if progress.record.time >= due or progress.record.switches:
            show(_line(progress, began))
            due = progress.record.time + PLAIN_INTERVAL

    return watch


def _line(progress: Progress, began: float) -> str:
    record = progress.record
    ahead = ", ".join(f"{instant:.2f}" for instant in record.instants) or "none"
    factor = record.time / max(time.monotonic() - began, 1e-9)
    return (
        f"{record.time:6.1f} s  {progress.stage:<12} switches ahead [s]: {ahead:<14} "
        f"{factor:4.1f} x real time  fall-backs: {progress.fallbacks}"
    )
