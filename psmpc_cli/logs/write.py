"""Writes a log while the run goes on: rows are collected in memory and written with the whole file twice a second.

Every write puts a complete file, with checksums over its numbers, in the place of the one before in one step. So the
file opens at any time, and after a kill at any moment it lacks at most the samples of the last half second.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5p
from numpy.typing import ArrayLike

from psmpc_cli.errors import RunError
from psmpc_cli.logs.conditions import SPATIAL, Condition
from psmpc_cli.logs.files import image_of, replace_file, write_new
from psmpc_cli.logs.schema import (
    COLUMN_UNITS,
    FORMAT_VERSION,
    OF_COORDINATES,
    RUN,
    Column,
    Sample,
    layout,
    measure_together,
    sliding_of,
    units_of_columns,
)

BETWEEN_WRITES = 0.5
"""Shortest time from one write to the next [s]."""

LARGEST_SHARE = 0.05
"""Largest share of a run's time for writing files: those that take longer than a fortieth of a second, some 20 MB, are
written more rarely."""

ROWS_IN_A_CHUNK = 64
TICKS_IN_A_CHUNK = 512
ROWS_IN_A_PACK = 16
ELEMENTS_IN_A_CHUNK = 512
"""Sizes of the chunks of rows and of ticks, and of those of vectors with lengths of their own."""

Row = Mapping[str, ArrayLike]
"""What a sample leaves in every dataset that grows, by path."""


@dataclass(frozen=True)
class Header:
    """What a log says of the run before it begins.

    Attributes:
        attributes: Text and numbers kept as attributes of the file.
        values: Scales and other datasets that are known, by path.
        has: The conditions that hold of the run, see `conditions_of`.
    """

    attributes: Mapping[str, str | int | float | bool]
    values: Mapping[str, ArrayLike]
    has: frozenset[Condition]


class LogWriter:
    """An open log. Use as a context manager; `close` without `finish` leaves it unfinished.

    Without a path it is in memory alone.
    """

    def __init__(self, path: Path | None, header: Header, force: bool = False) -> None:
        """Begin a log in memory and write its file, which holds what is known before the first sample.

        The log is an HDF5 file in memory. Twice a second, as samples come, the file on disk is replaced by the whole of
        it: if it were written in place, a run that is killed would leave a damaged file.

        Args:
            path: The file on disk; None for a log in memory alone.
            header: What is known of the run beforehand: attributes, values, and which features it has.
            force: Overwrite an earlier log.

        Raises:
            InputError: The path is taken (with `force`, by a file that psmpc did not write), or cannot be written.
        """
        self.path = path
        self.absolute_path = path if path is None else path.absolute()  # the working folder may change
        # datasets that this run has: some are `only` in logs of spatial robots, or of robots with wheels, ...
        columns_of_log = [column for column in layout(SPATIAL in header.has) if column.only in header.has]
        # driver core: in memory; the name, which has to be unique, is that of no file
        self._file = h5py.File(f"log {id(self)}", "w", driver="core", backing_store=False, libver="latest")
        # until `finish`: whether the last stage was completed, why the run ended, whether it could not go on
        unfinished = {"finished": False, "end_reason": "", "stuck": False}
        attributes = {"kind": RUN, "format_version": FORMAT_VERSION, **unfinished, **header.attributes}
        self._datasets = create_log(self._file, columns_of_log, attributes, header.values)
        # a column with a `value`, which reads it from a sample, grows with every sample; others are written once
        self._growing_columns = [column for column in columns_of_log if column.value is not None]
        self._waiting_rows: list[Sample | Row] = []
        self._rows_in_log = 0
        self._has_unwritten_changes = False
        self._next_write = 0.0  # time of the clock [s] before which no row is written: the first one is at once
        if path is not None:
            write_new(path, image_of(self._file), force)

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    @property
    def file(self) -> h5py.File:
        """The log in memory, with every row so far."""
        self._add_waiting_rows()
        return self._file

    def write(self, row: Sample | Row) -> None:
        """Add a sample, which is read when the file is written, or its row.

        Raises:
            RunError: The file cannot be written any further, for example because the disk is full.
        """
        self._waiting_rows.append(row)
        self._has_unwritten_changes = True
        if monotonic() >= self._next_write:
            self._write_file()

    def update(self, values: Mapping[str, ArrayLike]) -> None:
        """Set datasets that do not grow, by path; they are in the file with the next write."""
        for path, value in values.items():
            self._file[path][...] = value
        self._has_unwritten_changes = True

    def update_attributes(self, attributes: Mapping[str, str]) -> None:
        """Set attributes of the log; they are in the file with the next write."""
        self._file.attrs.update(attributes)
        self._has_unwritten_changes = True

    def finish(self, finished: bool, reason: str, values: Mapping[str, ArrayLike], stuck: bool = False) -> None:
        """Write how the run ended, and what is known then of datasets that do not grow.

        Args:
            finished: Whether the last stage met its end condition.
            reason: Why the run ended, in words.
            values: Datasets that do not grow, by path.
            stuck: Whether the run could not go on.

        Raises:
            RunError: As for `write`.
        """
        self.update(values)
        self._file.attrs.update({"finished": finished, "end_reason": reason, "stuck": stuck})
        self._write_file()

    def close(self) -> None:
        """Write what is not in the file yet, and close it.

        Raises:
            RunError: As for `write`.
        """
        try:
            if self._has_unwritten_changes:
                self._write_file()
        finally:
            self._file.close()

    def _write_file(self) -> None:
        """Replace the file by the whole log so far, in one step: a kill at any moment leaves a file that opens.

        Samples that wait are first added to the log in memory, where a log without a path stays.

        Raises:
            RunError: The file cannot be written.
        """
        self._add_waiting_rows()
        began_at = monotonic()
        if self.absolute_path is not None:
            try:
                replace_file(self.absolute_path, image_of(self._file))
            except OSError as error:
                reason = error.strerror or error
                raise RunError(
                    f"{self.path} cannot be written any further, it holds the run as last written: {reason}"
                ) from None
        ended_at = monotonic()
        self._has_unwritten_changes = False
        # the slower the write, the later the next one: writing takes at most LARGEST_SHARE of a run's time
        self._next_write = ended_at + max(BETWEEN_WRITES, (ended_at - began_at) / LARGEST_SHARE)

    def _add_waiting_rows(self) -> None:
        """Add the samples that wait to the datasets of the log in memory, many at once because that is faster.

        `_rows_in_log` is counted up last, so that after an interruption the same rows are written again to the same
        place.
        """
        rows = rows_of(self._waiting_rows, self._growing_columns)
        for column in self._growing_columns if rows else ():
            values = [np.asarray(row[column.path]) for row in rows]
            if column.ragged:
                self._add_ragged_rows(column, values)
                continue
            # a sample has one row in a dataset along time, and a row for each of its ticks in one along ticks
            new_values = np.array(values) if column.dims[0] == "time" else np.concatenate(values)
            rows_per_sample = len(new_values) // len(rows)
            _write_rows(self._datasets[column.path], self._rows_in_log * rows_per_sample, new_values)
        self._rows_in_log += len(rows)
        self._waiting_rows = []

    def _add_ragged_rows(self, column: Column, values: list[np.ndarray]) -> None:
        """Add rows of different lengths: padded with NaN to the longest one, with their lengths beside them."""
        lengths = [len(row) for row in values]
        padded_rows = np.full((len(values), max(lengths)), np.nan)
        for padded_row, row in zip(padded_rows, values, strict=True):
            padded_row[: len(row)] = row
        dataset = self._datasets[column.path]
        _write_rows(dataset, self._rows_in_log, padded_rows)
        _write_rows(self._datasets[f"{column.path}_length"], self._rows_in_log, np.array(lengths))
        _write_rows(self._datasets[column.dims[1]], 0, np.arange(dataset.shape[1]))  # scale: the index along a row


def rows_of(samples: Sequence[Sample | Row], columns: Sequence[Column]) -> list[Row]:
    """Read the rows of samples in some datasets, by path; rows that were read already stay as they are."""
    measure_together([each for each in samples if isinstance(each, Sample)])
    readers = [(column.path, column.value) for column in columns if column.value is not None]
    return [{path: read(each) for path, read in readers} if isinstance(each, Sample) else each for each in samples]


def _write_rows(dataset: h5py.Dataset, first: int, rows: np.ndarray) -> None:
    """Write rows of a dataset from row `first` to its end; rows longer than those before widen the dataset."""
    dataset.resize((first + len(rows), *map(max, dataset.shape[1:], rows.shape[1:])))
    dataset[(slice(first, None), *map(slice, rows.shape[1:]))] = rows.astype(dataset.dtype)


def create_log(
    group: h5py.Group, columns: Sequence[Column], attributes: Mapping[str, Any], values: Mapping[str, ArrayLike]
) -> dict[str, h5py.Dataset]:
    """Create every dataset of a log, with units and names of its dimensions, so that rows can be appended to it.

    Dimension scales (what runs along an axis: time, coordinates, stages) come first, as others are tied to them.

    Args:
        group: An empty group.
        columns: The datasets.
        attributes: Attributes of the log.
        values: What is known of the datasets beforehand, by path. Others begin without rows, or with unknown values.

    Returns:
        The datasets by path.
    """
    group.attrs.update(attributes)
    # with `onset: closeness` the presence of stages is a number without a unit, otherwise a norm of controls
    without_unit = ("window/presence", "stages/epsilon") if attributes.get("onset") == "closeness" else ()
    datasets = dict[str, h5py.Dataset]()
    coordinate_names = dict[str, list[str]]()  # by path of the scale that has them
    sliding = sliding_of(attributes)
    # a column with rows of different lengths has three parts: the rows, their lengths, and the index along a row
    parts = (part for column in columns for part in column.parts)
    for part in sorted(parts, key=lambda part: not part.is_scale):
        scale_lengths = [len(datasets[scale]) for scale in part.dims if scale != part.path]
        dataset = _create_dataset(group, part, scale_lengths, values.get(part.path))
        datasets[part.path] = dataset
        units = "1" if part.path in without_unit else part.units
        dataset.attrs.update({"units": units, "long_name": part.long_name})
        if not part.is_scale and part.dims[-1:] and part.dims[-1] in OF_COORDINATES:
            coordinate = part.dims[-1]
            if coordinate not in coordinate_names:
                coordinate_names[coordinate] = datasets[coordinate].asstr()[:].tolist()
            if column_units := units_of_columns(part, coordinate_names[coordinate], sliding):
                dataset.attrs[COLUMN_UNITS] = column_units
        if part.is_scale:
            dataset.make_scale(part.path.rpartition("/")[2])
            continue
        for dimension, scale in zip(dataset.dims, part.dims, strict=True):
            dimension.attach_scale(datasets[scale])
    return datasets


def _create_dataset(
    group: h5py.Group, column: Column, scale_lengths: list[int], known_values: ArrayLike | None
) -> h5py.Dataset:
    """Create a dataset of a log, stored so that damage is found: all numbers have checksums.

    A dataset that grows sample by sample is stored in chunks, each with a checksum. One of fixed size is stored within
    the metadata of the file, which have checksums as well.

    Args:
        group: The group of the log.
        column: What the schema says of the dataset: path, type, dimensions, and how its rows are read from samples.
        scale_lengths: Lengths of its dimensions, but for the one along which it is itself the scale.
        known_values: Its values; None if they are not known yet.

    Returns:
        The dataset; without rows, or with `column.unknown`, where no values are known.
    """
    is_text = column.dtype == "text"
    dtype = h5py.string_dtype() if is_text else np.dtype(column.dtype)
    data = None if known_values is None else np.asarray(known_values, object if is_text else dtype)
    grows = column.value is not None  # which reads its rows from a sample
    if not grows:
        compact_layout = h5p.create(h5p.DATASET_CREATE)
        compact_layout.set_layout(h5d.COMPACT)  # within the metadata
        shape = scale_lengths if data is None else data.shape
        unknown = None if is_text else column.unknown
        return group.create_dataset(column.path, shape, dtype, data, fillvalue=unknown, dcpl=compact_layout)
    if column.ragged:  # rows with lengths of their own
        chunks: tuple[int, ...] | bool = (ROWS_IN_A_PACK, ELEMENTS_IN_A_CHUNK)
        growth_options: dict[str, Any] = {"maxshape": (None, None), "compression": "gzip", "compression_opts": 1}
        shape = [0, 0]
        growth_options["fillvalue"] = np.nan
    else:
        row_shape = scale_lengths[0 if column.is_scale else 1 :]  # the first dimension is the one that grows
        chunks = (ROWS_IN_A_CHUNK if column.dims[0] == "time" else TICKS_IN_A_CHUNK, *row_shape)
        chunks = chunks if all(row_shape) else True  # HDF5 allows no chunks of size 0: it chooses
        shape = [0, *row_shape]
        growth_options = {"maxshape": (None, *row_shape)}
    shape = shape if data is None else data.shape
    return group.create_dataset(column.path, shape, dtype, data, chunks=chunks, fletcher32=True, **growth_options)
