"""A dataset of an open log that grows row by row."""

import math
from typing import Any

import h5py
import numpy as np
from h5py import h5s


class GrowingDataset:
    """Rows go in where they belong, so that writing a row again after an interruption does no harm.

    `chunk_size` is the room it takes at a time [bytes].

    It speaks to HDF5 directly: a sample writes some thirty datasets, and h5py's indexing costs three times as much.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._id, self._dtype = dataset.id, dataset.dtype
        self._width: tuple[int, ...] = dataset.shape[1:]
        self.chunk_size: int = math.prod(dataset.chunks) * dataset.dtype.itemsize

    @property
    def width(self) -> tuple[int, ...]:
        """Shape of a row."""
        return self._width

    def write(self, first: int, rows: Any) -> None:
        """Write rows (M, ...) from row `first` on, which become the last; rows that are too long widen the dataset."""
        values = np.ascontiguousarray(rows, self._dtype)
        self._width = tuple(max(old, new) for old, new in zip(self._width, values.shape[1:], strict=True))
        self._id.set_extent((first + len(values), *self._width))
        if values.size:
            space = self._id.get_space()
            space.select_hyperslab((first, *(0 for _ in self._width)), values.shape)
            self._id.write(h5s.create_simple(values.shape), space, values)

    def cut(self, length: int) -> None:
        """Drop every row from `length` on."""
        self._id.set_extent((length, *self._width))
