"""A whole run in memory, from its log or straight from a simulation."""

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import h5py
import numpy as np

from psmpc_cli.errors import InputError, LogError, SpecError
from psmpc_cli.logs.files import copy_group, image_of, kind_in, read_file, write_new
from psmpc_cli.logs.schema import COMPARISON, RUN, SCHEMA, Column, columns
from psmpc_cli.logs.summary import Summary, summarize
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.load import Task, parse_task

if TYPE_CHECKING:
    import xarray

T = TypeVar("T")

Array = np.ndarray

IN_MEMORY = Path("a run in memory")
"""Path of a run without a file."""

EXPECTED = "expected a log written by psmpc simulate"

ATTRIBUTES = ("finished", "end_reason", "stuck", "controller", "task_name", "task_yaml", "robot_yaml")
"""Attributes that every log has."""


@dataclass(frozen=True)
class Span:
    """The time in which a stage was the current one [s].

    Attributes:
        index, name: The stage.
        start, end: First and last instant; the end of the run for a stage that the run did not end.
        early: Its actual start if that lies before `start`, else None.
    """

    index: int
    name: str
    start: float
    end: float
    early: float | None


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a run at its samples and, if the run ended, at its end: N times.

    Attributes:
        time: Times (N,) [s].
        Q: Coordinates (N, n) [m, rad].
        v: Velocities (N, n) [m/s, rad/s].
        xi: Poses of base and end-effectors (N, m) [m, rad].
        Q_seen, v_seen: The state that the controller saw (N, n): measured, or predicted over a known delay.
    """

    time: Array
    Q: Array
    v: Array
    xi: Array
    Q_seen: Array
    v_seen: Array

    @property
    def end(self) -> float:
        """Last time [s]."""
        return float(self.time[-1])

    def poses_at(self, time: Array) -> Array:
        """Interpolate the poses (K, m) [m, rad] at times (K,) [s]."""
        return np.column_stack([np.interp(time, self.time, row) for row in self.xi.T])

    def coordinates_at(self, time: float) -> Array:
        """Interpolate the coordinates (n,) [m, rad] at a time [s]."""
        return np.array([np.interp(time, self.time, row) for row in self.Q.T])


@dataclass(frozen=True, eq=False)
class Run:
    """A whole run in memory, with K samples, n coordinates, m pose coordinates and S stages.

    `run["window/instants"]` is the array of a dataset of the log, any but the plans; docs/log.md lists them.

    Attributes:
        path: The file, or `IN_MEMORY`.
        attributes: Versions, effective texts of task and robot, `finished`, `end_reason`, ...
        arrays: Every dataset but the plans, by its path.
        group: Group of the file that holds the run.
        has_plans: Whether the run has plans, see `plan`.
        image: The log of a run in memory, as bytes.
    """

    path: Path
    attributes: Mapping[str, Any]
    arrays: Mapping[str, Array]
    group: str = "/"
    has_plans: bool = False
    image: bytes = b""

    def __getitem__(self, path: str) -> Array:
        return self.arrays[path]

    def __contains__(self, path: str) -> bool:
        return path in self.arrays

    @property
    def columns(self) -> dict[str, Array]:
        """The datasets with one row for each sample, by path; `time` is one of them."""
        return {"time": self.time, **{column.path: self[column.path] for column in self._sampled}}

    @property
    def time(self) -> Array:
        """Times of the samples (K,) [s]."""
        return self["time"]

    @property
    def Q(self) -> Array:
        """True coordinates at the samples (K, n) [m, rad]."""
        return self.arrays.get("state/Q_true", self["state/Q"])

    @property
    def v(self) -> Array:
        """True velocities at the samples (K, n) [m/s, rad/s]."""
        return self.arrays.get("state/Qdot_true", self["state/Qdot"])

    @property
    def Q_seen(self) -> Array:
        """Coordinates as the controller saw them (K, n) [m, rad]: measured, or predicted over a known delay."""
        return self["state/Q"]

    @property
    def v_seen(self) -> Array:
        """Velocities as the controller saw them (K, n) [m/s, rad/s]."""
        return self["state/Qdot"]

    @property
    def u(self) -> Array:
        """Acceleration over the first tick of each sample (K, n) [m/s^2, rad/s^2]."""
        return self["control/u"]

    @property
    def F(self) -> Array:
        """Generalized force at the samples (K, n) [N, N m]."""
        return self["force/F"]

    @property
    def xi(self) -> Array:
        """Poses of base and end-effectors at the samples (K, m) [m, rad]."""
        return self["pose/xi"]

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the n coordinates."""
        return tuple(self["coordinate"].tolist())

    @property
    def pose_coordinates(self) -> tuple[str, ...]:
        """Names of the m pose coordinates."""
        return tuple(self["pose_coordinate"].tolist())

    @property
    def stage_names(self) -> tuple[str, ...]:
        """Names of the S stages."""
        return tuple(self["stages/name"].tolist())

    @property
    def stages(self) -> dict[str, Array]:
        """Table of the stages: name, priority, switch_time [s], actual_start [s] and early (S,).

        Also epsilon (E,), and actual_start_by_epsilon (S, E) [s]. A time is NaN if it never came.
        """
        return self._below("stages")

    @property
    def monitors(self) -> dict[str, Array]:
        """Table of the monitors: name, held (-1 if unknown), margin [m, m/s]."""
        return self._below("monitors")

    @property
    def ticks(self) -> dict[str, Array]:
        """Low-level ticks: time (M,) [s], Q, v, F (M, n); empty unless the task logs them."""
        return {"v" if name == "Qdot" else name: values for name, values in self._below("ticks").items()}

    @property
    def uncertainty(self) -> dict[str, Array]:
        """What was drawn: body, axis, mass_factor, inertia_factor, centre_of_mass; empty without an uncertainty."""
        return self._below("uncertainty")

    @property
    def final(self) -> dict[str, Array]:
        """State at the end of the run: time [s], Q, v, xi, Q_seen and v_seen; NaN if the run did not end."""
        return {
            "time": self["final/end_time"],
            "Q": self.arrays.get("final/Q_true", self["final/Q"]),
            "v": self.arrays.get("final/Qdot_true", self["final/Qdot"]),
            "xi": self["final/xi"],
            "Q_seen": self["final/Q"],
            "v_seen": self["final/Qdot"],
        }

    @property
    def interrupted(self) -> bool:
        """Whether the run was stopped from outside, or still runs."""
        return not np.isfinite(self["final/end_time"])

    @cached_property
    def task(self) -> Task:
        """The task as it ran.

        Raises:
            LogError: The texts in the log are not a task and a robot of this version, or not those of this run.
        """
        task_yaml, robot_yaml, name = (str(self.attributes[key]) for key in ("task_yaml", "robot_yaml", "task_name"))
        try:
            task = parse_task(task_yaml, robot_yaml, name)
        except SpecError as error:
            raise LogError(f"{self.path}: the task or robot in it is not valid in this version:\n{error}") from None
        described = labels(task.robot, "joint"), tuple(stage.name for stage in task.spec.stages)
        if described != (self.coordinates, self.stage_names):
            raise LogError(f"{self.path}: the task and robot in it do not describe the run it holds")
        return task

    @cached_property
    def problem(self) -> Problem:
        """The computable problem of the task.

        Raises:
            LogError: As for `task`.
        """
        return build_problem(self.task)

    @cached_property
    def motion(self) -> Motion:
        """The motion at the samples and at the end of the run.

        Raises:
            LogError: The run has no samples.
        """
        if not len(self.time):
            raise LogError(f"{self.path}: found no samples, expected at least one: the run ended before its first one")
        final = self.final
        rows = {name: getattr(self, name) for name in final}
        if final["time"] > self.time[-1]:
            rows = {name: np.concatenate([values, final[name][None]]) for name, values in rows.items()}
        return Motion(**rows)

    @cached_property
    def spans(self) -> tuple[Span, ...]:
        """The stages that were reached, in order; a stage that only started early has `start` at the end of the run.

        Raises:
            LogError: The run has no samples.
        """
        spans: list[Span] = []
        end, start, stages = self.motion.end, float(self.time[0]), self.stages
        for index, name in enumerate(self.stage_names):
            actual, switch = (float(stages[key][index]) for key in ("actual_start", "switch_time"))
            early = actual if index and stages["early"][index] and actual < start else None
            if spans and start >= end and early is None:
                break
            spans.append(Span(index, name, start, switch if np.isfinite(switch) else end, early))
            start = spans[-1].end
        return tuple(spans)

    def summary(self) -> Summary:
        """Summarize the run.

        Raises:
            LogError: As for `task`.
        """
        return summarize(self.arrays, self.attributes, self.problem)

    def plan(self, name: str, sample: int) -> Array:
        """Return one vector of a sample's solve: guess, guess_multipliers, parameters or solution.

        Raises:
            LogError: The run has no plans, or not this sample's, or its file cannot be read any more.
        """
        if not self.has_plans:
            raise LogError(f"{self.path}: found no plans, expected the log of a task with log: {{plans: true}}")
        if not 0 <= sample < len(self.time):
            choices = f"one from 0 to {len(self.time) - 1}" if len(self.time) else "none: the log holds no samples"
            raise LogError(f"{self.path}: found no sample {sample}, expected {choices}")
        return self.plans[f"plan/{name}"][sample, : self.plans[f"plan/{name}_length"][sample]]

    @cached_property
    def plans(self) -> dict[str, Array]:
        """The datasets below /plan by path, read when they are first used; empty without plans.

        Raises:
            LogError: The file cannot be read any more.
        """
        paths = [f"{column.path}{part}" for column in SCHEMA if column.ragged for part in ("", "_length")]
        if not self.has_plans:
            return {}
        return self._read(lambda group: {path: np.asarray(group[path][: len(self.time)]) for path in paths})

    def save(self, path: Path | str, force: bool = False) -> None:
        """Write the run into a log of its own.

        Raises:
            InputError: The path is taken (with `force`, by a file that psmpc did not write), or cannot be written.
            LogError: The file of the run cannot be read any more.
        """
        write_new(Path(path), self.image or image_of(lambda file: self.copy_into(file)), force)

    def copy_into(self, target: h5py.Group) -> None:
        """Copy the log of the run into a group of an open file.

        Raises:
            LogError: The file of the run cannot be read any more.
        """
        self._read(lambda group: copy_group(group, target))

    def to_csv(self, directory: Path | str, force: bool = False) -> list[Path]:
        """Write samples.csv and stages.csv, and ticks.csv if ticks were logged, and return their paths.

        Raises:
            InputError: A file exists already, or the directory cannot be written.
        """
        directory = Path(directory)
        tables = {"samples.csv": self._samples_table(), "stages.csv": self._stages_table()}
        if self.ticks:
            tables["ticks.csv"] = self._ticks_table()
        paths = [directory / name for name in tables]
        if not force and (present := [str(path) for path in paths if path.exists()]):
            raise InputError(
                f"{', '.join(present)} exists already: choose another directory, or overwrite with --force"
            )
        try:
            directory.mkdir(parents=True, exist_ok=True)
            for path, table in zip(paths, map(dict, tables.values()), strict=True):
                with path.open("w", newline="", encoding="utf-8") as file:
                    csv.writer(file).writerows([table, *zip(*table.values(), strict=True)])
        except (FileExistsError, NotADirectoryError):
            raise InputError(f"{directory} cannot be written: it is no directory") from None
        except OSError as error:
            raise InputError(f"{directory} cannot be written: {error.strerror}") from None
        return paths

    def to_xarray(self) -> "xarray.Dataset":
        """Convert all datasets with a row for each sample to an xarray.Dataset with named dimensions.

        Raises:
            InputError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise InputError("found no xarray, which Run.to_xarray needs: pip install xarray") from None
        about = {column: {"units": column.units, "long_name": column.long_name} for column in self._sampled}
        variables = {column.path: (column.dims, self[column.path], about[column]) for column in self._sampled}
        names = {dim: self[dim] for column in self._sampled for dim in column.dims}
        return xarray.Dataset(variables, names, dict(self.attributes))

    @property
    def _sampled(self) -> tuple[Column, ...]:
        """The columns of the samples, without the scale `time`."""
        return tuple(column for column in columns("time") if column.path in self.arrays)

    def _below(self, group: str) -> dict[str, Array]:
        paths = [path for path in self.arrays if path.startswith(f"{group}/")]
        return {path.removeprefix(f"{group}/"): self.arrays[path] for path in paths}

    def _read(self, read: Callable[[h5py.Group], T]) -> T:
        """Read from the group of the run's file or image."""
        if self.image:
            with h5py.File(io.BytesIO(self.image), "r") as file:
                return read(file)
        return read_file(self.path, lambda file: read(file[self.group]))

    def _samples_table(self) -> Iterator[tuple[str, Array]]:
        yield "time [s]", self.time
        for column in self._sampled:
            if len(column.dims) == 1:
                yield column.path if column.units == "1" else f"{column.path} [{column.units}]", self[column.path]
            else:
                yield from _named(column.path, self[column.dims[1]], self[column.path])

    def _stages_table(self) -> Iterator[tuple[str, Array]]:
        stages = self.stages
        for name in ("name", "priority", "switch_time", "actual_start", "early"):
            yield name, stages[name]
        epsilons = [f"{epsilon:g}" for epsilon in stages["epsilon"]]
        yield from _named("actual_start", epsilons, stages["actual_start_by_epsilon"])

    def _ticks_table(self) -> Iterator[tuple[str, Array]]:
        yield "time [s]", self["ticks/time"]
        for quantity in ("Q", "Qdot", "F"):
            yield from _named(quantity, self.coordinates, self[f"ticks/{quantity}"])


def _named(name: str, labels: Iterable[str], values: Array) -> Iterator[tuple[str, Array]]:
    """Yield the columns of values (K, labels) with a name each."""
    return ((f"{name}/{label}", column) for label, column in zip(labels, values.T, strict=True))


def read_run(path: Path | str) -> Run:
    """Read the log of a run, finished or cut short by a kill.

    Raises:
        LogError: The file is missing, damaged, of another program or version, or not the log of one run.
    """
    path = Path(path)

    def read(file: h5py.File) -> Run:
        if (kind := kind_in(file)) != RUN:
            raise LogError(f"{path}: found a {kind} of several runs, expected the log of one")
        return run_in(file, path)

    return read_file(path, read)


def read_comparison(path: Path) -> dict[str, Run]:
    """Read the runs of a comparison by name, in the order in which they were compared.

    Raises:
        LogError: As for `read_run`; or the file is no comparison.
    """

    def read(file: h5py.File) -> dict[str, Run]:
        if (kind := kind_in(file)) != COMPARISON:
            found = "the log of one run" if kind == RUN else f"a {kind}"
            raise LogError(f"{path}: found {found}, expected a comparison written by psmpc compare")
        return {str(name): run_in(file[f"runs/{name}"], path) for name in file.attrs["runs"]}

    return read_file(path, read)


def run_in(group: h5py.Group, path: Path = IN_MEMORY) -> Run:
    """Read the run in a group of an open file; without a path that of a file in memory.

    Raises:
        LogError: It lacks an attribute.
        Exception: One of `files.DAMAGE`: it is damaged.
    """
    for name in ATTRIBUTES:
        if name not in group.attrs:
            raise LogError(f"{path}: found no attribute {name}, {EXPECTED}")
    image = b""
    if path == IN_MEMORY:
        group.file.flush()
        image = group.file.id.get_file_image()
    return Run(path, dict(group.attrs), arrays_in(group), group.name, "plan/solution" in group, image)


def arrays_in(group: h5py.Group) -> dict[str, Array]:
    """Read the datasets of the run in a group of an open file, all but the plans, by path.

    Raises:
        Exception: One of `files.DAMAGE`: it is damaged.
    """
    present = [c for c in SCHEMA if not c.ragged and (not c.only or c.path in group)]
    arrays = {c.path: _array(group[c.path]) for c in present if c.value is None}
    for along in ("time", "ticks/tick"):
        arrays |= _rows(group, [c.path for c in present if c.value is not None and c.dims[0] == along])
    for column in present:
        if arrays[column.path].shape != tuple(len(arrays[dim]) for dim in column.dims):
            raise ValueError(f"{column.path} has shape {arrays[column.path].shape}")
    if not (np.diff(arrays["time"]) > 0).all():
        raise ValueError("time does not rise")
    return arrays


def _rows(group: h5py.Group, paths: list[str]) -> dict[str, Array]:
    """Read datasets along one time, as many rows as all of them have: a kill may leave the last one half written."""
    if not paths:
        return {}
    rows = min(len(group[path]) for path in paths)
    try:
        return {path: _array(group[path])[:rows] for path in paths}
    except OSError:
        if group.attrs["end_reason"]:
            raise
    # killed at the moment in which space was allocated for this row and the following ones
    chunk = group[paths[0]].chunks[0]
    return {path: _array(group[path], (rows - 1) // chunk * chunk) for path in paths}


def _array(dataset: h5py.Dataset, rows: int | None = None) -> Array:
    """Read a dataset, or its first rows, text as text."""
    part = () if rows is None else slice(rows)
    if h5py.check_string_dtype(dataset.dtype) is None:
        return np.asarray(dataset[part])
    return np.asarray(dataset.asstr()[part], dtype=str)
