"""How far long work has come: what takes seconds tells it to a watcher, or logs it; the command line shows it."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

logger = logging.getLogger(__name__)

RETOLD_EVERY = 10.0
"""Time after which progress is told again while no part of the work ends [s]."""


@dataclass(frozen=True)
class Progress:
    """How far a piece of work has come.

    Attributes:
        parts: What its parts are called, such as runs.
        total: How many there are.
        ended: Parts that have ended.
        failed: Those of them that failed.
        elapsed: Time since the work began [s].
        left: Estimated time to its end, at the pace of the parts that have ended [s]; NaN before the first one.
        title: What is done, where the parts do not say so.
        last: The part that ended last, where it has a name.
        is_due: Whether it is worth a line where lines stay.
    """

    parts: str
    total: int
    ended: int = 0
    failed: int = 0
    elapsed: float = 0.0
    left: float = math.nan
    title: str = ""
    last: str = ""
    is_due: bool = True

    def __str__(self) -> str:
        title = f"{self.title}: " if self.title else ""
        if not self.total:
            return f"{title}no {self.parts} are left"
        failed = f", {self.failed} failed" if self.failed else ""
        last = f", {self.last} done" if self.last else ""
        left = f", about {duration(self.left)} left" if self.left > 0 else ""
        return f"{title}{self.ended} of {self.total} {self.parts}{failed}{last}{left}"


Watch = Callable[[Progress], None]


class Work:
    """A piece of work whose parts end one after another; it tells a watcher how far it has come."""

    def __init__(
        self,
        parts: str,
        total: int,
        watch: Watch = logger.info,
        title: str = "",
        small_parts: bool = False,
        announced: bool = False,
    ) -> None:
        """Begin the work.

        Args:
            parts: What its parts are called.
            total: How many there are.
            watch: Called at the beginning, after every part, and by `wait` from time to time; by default it logs.
            title: What is done, where the parts do not say so.
            small_parts: Whether the parts are too many or too short to be worth a line each.
            announced: Whether the beginning is worth a line even then.
        """
        self._parts = parts
        self._total = total
        self._watch = watch
        self._title = title
        self._small_parts = small_parts
        self._began = time.monotonic()
        self._told = self._began
        self._ended = 0
        self._failed = 0
        self._pace = math.nan
        self._last = ""
        self._tell(is_due=announced or not small_parts)

    def advance(self, last: str = "", failed: bool = False) -> None:
        """Count a part that has ended."""
        self._ended += 1
        self._failed += failed
        self._last = last
        self._pace = (time.monotonic() - self._began) / self._ended
        self._tell(is_due=not self._small_parts)

    def wait(self) -> None:
        """Tell the progress again if that was long ago: called while a part goes on."""
        if time.monotonic() - self._told >= RETOLD_EVERY:
            self._tell(is_due=False)

    def _tell(self, is_due: bool) -> None:
        self._told = time.monotonic()
        elapsed = self._told - self._began
        left = max(self._pace * self._total - elapsed, 0.0) if self._ended < self._total else 0.0
        self._watch(
            Progress(
                parts=self._parts,
                total=self._total,
                ended=self._ended,
                failed=self._failed,
                elapsed=elapsed,
                left=left if self._ended else math.nan,
                title=self._title,
                last=self._last,
                is_due=is_due,
            )
        )


class Spell:
    """Work that mostly is short: only if it takes long is it told of, from time to time."""

    def __init__(self, title: str, parts: str) -> None:
        """Prepare for work that is one of these parts."""
        self._title = title
        self._parts = parts
        self._began = math.inf
        self._work: Work | None = None

    def __enter__(self) -> None:
        self._began = time.monotonic()

    def __exit__(self, *error: object) -> None:
        self._began = math.inf
        if self._work is not None:
            self._work.advance()
            self._work = None

    def wait(self) -> None:
        """Tell of it if it takes long: called again and again while it goes on."""
        if time.monotonic() - self._began < RETOLD_EVERY:
            return
        if self._work is None:
            self._work = Work(self._parts, 1, title=self._title, small_parts=True)
        self._work.wait()


def duration(seconds: float) -> str:
    """Write a time in hours, minutes and seconds, the largest two of them."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
