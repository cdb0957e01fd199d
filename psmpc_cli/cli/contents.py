"""The files that psmpc writes as commands see them: whatever a file holds is read, printed, drawn, filmed, exported.

A kind of file is a class with one interface, and one entry of `KINDS`.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import typer

from psmpc_cli.cli import tables
from psmpc_cli.cli.common import echo, watched_run
from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.files import kind_of
from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.run import Run, read_comparison, read_run
from psmpc_cli.logs.schema import COMPARISON, KEY_SWEEP, MONTE_CARLO, PARETO, RUN, SWEEP
from psmpc_cli.studies.fronts import read_fronts
from psmpc_cli.studies.monte_carlo import MonteCarloRuns
from psmpc_cli.studies.sweep import SweepCells


class Contents(ABC):
    """What a file holds; by itself the results of a study that holds no runs.

    Attributes:
        kind: Name of the kind of file, as in the file and in messages.
        path: The file.
        value: What was read from it.
    """

    kind: ClassVar[str]
    to_film: ClassVar[str] = "the log of a run is"
    """What of it, or instead of it, can be filmed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.value: Any = self.read(path)

    @abstractmethod
    def read(self, path: Path) -> Any:
        """Read the file; LogError if it is damaged."""

    @abstractmethod
    def print(self, verbose: bool = False) -> None:
        """Print its table, of a run all that was measured if `verbose`."""

    @property
    def drawable(self) -> bool:
        """Whether there are figures of it."""
        return True

    def ensure_filmable(self, option: str) -> None:
        """Raise InputError if it cannot be filmed, as an option asks for."""
        raise InputError(f"--{option}: a {self.kind} is not animated, but {self.to_film}")

    def logs(self) -> Mapping[str, Run]:
        """Return the logs in it, by the folder into which their tables are exported.

        Raises:
            InputError: There is none.
        """
        raise InputError(
            f"--csv: {self.path} holds a {self.kind}, expected logs; other programs, such as xarray, open it"
        )

    def runs(self, chosen: Sequence[str], quiet: bool) -> dict[str, Run]:
        """Return runs by name: those chosen with --run, or without that option those there are.

        Raises:
            InputError: There is none, or none of a name.
            typer.Exit: A signal came while a run was repeated.
        """
        if chosen:
            raise InputError(f"--run: {self.path} holds a {self.kind}, expected a comparison or a Monte Carlo study")
        raise InputError(f"{self.path} holds a {self.kind}, expected the log of a run, or a file of several")


class Log(Contents):
    """The log of one run."""

    kind = RUN
    value: Run

    def read(self, path: Path) -> Run:
        """Read the run."""
        return read_run(path)

    def print(self, verbose: bool = False) -> None:
        """Print its summary."""
        tables.print_summary(self.value, verbose)

    @property
    def drawable(self) -> bool:
        """Whether it has samples."""
        return len(self.value.time) > 0

    def ensure_filmable(self, option: str) -> None:
        """Raise nothing: a run can be filmed."""

    def logs(self) -> Mapping[str, Run]:
        """Return the run, whose tables need no folder of their own."""
        return {"": self.value}

    def runs(self, chosen: Sequence[str], quiet: bool) -> dict[str, Run]:
        """Return the run by its controller; InputError if one was chosen."""
        return super().runs(chosen, quiet) if chosen else {str(self.value.attributes["controller"]): self.value}


class SeveralRuns(Contents):
    """A file that holds several runs, or what they are repeated from."""

    to_film = "a run of it is: choose one with --run"

    @property
    @abstractmethod
    def names(self) -> list[str]:
        """The names of its runs."""

    @property
    @abstractmethod
    def choices(self) -> str:
        """Which names there are, for messages."""

    @abstractmethod
    def run(self, name: str, quiet: bool) -> tuple[str, Run]:
        """Return one run, and what it is called among others."""

    def unchosen(self) -> list[str]:
        """Return the names of the runs that count where none is chosen; InputError if one has to be."""
        raise self._unknown("no --run")

    def runs(self, chosen: Sequence[str], quiet: bool) -> dict[str, Run]:
        """Return the runs of these names."""
        found: dict[str, Run] = {}
        for name in chosen or self.unchosen():
            if name not in self.names:
                raise self._unknown(f"no run '{name}'" if name else "no --run")
            title, run = self.run(name, quiet)
            found[title] = run
        return found

    def _unknown(self, found: str) -> InputError:
        return InputError(f"{self.path} holds several runs: found {found}, expected --run with {self.choices}")


class ComparisonLogs(SeveralRuns):
    """The logs of a comparison."""

    kind = COMPARISON
    value: dict[str, Run]

    def read(self, path: Path) -> dict[str, Run]:
        """Read the runs by controller."""
        return read_comparison(path)

    def print(self, verbose: bool = False) -> None:
        """Print the runs side by side."""
        tables.print_comparison(self.value, self.path, verbose)

    @property
    def drawable(self) -> bool:
        """Whether all runs have samples."""
        return all(len(run.time) for run in self.value.values())

    def logs(self) -> Mapping[str, Run]:
        """Return the runs by controller."""
        return self.value

    @property
    def names(self) -> list[str]:
        """The controllers."""
        return list(self.value)

    @property
    def choices(self) -> str:
        """The controllers in a row."""
        return f"one of {', '.join(self.names)}"

    def unchosen(self) -> list[str]:
        """Return all controllers."""
        return self.names

    def run(self, name: str, quiet: bool) -> tuple[str, Run]:
        """Return the run of a controller."""
        return name, self.value[name]


class MonteCarlo(SeveralRuns):
    """A Monte Carlo study, whose runs are repeated from their seeds."""

    kind = MONTE_CARLO
    value: MonteCarloRuns

    def read(self, path: Path) -> MonteCarloRuns:
        """Read the study."""
        return MonteCarloRuns(read_results(path, MONTE_CARLO))

    def print(self, verbose: bool = False) -> None:
        """Print the success rate, the spread and the worst runs."""
        tables.print_monte_carlo(self.value, verbose)

    @property
    def names(self) -> list[str]:
        """The numbers of the runs."""
        return [str(number) for number in range(len(self.value["seed"]))]

    @property
    def choices(self) -> str:
        """The range of the numbers."""
        return f"0 to {self.names[-1]}"

    def run(self, name: str, quiet: bool) -> tuple[str, Run]:
        """Repeat a run, with its progress."""
        with watched_run(quiet) as (watch, interruption):
            run = self.value.repeat(int(name), watch)
        if run.interrupted:
            raise typer.Exit(interruption.exit_code)
        return f"run {name}", run


class Sweep(Contents):
    """A sweep over weights."""

    kind = SWEEP
    value: SweepCells

    def read(self, path: Path) -> SweepCells:
        """Read the cells."""
        return SweepCells(read_results(path, SWEEP))

    def print(self, verbose: bool = False) -> None:
        """Print a row for each run, and the recommended ratio."""
        tables.print_sweep(self.value, verbose)


class KeySweep(Contents):
    """A sweep over any keys, from `psmpc_cli.sweep`."""

    kind = KEY_SWEEP
    value: Results

    def read(self, path: Path) -> Results:
        """Read what became of the runs."""
        return read_results(path, KEY_SWEEP)

    def print(self, verbose: bool = False) -> None:
        """Print a row for each run."""
        tables.print_key_sweep(self.value)

    @property
    def drawable(self) -> bool:
        """Whether there are figures of it: what its keys mean is not known."""
        return False


class Fronts(Contents):
    """A Pareto study."""

    kind = PARETO
    value: Results

    def read(self, path: Path) -> Results:
        """Read the fronts."""
        return read_fronts(path)

    def print(self, verbose: bool = False) -> None:
        """Print a row for each sample, and how the fronts move."""
        tables.print_fronts(self.value)


KINDS: Mapping[str, type[Contents]] = {
    each.kind: each for each in (Log, ComparisonLogs, Sweep, KeySweep, Fronts, MonteCarlo)
}
"""The classes by the kinds that files name."""


def read_contents(path: Path) -> Contents:
    """Read a file written by psmpc.

    Raises:
        LogError: The file is missing, damaged or of another program.
    """
    kind = kind_of(path)
    if kind not in KINDS:
        raise LogError(f"{path}: found a {kind}, expected one of: {', '.join(KINDS)}")
    return KINDS[kind](path)


def present(
    path: Path, figures: bool, force: bool, quiet: bool, verbose: bool = False, films: Collection[str] = ()
) -> Any:
    """Print the table of a file and draw its figures and films; the end of a command that has written the file.

    Args:
        path: The file that the command has written: a log, or results of a study.
        figures: Whether its figures are drawn, into its folder of figures.
        force: Replace figures of an earlier command.
        quiet: Whether nothing is printed.
        verbose: Whether all that was measured is printed.
        films: Names of the films that are drawn.

    Returns:
        What the file holds: a run, runs by name, or the results of the study.
    """
    from psmpc_cli.figures.registry import default_directory, draw

    contents = read_contents(path)
    if not quiet:
        contents.print(verbose)
    if (figures or films) and contents.drawable:
        only = None if figures else ()  # all figures, or none but the films
        directory = default_directory(path)
        drawn = draw(contents.kind, contents.value, directory, only=only, force=force, films=films)
        if not quiet:
            echo(f"{len(drawn)} figures in {directory}" if figures else f"film in {directory}")
    return contents.value
