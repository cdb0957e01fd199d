"""The process that meets a file first: it reads all of it, and what happens then happens to this process alone.

HDF5 is written in C and can crash, hang or ask for all memory when a file is not what it says. This program takes
paths, one a line as JSON, and answers each with what is wrong with the file, or null; no answer says enough.
"""

import json
import sys
from collections.abc import Iterator
from contextlib import suppress
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5d

from psmpc_cli.logs.schema import COMPARISON, FORMAT_VERSION, RUN
from psmpc_cli.logs.structure import EXPANSION, ROOM, RefusedError, damaged, ensure_plain, varies

MEMORY = 2**31
"""Bytes of addresses this process may use; Python, NumPy and HDF5 alone take a fifth of it."""

SECONDS = 3
"""Seconds of computing for a file, and for every `BYTES` bytes one more."""

BYTES = 20_000_000

BLOCK = 2**22
"""Bytes read at a time."""


def main() -> None:
    """Answer one line after another until there are no more."""
    _limit()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        path = json.loads(line)
        _allow(path)
        sys.stdout.write(json.dumps(found(path)) + "\n")
        sys.stdout.flush()


def found(path: str) -> str | None:
    """Return what is wrong with an HDF5 file; None if all of it can be read, or if it is none of this version."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            if "psmpc_version" in file.attrs and file.attrs.get("format_version") == FORMAT_VERSION:
                size = file.id.get_filesize()
                datasets = ensure_plain(file, size)
                for group in (file, *file.get("runs", {}).values()):
                    dict(group.attrs)
                _read(datasets, size)
                _make_use_of(Path(path), file)
    except RefusedError as refused:
        return str(refused)
    except MemoryError:
        return "an HDF5 file that takes too much memory"
    except Exception as error:  # of whatever type: HDF5 failed on this file, in its own process
        return damaged(error)
    return None


def _read(datasets: list[tuple[str, h5py.Dataset]], size: int) -> None:
    """Read everything there is; numbers that cannot be read are left to whoever reads them next, who may not need them.

    A kill may have cut off some of them. Attributes and texts are there from the beginning; where they cannot be read
    they may only have asked for more memory than this process has, and the next would wait for it.

    Raises:
        RefusedError: It is more than a file of so many bytes can hold.
        OSError, RuntimeError, ValueError, KeyError, TypeError, MemoryError: It is damaged.
    """
    room = ROOM + EXPANSION * size
    for path, dataset in datasets:
        dict(dataset.attrs)
        tolerated = () if varies(dataset.id) else (OSError, RuntimeError, ValueError)
        for selection, length in _pieces(dataset):
            if (room := room - length) < 0:
                raise RefusedError(
                    f"data that unfold to more than {ROOM + EXPANSION * size:.1e} bytes at {path[:60]!a}"
                )
            with suppress(*tolerated):
                value = dataset[selection]
                room -= len(value) if isinstance(value, bytes) else 0


def _make_use_of(path: Path, file: h5py.File) -> None:
    """Do what the commands do with a file, whatever comes of it: some of HDF5 is met only there."""
    from psmpc_cli.logs.comparison import logs_in
    from psmpc_cli.logs.read import kind_in, log_in
    from psmpc_cli.logs.results import results_in

    read = {RUN: log_in, COMPARISON: logs_in}
    with suppress(Exception):
        read.get(kind_in(file), results_in)(path, file)


def _pieces(dataset: h5py.Dataset) -> Iterator[tuple[Any, int]]:
    """Give what of a dataset is read at a time, and its size [bytes]: chunks that are there, rows, or single texts."""
    width = dataset.id.get_type().get_size()
    if not dataset.shape:
        yield (), width
    elif varies(dataset.id):
        yield from ((index, 0) for index in np.ndindex(dataset.shape))  # many may stand in the same place
    elif dataset.id.get_create_plist().get_layout() == h5d.CHUNKED:
        offsets: list[tuple[int, ...]] = []
        with suppress(OSError, RuntimeError, ValueError):
            dataset.id.chunk_iter(lambda chunk: offsets.append(chunk.chunk_offset))
        for offset in offsets:
            ends = map(sum, zip(offset, dataset.chunks, strict=True))
            yield tuple(map(slice, offset, ends)), prod(dataset.chunks) * width
    else:
        rows = max(1, BLOCK // max(1, prod(dataset.shape[1:]) * width))
        yield from ((slice(first, first + rows), 0) for first in range(0, len(dataset), rows))


def _limit() -> None:
    """Give this process little: no memory without end, no file to write, no traces of a crash."""
    if sys.platform == "win32":
        return
    import resource

    for kind, wanted in ((resource.RLIMIT_AS, MEMORY), (resource.RLIMIT_FSIZE, 0), (resource.RLIMIT_CORE, 0)):
        allowed = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (wanted if allowed == resource.RLIM_INFINITY else min(wanted, allowed), allowed))


def _allow(path: str) -> None:
    """Give this process time for one more file."""
    if sys.platform == "win32":
        return
    import os
    import resource

    spent = resource.getrusage(resource.RUSAGE_SELF)
    wanted = int(spent.ru_utime + spent.ru_stime + seconds(os.path.getsize(path))) + 1
    allowed = resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(
        resource.RLIMIT_CPU, (wanted if allowed == resource.RLIM_INFINITY else min(wanted, allowed), allowed)
    )


def seconds(size: int) -> float:
    """Return how long a file of so many bytes may take [s]."""
    return SECONDS + size / BYTES
