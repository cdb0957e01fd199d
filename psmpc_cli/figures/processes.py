"""Independent calls shared among processes that are forked, and so have all that this one has in memory."""

import gc
import os
import select
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from psmpc_cli.errors import SIGNALS, Interruption, deferred_signals
from psmpc_cli.progress import Work

MOST_PROCESSES = 4
"""Most processes that share calls, this one among them."""


def make_calls(calls: Sequence[Callable[[], object]]) -> None:
    """Make calls whose results are files, such as drawing figures, several at a time in processes that are forked.

    This process and the forked ones take the next call from one queue until it is empty. A call that failed in a forked
    process, or whose process was killed, is repeated in this one, where its error appears as if nothing had been
    forked. After an error or a signal no process begins another call.

    Args:
        calls: The calls, at most 256. What they return is dropped.

    Raises:
        Exception: Whatever a call raises.
    """
    helpers = min(len(calls), _usable_processes()) - 1  # besides this process
    work = Work("figures", len(calls), title="drawing", small_parts=True)
    if helpers < 1:
        for call in calls:
            with garbage_collection_paused():
                call()
            work.advance()
        return
    with deferred_signals() as interruption:
        _make_shared_calls(calls, helpers, interruption, work)


def _usable_processes() -> int:
    """Return how many processes may share calls: 1 where a fork is unsafe, on other systems and beside threads."""
    if sys.platform != "linux" or threading.active_count() > 1:
        return 1
    return min(MOST_PROCESSES, len(os.sched_getaffinity(0)))


def _make_shared_calls(
    calls: Sequence[Callable[[], object]], helpers: int, interruption: Interruption, work: Work
) -> None:
    """Make calls in this process and in forked ones, which share a queue of the calls' numbers.

    The queue is a pipe that holds one byte for each call, the number of the call. A process takes a call by reading a
    byte, which no other process then reads. Forked processes write the numbers of the calls that they have made into a
    second pipe. Calls that nobody has made at the end, because their process failed, are made here.

    Args:
        calls: The calls, at most 256, as the number of a call is one byte.
        helpers: Number of processes to fork.
        interruption: Its `number` is that of a signal that came, 0 without one; after a signal no further call begins.
        work: The progress, which counts the calls that were made.
    """
    queue, queue_end = os.pipe()
    os.write(queue_end, bytes(range(len(calls))))
    os.close(queue_end)
    made_elsewhere, report = os.pipe()
    children = [_fork_helper(calls, queue, report) for _ in range(helpers)]
    os.close(report)

    not_made = set(range(len(calls)))
    try:
        while not interruption.number and (number := os.read(queue, 1)):
            with garbage_collection_paused():
                calls[number[0]]()
            not_made.remove(number[0])
            work.advance()
            # reports that have come so far, without waiting for others
            while select.select([made_elsewhere], [], [], 0)[0] and (number := os.read(made_elsewhere, 1)):
                not_made.discard(number[0])
                work.advance()
    finally:
        os.read(queue, len(calls))  # emptied, also after an error, so that the other processes end
        os.close(queue)
        # until all processes have closed the pipe, which is when they have ended
        while numbers := os.read(made_elsewhere, len(calls)):
            not_made.difference_update(numbers)
        os.close(made_elsewhere)
        for child in children:
            os.waitpid(child, 0)
    for number_left in sorted(not_made):
        if interruption.number:
            return
        calls[number_left]()


def _fork_helper(calls: Sequence[Callable[[], object]], queue: int, report: int) -> int:
    """Fork a process that takes calls from a queue until it is empty; return its process id to the parent.

    The forked process ignores signals: its parent then empties the queue, which ends it. At the first error it ends
    without a message, because the parent makes the failed call again.

    Args:
        calls: The calls.
        queue: File descriptor of the pipe from which it reads the numbers of calls, a byte each.
        report: File descriptor of the pipe to which it writes the numbers of the calls that it has made.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads of NumPy's libraries, which expect forks
        child = os.fork()
    if child:
        return child  # this is the parent
    try:
        for signal_number in SIGNALS:
            signal.signal(signal_number, signal.SIG_IGN)
        gc.disable()
        while number := os.read(queue, 1):
            calls[number[0]]()
            os.write(report, number)
    finally:
        os._exit(0)  # noqa: TID251  # a forked process ends here, not the program


@contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Keep Python from looking for garbage while a figure is made: in its thousands of new objects there is none."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
