"""Writes a log while the run goes on: every sample is in the file before the next one begins.

The file may be read while it is written, and after a kill: it is not locked, and what a row refers to is in it before
the row. A run that ends leaves a copy in its place, with checksums over all that it says.
"""

import errno
import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5p, h5s, h5t
from numpy.typing import ArrayLike

from psmpc_cli.errors import RunError
from psmpc_cli.logs.files import write_new
from psmpc_cli.logs.schema import FORMAT_VERSION, RUN, SCHEMA, Column, Sample

ROWS_IN_A_CHUNK, TICKS_IN_A_CHUNK, ELEMENTS_IN_A_CHUNK = 256, 4096, 512
"""Chunks are large: space is set aside rarely, and between those times a killed run can only lose its last row."""

ROWS_IN_A_PACK = 16
"""Rows of vectors that a finished log compresses together."""

SPARE = 2**17
"""Room kept free for what HDF5 itself adds [bytes]."""


@dataclass(frozen=True)
class Header:
    """What a log says of the run before it begins.

    Attributes:
        attributes: Text and numbers kept as attributes of the file.
        values: Scales and other datasets that are known, by path.
        has: Which of the datasets that only some runs have it holds, by `Column.only`.
        units: Units of datasets that the task decides, by path.
    """

    attributes: Mapping[str, str | int | float | bool]
    values: Mapping[str, ArrayLike]
    has: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> list[Column]:
        """Every dataset of the log."""
        return [column for column in SCHEMA if not column.only or column.only in self.has]


class LogWriter:
    """An open log. Use as a context manager; `close` without `finish` leaves it unfinished.

    Without a path it is in memory alone. `file` is the open file.
    """

    def __init__(self, path: Path | None, header: Header, force: bool = False) -> None:
        self.path = path
        if path is None:
            self.file = h5py.File("log", "w", driver="core", backing_store=False)
            _create(self.file, header)
        else:
            write_new(path, _image(header), force)
            self.file = h5py.File(path, "r+", locking=False)
            _claim(self.file.id.get_vfd_handle())
        self._header, self._rows, self._finished = header, 0, False
        growing = [(column, _GrowingDataset(self.file[column.path])) for column in header.columns if column.value]
        self._ahead = [each for each in growing if each[0].dims[0] != "time" or each[0].ragged]
        self._samples = [each for each in growing if each not in self._ahead]
        self._about = {
            part.path: _GrowingDataset(self.file[part.path]) for column, _ in self._ahead for part in _parts(column)[1:]
        }
        self._chunks = sum(dataset.chunk_size for column, dataset in growing if not column.ragged)

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def append(self, sample: Sample) -> None:
        """Write a sample and give it to the operating system.

        Raises:
            RunError: The file cannot be written any further, for example because the disk is full; or it is gone.
        """
        self.write({column.path: column.value(sample) for column in self._header.columns if column.value})

    def write(self, row: Mapping[str, ArrayLike]) -> None:
        """Write what a sample leaves in every dataset that grows, by path.

        Raises:
            RunError: As for `append`.
        """
        if not self._is_there():
            raise RunError(f"{self.path} was removed or replaced while the run went on, and what it held is lost")
        ahead = [(column, dataset, np.asarray(row[column.path])) for column, dataset in self._ahead]
        with self._writing():
            self._reserve(self._chunks + 2 * sum(values.nbytes for _, _, values in ahead))
            for column, dataset, values in ahead:
                if column.ragged:
                    self._write_ragged(column.path, dataset, values)
                else:
                    dataset.write(self._rows * len(values), values)
            if ahead:
                self._flush()  # what the row refers to is in the file before the row is
            for column, dataset in self._samples:
                dataset.write(self._rows, np.asarray(row[column.path])[None])
            self._flush()
        self._rows += 1

    def update(self, values: Mapping[str, ArrayLike]) -> None:
        """Write datasets that do not grow, by path."""
        with self._writing():
            for path, value in values.items():
                self.file[path][...] = value
            self._flush()

    def finish(self, finished: bool, reason: str, values: Mapping[str, ArrayLike], stuck: bool = False) -> None:
        """Write how the run ended, and what is known then of datasets that do not grow; half a sample is dropped."""
        with self._writing():
            self._reserve()
            for _, dataset in self._samples:
                dataset.cut(self._rows)
        self.update(values)
        with self._writing():
            self.file.attrs.update({"finished": finished, "end_reason": reason, "stuck": stuck})
            self._flush()
        self._finished = True

    def close(self) -> None:
        """Close the file; a finished one is replaced by a copy with checksums, if there is room for it."""
        if self.path is None:
            self.file.close()
            return
        with self._writing():
            self.file.flush()
            replaced = self._finished and self._is_there()
            image = _image(self._header, self.file) if replaced else b""
            os.ftruncate(self.file.id.get_vfd_handle(), self.file.id.get_filesize())
            self.file.close()
        if replaced:
            part = self.path.resolve().with_name(f".{self.path.name}.{os.getpid()}.part")
            with suppress(OSError):
                part.write_bytes(image)
                os.replace(part, self.path.resolve())
            part.unlink(missing_ok=True)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:
            reason = (isinstance(error, OSError) and error.strerror) or str(error).partition("\n")[0]
            raise RunError(
                f"{self.path} cannot be written any further, it holds the run up to then: {reason}"
            ) from None

    def _flush(self) -> None:
        if self.path is not None:
            self.file.flush()

    def _is_there(self) -> bool:
        """Tell whether the file still has its name: what is written to one that has none is lost."""
        if self.path is None:
            return True
        try:
            return os.path.samestat(os.stat(self.path), os.fstat(self.file.id.get_vfd_handle()))
        except OSError:
            return False

    def _reserve(self, size: int = 0) -> None:
        """Make sure of room for so many bytes more: HDF5 does not survive a full disk, so it must never meet one."""
        if self.path is None or not hasattr(os, "posix_fallocate"):
            return
        descriptor, end = self.file.id.get_vfd_handle(), self.file.id.get_filesize()
        if os.fstat(descriptor).st_size < end + size + SPARE:
            os.posix_fallocate(descriptor, end, size + SPARE)

    def _write_ragged(self, path: str, dataset: "_GrowingDataset", values: np.ndarray) -> None:
        (before,) = dataset.width
        dataset.write(self._rows, values[None])
        self._about[f"{path}_length"].write(self._rows, [len(values)])
        (after,) = dataset.width
        self._about[f"{path}_element"].write(before, np.arange(before, after))


def claimed(path: Path) -> bool:
    """Return whether another process writes a log still."""
    with path.open("r+b") as file:
        return not _claim(file.fileno())


def _claim(descriptor: int) -> bool:
    """Claim an open file for this process; return whether no other has. Readers do not notice."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN)
    return True


class _GrowingDataset:
    """Rows go in at their number, so that writing a row again after an interruption does no harm.

    `chunk_size` is the room it takes at a time [bytes].

    It calls HDF5 directly and keeps the objects a write needs: a sample writes some forty datasets, h5py's indexing
    costs three times as much, and making those objects anew three times as much again.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._id, self._dtype = dataset.id, dataset.dtype
        self.width: tuple[int, ...] = dataset.shape[1:]
        self._type, self._space = h5t.py_create(self._dtype), h5s.create_simple(dataset.shape)
        self._memory = cache(h5s.create_simple)
        self.chunk_size: int = math.prod(dataset.chunks) * dataset.dtype.itemsize

    def write(self, first: int, rows: Any) -> None:
        """Write rows (M, ...) from row `first` on, which become the last; rows that are too long widen the dataset."""
        values = np.ascontiguousarray(rows, self._dtype)
        self.width = tuple(max(old, new) for old, new in zip(self.width, values.shape[1:], strict=True))
        extent = (first + len(values), *self.width)
        self._id.set_extent(extent)
        if values.size:
            self._space.set_extent_simple(extent)
            self._space.select_hyperslab((first, *(0 for _ in self.width)), values.shape)
            self._id.write(self._memory(values.shape), self._space, values, self._type)

    def cut(self, length: int) -> None:
        """Drop every row from `length` on."""
        self._id.set_extent((length, *self.width))


def _image(header: Header, run: h5py.File | None = None) -> bytes:
    """Return the image of an empty log, or of that of a finished run with checksums."""
    with h5py.File("log", "w", driver="core", backing_store=False, libver="latest" if run else None) as file:
        _create(file, header, run)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _create(file: h5py.File, header: Header, run: h5py.File | None = None) -> None:
    """Create every dataset of a log: without rows, or as a finished run has it and with checksums."""
    attributes = {"kind": RUN, "format_version": FORMAT_VERSION, "finished": False, "end_reason": "", "stuck": False}
    file.attrs.update({**attributes, **header.attributes} if run is None else run.attrs)
    parts = [part for column in header.columns for part in _parts(column)]
    for part in sorted(parts, key=lambda part: not part.is_scale):
        dataset = _empty(file, part, header) if run is None else _checked(file, part, run[part.path])
        dataset.attrs.update({"units": header.units.get(part.path, part.units), "long_name": part.long_name})
        if part.is_scale:
            dataset.make_scale(part.path.rpartition("/")[2])
            continue
        for dimension, scale in zip(dataset.dims, part.dims, strict=True):
            dimension.attach_scale(file[scale])


def _parts(column: Column) -> list[Column]:
    """Return a column; with it, if its rows have lengths of their own, those lengths and the index along a row."""
    if not column.ragged:
        return [column]
    path, element = column.path, column.dims[1]
    length = Column(f"{path}_length", "1", f"number of elements in each row of {path}", column.value, "i4", ("time",))
    return [column, length, Column(element, "1", f"index into a row of {path}", column.value, "i4", (element,))]


def _empty(file: h5py.File, column: Column, header: Header) -> h5py.Dataset:
    """Create a dataset without rows, or with the values that are known before the run."""
    text, known = column.dtype == "text", header.values.get(column.path)
    dtype = h5py.string_dtype() if text else column.dtype
    widths = [len(file[scale]) for scale in column.dims if scale != column.path]
    if column.value is None:
        shape = widths if known is None else np.shape(known)
        return file.create_dataset(column.path, shape, dtype, known, fillvalue=None if text else column.unknown)
    if column.ragged:
        chunks = (1, ELEMENTS_IN_A_CHUNK)
        return file.create_dataset(column.path, (0, 0), dtype, maxshape=(None, None), chunks=chunks, fillvalue=np.nan)
    widths = widths[0 if column.is_scale else 1 :]
    chunk = ROWS_IN_A_CHUNK if column.dims[0] == "time" else TICKS_IN_A_CHUNK
    return file.create_dataset(column.path, (0, *widths), dtype, maxshape=(None, *widths), chunks=(chunk, *widths))


def _checked(file: h5py.File, column: Column, logged: h5py.Dataset) -> h5py.Dataset:
    """Create a dataset with all that a finished run says, so that damage to it is noticed when it is read."""
    if column.value is None:
        compact = h5p.create(h5p.DATASET_CREATE)
        compact.set_layout(h5d.COMPACT)
        return file.create_dataset(column.path, data=logged[()], dtype=logged.dtype, dcpl=compact)
    same = {"data": logged[()], "dtype": logged.dtype, "maxshape": logged.maxshape, "fletcher32": True}
    if column.ragged:
        packed = {"shuffle": True, "compression": "gzip", "compression_opts": 1, "fillvalue": np.nan}
        return file.create_dataset(column.path, chunks=(ROWS_IN_A_PACK, ELEMENTS_IN_A_CHUNK), **packed, **same)
    return file.create_dataset(column.path, chunks=logged.chunks, **same)
