"""What commands share: the paths of what they write, their progress, and how signals end them."""

import math
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from itertools import count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from psmpc_cli.errors import InputError, Interruption, deferred_signals
from psmpc_cli.progress import Progress, duration

if TYPE_CHECKING:
    from rich.live import Live

    from psmpc_cli.logs.schema import Sample
    from psmpc_cli.specs.document import Change

RUNS = Path("runs")
"""Folder of the default outputs."""


GOOD = "green"
BAD = "red"
WARNING = "yellow"
"""Colours of what commands print."""


def echo(text: str = "", err: bool = False, colour: str | None = None) -> None:
    """Print a text, as everything that commands print, with escapes for characters that could control a terminal.

    Args:
        text: The text.
        err: Whether it goes to standard error.
        colour: Its colour on a terminal, unless the environment variable NO_COLOR forbids it.
    """
    shown = escaped(text)
    typer.echo(shown if colour is None or os.environ.get("NO_COLOR") else typer.style(shown, fg=colour), err=err)


def escaped(text: str) -> str:
    """Write escapes for the characters of a text that are not printable, but for the ends of its lines and tabs."""
    from psmpc_cli.specs.document import printable

    return "\n".join("\t".join(map(printable, line.split("\t"))) for line in text.split("\n"))


def validate(reference: str, changes: "Sequence[Change] | None" = None) -> None:
    """Reject an invalid task before a command imports what is heavy.

    Raises:
        SpecError: It is not valid.
    """
    from psmpc_cli.specs.load import load_task

    load_task(reference, changes or ())


def ensure_not_both(quiet: bool, verbose: bool) -> None:
    """Raise InputError where a command is to print nothing and everything."""
    if quiet and verbose:
        raise InputError("found both --quiet and --verbose, expected at most one of them")


def output_file(
    given: Path | None,
    name: str,
    kind: str,
    force: bool,
    figures: bool,
    resume: bool = False,
    films: Collection[str] = (),
    inputs: Iterable[Path | str] = (),
) -> Path:
    """Choose the file that a command writes and make sure that nothing is overwritten unasked.

    Commands call this before their long work, so that it is not lost because its result cannot be written.

    The file is the one given after -o. Without it, the file is the first of runs/NAME.h5, runs/NAME-2.h5, ... that is
    free; runs/NAME.h5 in any case if `force` is set; and to resume a study the last of them that exists. If figures or
    films are drawn, their folder beside the file counts as well.

    Args:
        given: The file given after -o.
        name: NAME.
        kind: What the file will hold, such as a run or a sweep; the names of its figures follow from it.
        force: Replace files of an earlier command.
        figures: Whether figures are drawn.
        resume: Whether a study is resumed.
        films: Names of the films that are drawn.
        inputs: Files that the command reads, which it must not overwrite, or names of built-in ones.

    Raises:
        InputError: The file or its folder of figures exists and is not to be overwritten, or cannot be written.
    """
    from psmpc_cli.figures.registry import check_replaceable, default_directory
    from psmpc_cli.logs.files import check_output

    default = RUNS / f"{name}.h5"
    if resume:  # into a file that exists and is read before it is written, so that nothing is to be checked
        # the last of the numbered files that exists, or the first one
        return given or next(path for path, later in pairwise(_numbered(default)) if not later.exists())
    path = given or free_path(default, force)
    check_output(path, force, inputs=inputs)
    if figures or films:
        directory = default_directory(path)
        ensure_fillable(directory, force, "with --force, or leave the figures out with --no-figures")
        check_replaceable(directory, kind, films)
    return path


def free_path(default: Path, force: bool) -> Path:
    """Choose the first of NAME, NAME-2, ... that neither exists nor has a folder of figures; NAME itself if forced."""
    free = (path for path in _numbered(default) if not any(map(os.path.lexists, (path, path.with_suffix("")))))
    return default if force else next(free)


def _numbered(path: Path) -> Iterator[Path]:
    """Yield a path NAME and then NAME-2, NAME-3 and so on, with its ending."""
    return (path if number == 1 else path.with_stem(f"{path.stem}-{number}") for number in count(1))


def ensure_fillable(folder: Path, force: bool, overwrite: str = "with --force") -> None:
    """Raise InputError if a folder is no folder, cannot be written, or has files that are not to be overwritten."""
    from psmpc_cli.logs.files import ensure_creatable

    ensure_creatable(folder)
    if folder.exists() and any(folder.iterdir()) and not force:
        raise InputError(f"{folder} holds files already: choose another place with -o, overwrite {overwrite}")


@contextmanager
def ending_on_signals(outcome: str) -> Iterator[Interruption]:
    """End the command on a signal that comes inside, with one message, `outcome`, and the exit code of the signal."""
    with deferred_signals() as interruption:
        try:
            yield interruption
        except KeyboardInterrupt as reason:
            echo(f"psmpc: {reason}; {outcome}", err=True)
            raise typer.Exit(interruption.exit_code) from None


class ProgressLine:
    """Where the progress of long work is shown; by itself nowhere, as after --quiet."""

    def show(self, what: str | Progress, is_due: bool = True) -> None:
        """Show a line, or how far work has come; here nothing, as after --quiet.

        Args:
            what: The line, or the progress.
            is_due: Whether a line is worth one of its own where lines stay; a Progress says that itself.
        """


class PlainLines(ProgressLine):
    """Lines on standard error that stay: those that are due, and of long work one now and then."""

    def __init__(self) -> None:
        self._next = time.monotonic() + SHORT

    def show(self, what: str | Progress, is_due: bool = True) -> None:
        """Print a line if it is due or the last one was long ago."""
        now = time.monotonic()
        if (is_due if isinstance(what, str) else what.is_due) or now >= self._next:
            self._next = now + BETWEEN_LINES
            echo(str(what), err=True)


class TerminalLine(ProgressLine):
    """One line of a terminal that each shown one replaces.

    It needs no thread: processes that draw figures cannot be forked beside one.
    """

    def __init__(self, live: "Live") -> None:
        self._live = live

    def show(self, what: str | Progress, is_due: bool = True) -> None:
        """Replace the line."""
        from rich.text import Text

        self._live.update(Text(escaped(str(what)), overflow="ellipsis", no_wrap=True), refresh=True)


SHORT = 2.0
"""Work that ends within this time need not be shown [s]."""

BETWEEN_LINES = 20.0
"""Longest time between two lines of long work [s]."""

LINE_EVERY = 5.0
"""Simulated time between two lines of a run where no stage switches [s]."""

_shown_by: ContextVar[ProgressLine | None] = ContextVar("shown_by", default=None)
"""What shows progress now, for what logs it."""


@contextmanager
def live_line(quiet: bool) -> Iterator[ProgressLine]:
    """Provide the object on which a command shows the progress of long work, and remove its line at the end.

    It shows nothing if `quiet`, replaces one line of standard error on a terminal, and writes lines that stay where
    standard error is a file. Inside the context, progress that the library logs is shown on the same line.
    """
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True)
    with ExitStack() as stack:
        line: ProgressLine
        if quiet:
            line = ProgressLine()
        elif console.is_terminal:
            live = Live(console=console, auto_refresh=False, transient=True, redirect_stdout=False)
            line = TerminalLine(stack.enter_context(live))
            console.show_cursor()  # a signal may end the program at once, and would leave it hidden
        else:
            line = PlainLines()
        token = _shown_by.set(line)  # where `LoggedProgress` looks for it
        try:
            yield line
        finally:
            _shown_by.reset(token)


class LoggedProgress:
    """Shows progress that the library logs: where a command shows its own, else on a line until the work has ended."""

    def __init__(self) -> None:
        self._own = ExitStack()

    def show(self, progress: Progress) -> None:
        """Show how far work has come."""
        line = _shown_by.get()
        if line is None and progress.total:
            line = self._own.enter_context(live_line(quiet=False))
        if line is not None and progress.total:
            line.show(progress)
        if progress.ended >= progress.total:
            self.end()

    def end(self) -> None:
        """End what is shown, also of work that does not come to its end."""
        self._own.close()


@contextmanager
def watched_run(quiet: bool, end: float = math.inf) -> "Iterator[tuple[Callable[[Sample], None], Interruption]]":
    """Provide a watcher that shows the progress of a run and ends it after the sample at which a signal came.

    Its line has time, stage, planned switch times, real-time factor since the first sample, failed solves, and the
    estimated time to the end of the run if that is known, as of one that is repeated. Without a terminal there is a
    line at every switch, and otherwise every `LINE_EVERY` of simulated time, or after `BETWEEN_LINES`.

    Args:
        quiet: Whether nothing is shown.
        end: When the run ends, if that is known [s], in simulated time.

    Yields:
        The function to call with every sample of the run, which raises KeyboardInterrupt after a signal; and the signal
        that came, with the exit code of the command.
    """
    began = 0.0  # of the first sample, by the monotonic clock; 0 before it
    due = 0.0  # simulated time from which the next line is due
    failed = 0
    with deferred_signals() as interruption, live_line(quiet) as line:

        def watch(sample: "Sample") -> None:
            """Show how far the run has come with a sample; raise KeyboardInterrupt if a signal has come."""
            nonlocal began, due, failed
            command = sample.command
            now = time.monotonic()
            began = began or now
            failed += "solve_failed" in command.events
            # simulated time per time of the clock, unknown at the first sample
            pace = command.time / (now - began) if command.time > 0 and now > began else math.nan
            factor = f"{pace:.1f}" if pace > 0 else "-"
            seconds = (end - command.time) / pace
            remaining = f"  about {duration(seconds)} left" if 0 < seconds < math.inf else ""
            ahead = ", ".join(f"{instant:.2f}" for instant in command.switch_times) or "none"
            is_due = command.time >= due or bool(command.switches)
            due = command.time + LINE_EVERY if is_due else due
            line.show(
                f"{command.time:5.1f} s  {command.stage.name:<10} planned switch times: {ahead:<12} "
                f"{factor:>5} x real time  failed solves: {failed}{remaining}",
                is_due,
            )
            interruption.raise_if_signalled()

        yield watch, interruption
