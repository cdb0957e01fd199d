"""Ctrl-C and SIGTERM end a run cleanly after the sample in hand; a second one ends the program at once."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

ENDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
"""The signals that end a run, and what its log says of it."""


@dataclass
class Interruption:
    """Which signal asked the run to end; 0 while none did."""

    number: int = 0

    @property
    def exit_code(self) -> int:
        """What a shell gives for a program that this signal ended."""
        return 128 + (self.number or signal.SIGINT)

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal came, with what to say of it."""
        if self.number:
            raise KeyboardInterrupt(ENDS[signal.Signals(self.number)])


@contextmanager
def noticing_signals() -> Iterator[Interruption]:
    """Keep signals from breaking into a solve or a write: the first is only noted, the next has its usual effect."""
    interruption = Interruption()

    def note(number: int, frame: FrameType | None) -> None:
        interruption.number = number
        for noticed in ENDS:
            signal.signal(noticed, signal.SIG_DFL)

    with _handled_by(note):
        yield interruption


@contextmanager
def stopping_on_signals() -> Iterator[Interruption]:
    """Let both signals break into what goes on as KeyboardInterrupt, with what to say of it."""
    interruption = Interruption()

    def stop(number: int, frame: FrameType | None) -> None:
        interruption.number = number
        interruption.check()

    with _handled_by(stop):
        yield interruption


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Give both signals a handler for a while."""
    before = {number: signal.signal(number, handler) for number in ENDS}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
