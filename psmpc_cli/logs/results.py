"""Results of a study: arrays over named coordinates in one file, filled in while the study runs.

All arrays have their full size from the beginning, with a value that says "not yet". Each cell that is filled in puts a
whole file in the place of the one before, so that a killed study leaves a readable file.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import LogError, RunError
from psmpc_cli.logs.files import kind_in, new_image, read_array, read_file, replace_file, write_new
from psmpc_cli.logs.schema import FORMAT_VERSION


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
    """Write a results file; a quantity that is its own only dimension is a coordinate.

    Raises:
        InputError: The file exists already or cannot be written; with `force`, it exists and is no HDF5 file.
    """
    about = {"kind": kind, "psmpc_version": __version__, "format_version": FORMAT_VERSION}
    write_new(path, _image({**about, **attributes}, quantities), force)


def _image(attributes: Mapping[str, object], quantities: Iterable[Quantity]) -> bytes:
    def fill(file: h5py.File) -> None:
        file.attrs.update(attributes)
        for quantity in sorted(quantities, key=lambda quantity: quantity.dims != (quantity.name,)):
            _create(file, quantity)

    return new_image(fill)


def _create(file: h5py.File, quantity: Quantity) -> None:
    values = quantity.values
    if values.dtype.kind in "UO":
        values = np.array(values.tolist(), h5py.string_dtype())
    # HDF5 has no checksums of texts of variable length, nor of single numbers
    chunks = values.shape if values.size and values.shape and not values.dtype.hasobject else None
    dataset = file.create_dataset(quantity.name, data=values, chunks=chunks, fletcher32=chunks is not None)
    dataset.attrs.update({"units": quantity.units, "long_name": quantity.long_name, "dims": " ".join(quantity.dims)})
    if quantity.meanings:
        codes = {"flag_values": np.arange(len(quantity.meanings)), "flag_meanings": " ".join(quantity.meanings)}
        dataset.attrs.update(codes)
    if quantity.dims == (quantity.name,):
        dataset.make_scale(quantity.name)
        return
    for dimension, name in zip(dataset.dims, quantity.dims, strict=True):
        dimension.attach_scale(file[name])


class ResultsWriter:
    """Fills a results file in, cell by cell."""

    def __init__(self, results: Results) -> None:
        self.results = results
        values = {name: quantity.values for name, quantity in results.quantities.items()}  # text of any length
        self._values = {
            name: each.astype(object if each.dtype.kind == "U" else each.dtype) for name, each in values.items()
        }

    def fill(self, index: tuple[int, ...], values: Mapping[str, np.ndarray | float | str]) -> None:
        """Fill in the values of one cell; they are in the file with the next `write`."""
        for name, value in values.items():
            self._values[name][index] = value

    def write(self) -> None:
        """Write the whole file in the place of the one before.

        Raises:
            RunError: The file cannot be written.
        """
        filled = [replace(each, values=self._values[name]) for name, each in self.results.quantities.items()]
        try:
            replace_file(self.results.path, _image(self.results.attributes, filled))
        except OSError as error:
            raise RunError(f"{self.results.path} cannot be written any further: {error.strerror or error}") from None


def read_results(path: Path, kind: str) -> Results:
    """Return the results of a study of this kind.

    Raises:
        LogError: The file is missing, damaged, of another version, or of another kind.
    """

    def read(file: h5py.File) -> Results:
        if (found := kind_in(file)) != kind:
            raise LogError(f"{path}: found a {found}, expected a {kind}")
        quantities = {name: _quantity(name, dataset) for name, dataset in file.items()}
        for each in quantities.values():
            if each.values.shape != tuple(quantities[name].values.size for name in each.dims):
                raise ValueError(f"{each.name} does not fit its coordinates")
            if each.meanings and not np.isin(each.values, np.arange(len(each.meanings))).all():
                raise ValueError(f"{each.name} holds a code without a meaning")
        return Results(path, dict(file.attrs), quantities)

    return read_file(path, read, f"a {kind} written by psmpc")


def _quantity(name: str, dataset: h5py.Dataset) -> Quantity:
    units, long_name, dims, meanings = (
        str(dataset.attrs.get(key, "")) for key in ("units", "long_name", "dims", "flag_meanings")
    )
    return Quantity(name, tuple(dims.split()), read_array(dataset), units, long_name, tuple(meanings.split()))
