"""Calls that may never return, each in a process of its own, which can be ended.

Code of others runs here: fatrop, for example, raises a regularization without end where an iterate is not a number. No
signal and no exception ends a loop in C++; the end of a process does.
"""

import os
import pickle
import select
import signal
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar, cast

from psmpc_cli.errors import SIGNALS, check_deferred, end_with_parent

Result = TypeVar("Result")

LONGEST_CALL = 60.0
"""Processor time after which a call is ended [s].

It is that of the call alone, whatever else the machine does, and many times what the largest windows take: it strikes
only what hangs, so that runs can be repeated.
"""

WAITING = 10.0
"""Longest wall time of a call, for one that waits and computes nothing, in units of its longest processor time."""

POLL = 0.1
"""Time between two looks for a signal [s]."""

GRACE = 1.0
"""Time after a signal for which a call may go on [s]: most end by then, with a sample that is whole."""

PIPE_SIZE = 1 << 16
"""Bytes that are read at a time."""


def call_bounded(function: Callable[[], Result], longest: float) -> Result:
    """Call a function in a copy of this process, and return its result, which pickles.

    What it changes is lost with the copy.

    Args:
        function: The function. What it raises is raised here.
        longest: Processor time after which it is ended [s].

    Raises:
        TimeoutError: It did not return in time.
        RuntimeError: It ended its process.
        KeyboardInterrupt: A signal has come, and the call goes on nevertheless.
    """
    read, write = os.pipe()
    parent = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other threads may hold locks: the copy needs none of them
        process = os.fork()
    if process == 0:
        _answer(function, longest, parent, write)
    os.close(write)
    try:
        answer = _read_all(read, time.monotonic() + WAITING * longest)
    except BaseException:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        raise
    finally:
        os.close(read)
    _, status = os.waitpid(process, 0)
    if os.WTERMSIG(status) != signal.SIGKILL or not answer:
        raise _error_of(status, longest)
    found: Answer[Result] = pickle.loads(answer)
    return found.result()


@dataclass(frozen=True)
class Answer(Generic[Result]):
    """What a call returned, or raised."""

    returned: Result | None
    raised: Exception | None = None

    def result(self) -> Result:
        """Return what the call returned, or raise what it raised."""
        if self.raised is not None:
            raise self.raised
        return cast(Result, self.returned)


def _answer(function: Callable[[], Result], longest: float, parent: int, write: int) -> None:
    """Call the function in the copy, write its answer, and end the copy, at the latest when its time is up."""
    try:
        for number in SIGNALS:  # of a terminal they reach both processes: the parent decides
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, longest)
        end_with_parent(parent)
        try:
            answer = Answer(function())
        except Exception as error:
            answer = Answer(None, error)
        with open(write, "wb") as pipe:
            pipe.write(pickle.dumps(answer))
    finally:
        os.kill(os.getpid(), signal.SIGKILL)  # nothing of the parent's is flushed or removed, as an exit would


def _read_all(read: int, until: float) -> bytes:
    """Read a pipe to its end.

    Raises:
        TimeoutError: That did not come by an instant of `time.monotonic` [s].
        KeyboardInterrupt: As for `call_bounded`.
    """
    parts = list[bytes]()
    while time.monotonic() < until:
        check_deferred(GRACE)
        if not select.select([read], [], [], POLL)[0]:
            continue
        parts.append(os.read(read, PIPE_SIZE))
        if not parts[-1]:
            return b"".join(parts)
    raise TimeoutError("it waits for something that does not come")


def _error_of(status: int, longest: float) -> Exception:
    """Return what the status of a process says that did not answer."""
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF:
        return TimeoutError(f"it did not return within {longest:g} s of processor time")
    return RuntimeError(f"its process was ended by signal {os.WTERMSIG(status)}")
