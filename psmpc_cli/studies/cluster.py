"""Calls on a Dask cluster that runs already."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

from psmpc_cli import __version__
from psmpc_cli.errors import RunError
from psmpc_cli.studies.cluster_client import connected, ensure_alike, workers
from psmpc_cli.studies.parallel import refuse_loss

if TYPE_CHECKING:
    from distributed import Client, Future

Item = TypeVar("Item")
Result = TypeVar("Result")

DESERTED = 60
"""How long a cluster may be without any worker before the calls are given up [s]."""

LOOK = 5
"""How often to look whether there are workers while no call comes back [s]."""


class DaskCalls:
    """Calls on the workers of a Dask cluster.

    Attributes:
        address: Of its scheduler, such as tcp://127.0.0.1:8786.
    """

    def __init__(self, address: str) -> None:
        """Try the cluster.

        Raises:
            InputError: There is none, it has no workers, or they do not fit; or Dask is not installed.
        """
        self.address = address
        with connected(address):
            pass

    def each(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        lost: Callable[[Item], Result] = refuse_loss,
    ) -> Iterator[tuple[int, Result]]:
        """Give the index and the result of each item as they come; see `Calls`.

        The scheduler makes a call again whose worker was killed, until it takes the call for the reason. A call that
        only waited there is under suspicion as well; so such calls are made once more, one at a time.

        Raises:
            InputError: The cluster is none to make calls on any more.
            RunError: As `Calls` has it.
        """
        with connected(self.address) as client:
            suspects = []
            for index, result in _made(client, function, dict(enumerate(items))):
                if isinstance(result, _Killed):
                    suspects.append(index)
                else:
                    yield index, result
            for suspect in suspects:
                for index, result in _made(client, function, {suspect: items[suspect]}):
                    yield index, lost(items[index]) if isinstance(result, _Killed) else result


class _Killed:
    """Stands for the result of a call whose workers were killed, all that the scheduler tried."""


def _made(
    client: "Client", function: Callable[[Item], Result], items: Mapping[int, Item]
) -> Iterator[tuple[int, Result | _Killed]]:
    """Make calls and give the index and the result of each as they come."""
    ended: SimpleQueue[Future] = SimpleQueue()
    calls = {}
    for index, item in items.items():
        future = client.submit(_call, __version__, function, item, pure=False)
        calls[future] = index
        future.add_done_callback(ended.put)
    while calls:
        future = _awaited(client, lambda seconds: ended.get(timeout=seconds))
        yield calls.pop(future), _result(client, future)


def _call(version: str, function: Callable[[Item], Result], item: Item) -> Result:
    """Make a call, on a worker, which may have come later than the others."""
    if version != __version__:
        raise RunError(f"a worker with psmpc {__version__} came to the cluster, expected {version}")
    return function(item)


def _awaited(client: "Client", take: Callable[[float], Result]) -> Result:
    """Return what `take` does; it raises Empty after so many seconds in vain.

    Raises:
        RunError: The cluster has no workers any more.
    """
    inhabited = time.monotonic()
    while True:
        try:
            return take(LOOK)
        except Empty:
            if workers(client):
                inhabited = time.monotonic()
        if time.monotonic() - inhabited > DESERTED:
            raise RunError(f"the Dask cluster has had no workers for {DESERTED} s")


def _result(client: "Client", future: "Future") -> Any:
    """Return the result of a call that has ended; where it went down with its worker, the call is made again.

    Raises:
        InputError: It failed, and there is a worker that does not fit.
        RunError: The cluster is gone.
    """
    from distributed import CancelledError, KilledWorker

    def take(seconds: float) -> Any:
        try:
            return future.result(seconds)
        except TimeoutError:
            if future.status == "error":  # the call's own
                raise
            raise Empty from None

    try:
        return _awaited(client, take)
    except KilledWorker:
        return _Killed()
    except CancelledError:
        raise RunError("the connection to the Dask scheduler was lost") from None
    except RunError:
        raise
    except Exception:
        ensure_alike(client)
        raise
