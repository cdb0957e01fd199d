"""Results of a study: arrays over named coordinates in one file, filled in while the study runs.

All arrays have their full size from the beginning, with a value that says "not yet". Each time they are saved a whole
file takes the place of the one before, so that a killed study leaves a readable file.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import LogError, RunError
from psmpc_cli.logs.files import FileLock, new_image, read_array, read_attributes, read_file, write_new
from psmpc_cli.logs.schema import FORMAT_VERSION
from psmpc_cli.logs.walk import unexpected_item


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

    @property
    def is_dimension(self) -> bool:
        """Whether it is a coordinate, along which other quantities run."""
        return self.dims == (self.name,)

    @property
    def is_text(self) -> bool:
        """Whether the values are texts."""
        return self.values.dtype.kind in "UO"


@dataclass(frozen=True, eq=False)
class Results:
    """The results of a study in memory.

    Attributes:
        path: Their file, if they have one.
        attributes: Attributes of the file.
        quantities: Its arrays by name; one that is its own only dimension is a coordinate.
    """

    path: Path
    attributes: Mapping[str, object]
    quantities: Mapping[str, Quantity]

    def __repr__(self) -> str:
        sizes = (f"{name} ({len(each.values)})" for name, each in self.quantities.items() if each.dims == (name,))
        kind = self.attributes.get("kind", "study")
        return f"<Results of a {kind}: {len(self.quantities)} quantities over {', '.join(sizes)}>"

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.quantities:
            raise LogError(f"{self.path}: found no {name}, expected results as psmpc writes them")
        return self.quantities[name].values

    def create(self, force: bool = False, lock: FileLock | None = None) -> None:
        """Write a new file, locked if a lock of its path is given.

        Raises:
            InputError: The file exists already or cannot be written; with `force`, it exists and is no HDF5 file.
        """
        write_new(self.path, new_image(self._write), force, replace=None if lock is None else lock.replace)

    def save(self, lock: FileLock) -> None:
        """Write the whole file in the place of the one before, of which the lock is held.

        Raises:
            RunError: The file cannot be written.
        """
        try:
            lock.replace(new_image(self._write))
        except OSError as error:
            raise RunError(f"{self.path} cannot be written any further: {error.strerror or error}") from None

    def _write(self, file: h5py.File) -> None:
        """Write attributes and quantities into an empty HDF5 file, those that are dimensions of others first.

        The others are tied to these by HDF5's dimension scales, so that other programs know what runs along each axis.

        Args:
            file: The file, open for writing.
        """
        file.attrs.update(self.attributes)
        datasets = dict[str, h5py.Dataset]()
        for quantity in sorted(self.quantities.values(), key=lambda quantity: not quantity.is_dimension):
            values = quantity.values
            if quantity.is_text:
                values = np.array(values.tolist(), h5py.string_dtype())
            # HDF5 has no checksums of texts of variable length, nor of single numbers
            chunks = values.shape if values.size and values.shape and not values.dtype.hasobject else None
            dataset = file.create_dataset(quantity.name, data=values, chunks=chunks, fletcher32=chunks is not None)
            datasets[quantity.name] = dataset
            dataset.attrs.update(
                {"units": quantity.units, "long_name": quantity.long_name, "dims": " ".join(quantity.dims)}
            )
            if quantity.meanings:  # the values are codes; the names of these attributes are those of the CF conventions
                codes = {"flag_values": np.arange(len(quantity.meanings)), "flag_meanings": " ".join(quantity.meanings)}
                dataset.attrs.update(codes)
            if quantity.is_dimension:
                dataset.make_scale(quantity.name)
                continue
            for dimension, name in zip(dataset.dims, quantity.dims, strict=True):
                dimension.attach_scale(datasets[name])


def new_results(
    path: Path, kind: str, attributes: Mapping[str, str | int | float], quantities: Iterable[Quantity]
) -> Results:
    """Build the results of a study, which are in no file yet."""
    about = {"kind": kind, "psmpc_version": __version__, "format_version": FORMAT_VERSION}
    return Results(path, {**about, **attributes}, {each.name: each for each in quantities})


def read_results(path: Path, kind: str) -> Results:
    """Read the results of a study, such as a sweep, from its file, and check that they are complete and consistent.

    Args:
        path: The file.
        kind: Which kind of study is expected.

    Returns:
        The results, in memory.

    Raises:
        LogError: The file is missing, damaged, of another version, or of another kind; a dataset is not as long as its
            dimensions, or has a code without a meaning.
    """

    def read_open(file: h5py.File) -> Results:
        """Read every dataset of the open file as a quantity along named dimensions.

        The names of its dimensions are in the attribute `dims`. A dimension is a dataset that runs along itself alone,
        and its length is that of the dimension. Values with `flag_meanings` are codes: 0 for the first meaning.

        Raises:
            LogError: A dataset is not as long as its dimensions, or has a code without a meaning.
        """
        quantities = dict[str, Quantity]()
        datasets = dict(file.items())
        attributes = {name: read_attributes(dataset) for name, dataset in datasets.items()}
        dims_of = {name: tuple(str(of_dataset.get("dims", "")).split()) for name, of_dataset in attributes.items()}
        for name, dataset in datasets.items():
            # 0, which no dataset may have, for a dimension that is none
            lengths = tuple(datasets[dim].size if dims_of.get(dim) == (dim,) else 0 for dim in dims_of[name])
            if not isinstance(dataset, h5py.Dataset) or dataset.shape != lengths or 0 in lengths:
                expected = f"a dataset along {dims_of[name]} of shape {lengths}, none 0"
                raise unexpected_item(dataset, str(dataset), expected)
            meanings = tuple(str(attributes[name].get("flag_meanings", "")).split())
            values = read_array(dataset)
            quantities[name] = Quantity(
                name=name,
                dims=dims_of[name],
                values=values,
                units=str(attributes[name].get("units", "")),
                long_name=str(attributes[name].get("long_name", "")),
                meanings=meanings,
            )
            if meanings and not np.isin(values, np.arange(len(meanings))).all():
                raise unexpected_item(dataset, "a code without a meaning", f"numbers of {' '.join(meanings)}")
        return Results(path, read_attributes(file), quantities)

    return read_file(path, read_open, f"a {kind} written by psmpc", kind)
