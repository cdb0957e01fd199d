"""Several runs: one file with all of them, each below /runs in a group laid out as a log; differences of two runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli import __version__
from psmpc_cli.logs.files import new_image, write_new
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import COMPARISON, FORMAT_VERSION, SCHEMA

ALONG_TIME = {part.path for column in SCHEMA for part in column.parts if part.dims[:1] == ("time",)}
"""Datasets with a row a sample."""


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
        largest: Largest difference of two numbers; NaN where none can be compared.
        row: Row of the first difference; -1 where there is none.
        units: Of the numbers.
        what: What differs, if it is not the numbers alone.
    """

    path: str
    largest: float
    row: int
    units: str
    what: str = ""


@dataclass(frozen=True)
class Comparison:
    """The result of comparing two runs: how many datasets were compared, and those that differ."""

    compared: int
    differences: tuple[Difference, ...]


def compare_logs(one: Path, other: Path, rows: int | None = None, without: tuple[str, ...] = ()) -> Comparison:
    """Compare every dataset of two logs but the wall times.

    Args:
        one: A log, maybe cut short.
        other: Another.
        rows: Number of samples that are compared; by default all.
        without: Beginnings of the paths of further datasets that are left out.

    Raises:
        LogError: One of them cannot be read.
    """
    runs = [read_run(one), read_run(other)]
    mine, others = (run.arrays for run in runs)
    wanted = [path for path in sorted({*mine, *others}) if not (path.endswith("wall_time") or path.startswith(without))]
    found = [_difference(path, mine, others, _length(path, runs[0], rows)) for path in wanted]
    return Comparison(len(found), tuple(each for each in found if each is not None))


def _length(path: str, run: Run, rows: int | None) -> int | None:
    """Return how many rows of a dataset belong to so many samples; None for all it has."""
    if rows is not None and path.startswith("ticks/"):
        return rows * round(len(run["ticks/time"]) / max(len(run.time), 1))
    return rows if path in ALONG_TIME else None


def _difference(
    path: str, one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray], rows: int | None
) -> Difference | None:
    if path not in one or path not in other:
        return Difference(path, np.nan, -1, "", f"only the {'run' if path in other else 'log'} has it")
    a, b = (each[path] if rows is None else each[path][:rows] for each in (one, other))
    if rows is not None and a.ndim == b.ndim == 2:  # rows of vectors are as wide as the longest of the whole run
        a, b = (values[:, : min(a.shape[1], b.shape[1])] for values in (a, b))
    units, what = next((column.units for column in SCHEMA if column.path == path), "1"), ""
    if a.shape != b.shape:
        shapes = " and ".join("x".join(map(str, each.shape)) for each in (a, b))
        what, common = f"shapes {shapes}", tuple(map(slice, np.minimum(a.shape, b.shape)))
        a, b = a[common], b[common]
    numbers = a.dtype.kind in "fiub"
    same = (a == b) | (np.isnan(a) & np.isnan(b)) if a.dtype.kind == "f" else a == b
    if np.all(same):
        return Difference(path, 0.0, -1, units, what) if what else None
    row = int(np.argwhere(~np.atleast_1d(same))[0, 0])
    apart = np.abs(a.astype(float) - b.astype(float))[~same] if numbers else np.zeros(0)
    if not numbers or not np.isfinite(apart).all():
        what = what or ("values only one of them has" if numbers else "texts")
    return Difference(path, float(np.nanmax(apart, initial=0.0)) if numbers else np.nan, row, units, what)
