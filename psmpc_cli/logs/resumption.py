"""A log that a run goes on with: the complete rows of the one before, in a new file that takes its place at once."""

import os
import shutil
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.create import Header, create_log
from psmpc_cli.logs.growing import GrowingDataset
from psmpc_cli.logs.layout import TICK
from psmpc_cli.logs.read import opened
from psmpc_cli.logs.write import claimed

SPARE = 1.1
"""Room wanted for the new file, in sizes of the old one."""

CONTINUED = "continued"
"""Attribute with the times from which a run was continued [s]."""


def reopen_log(path: Path, header: Header, rows: int) -> None:
    """Let a log end before sample `rows`, as if the run stood there.

    The file a killed run leaves can be read, but what it says of its own free space may be out of date, so nothing is
    appended to it. Its rows are copied, and the copy takes its place in one step: whatever happens meanwhile, one of
    the two stands there whole.

    Args:
        path: The log.
        header: What a new log of the same run would say.
        rows: Number of samples that are kept.

    Raises:
        LogError: The log cannot be read.
        InputError: There is no room or no permission for the new file.
    """
    target = path.resolve()
    part = target.with_name(f"{target.name}.part")
    try:
        _ensure_nobody_writes(target)
        part.unlink(missing_ok=True)
        if shutil.disk_usage(target.parent).free < SPARE * target.stat().st_size:
            raise InputError(f"{path} cannot be continued: no space left on device")
        try:
            create_log(part, header)
            with opened(path) as old, h5py.File(part, "r+") as new:
                _copy(path, old, new, rows)
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path} cannot be continued: {error.strerror or error}") from None


def _ensure_nobody_writes(path: Path) -> None:
    """Make sure that no run writes the log still.

    Raises:
        InputError: One does.
    """
    with path.open("r+b") as file:
        if not claimed(file.fileno()):
            raise InputError(f"{path} cannot be continued: its run still goes on")


def _copy(path: Path, old: h5py.File, new: h5py.File, rows: int) -> None:
    """Copy what was said of the run, and the rows of so many samples."""
    new.attrs.update({**old.attrs, "finished": False, "end_reason": ""})
    before = [*np.atleast_1d(old.attrs[CONTINUED])] if CONTINUED in old.attrs else []
    new.attrs[CONTINUED] = [*before, float(old["time"][rows]) if rows < len(old["time"]) else 0.0]
    growing: list[str] = []
    new.visititems(lambda name, item: growing.append(name) if _grows(item) else None)
    missing = [name for name in growing if name not in old]
    if missing:
        raise LogError(f"{path} cannot be continued: it has no {missing[0]}, which this version writes")
    ticks = _ticks(old, rows)
    for name in growing:
        if f"{name}_length" in old:
            _copy_vectors(old, new, name, rows)
        elif not name.endswith("_element"):
            GrowingDataset(new[name]).write(0, old[name][: ticks if name.startswith("ticks/") else rows])


def _grows(item: h5py.HLObject) -> bool:
    return isinstance(item, h5py.Dataset) and item.maxshape[:1] == (None,)


def _ticks(file: h5py.File, rows: int) -> int:
    """Return the number of ticks in so many samples."""
    if TICK.path not in file or rows >= len(file["time"]):
        return 0 if TICK.path not in file else len(file[TICK.path])
    return int(np.searchsorted(file["ticks/time"][()], float(file["time"][rows]) - 1e-9))


def _copy_vectors(old: h5py.File, new: h5py.File, name: str, rows: int) -> None:
    """Copy vectors whose lengths differ, row by row, each as long as it is."""
    target, lengths = GrowingDataset(new[name]), old[f"{name}_length"][:rows]
    for row, length in enumerate(lengths):
        target.write(row, old[name][row, :length][None])
    elements = GrowingDataset(new[f"{name}_element"])
    elements.write(0, np.arange(*target.width))
