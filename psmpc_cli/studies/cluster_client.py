"""A client of a Dask cluster that runs already, and whose workers compute what this process would."""

import asyncio
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from psmpc_cli import __version__
from psmpc_cli.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

ANSWER = 10
"""How long a scheduler has to answer, and its first worker to be there [s]."""


@contextmanager
def connected(address: str) -> "Iterator[Client]":
    """Give a client of a cluster that can make calls.

    Raises:
        InputError: There is none, or it cannot.
    """
    try:
        from distributed import Client
        from distributed.versions import VersionMismatchWarning
    except ImportError:
        raise InputError("--dask: Dask is not installed, expected the extra: pip install 'psmpc[dask]'") from None
    with _silence():
        _ensure_scheduler(address)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # of packages that play no role here, as a rule
            client = Client(address, timeout=ANSWER, set_as_default=False)
        with client:
            _ensure_workers(client, address)
            yield client


@contextmanager
def _silence() -> Iterator[None]:
    """Keep Dask from logging what is said in a message of our own, or is nothing to say where calls are made again."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in ("distributed", "tornado")]
    loud = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in loud:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in loud:
            logger.disabled = False


def _ensure_scheduler(address: str) -> None:
    """Ask for a scheduler; a client that finds none leaves tracebacks behind.

    Raises:
        InputError: None answers.
    """
    from distributed import Security, rpc

    async def ask() -> str:
        known = Security().get_connection_args("client")
        async with rpc(address, timeout=ANSWER, connection_args=known) as there:
            return str((await there.identity())["type"])

    try:
        found = asyncio.run(asyncio.wait_for(ask(), ANSWER + 1))
    except Exception as error:  # whatever an address may be, and whatever may answer there
        reason = " ".join(str(error).split()) or f"nothing understood within {ANSWER} s"
        raise InputError(
            f"--dask: no Dask scheduler answers at '{address}' ({reason}); "
            "start one with: dask scheduler --host 127.0.0.1 --dashboard-address 127.0.0.1:8787"
        ) from None
    if found != "Scheduler":
        raise InputError(f"--dask: found a {found} at {address}, expected a scheduler")


def _ensure_workers(client: "Client", address: str) -> None:
    """Refuse a cluster that has no workers, or such as would not compute what this process does.

    Raises:
        InputError: It is such a cluster.
    """
    try:
        client.wait_for_workers(1, timeout=ANSWER)
    except TimeoutError:
        raise InputError(
            f"--dask: the scheduler at {address} has no workers; start one on this machine with: dask worker {address} "
            "--nthreads 1 --host 127.0.0.1 --dashboard-address 127.0.0.1:0"
        ) from None
    ensure_alike(client)


def workers(client: "Client") -> Mapping[str, int]:
    """Return the threads of each worker by its address; none where the scheduler is gone, as the calls will say."""
    try:
        return dict(client.nthreads())
    except OSError:
        return {}


def ensure_alike(client: "Client") -> None:
    """Refuse workers that would not compute what this process does.

    Raises:
        InputError: There is one.
    """
    for worker, threads in workers(client).items():
        if threads != 1:
            raise InputError(
                f"--dask: worker {worker} has {threads} threads, expected 1; start it with --nthreads 1, and with "
                "--nworkers for more than one call at a time"
            )
    versions = client.run(resolve_name, "psmpc_cli:__version__", on_error="return")
    for worker, found in versions.items():
        if found == __version__ or isinstance(found, OSError):  # the latter is gone by now
            continue
        version = f"psmpc {found}" if isinstance(found, str) else f"no psmpc ({found})"
        raise InputError(f"--dask: worker {worker} has {version}, expected psmpc {__version__} as here")
