"""Calls that may never return, in a copy of the process, which can be ended.

Code of others runs there: fatrop, for example, raises a regularization without end where an iterate is not a number. No
signal and no exception ends a loop in C++; the end of a process does.
"""

import os
import pickle
import select
import signal
import time
import warnings
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, ParamSpec, TypeVar, cast

from psmpc_cli.errors import SIGNALS, check_deferred, end_with_parent

P = ParamSpec("P")
Result = TypeVar("Result")

LONGEST_CALL = 30.0
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

LENGTH = 8
"""Bytes of the length of an answer, which stands before it."""


def processor_time() -> float:
    """Return the processor time that this process has used, with that of its bounded calls [s]."""
    return time.process_time() + BoundedCalls.processor_time


class BoundedCalls(Generic[P, Result]):
    """A function whose calls are answered by a copy of this process, one after the other.

    The copy is made at the first call, and anew after one that did not return. It knows what this process knew when it
    was made, so whoever changes what the function uses calls `renew`. What calls change stays in the copy.

    Args:
        function: The function; its arguments and results pickle.
        wait: Called again and again while a call goes on.

    Attributes:
        processor_time: Of all calls so far, of every function [s].
    """

    processor_time: ClassVar[float] = 0.0

    def __init__(self, function: Callable[P, Result], wait: Callable[[], None] = lambda: None) -> None:
        self._function = function
        self._wait = wait
        self._copy: _Copy | None = None
        self._end: Callable[[], Any] = int  # the status of a copy that never was

    def renew(self) -> int:
        """End the copy, so that the next call makes another one; return the status with which it has ended."""
        self._copy = None
        return int(self._end() or 0)

    def __call__(self, longest: float, /, *args: P.args, **kwargs: P.kwargs) -> Result:
        """Call the function in the copy of this process, and return or raise what it does.

        A copy that did not answer is ended, and the next call makes another one.

        Args:
            longest: Processor time after which the call is ended [s]. Its wall time is limited to `WAITING` times that.
            args: Arguments of the function.
            kwargs: Its named ones.

        Raises:
            TimeoutError: It did not return in time.
            RuntimeError: It ended its process.
            KeyboardInterrupt: A signal has come, and the call goes on nevertheless.
        """
        if self._copy is None:
            self._copy = _fork_copy(self._function)
            self._end = weakref.finalize(self, _Copy.end, self._copy)  # ends the copy with this object, at the latest
        try:
            request = pickle.dumps((longest, args, kwargs))
            answer = self._copy.ask(request, time.monotonic() + WAITING * longest, self._wait)
        except EOFError:  # the copy has ended: its status says why
            raise _error_of(self.renew(), longest) from None
        except BaseException:
            self.renew()
            raise
        unpickled: Answer[Result] = pickle.loads(answer)
        BoundedCalls.processor_time += unpickled.processor_time
        return unpickled.result()


@dataclass(frozen=True)
class Answer(Generic[Result]):
    """What a call returned, or raised, and the processor time that it took [s]."""

    returned: Result | None
    raised: Exception | None
    processor_time: float

    def result(self) -> Result:
        """Return what the call returned, or raise what it raised."""
        if self.raised is not None:
            raise self.raised
        return cast(Result, self.returned)


@dataclass(frozen=True)
class _Copy:
    """A copy of this process that answers calls.

    Attributes:
        process: Its process id.
        requests, answers: The ends of the pipes to it and from it.
    """

    process: int
    requests: int
    answers: int

    def end(self) -> int:
        """End it, and return the status with which it has ended."""
        os.close(self.requests)
        os.close(self.answers)
        with suppress(ProcessLookupError):
            os.kill(self.process, signal.SIGKILL)
        with suppress(ChildProcessError):
            return os.waitpid(self.process, 0)[1]
        return signal.SIGKILL

    def ask(self, request: bytes, until: float, wait: Callable[[], None]) -> bytes:
        """Send a request to the copy of this process, wait for its answer and return that.

        Args:
            request: The pickled call, see `_answer_calls`.
            until: When waiting stops, an instant of `time.monotonic` [s].
            wait: Called again and again until the answer comes, to show that something goes on.

        Raises:
            EOFError: The copy has ended.
            TimeoutError: The answer did not come in time.
            KeyboardInterrupt: A signal came, and no answer for some time after it.
        """
        try:
            sent = 0
            while sent < len(request):
                sent += os.write(self.requests, request[sent:])
        except BrokenPipeError:
            raise EOFError from None
        # An answer begins with its length.
        length = int.from_bytes(self._read(LENGTH, until, wait), "little")
        return self._read(length, until, wait)

    def _read(self, count: int, until: float, wait: Callable[[], None]) -> bytes:
        """Read `count` bytes of an answer from the copy of this process.

        Args:
            count: How many bytes.
            until: When waiting stops, an instant of `time.monotonic` [s].
            wait: Called each time that nothing has come for `POLL` seconds, to show that something goes on.

        Raises:
            EOFError: The copy has ended.
            TimeoutError: The bytes did not come in time.
            KeyboardInterrupt: A signal came, and not all of the bytes within `GRACE` after it.
        """
        content = bytearray()
        while len(content) < count:
            check_deferred(GRACE)  # raises KeyboardInterrupt where a signal came longer ago than that
            if time.monotonic() > until:
                raise TimeoutError("it waits for something that does not come")
            if not select.select([self.answers], [], [], POLL)[0]:
                wait()
                continue
            received = os.read(self.answers, min(PIPE_SIZE, count - len(content)))
            if not received:  # its end of the pipe is closed
                raise EOFError
            content += received
        return bytes(content)


def _fork_copy(function: Callable[P, Result]) -> _Copy:
    """Fork this process into a copy that answers calls of a function, and return the copy's process id and pipes.

    Only this process returns from here. The copy answers until there are no more calls, and ends.
    """
    requests_there, requests = os.pipe()
    answers, answers_there = os.pipe()
    parent = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other threads may hold locks: the copy needs none of them
        process = os.fork()
    if process == 0:
        os.close(requests)
        os.close(answers)
        _answer_calls(function, parent, requests_there, answers_there)
    os.close(requests_there)
    os.close(answers_there)
    return _Copy(process, requests, answers)


def _answer_calls(function: Callable[P, Result], parent: int, requests: int, answers: int) -> None:
    """Answer calls of a function in the copied process, one after the other, and end that process after the last.

    A call that uses more processor time than it may is ended together with the process, by the timer's signal SIGPROF.

    Args:
        function: The function.
        parent: Process id of the process that asks.
        requests: Descriptor of the pipe from which pickled calls are read: longest processor time [s], arguments, named
            arguments.
        answers: Descriptor of the pipe to which answers are written: the length, then the pickled `Answer`.
    """
    try:
        for number in SIGNALS:  # of a terminal they reach both processes: the parent decides
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGPROF, signal.SIG_DFL)  # by default it ends the process
        end_with_parent(parent)
        with open(requests, "rb") as incoming, open(answers, "wb") as outgoing:
            while True:
                longest, args, kwargs = pickle.load(incoming)
                signal.setitimer(signal.ITIMER_PROF, longest)
                began = time.process_time()
                returned = raised = None
                try:
                    returned = function(*args, **kwargs)
                except Exception as error:
                    raised = error
                answer = Answer(returned, raised, time.process_time() - began)
                signal.setitimer(signal.ITIMER_PROF, 0.0)
                content = pickle.dumps(answer)
                outgoing.write(len(content).to_bytes(LENGTH, "little") + content)
                outgoing.flush()
    except (EOFError, OSError):  # the parent needs it no more
        pass
    finally:
        os.kill(os.getpid(), signal.SIGKILL)  # nothing of the parent's is flushed or removed, as an exit would


def _error_of(status: int, longest: float) -> Exception:
    """Return what the status of a process says that did not answer."""
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF:
        return TimeoutError(f"it did not return within {longest:g} s of processor time")
    return RuntimeError(f"its process was ended by signal {os.WTERMSIG(status)}")
