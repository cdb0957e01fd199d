"""Writes a log while the run goes on: every record is in the file before the next one begins."""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import h5py
import numpy as np

from psmpc_cli.errors import RunError
from psmpc_cli.logs.create import Header, create_log
from psmpc_cli.logs.growing import GrowingDataset
from psmpc_cli.logs.layout import PLANS, TICK, TICKS, TIME
from psmpc_cli.logs.record import Record, SolveRecord, TickRecord
from psmpc_cli.logs.rows import levels_row, row, uncertain_row
from psmpc_cli.logs.seal import seal, unseal

__all__ = ["Header", "LogWriter", "StageTimes", "write_monitors"]

SPARE = 2**17
"""Room kept free for what HDF5 itself adds [bytes]."""


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
    """An open log, new or one that goes on. Use as a context manager; `close` without `finish` leaves it unfinished.

    The file may be read while it is written: it is not locked, and what a row refers to is in it before the row.
    """

    def __init__(self, path: Path, header: Header, force: bool = False, goes_on: bool = False) -> None:
        self.path = path
        if goes_on:
            unseal(path)
        else:
            create_log(path, header, force)
        self._file = h5py.File(path, "r+", locking=False)
        claimed(self._file.id.get_vfd_handle())
        self._stages = len(header.stages)
        self._levels, self._noisy = header.levels, header.noisy
        self._columns = self._growing(TIME.path, *(column.path for column in header.columns))
        self._ticks = self._growing(TICK.path, *(column.path for column in TICKS)) if header.ticks else {}
        vectors = [f"{path}{part}" for path, _ in PLANS for part in ("", "_length", "_element")]
        self._plans = self._growing(*vectors) if header.plans else {}
        self._chunks = sum(dataset.chunk_size for dataset in (*self._columns.values(), *self._ticks.values()))
        self._rows, self._finished = len(self._file[TIME.path]), False
        self._tick_rows = len(self._file[TICK.path]) if header.ticks else 0

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def append(self, record: Record) -> None:
        """Write one record and hand it to the operating system.

        Raises:
            RunError: The file cannot be written any further, for example because the disk is full; or it is gone.
        """
        self._ensure_there()
        with self._writing():
            self._reserve(self._chunks + 2 * sum(vector.nbytes for vector in _vectors(record.solve).values()))
            if self._plans:
                self._write_plans(record.solve)
            if self._ticks and record.ticks is not None:
                self._write_ticks(record.ticks)
            if self._plans or self._ticks:
                self._file.flush()
            # what the row speaks of stands in the file before the row does
            levels = levels_row(record.levels, self._stages) if self._levels else {}
            for path, value in {**row(record, self._stages), **levels, **uncertain_row(record)}.items():
                self._columns[path].write(self._rows, np.asarray(value)[None])
            self._file.flush()
        self._rows += 1
        self._tick_rows += 0 if record.ticks is None else len(record.ticks.time)

    def update_stages(self, times: StageTimes) -> None:
        """Write when the stages ended and started, as known so far."""
        with self._writing():
            self._file["stages/switch_time"][...] = times.switch_time
            self._file["stages/actual_start"][...] = times.actual_start
            self._file["stages/premature"][...] = times.premature
            self._file["stages/actual_start_by_epsilon"][...] = times.by_epsilon
            self._file.flush()

    def finish(
        self,
        finished: bool,
        reason: str,
        time_end: float,
        x: np.ndarray,
        xi: np.ndarray,
        true: np.ndarray | None = None,
    ) -> None:
        """Write how the run ended, and the state (2n,) and poses (m,) it ended in; half a record is dropped.

        In a log of noisy measurements `x` is the measured state; the true one (2n,) stands beside it.
        """
        n = len(x) // 2
        with self._writing():
            self._reserve()
            for dataset in self._columns.values():
                dataset.cut(self._rows)
            self._file.attrs.update({"finished": finished, "end_reason": reason})
            for name, value in (("end_time", time_end), ("Q", x[:n]), ("Qdot", x[n:]), ("xi", xi)):
                self._file[f"final/{name}"][...] = value
            if self._noisy and true is not None:
                self._file["final/Q_true"][...], self._file["final/Qdot_true"][...] = true[:n], true[n:]
            self._file.flush()
        self._finished = True

    def close(self) -> None:
        """Close the file, and give back the room it did not need."""
        with self._writing():
            self._file.flush()
            os.ftruncate(self._file.id.get_vfd_handle(), self._file.id.get_filesize())
            self._file.close()
        if self._finished:
            seal(self.path)

    def _growing(self, *paths: str) -> dict[str, GrowingDataset]:
        return {path: GrowingDataset(self._file[path]) for path in paths}

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:
            reason = (isinstance(error, OSError) and error.strerror) or str(error).partition("\n")[0]
            raise RunError(
                f"{self.path} cannot be written any further, it holds the run up to then: {reason}"
            ) from None

    def _ensure_there(self) -> None:
        """Make sure that the file still has its name: what is written to one that has none is lost.

        Raises:
            RunError: It was removed, or another stands in its place.
        """
        try:
            there = os.path.samestat(os.stat(self.path), os.fstat(self._file.id.get_vfd_handle()))
        except OSError:
            there = False
        if not there:
            raise RunError(f"{self.path} was removed or replaced while the run went on, and what it held is lost")

    def _reserve(self, size: int = 0) -> None:
        """Make sure of room for so many bytes more: HDF5 does not survive a full disk, so it must never meet one."""
        descriptor, end = self._file.id.get_vfd_handle(), self._file.id.get_filesize()
        if hasattr(os, "posix_fallocate") and os.fstat(descriptor).st_size < end + size + SPARE:
            os.posix_fallocate(descriptor, end, size + SPARE)

    def _write_plans(self, solve: SolveRecord) -> None:
        for path, values in _vectors(solve).items():
            dataset = self._plans[path]
            (before,) = dataset.width
            dataset.write(self._rows, values[None])
            self._plans[f"{path}_length"].write(self._rows, [len(values)])
            (after,) = dataset.width
            self._plans[f"{path}_element"].write(before, np.arange(before, after))

    def _write_ticks(self, ticks: TickRecord) -> None:
        first = self._tick_rows
        self._ticks[TICK.path].write(first, np.arange(first, first + len(ticks.time)))
        for column in TICKS:
            self._ticks[column.path].write(first, getattr(ticks, column.path.removeprefix("ticks/")))


def claimed(descriptor: int) -> bool:
    """Claim an open file for this process; return whether no other has. Readers do not notice."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN)
    return True


def _vectors(solve: SolveRecord) -> dict[str, np.ndarray]:
    """Return the vectors of a solve by their paths below /plan."""
    return {path: getattr(solve, path.removeprefix("plan/")) for path, _ in PLANS}


def write_monitors(path: Path, held: np.ndarray, margin: np.ndarray) -> None:
    """Write the verdict of each monitor and its margin (monitors,) into a closed log."""
    unseal(path)
    with h5py.File(path, "r+", locking=False) as file:
        file["monitors/held"][...] = held
        file["monitors/margin"][...] = margin
    seal(path)
