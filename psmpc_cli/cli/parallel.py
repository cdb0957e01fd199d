"""The progress of runs in parallel: one live line on a terminal, a line for each that ends elsewhere."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import typer

from psmpc_cli.studies.compare import simulated_times


class Runs:
    """Follows runs in other processes by the notes they leave beside their logs."""

    def __init__(self) -> None:
        self._paths: Mapping[str, Path] = {}
        self._done: list[str] = []

    def began(self, paths: Mapping[str, Path]) -> None:
        """Take in where the runs leave their logs, by name."""
        self._paths = dict(paths)

    def done(self, name: str) -> None:
        """Take in that a run has ended."""
        self._done.append(name)

    def line(self) -> str:
        """Return how far every run has come."""
        times = simulated_times(self._paths)
        return "   ".join(f"{name} {self._state(name, times)}" for name in self._paths)

    def _state(self, name: str, times: Mapping[str, float]) -> str:
        if name in self._done:
            return "done"
        return f"{times[name]:.1f} s" if name in times else "waits"


class _PlainRuns(Runs):
    """Says when a run has ended."""

    def done(self, name: str) -> None:
        super().done(name)
        typer.echo(f"{name} done, {len(self._done)} of {len(self._paths)}", err=True)


@contextmanager
def watching_runs(quiet: bool) -> Iterator[Runs]:
    """Give what follows the runs and shows how far they have come."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True)
    if quiet:
        yield Runs()
    elif not console.is_terminal:
        yield _PlainRuns()
    else:
        runs = Runs()
        with Live(
            get_renderable=lambda: Text(runs.line(), overflow="ellipsis", no_wrap=True),
            console=console,
            refresh_per_second=2,
            transient=True,
        ):
            yield runs
