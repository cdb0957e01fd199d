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
    differences = (_compare_dataset(column, log, again) for column in columns)
    return Comparison(len(columns), tuple(difference for difference in differences if difference is not None))


def _compare_dataset(column: Column, log: Run, new_run: Run) -> Difference | None:
    """Compare one dataset of a run with that of its repetition, to the last bit.

    Args:
        column: Path and units of the dataset.
        log: The run. If it was interrupted, only the rows that it has are compared.
        new_run: Its repetition.

    Returns:
        How they differ: only one run has the dataset, shapes differ, or values do. None if all values are equal.
    """
    path = column.path
    units = column.units
    shapes_differ = ""  # the words for it, if they do
    if not (path in log and path in new_run):
        return Difference(path, units, f"only the {'log' if path in log else 'run'} has it")
    log_values = log[path]
    new_values = new_run[path]
    if log.interrupted:
        rows_of_log = tuple(map(slice, log_values.shape))
        new_values = new_values[rows_of_log]
    if log_values.shape != new_values.shape:
        shapes = ("x".join(map(str, values.shape)) for values in (log_values, new_values))
        shapes_differ = "shapes " + " and ".join(shapes)
        common_part = tuple(map(slice, np.minimum(log_values.shape, new_values.shape)))
        log_values = log_values[common_part]
        new_values = new_values[common_part]
    are_numbers = log_values.dtype.kind in "fiu"  # float, signed and unsigned integer
    if are_numbers:
        is_same = np.isclose(log_values, new_values, rtol=0, atol=0, equal_nan=True)  # NaN counts as equal to NaN
    else:
        is_same = log_values == new_values
    if np.all(is_same):
        return Difference(path, units, shapes_differ) if shapes_differ else None
    first_row = int(np.argwhere(~np.atleast_1d(is_same))[0, 0])  # a single value is one of one row
    if not are_numbers:
        return Difference(path, units, shapes_differ or "texts", row=first_row)
    differences = np.abs(log_values.astype(float) - new_values.astype(float))[~is_same]
    description = shapes_differ
    if not np.isfinite(differences).all():
        description = shapes_differ or "values only one of them has"
    largest_difference = float(np.nanmax(differences, initial=0.0))  # initial: all of them may be NaN
    return Difference(path, units, description, largest_difference, first_row)
