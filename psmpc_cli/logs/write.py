"""Writes a log while the run goes on: readable at any time, complete up to a second before a kill."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import h5py
import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.layout import COLUMNS, FORMAT_VERSION, PLANS, TICKS, Column
from psmpc_cli.logs.record import Record, SolveRecord, TickRecord

FLUSH_INTERVAL = 0.5
"""Longest time between two flushes [s]."""


@dataclass(frozen=True)
class Header:
    """What a log says of the run before it begins.

    Attributes:
        attributes: Text and numbers kept as attributes of the file.
        coordinates, pose_coordinates, stages: Names along those dimensions.
        priorities: omega of each stage.
        epsilons: Thresholds of the actual start.
        ticks, plans: Whether ticks and plans are logged.
    """

    attributes: Mapping[str, str | int | float | bool]
    coordinates: tuple[str, ...]
    pose_coordinates: tuple[str, ...]
    stages: tuple[str, ...]
    priorities: tuple[float, ...]
    epsilons: tuple[float, ...]
    ticks: bool
    plans: bool


@dataclass(frozen=True, eq=False)
class StageTimes:
    """When each stage ended and started (S,) [s]; NaN if never.

    Attributes:
        switch_time: Ends the stage.
        actual_start: First sample at which the stage acts on the control.
        premature: Whether that lies before the instant at which the stage before it ends.
        by_epsilon: Actual start for each threshold (S, E).
    """

    switch_time: np.ndarray
    actual_start: np.ndarray
    premature: np.ndarray
    by_epsilon: np.ndarray


class LogWriter:
    """An open log. Use as a context manager; `close` without `finish` leaves `finished = false`."""

    def __init__(self, path: Path, header: Header, force: bool = False) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = h5py.File(path, "w" if force else "x")
        except FileExistsError:
            raise InputError(
                f"{path} exists already: choose another file with -o, or overwrite it with --force"
            ) from None
        except OSError as error:
            raise InputError(f"{path} cannot be written: {error.strerror or error}") from None
        self._header = header
        self._rows = 0
        self._flushed = time.monotonic()
        self._create(header)

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def append(self, record: Record) -> None:
        """Write one record, and flush if it is time."""
        self._extend("time", record.time)
        for column in COLUMNS:
            self._extend(column.path, self._value(column.path, record))
        self._rows += 1
        if self._header.plans:
            self._append_plans(record.solve)
        if self._header.ticks and record.ticks is not None:
            self._append_ticks(record.ticks)
        if time.monotonic() - self._flushed > FLUSH_INTERVAL:
            self.flush()

    def update_stages(self, times: StageTimes) -> None:
        """Write when the stages ended and started, as known so far."""
        self._file["stages/switch_time"][...] = times.switch_time
        self._file["stages/actual_start"][...] = times.actual_start
        self._file["stages/premature"][...] = times.premature
        self._file["stages/actual_start_by_epsilon"][...] = times.by_epsilon

    def finish(self, finished: bool, reason: str, time_end: float, x: np.ndarray, xi: np.ndarray) -> None:
        """Write how the run ended, and the state (2n,) and poses (m,) it ended in."""
        n = len(x) // 2
        self._file.attrs.update({"finished": finished, "end_reason": reason})
        for name, value in (("time", time_end), ("Q", x[:n]), ("Qdot", x[n:]), ("xi", xi)):
            self._file[f"final/{name}"][...] = value
        self.flush()

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()
        self._flushed = time.monotonic()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _create(self, header: Header) -> None:
        file = self._file
        file.attrs.update({"format_version": FORMAT_VERSION, "finished": False, "end_reason": "", **header.attributes})
        self._scale("coordinate", header.coordinates, "generalized coordinate")
        self._scale("pose_coordinate", header.pose_coordinates, "pose coordinate")
        self._scale("stage", header.stages, "stage")
        self._scale("momentum", ("x", "y", "angular"), "component of momentum")
        self._growing("time", (), "s", "sample time", "f8")
        file["time"].make_scale("time")
        for column in COLUMNS:
            self._column(column, "time")
        self._stages(header)
        n, m = len(header.coordinates), len(header.pose_coordinates)
        for name, shape in (("time", ()), ("Q", (n,)), ("Qdot", (n,)), ("xi", (m,))):
            file.create_dataset(f"final/{name}", shape, "f8", fillvalue=np.nan)
        if header.plans:
            for path, long_name in PLANS:
                self._growing(path, (), "", long_name, "f8", chunk=16384, compression="lzf")
                self._growing(f"{path}_offset", (), "1", f"first element of each sample in {path}", "i8")
        if header.ticks:
            self._growing("ticks/time", (), "s", "tick time", "f8", chunk=4096)
            file["ticks/time"].make_scale("tick_time")
            for column in TICKS:
                self._column(column, "ticks/time", chunk=4096)
        self.flush()

    def _scale(self, name: str, values: tuple[str, ...], long_name: str) -> None:
        dataset = self._file.create_dataset(name, data=np.array(values, "S64"))
        dataset.make_scale(name)
        dataset.attrs.update({"units": "", "long_name": long_name})

    def _column(self, column: Column, along: str, chunk: int = 64) -> None:
        width = (len(self._file[column.scale]),) if column.scale else ()
        dataset = self._growing(column.path, width, column.units, column.long_name, column.dtype, chunk)
        dataset.dims[0].attach_scale(self._file[along])
        if column.scale:
            dataset.dims[1].attach_scale(self._file[column.scale])

    def _growing(
        self,
        path: str,
        width: tuple[int, ...],
        units: str,
        long_name: str,
        dtype: str,
        chunk: int = 64,
        compression: str | None = None,
    ) -> h5py.Dataset:
        dataset = self._file.create_dataset(
            path, (0, *width), dtype, maxshape=(None, *width), chunks=(chunk, *width), compression=compression
        )
        dataset.attrs.update({"units": units, "long_name": long_name})
        return dataset

    def _stages(self, header: Header) -> None:
        S, E = len(header.stages), len(header.epsilons)
        group = self._file.create_group("stages")
        group["name"] = np.array(header.stages, "S64")
        group["priority"] = np.array(header.priorities)
        group["epsilon"] = np.array(header.epsilons)
        for name, shape, long_name in (
            ("switch_time", (S,), "instant that ends the stage; NaN if it never ended"),
            ("actual_start", (S,), "first sample at which the stage acts on the control; NaN if never"),
            ("actual_start_by_epsilon", (S, E), "actual start for each threshold"),
        ):
            dataset = group.create_dataset(name, shape, "f8", fillvalue=np.nan)
            dataset.attrs.update({"units": "s", "long_name": long_name})
            dataset.dims[0].attach_scale(self._file["stage"])
        group.create_dataset("premature", (S,), "i1")

    def _extend(self, path: str, value: object) -> None:
        dataset = self._file[path]
        dataset.resize(len(dataset) + 1, axis=0)
        dataset[-1] = value

    def _value(self, path: str, record: Record) -> object:
        S, first = len(self._header.stages), record.window_first
        group, name = path.split("/")
        match group, name:
            case (("state" | "control" | "force" | "pose"), _):
                return getattr(record, name)
            case "window", "first":
                return first
            case "window", "count":
                return len(record.instants) + 1
            case "window", "instants":
                return _along_stages(S, first, record.instants)
            case "window", "presence":
                presence = np.full(S, np.nan)
                presence[list(record.presence)] = list(record.presence.values())
                return presence
            case "normalization", _:
                return _along_stages(S, first, record.nadir)
            case "events", _:
                return name in record.flags
            case "solver", _:
                return getattr(record.solve, name)
            case "effort", ("base_force" | "base_torque"):
                return record.thruster_effort[("base_force", "base_torque").index(name)]
            case _:
                return getattr(record, _FIELDS[path])

    def _append_plans(self, solve: SolveRecord) -> None:
        for path, _ in PLANS:
            values, dataset = getattr(solve, path.removeprefix("plan/")), self._file[path]
            first = len(dataset)
            self._extend(f"{path}_offset", first)
            dataset.resize(first + len(values), axis=0)
            dataset[first:] = values

    def _append_ticks(self, ticks: TickRecord) -> None:
        for path in ("ticks/time", *(column.path for column in TICKS)):
            values, dataset = getattr(ticks, path.removeprefix("ticks/")), self._file[path]
            first = len(dataset)
            dataset.resize(first + len(values), axis=0)
            dataset[first:] = values


_FIELDS = {
    "cost/current_stage": "stage_cost",
    "margin/position": "position_margin",
    "margin/velocity": "velocity_margin",
    "effort/control": "control_effort",
    "balance/momentum": "momentum_error",
    "balance/energy": "energy_error",
}


def _along_stages(S: int, first: int, values: np.ndarray) -> np.ndarray:
    """Return the window's values at their stages' places (S,); NaN elsewhere."""
    row = np.full(S, np.nan)
    row[first : first + len(values)] = values
    return row


def write_monitors(path: Path, names: tuple[str, ...], held: np.ndarray, margin: np.ndarray) -> None:
    """Add the verdict of each monitor and its margin (monitors,) to a closed log."""
    with h5py.File(path, "r+") as file:
        group = file.create_group("monitors")
        for name, values in (("name", np.array(names, "S64")), ("held", held.astype("i1")), ("margin", margin)):
            group[name] = values
