"""Reads a log back."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.layout import COLUMNS, FORMAT_VERSION, PLANS, TICKS


@dataclass(frozen=True, eq=False)
class Log:
    """A log in memory; arrays by their path in the file.

    Attributes:
        path: The file.
        attributes: The file's attributes (versions, effective YAML texts, `finished`, `end_reason`, ...).
        columns: Every dataset with a row a sample, /time included, by path.
        stages: Datasets below /stages: name, priority, switch_time, actual_start, premature, epsilon, ...
        coordinates, pose_coordinates: Names of the rows of Q and xi.
        final: time, Q, Qdot and xi at the end of the run; NaN in a run that was killed.
        monitors: name, held, margin; empty in a run that was killed.
        ticks: Datasets below /ticks, empty where none were logged.
        plans: Whether /plan was logged.
    """

    path: Path
    attributes: Mapping[str, object]
    columns: Mapping[str, np.ndarray]
    stages: Mapping[str, np.ndarray]
    coordinates: tuple[str, ...]
    pose_coordinates: tuple[str, ...]
    final: Mapping[str, np.ndarray]
    monitors: Mapping[str, np.ndarray]
    ticks: Mapping[str, np.ndarray]
    plans: bool

    def __getitem__(self, path: str) -> np.ndarray:
        return self.columns[path]

    @property
    def time(self) -> np.ndarray:
        """Sample times (K,) [s]."""
        return self.columns["time"]

    @property
    def stage_names(self) -> tuple[str, ...]:
        """Names of the stages."""
        return tuple(str(name) for name in self.stages["name"])


def read_log(path: Path) -> Log:
    """Return a log of this version.

    Raises:
        LogError: The file is missing, no HDF5 file, cut off, of another program or of another version.
    """
    if not path.exists():
        raise LogError(f"{path}: no such file; expected a log written by psmpc simulate")
    if path.is_dir():
        raise LogError(f"{path}: is a directory; expected a log written by psmpc simulate")
    try:
        with h5py.File(path, "r") as file:
            _check(path, file)
            return _load(path, file)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise LogError(
            f"{path}: not readable as a log, it may be cut off or no HDF5 file ({_first_line(error)})"
        ) from None


def read_plan(path: Path, name: str, sample: int) -> np.ndarray:
    """Return one sample's vector of a dataset below /plan, such as `solution`."""
    with h5py.File(path, "r") as file:
        offset, values = file[f"plan/{name}_offset"], file[f"plan/{name}"]
        last = offset[sample + 1] if sample + 1 < len(offset) else len(values)
        return np.asarray(values[offset[sample] : last])


def _check(path: Path, file: h5py.File) -> None:
    if "format_version" not in file.attrs or "psmpc_version" not in file.attrs:
        raise LogError(f"{path}: an HDF5 file, but not a log of psmpc; expected one written by psmpc simulate")
    found = int(file.attrs["format_version"])
    if found != FORMAT_VERSION:
        raise LogError(
            f"{path}: log format {found}, written by psmpc {file.attrs['psmpc_version']}; this version reads format "
            f"{FORMAT_VERSION}: read it with that version, or run the experiment again"
        )


def _load(path: Path, file: h5py.File) -> Log:
    rows = min(len(file[column.path]) for column in COLUMNS)
    columns = {column.path: _array(file[column.path])[:rows] for column in COLUMNS}
    has_ticks = "ticks" in file
    return Log(
        path=path,
        attributes=dict(file.attrs),
        columns={"time": file["time"][:rows], **columns},
        stages={name: _array(dataset) for name, dataset in file["stages"].items()},
        coordinates=tuple(_array(file["coordinate"])),
        pose_coordinates=tuple(_array(file["pose_coordinate"])),
        final={name: _array(dataset) for name, dataset in file["final"].items()},
        monitors={name: _array(dataset) for name, dataset in file["monitors"].items()} if "monitors" in file else {},
        ticks={name: _array(file[f"ticks/{name}"]) for name in _tick_names()} if has_ticks else {},
        plans=PLANS[0][0] in file,
    )


def _tick_names() -> tuple[str, ...]:
    return ("time", *(column.path.removeprefix("ticks/") for column in TICKS))


def _array(dataset: h5py.Dataset) -> np.ndarray:
    values = np.asarray(dataset[()])
    return np.char.decode(values, "utf-8") if values.dtype.kind == "S" else values


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
