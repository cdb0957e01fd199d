"""A dataset of an open log that grows row by row."""

import math
from functools import cache
from typing import Any

import h5py
import numpy as np
from h5py import h5s, h5t


class GrowingDataset:
    """Rows go in where they belong, so that writing a row again after an interruption does no harm.

    `chunk_size` is the room it takes at a time [bytes].

    It speaks to HDF5 directly and keeps the objects a write needs: a sample writes some forty datasets, h5py's indexing
    costs three times as much, and making those objects anew three times as much again.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._id, self._dtype = dataset.id, dataset.dtype
        self._width: tuple[int, ...] = dataset.shape[1:]
        self._type, self._space = h5t.py_create(self._dtype), h5s.create_simple(dataset.shape)
        self._memory = cache(h5s.create_simple)
        self.chunk_size: int = math.prod(dataset.chunks) * dataset.dtype.itemsize

    @property
    def width(self) -> tuple[int, ...]:
        """Shape of a row."""
        return self._width

    def write(self, first: int, rows: Any) -> None:
        """Write rows (M, ...) from row `first` on, which become the last; rows that are too long widen the dataset."""
        values = np.ascontiguousarray(rows, self._dtype)
        self._width = tuple(max(old, new) for old, new in zip(self._width, values.shape[1:], strict=True))
        extent = (first + len(values), *self._width)
        self._id.set_extent(extent)
        if values.size:
            self._space.set_extent_simple(extent)
            self._space.select_hyperslab((first, *(0 for _ in self._width)), values.shape)
            self._id.write(self._memory(values.shape), self._space, values, self._type)

    def cut(self, length: int) -> None:
        """Drop every row from `length` on."""
        self._id.set_extent((length, *self._width))
