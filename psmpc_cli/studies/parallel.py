"""Calls in parallel, in processes of this machine with one thread each."""

import os
import signal
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from multiprocessing import resource_tracker
from typing import NoReturn, Protocol, TypeVar

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.backend import resource_tracker as loky_resource_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError

from psmpc_cli.errors import RunError

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE = 3
"""How often in a row processes may be ended from outside before any call comes back."""


def refuse_loss(item: object) -> NoReturn:
    """Raise RunError: without the result of every item the work makes no sense."""
    raise RunError(
        "processes are ended from outside again and again, for want of memory perhaps: try fewer at once with --jobs"
    )


class Calls(Protocol):
    """Calls a function on many items at once, somewhere."""

    def each(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        lost: Callable[[Item], Result] = refuse_loss,
    ) -> Iterator[tuple[int, Result]]:
        """Give the index and the result of each item as they come; a call whose process is killed is made again.

        Args:
            function: Pickles, as its items and results do. What it raises ends the work.
            items: What it is called on.
            lost: Gives, here, what stands for the result of an item whose call ends its process again and again.

        Raises:
            RunError: There is nowhere left to make calls, or a call is lost and `lost` takes no losses.
        """
        ...


class LocalCalls:
    """Calls in processes of this machine, never in this one: a call may end its process, and CasADi swallows Ctrl-C.

    Attributes:
        jobs: Processes at once; as many as there are cores where None is given.
    """

    def __init__(self, jobs: int | None = None) -> None:
        self.jobs = jobs or os.cpu_count() or 1

    def each(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        lost: Callable[[Item], Result] = refuse_loss,
    ) -> Iterator[tuple[int, Result]]:
        """Give the index and the result of each item as they come; see `Calls`.

        A process that is killed takes the calls beside it along. So where that goes on, calls are made one at a time
        until the one that brings it about is known.
        """
        waiting, ended = dict(enumerate(items)), 0
        while waiting:
            together = ended < PATIENCE
            chosen = dict(islice(waiting.items(), None if together else 1))
            try:
                for index, result in self._once(function, chosen):
                    del waiting[index]
                    yield index, result
            except TerminatedWorkerError:
                if together:
                    ended = ended + 1 if len(waiting) == len(chosen) else 1
                else:
                    ended = 0
                    (culprit,) = chosen
                    yield culprit, lost(waiting.pop(culprit))

    def _once(self, function: Callable[[Item], Result], items: Mapping[int, Item]) -> Iterator[tuple[int, Result]]:
        processes = max(2, self.jobs)  # a single one would be this one; of two, the second waits for ever
        with parallel_config("loky", n_jobs=processes, inner_max_num_threads=1):
            ahead = 1 if self.jobs == 1 else 2 * self.jobs
            workers = Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch=ahead)
            results: Generator[tuple[int, Result], None, None] = _nothing()
            try:
                with _deaf_to_ctrl_c():
                    results = workers(delayed(_numbered)(function, index, item) for index, item in items.items())
                while (numbered := next(results, None)) is not None:
                    yield numbered
            finally:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # where the rest is not wanted any more
                    results.close()


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Start processes that Ctrl-C does not reach from their first instruction on; here it waits until they are started.

    A terminal sends it to all processes, and one that imports would say so at length: to end it is up to this one. A
    process inherits what is blocked, and so do the threads that start further ones.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    for tracker in (resource_tracker, loky_resource_tracker):
        tracker.ensure_running()  # which unblocks the signals it blocks meanwhile
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _nothing() -> Generator[tuple[int, Result], None, None]:
    """Give no result."""
    yield from ()


def _numbered(function: Callable[[Item], Result], index: int, item: Item) -> tuple[int, Result]:
    """Make a call in a process of its own, which Ctrl-C reaches as well where it cannot be blocked."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return index, function(item)
