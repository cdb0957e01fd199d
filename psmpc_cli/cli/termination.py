"""Ctrl-C and SIGTERM end a run cleanly: both become a KeyboardInterrupt, told apart by the exit code."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass
class Interruption:
    """Which signal ended the run; the exit code is the shell's for it."""

    exit_code: int = 130


@contextmanager
def raised_on_termination() -> Iterator[Interruption]:
    """Raise KeyboardInterrupt on SIGTERM as Python does on Ctrl-C."""
    interruption = Interruption()

    def interrupt(number: int, frame: FrameType | None) -> None:
        interruption.exit_code = 128 + number
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield interruption
    finally:
        signal.signal(signal.SIGTERM, before)
