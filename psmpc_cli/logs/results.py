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
from psmpc_cli.logs.new_file import write_new
from psmpc_cli.logs.read import kind_in, opened
from psmpc_cli.logs.schema import FORMAT_VERSION
from psmpc_cli.logs.seal import seal, sealed, unseal
from psmpc_cli.logs.sound import ensure_believable

TEXT_LENGTH = 200
"""Room for a text that is filled in later [bytes]; longer ones are cut."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """One array of a results file.

    Attributes:
        name: Its name in the file.
        dims: Names of the coordinates along its dimensions; a coordinate has its own name alone.
        values: The values, or what stands for them until they are filled in. Text is kept as UTF-8.
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
    with h5py.File("results", "w", driver="core", backing_store=False) as file:
        file.attrs.update({"kind": kind, "psmpc_version": __version__, "format_version": FORMAT_VERSION, **attributes})
        for quantity in sorted(quantities, key=lambda quantity: quantity.dims != (quantity.name,)):
            _create(file, quantity)
        file.flush()
        image: bytes = file.id.get_file_image()
    write_new(path, sealed(image), force)


def _create(file: h5py.File, quantity: Quantity) -> None:
    dataset = file.create_dataset(quantity.name, data=_stored(quantity))
    dataset.attrs.update({"units": quantity.units, "long_name": quantity.long_name})
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
            unseal(path)
            self._file = h5py.File(path, "r+", locking=False)
        except OSError as error:
            raise RunError(f"{path} cannot be written any further: {error}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()
        seal(self.path)

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
    with opened(path) as file:
        if (found := kind_in(file)) != kind:
            raise LogError(f"{path}: found a {found}, expected a {kind}")
        return results_in(path, file)


def results_in(path: Path, file: h5py.File) -> Results:
    """Return the results in an open file.

    Raises:
        OSError, RuntimeError, ValueError, KeyError, AttributeError: They are damaged.
    """
    quantities = {name: _quantity(name, dataset) for name, dataset in file.items()}
    for quantity in quantities.values():
        _check(quantity, quantities)
    return Results(path, dict(file.attrs), quantities)


def _check(quantity: Quantity, quantities: Mapping[str, Quantity]) -> None:
    """Make sure that a quantity fits its coordinates and holds numbers, texts or codes that mean something.

    Raises:
        ValueError: It does not.
        KeyError: It has no such coordinate.
    """
    if quantity.values.shape != tuple(quantities[name].values.size for name in quantity.dims):
        raise ValueError(f"{quantity.name} does not fit its coordinates")
    if quantity.values.dtype.kind not in "fiuU":
        raise ValueError(f"{quantity.name} holds neither numbers nor texts")
    if quantity.values.dtype.kind == "f" and quantity.values.dtype != np.float64:
        raise ValueError(f"{quantity.name} has type {quantity.values.dtype}, not float64")
    if quantity.meanings and not np.isin(quantity.values, np.arange(len(quantity.meanings))).all():
        raise ValueError(f"{quantity.name} holds a code without a meaning")
    ensure_believable(quantity.name, quantity.values)


def _dims(name: str, dataset: h5py.Dataset) -> tuple[str, ...]:
    """Return the names of a dataset's coordinates.

    They are looked up here and not by HDF5's functions for dimension scales, which crash or hang on damaged files.
    """
    if dataset.attrs.get("CLASS") == b"DIMENSION_SCALE":
        return (name,)
    references = dataset.attrs.get("DIMENSION_LIST", ())
    return tuple(str(dataset.file[reference[0]].name).lstrip("/") for reference in references)


def _quantity(name: str, dataset: h5py.Dataset) -> Quantity:
    text = h5py.check_string_dtype(dataset.dtype) is not None
    values = np.asarray(dataset.asstr()[()], dtype=str) if text else np.asarray(dataset)
    meanings = tuple(str(dataset.attrs.get("flag_meanings", "")).split())
    units, long_name = str(dataset.attrs["units"]), str(dataset.attrs["long_name"])
    return Quantity(name, _dims(name, dataset), values, units, long_name, meanings)
