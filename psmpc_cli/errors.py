"""The errors a user can cause or meet, whose messages name the culprit and what would be right; and interruptions.

What a signal does to a program and to the processes that it started is here as well.
"""

import logging
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread, current_thread, main_thread
from types import FrameType

SIGNALS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
"""The signals that end a command, and how its log and messages name that."""

LONGEST_REPETITION = 0.2
"""How long after a signal a further one counts as the same [s]: terminals and `make` send one twice, within some
milliseconds; a user who presses Ctrl-C again takes longer."""

ORPHAN_POLL = 0.5
"""Time between two looks of a process for its parent [s]."""


class PsmpcError(Exception):
    """Root of all errors this package raises on purpose. `exit_code` is what the command line returns."""

    exit_code = 2


class SpecError(PsmpcError):
    """A robot or task description does not hold; the message lists every problem, one a line."""


class InputError(PsmpcError):
    """A flag, path or argument is wrong."""


class LogError(PsmpcError):
    """A file is not a log this version can read."""


class RunError(PsmpcError):
    """A run could not go on; the reason is the message."""

    exit_code = 3


class Interruption:
    """A signal that was deferred.

    Attributes:
        number: The signal; 0 as long as none has come.
        handled: Whether `raise_if_signalled` has raised it.
    """

    def __init__(self) -> None:
        self.number = 0
        self.handled = False
        self._came = 0.0
        self._before = {number: signal.getsignal(number) for number in SIGNALS}

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal: store it; one that comes `LONGEST_REPETITION` later does what it did before."""
        if self.number and time.monotonic() > self._came + LONGEST_REPETITION:
            self.restore()
            signal.raise_signal(number)
        if not self.number:
            self.number = number
            self._came = time.monotonic()

    @property
    def exit_code(self) -> int:
        """Exit code of a program that the signal ended."""
        return 128 + (self.number or signal.SIGINT)

    def raise_if_signalled(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self.number:
            self.handled = True
            raise KeyboardInterrupt(SIGNALS[signal.Signals(self.number)])

    def check_after(self, delay: float) -> None:
        """Raise KeyboardInterrupt if a signal came longer ago than a delay [s]."""
        if self.number and time.monotonic() > self._came + delay:
            self.raise_if_signalled()

    def restore(self) -> None:
        """Let signals do again what they did before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)


@contextmanager
def deferred_signals() -> Iterator[Interruption]:
    """Store Ctrl-C and SIGTERM until `check` is called, so that no solve, write or start of a process is interrupted.

    A signal that was not checked for does at the end what it did before. Inside another use, that one stores them. In
    another thread than the main one, which alone sees signals, nothing is stored.
    """
    present = signal.getsignal(signal.SIGINT)
    if isinstance(present, Interruption) or current_thread() is not main_thread():
        yield present if isinstance(present, Interruption) else Interruption()
        return
    interruption = Interruption()
    for number in SIGNALS:
        signal.signal(number, interruption)
    try:
        yield interruption
    finally:
        interruption.restore()
        if interruption.number and not interruption.handled:
            signal.raise_signal(interruption.number)


def check_deferred(delay: float) -> None:
    """Raise KeyboardInterrupt if a signal was deferred longer ago than a delay [s].

    For code that waits inside a use of `deferred_signals`; elsewhere signals are not deferred, and nothing is raised.
    """
    present = signal.getsignal(signal.SIGINT)
    if isinstance(present, Interruption) and current_thread() is main_thread():
        present.check_after(delay)


def silence_libraries() -> None:
    """Keep warnings and log messages of libraries from standard error; handlers of loggers of their own stay."""
    logging.captureWarnings(True)
    logging.getLogger().addHandler(logging.NullHandler())  # without any handler Python writes warnings itself


def begin_worker(parent: int) -> None:
    """Prepare a process that was started for calls: its libraries are silent, and it ends with its parent.

    Args:
        parent: Process id of the parent.
    """
    silence_libraries()
    end_with_parent(parent)


def end_with_parent(parent: int) -> None:
    """End this process when its parent has ended: a parent that is killed cannot end the processes it started.

    A thread looks for the parent. Linux could send a signal instead, but does so when the *thread* ends that started
    the process.

    Args:
        parent: Process id of the parent.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(ORPHAN_POLL)
        os.kill(os.getpid(), signal.SIGKILL)

    Thread(target=watch, daemon=True).start()
