"""Results of a study: arrays over named coordinates in one file, filled in place while the study runs.

All arrays have their full size from the beginning, with a value that says "not yet". Filling them in changes no byte of
the file but theirs, so that a killed study leaves a readable file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import h5py
import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import LogError, RunError
from psmpc_cli.logs.files import image_of, kind_in, read_file, write_new
from psmpc_cli.logs.schema import FORMAT_VERSION

TEXT_LENGTH = 200
"""Room for a text that is filled in later [bytes]; longer ones are cut."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """One array of a results file.

    Attributes:
        name: Its name in the file.
        dims: Names of the coordinates along its dimensions; a coordinate has only its own name.
        values: The values, or a placeholder until they are filled in. Text is stored as UTF-8.
        units: SI units.
        long_name: What it is, for a plot's axis or a reader.
        meanings: What the values 0, 1, ... of a code mean.
    """

    name: str
    dims: tuple[str, ...]
    values: np.ndarray
    units: str
    long_name: str
    meanings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Results:
    """A results file in memory.

    Attributes:
        path: The file.
        attributes: Its attributes.
        quantities: Its arrays by name, coordinates among them.
    """

    path: Path
    attributes: Mapping[str, object]
    quantities: Mapping[str, Quantity]

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.quantities:
            raise LogError(f"{self.path}: found no {name}, expected results as psmpc writes them")
        return self.quantities[name].values


def create_results(
    path: Path, kind: str, attributes: Mapping[str, str | int | float], quantities: Sequence[Quantity], force: bool
) -> None:
    """Write a results file in one piece; a quantity that is its own only dimension is a coordinate.

    Raises:
        InputError: The file exists already or cannot be written; with `force`, it exists and is no HDF5 file.
    """

    def fill(file: h5py.File) -> None:
        file.attrs.update({"kind": kind, "psmpc_version": __version__, "format_version": FORMAT_VERSION, **attributes})
        for quantity in sorted(quantities, key=lambda quantity: quantity.dims != (quantity.name,)):
            _create(file, quantity)

    write_new(path, image_of(fill, ("v108", "v108")), force)


def _create(file: h5py.File, quantity: Quantity) -> None:
    values = _stored(quantity)
    # HDF5 has no checksums of texts of variable length, nor of single numbers
    chunks = values.shape if values.size and values.shape and not values.dtype.hasobject else None
    dataset = file.create_dataset(quantity.name, data=values, chunks=chunks, fletcher32=chunks is not None)
    dataset.attrs.update({"units": quantity.units, "long_name": quantity.long_name, "dims": " ".join(quantity.dims)})
    if quantity.meanings:
        dataset.attrs.update(
            {"flag_values": np.arange(len(quantity.meanings)), "flag_meanings": " ".join(quantity.meanings)}
        )
    if quantity.dims == (quantity.name,):
        dataset.make_scale(quantity.name)
        return
    for dimension, name in zip(dataset.dims, quantity.dims, strict=True):
        dimension.attach_scale(file[name])


def _stored(quantity: Quantity) -> np.ndarray:
    """Return the values as they stand in the file: text that is filled in later has its room from the beginning."""
    if quantity.values.dtype.kind != "U":
        return quantity.values
    if quantity.dims == (quantity.name,):
        return np.array(quantity.values.tolist(), h5py.string_dtype())
    room = h5py.string_dtype("utf-8", TEXT_LENGTH)
    texts = [_cut(text) for text in quantity.values.ravel()]
    return np.array(texts, room).reshape(quantity.values.shape)


def _cut(text: str) -> bytes:
    """Return a text that fits its room, no character of it cut in two."""
    return text.encode()[:TEXT_LENGTH].decode(errors="ignore").encode()


class ResultsWriter:
    """Fills a results file in, cell by cell."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = h5py.File(path, "r+", locking=False)
        except OSError as error:
            raise RunError(f"{path} cannot be written any further: {error}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()

    def write(self, index: tuple[int, ...], values: Mapping[str, np.ndarray | float | str]) -> None:
        """Fill in the values of one cell; they are in the file when this returns.

        Raises:
            RunError: The file cannot be written.
        """
        try:
            for name, value in values.items():
                cell = _cut(value) if isinstance(value, str) else value
                self._file[name][index] = cell
            self._file.flush()
        except OSError as error:
            raise RunError(f"{self.path} cannot be written any further: {error}") from None


def read_results(path: Path, kind: str) -> Results:
    """Return the results of a study of this kind.

    Raises:
        LogError: The file is missing, damaged, of another version, or of another kind.
    """

    def read(file: h5py.File) -> Results:
        if (found := kind_in(file)) != kind:
            raise LogError(f"{path}: found a {found}, expected a {kind}")
        quantities = {name: _quantity(name, dataset) for name, dataset in file.items()}
        for quantity in quantities.values():
            _check(quantity, quantities)
        return Results(path, dict(file.attrs), quantities)

    return read_file(path, read, f"a {kind} written by psmpc")


def _check(quantity: Quantity, quantities: Mapping[str, Quantity]) -> None:
    """Make sure that a quantity fits its coordinates, and that its codes have a meaning.

    Raises:
        ValueError: It does not.
        KeyError: It has no such coordinate.
    """
    if quantity.values.shape != tuple(quantities[name].values.size for name in quantity.dims):
        raise ValueError(f"{quantity.name} does not fit its coordinates")
    if quantity.meanings and not np.isin(quantity.values, np.arange(len(quantity.meanings))).all():
        raise ValueError(f"{quantity.name} holds a code without a meaning")


def _quantity(name: str, dataset: h5py.Dataset) -> Quantity:
    text = h5py.check_string_dtype(dataset.dtype) is not None
    values = np.asarray(dataset.asstr()[()], dtype=str) if text else np.asarray(dataset)
    units, long_name, dims, meanings = (
        str(dataset.attrs.get(key, "")) for key in ("units", "long_name", "dims", "flag_meanings")
    )
    return Quantity(name, tuple(dims.split()), values, units, long_name, tuple(meanings.split()))
