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
        what: What differs, if it is not the numbers alone.
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
    """Compare every dataset of two runs but the wall times; of a log that was cut short, the rows that it has."""
    columns = [
        column
        for path, column in sorted(COLUMNS.items())
        if (path in log or path in again) and not path.endswith("wall_time")
        if column.value is not None or not log.interrupted
    ]
    found = (_difference(column, log, again) for column in columns)
    return Comparison(len(columns), tuple(each for each in found if each is not None))


def _difference(column: Column, log: Run, again: Run) -> Difference | None:
    path = column.path
    units = column.units
    what = ""
    if path not in log or path not in again:
        return Difference(path, units, f"only the {'log' if path in log else 'run'} has it")
    a = log[path]
    b = again[path]
    if log.interrupted:
        b = b[tuple(map(slice, a.shape))]
    if a.shape != b.shape:
        what = "shapes " + " and ".join("x".join(map(str, each.shape)) for each in (a, b))
        common = tuple(map(slice, np.minimum(a.shape, b.shape)))
        a = a[common]
        b = b[common]
    numbers = a.dtype.kind in "fiu"
    same = np.isclose(a, b, 0, 0, equal_nan=True) if numbers else a == b
    if np.all(same):
        return Difference(path, units, what) if what else None
    row = int(np.argwhere(~np.atleast_1d(same))[0, 0])
    apart = np.abs(a.astype(float) - b.astype(float))[~same] if numbers else np.array([np.nan])
    if not np.isfinite(apart).all():
        what = what or ("values only one of them has" if numbers else "texts")
    return Difference(path, units, what, float(np.nanmax(apart, initial=0.0)) if numbers else np.nan, row)
