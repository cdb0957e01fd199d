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
    """Make calls whose results are files, such as drawing figures, each once, in several processes at a time.

    This process and others that are forked for it take the next call from one queue until it is empty. A call that
    failed elsewhere, or whose process was killed, is repeated here, where its error appears as if nothing had been
    forked. After an error or a signal no process begins another call.

    Raises:
        Exception: What a call raises.
    """
    helpers = min(len(calls), _usable_processes()) - 1
    work = Work("figures", len(calls), title="drawing", small_parts=True)
    if helpers < 1:
        for call in calls:
            with uncollected():
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

    The queue is a pipe with one byte for each call, so that reading a byte takes a call; a second pipe reports which
    were made.

    Args:
        calls: The calls, at most 256.
        helpers: Number of processes to fork.
        interruption: Tells whether a signal came; then no further call begins.
        work: Counts the calls that were made.
    """
    queue, queue_end = os.pipe()
    os.write(queue_end, bytes(range(len(calls))))
    os.close(queue_end)
    made_elsewhere, report = os.pipe()
    children = [_fork(calls, queue, report) for _ in range(helpers)]
    os.close(report)

    not_made = set(range(len(calls)))
    try:
        while not interruption.number and (number := os.read(queue, 1)):
            with uncollected():
                calls[number[0]]()
            not_made.remove(number[0])
            work.advance()
            while select.select([made_elsewhere], [], [], 0)[0] and (number := os.read(made_elsewhere, 1)):
                not_made.discard(number[0])
                work.advance()
    finally:
        os.read(queue, len(calls))  # emptied, after an error too: the others then end
        os.close(queue)
        while numbers := os.read(made_elsewhere, len(calls)):
            not_made.difference_update(numbers)
        os.close(made_elsewhere)
        for child in children:
            os.waitpid(child, 0)
    for number_left in sorted(not_made):
        if interruption.number:
            return
        calls[number_left]()


def _fork(calls: Sequence[Callable[[], object]], queue: int, report: int) -> int:
    """Start a process that takes calls from a queue until it is empty; return its id.

    It ignores signals, since its parent empties the queue then, and ends at the first error without a word: the parent
    makes the call again.

    Args:
        calls: The calls.
        queue: Pipe from which it reads the numbers of calls.
        report: Pipe to which it writes the numbers of those it has made.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads of NumPy's libraries, which expect forks
        child = os.fork()
    if child:
        return child
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
def uncollected() -> Iterator[None]:
    """Keep Python from looking for garbage while a figure is made: in its thousands of new objects there is none."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
