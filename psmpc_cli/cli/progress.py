"""The progress of runs and studies, and how signals end them: a live display on a terminal, plain lines elsewhere."""

import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Self

import typer

if TYPE_CHECKING:
    from rich.text import Text

    from psmpc_cli.logs.schema import Sample
    from psmpc_cli.studies.runner import Progress

PLAIN_INTERVAL = 5.0
"""Simulated time between two plain lines [s]."""

SIGNALS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
"""The signals that end a command, and how its log and messages name that."""


@dataclass
class Interruption:
    """The signal that ends a command; 0 as long as none has come."""

    number: int = 0

    @property
    def exit_code(self) -> int:
        """Exit code of a program that the signal ended."""
        return 128 + (self.number or signal.SIGINT)

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self.number:
            raise KeyboardInterrupt(SIGNALS[signal.Signals(self.number)])


@contextmanager
def handled_signals(at_once: bool) -> Iterator[Interruption]:
    """Handle Ctrl-C and SIGTERM.

    Args:
        at_once: Raise KeyboardInterrupt immediately. Otherwise the first signal is stored, so that no solve or write is
            interrupted, until `check` is called; a second one ends the program.
    """
    interruption = Interruption()

    def handle(number: int, frame: FrameType | None) -> None:
        interruption.number = number
        if at_once:
            interruption.check()
        for each in SIGNALS:
            signal.signal(each, signal.SIG_DFL)

    before = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield interruption
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


@contextmanager
def ending_on_signals(outcome: str, at_once: bool = True) -> Iterator[Interruption]:
    """Let a signal end what is done inside with one message, `outcome`, and the exit code of the signal."""
    with handled_signals(at_once) as interruption:
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

    console = Console(stderr=True)
    if not quiet and console.is_terminal:
        with Live(console=console, refresh_per_second=8, transient=True) as live:
            yield lambda text, due=True: live.update(Text(text, overflow="ellipsis", no_wrap=True))
    else:
        yield lambda text, due=True: typer.echo(text, err=True) if due and not quiet else None


@contextmanager
def watched_run(quiet: bool) -> "Iterator[tuple[Callable[[Sample], None], Interruption]]":
    """Provide a watcher that shows the progress of a run and ends it after the sample at which a signal came."""
    line, due = RunLine(), 0.0
    with handled_signals(at_once=False) as interruption, live_line(quiet) as show:

        def watch(sample: "Sample") -> None:
            nonlocal due
            is_due = sample.command.time >= due or bool(sample.command.switches)
            due = sample.command.time + PLAIN_INTERVAL if is_due else due
            show(line.text(sample), is_due)
            interruption.check()

        yield watch, interruption


class RunLine:
    """The progress of a run as one line; the real-time factor counts from the first sample on."""

    def __init__(self) -> None:
        self._began: float | None = None
        self._failed = 0

    def text(self, sample: "Sample") -> str:
        """Write simulated time, stage, planned switch times, real-time factor and number of failed solves."""
        command, now = sample.command, time.monotonic()
        self._failed += "solve_failed" in command.events
        if self._began is None:
            self._began = now
        elapsed = now - self._began
        factor = f"{command.time / elapsed:.1f}" if elapsed > 0 and command.time > 0 else "-"
        ahead = ", ".join(f"{instant:.2f}" for instant in command.instants) or "none"
        return (
            f"{command.time:5.1f} s  {command.stage.name:<10} planned switch times: {ahead:<12} "
            f"{factor:>5} x real time  failed solves: {self._failed}"
        )


@contextmanager
def watched_study(quiet: bool, failed: str) -> "Iterator[Callable[[Progress], None]]":
    """Provide a watcher that shows how many runs of a study have ended, and the estimated time to its end.

    Args:
        quiet: Show nothing.
        failed: Follows the number of failures.
    """
    with live_line(quiet) as show:

        def watch(progress: "Progress") -> None:
            text = f"{progress.ended} of {progress.runs} runs"
            text += f", {progress.failed} {failed}" if progress.failed else ""
            if 0 < progress.ended < progress.runs:
                left = progress.elapsed / progress.ended * (progress.runs - progress.ended)
                text += f", about {left // 60:.0f} min {left % 60:.0f} s left"
            show(text)

        yield watch


class ParallelRuns:
    """Shows the progress of runs in other processes: their simulated times, from the notes beside their logs."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._paths: Mapping[str, Path] = {}
        self._done: list[str] = []

    def __rich__(self) -> "Text":
        """Show the simulated time of every run."""
        from rich.text import Text

        from psmpc_cli.studies.compare import simulated_times

        times = simulated_times(self._paths)
        states = {name: f"{times[name]:.1f} s" if name in times else "waits" for name in self._paths}
        states |= dict.fromkeys(self._done, "done")
        text = "   ".join(f"{name} {state}" for name, state in states.items())
        return Text(text, overflow="ellipsis", no_wrap=True)

    @contextmanager
    def shown(self) -> Iterator[Self]:
        """Show a live line on a terminal, a line for each run that ends elsewhere."""
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True)
        if self._quiet or not console.is_terminal:
            yield self
            return
        self._quiet = True
        with Live(self, console=console, refresh_per_second=2, transient=True):
            yield self

    def began(self, paths: Mapping[str, Path]) -> None:
        """Store the paths of the logs, by name."""
        self._paths = dict(paths)

    def done(self, name: str) -> None:
        """Store that a run has ended."""
        self._done.append(name)
        if not self._quiet:
            typer.echo(f"{name} done, {len(self._done)} of {len(self._paths)}", err=True)
