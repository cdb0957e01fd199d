"""Reads a log back, whole or cut short by a kill."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli.errors import LogError
from psmpc_cli.logs.guard import ensure_readable
from psmpc_cli.logs.schema import FORMAT_VERSION, RUN, SCHEMA, columns
from psmpc_cli.logs.sound import ensure_sound
from psmpc_cli.logs.structure import RefusedError, damaged
from psmpc_cli.specs.messages import shortened

EXPECTED = "expected a log written by psmpc simulate"

ATTRIBUTES = ("finished", "end_reason", "controller", "task_name", "task_yaml", "robot_yaml")
"""What a log cannot be understood without."""

DAMAGE = (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError, MemoryError)
"""What h5py and NumPy raise over a file that is not what it says."""


@dataclass(frozen=True, eq=False)
class Log:
    """A log in memory; arrays by their path in the file.

    Attributes:
        path: The file.
        attributes: The file's attributes (versions, effective YAML texts, `finished`, `end_reason`, ...).
        columns: Every dataset with a row a sample, /time included, by path; an older log may lack some.
        stages: Datasets below /stages: name, priority, switch_time, actual_start, early, epsilon, ...
        coordinates, pose_coordinates: Names of the rows of Q and xi.
        final: time, Q, Qdot and xi at the end of the run; NaN in a run that was killed or interrupted. With noise Q and
            Qdot are what the controller saw, Q_true and Qdot_true stand beside them.
        monitors: name, held (-1 in a run that was killed), margin.
        ticks: time, Q, Qdot and F at every tick, empty where none were logged.
        plans: Whether /plan was logged.
        uncertainty: body, mass_factor, inertia_factor, centre_of_mass as drawn; empty without an uncertainty.
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
    uncertainty: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __getitem__(self, path: str) -> np.ndarray:
        return self.columns[path]

    @property
    def time(self) -> np.ndarray:
        """Sample times (K,) [s]."""
        return self.columns["time"]

    @property
    def interrupted(self) -> bool:
        """Whether the run was stopped from outside, or goes on."""
        return not np.isfinite(self.final["time"])

    @property
    def stage_names(self) -> tuple[str, ...]:
        """Names of the stages."""
        return tuple(str(name) for name in self.stages["name"])


def read_log(path: Path) -> Log:
    """Return a log of this version.

    Raises:
        LogError: The file is missing, no HDF5 file, cut off, of another program or of another version.
    """
    with opened(path) as file:
        if kind_in(file) != RUN:
            raise LogError(f"{path}: found a {kind_in(file)} of several runs, expected the log of one")
        return log_in(path, file)


def kind_of(path: Path) -> str:
    """Return what a file of this version holds, RUN or COMPARISON.

    Raises:
        LogError: As for `read_log`.
    """
    with opened(path) as file:
        return kind_in(file)


def kind_in(file: h5py.File) -> str:
    """Return what an open file holds; one that does not say is a run."""
    return str(file.attrs.get("kind", RUN))


def read_plan(path: Path, name: str, sample: int) -> np.ndarray:
    """Return one sample's vector of a dataset below /plan, such as `solution`.

    Raises:
        LogError: As for `read_log`; or the log holds no plans, or not this sample's.
    """
    with opened(path) as file:
        if f"plan/{name}" not in file:
            raise LogError(f"{path}: holds no plans; expected a log of a task with log: {{plans: true}}")
        lengths, held = file[f"plan/{name}_length"], len(file["time"])
        if not 0 <= sample < held:
            choices = f"expected one from 0 to {held - 1}" if held else "it holds none"
            raise LogError(f"{path}: found no sample {sample}; {choices}")
        return np.asarray(file[f"plan/{name}"][sample, : lengths[sample]])


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open a file of this version to read, while it is written too; whatever is wrong with it is a LogError."""
    try:
        if path.is_dir():
            raise LogError(f"{path}: found a directory, {EXPECTED}")
        if not path.exists():
            raise LogError(f"{path}: found no such file, {EXPECTED}")
        if not path.is_file():
            raise LogError(f"{path}: found no regular file, {EXPECTED}")
        if not path.stat().st_size:
            raise LogError(f"{path}: found an empty file, {EXPECTED}")
        with path.open("rb"):
            pass
    except OSError as error:
        raise LogError(f"{path}: found no readable file ({error.strerror or error}), {EXPECTED}") from None
    if not h5py.is_hdf5(path):
        raise LogError(f"{path}: found no HDF5 file, {EXPECTED}")
    try:
        ensure_readable(path)
        with h5py.File(path, "r", locking=False) as file:
            _check(path, file)
            yield file
    except RefusedError as refused:
        raise LogError(f"{path}: found {refused}, {EXPECTED}") from None
    except DAMAGE as error:
        raise LogError(f"{path}: found {damaged(error)}, {EXPECTED}") from None


def _check(path: Path, file: h5py.File) -> None:
    """Refuse what is no log of this version."""
    if "format_version" not in file.attrs or "psmpc_version" not in file.attrs:
        raise LogError(f"{path}: found an HDF5 file of another program, {EXPECTED}")
    found = file.attrs["format_version"]
    if found != FORMAT_VERSION:
        version, writer = (shortened(ascii(str(value))[1:-1]) for value in (found, file.attrs["psmpc_version"]))
        raise LogError(
            f"{path}: found log format {version}, written by psmpc {writer}; this version reads "
            f"format {FORMAT_VERSION}: read it with that version, or run the experiment again"
        )


def log_in(path: Path, file: h5py.Group) -> Log:
    """Return the log of a run that stands in a file, or in a group of it.

    Raises:
        LogError: It lacks an attribute.
    """
    for name in ATTRIBUTES:
        if name not in file.attrs:
            raise LogError(f"{path}: found no attribute {name}, {EXPECTED}")
    samples = _along(
        file, "time", *(c.path for c in columns("time") if not c.ragged and (c.path in file or not c.only))
    )
    has_ticks = "ticks/time" in file
    ticks = _along(file, *(column.path for column in columns("ticks/tick"))) if has_ticks else {}
    fixed = {c.path: _array(file[c.path]) for c in SCHEMA if c.value is None and (c.path in file or not c.only)}
    ensure_sound(file.attrs, {**fixed, **samples, **ticks})
    return Log(
        path=path,
        attributes=dict(file.attrs),
        columns=samples,
        stages=_below("stages", fixed),
        coordinates=tuple(str(name) for name in fixed["coordinate"]),
        pose_coordinates=tuple(str(name) for name in fixed["pose_coordinate"]),
        final={"time": fixed["final/end_time"], **_below("final", fixed)},
        monitors=_below("monitors", fixed),
        uncertainty=_below("uncertainty", fixed),
        ticks=_below("ticks", ticks),
        plans="plan/solution" in file,
    )


def _along(file: h5py.Group, *paths: str) -> dict[str, np.ndarray]:
    """Return datasets along one time, as many rows as all of them have: a kill may leave the last one half written."""
    datasets = {path: file[path] for path in paths}
    rows = min(len(dataset) for dataset in datasets.values())
    try:
        return {path: _array(dataset)[:rows] for path, dataset in datasets.items()}
    except OSError:
        if file.attrs["end_reason"]:
            raise
    # killed in the very moment in which space was set aside for this row and those to come
    rows = (rows - 1) // datasets[paths[0]].chunks[0] * datasets[paths[0]].chunks[0]
    return {path: _array(dataset, rows) for path, dataset in datasets.items()}


def _below(group: str, datasets: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {path.removeprefix(f"{group}/"): values for path, values in datasets.items() if path.startswith(f"{group}/")}


def _array(dataset: h5py.Dataset, rows: int | None = None) -> np.ndarray:
    """Return a dataset, or its first rows, in memory, text as text."""
    part = () if rows is None else slice(rows)
    if h5py.check_string_dtype(dataset.dtype) is None:
        return np.asarray(dataset[part])
    return np.asarray(dataset.asstr()[part], dtype=str)
