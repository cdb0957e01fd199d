"""Several runs: one file with all of them, each below /runs in a group laid out as a log; differences of two runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli import __version__
from psmpc_cli.logs.files import new_image, write_new
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import COMPARISON, FORMAT_VERSION, SCHEMA, Column

COLUMNS = {part.path: part for column in SCHEMA for part in column.parts}
"""What is known of each dataset, by its path."""


def save_comparison(runs: Mapping[str, Run], path: Path, force: bool = False) -> None:
    """Write runs by name into one file, whole or not at all.

    Raises:
        InputError: The file exists already or cannot be written.
    """

    def fill(file: h5py.File) -> None:
        file.attrs.update({"kind": COMPARISON, "psmpc_version": __version__, "format_version": FORMAT_VERSION})
        file.attrs["runs"] = list(runs)
        for name, run in runs.items():
            run.write_into(file.create_group(f"runs/{name}"))

    write_new(path, new_image(fill), force)


@dataclass(frozen=True)
class Difference:
    """A dataset in which two runs differ.

    Attributes:
        path: The dataset.
        units: Of its numbers.
        what: What differs, where it is more than the numbers.
        largest: Largest difference of two numbers; NaN where none can be compared.
        row: Row of the first difference; -1 where there is none.
    """

    path: str
    units: str
    what: str
    largest: float = np.nan
    row: int = -1


@dataclass(frozen=True)
class Comparison:
    """The result of comparing two runs: how many datasets were compared, and those that differ."""

    compared: int
    differences: tuple[Difference, ...]


def compare_runs(log: Run, again: Run) -> Comparison:
    """Compare every dataset of two runs but the wall times.

    Of a log that was cut short the rows are compared that it has.
    """
    columns = [
        column
        for path, column in sorted(COLUMNS.items())
        if (path in log or path in again) and not path.endswith("wall_time")
        if column.value is not None or not log.interrupted
    ]
    differences = (_difference(column, log, again) for column in columns)
    return Comparison(len(columns), tuple(each for each in differences if each is not None))


def _difference(column: Column, log: Run, again: Run) -> Difference | None:
    """Compare one dataset of two runs; None where it is equal to the bit."""
    path = column.path
    units = column.units
    what = ""
    if not (path in log and path in again):
        return Difference(path, units, f"only the {'log' if path in log else 'run'} has it")
    logged = log[path]
    repeated = again[path]
    if log.interrupted:
        repeated = repeated[tuple(map(slice, logged.shape))]
    if logged.shape != repeated.shape:
        what = "shapes " + " and ".join("x".join(map(str, each.shape)) for each in (logged, repeated))
        common = tuple(map(slice, np.minimum(logged.shape, repeated.shape)))
        logged = logged[common]
        repeated = repeated[common]
    are_numbers = logged.dtype.kind in "fiu"
    is_same = np.isclose(logged, repeated, 0, 0, equal_nan=True) if are_numbers else logged == repeated
    if np.all(is_same):
        return Difference(path, units, what) if what else None
    first_row = int(np.argwhere(~np.atleast_1d(is_same))[0, 0])
    if not are_numbers:
        return Difference(path, units, what or "texts", row=first_row)
    differences = np.abs(logged.astype(float) - repeated.astype(float))[~is_same]
    if not np.isfinite(differences).all():
        what = what or "values only one of them has"
    return Difference(path, units, what, float(np.nanmax(differences, initial=0.0)), first_row)
