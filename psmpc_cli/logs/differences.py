"""Two logs compared dataset by dataset."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli.logs.read import opened

WALL_TIME = "wall_time"
"""Last part of the name of what no two runs have alike."""


@dataclass(frozen=True)
class Difference:
    """How far a dataset of two logs differs.

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
    """What came of comparing two logs.

    Attributes:
        compared: Number of datasets that were compared.
        differences: Those that differ.
    """

    compared: int
    differences: tuple[Difference, ...]


def compare_logs(one: Path, other: Path, rows: int | None = None, without: tuple[str, ...] = ()) -> Comparison:
    """Compare every dataset of two logs but the wall times.

    Args:
        one: A log, maybe cut short.
        other: Another.
        rows: Number of samples that are compared; by default all.
        without: What the paths of further datasets that are left out begin with.

    Raises:
        LogError: One of them cannot be read.
    """
    with opened(one) as first, opened(other) as second:
        mine, others = dict(_datasets(first)), dict(_datasets(second))
        left_out = (WALL_TIME,) if rows is None else (WALL_TIME, "_element")
        wanted = [path for path in mine | others if not path.endswith(left_out) and not path.startswith(without)]
        found = [_difference(path, mine, others, _length(path, mine, rows)) for path in sorted(wanted)]
    return Comparison(len(found), tuple(each for each in found if each is not None))


def _datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Give every dataset of a log by its path."""
    datasets: dict[str, h5py.Dataset] = {}
    file.visititems(lambda name, item: datasets.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    yield from datasets.items()


def _length(path: str, datasets: Mapping[str, h5py.Dataset], rows: int | None) -> int | None:
    """Return how many rows of a dataset belong to so many samples; None for all it has."""
    dataset = datasets.get(path)
    if rows is None or dataset is None or dataset.maxshape[:1] != (None,):
        return None
    if path.startswith("ticks/"):
        return rows * round(len(dataset) / max(len(datasets["time"]), 1))
    return None if path.endswith("_element") else rows


def _difference(
    path: str, one: Mapping[str, h5py.Dataset], other: Mapping[str, h5py.Dataset], rows: int | None
) -> Difference | None:
    if path not in one or path not in other:
        return Difference(path, np.nan, -1, "", f"only the {'run' if path in other else 'log'} has it")
    a, b = (np.asarray(each[path][() if rows is None else slice(rows)]) for each in (one, other))
    if rows is not None and a.ndim == b.ndim == 2:  # rows of vectors are as wide as the longest of the whole run
        a, b = (values[:, : min(a.shape[1], b.shape[1])] for values in (a, b))
    units = str(one[path].attrs.get("units", ""))
    if a.shape != b.shape:
        shapes = " and ".join("x".join(map(str, each.shape)) for each in (a, b))
        what, common = f"shapes {shapes}", tuple(map(slice, np.minimum(a.shape, b.shape)))
        a, b = a[common], b[common]
    else:
        what = ""
    return _of_values(path, a, b, units, what)


def _of_values(path: str, a: np.ndarray, b: np.ndarray, units: str, what: str) -> Difference | None:
    numbers = a.dtype.kind in "fiub"
    same = (a == b) | (np.isnan(a) & np.isnan(b)) if a.dtype.kind == "f" else a == b
    if np.all(same):
        return Difference(path, 0.0, -1, units, what) if what else None
    row = int(np.argwhere(~np.atleast_1d(same))[0, 0])
    apart = np.abs(a.astype(float) - b.astype(float))[~same] if numbers else np.zeros(0)
    if not numbers or not np.isfinite(apart).all():
        what = what or ("values only one of them has" if numbers else "texts")
    return Difference(path, float(np.nanmax(apart, initial=0.0)) if numbers else np.nan, row, units, what)
