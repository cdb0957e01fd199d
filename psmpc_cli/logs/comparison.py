"""A comparison: one file with the logs of several runs, each below /runs in a group laid out as a log of its own."""

import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py

from psmpc_cli import __version__
from psmpc_cli.errors import InputError, LogError, RunError
from psmpc_cli.logs.new_file import refuse
from psmpc_cli.logs.read import Log, kind_in, log_in, opened
from psmpc_cli.logs.schema import COMPARISON, FORMAT_VERSION
from psmpc_cli.logs.seal import seal
from psmpc_cli.logs.structure import OF_DIMENSIONS

SPARE = 1.1
"""Room wanted for a comparison, in sizes of the logs it is made from."""


def merge_logs(logs: Mapping[str, Path], path: Path, force: bool = False) -> None:
    """Write the logs of closed runs, by name, into one file, whole or not at all.

    Raises:
        InputError: The file exists already or cannot be written.
        RunError: There is no room for it.
    """
    refuse(path, force)
    part = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(path.parent).free < SPARE * sum(log.stat().st_size for log in logs.values()):
            raise RunError(f"{path} cannot be written: no space left on device")
        try:
            _write(logs, part)
            seal(part)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None


def read_comparison(path: Path) -> dict[str, Log]:
    """Return the logs in a comparison by name, in the order in which they were compared.

    Raises:
        LogError: As for `read_log`; or the file is the log of one run.
    """
    with opened(path) as file:
        if kind_in(file) != COMPARISON:
            raise LogError(f"{path}: found the log of one run, expected a comparison written by psmpc compare")
        return logs_in(path, file)


def logs_in(path: Path, file: h5py.File) -> dict[str, Log]:
    """Return the logs in an open comparison by name.

    Raises:
        LogError: As for `log_in`.
    """
    return {str(name): log_in(path, file[f"runs/{name}"]) for name in file.attrs["runs"]}


def extract_log(path: Path, name: str, log: Path) -> None:
    """Write a run of a comparison into a file of its own, as the log it was.

    Raises:
        LogError: The comparison has no such run.
        InputError: The file cannot be written.
    """
    try:
        with h5py.File(path, "r", locking=False) as source, h5py.File(log, "w") as target:
            if f"runs/{name}" not in source:
                raise LogError(f"{path}: found no run {name}, expected one of {', '.join(source.get('runs', ()))}")
            _copy(source[f"runs/{name}"], target)
    except OSError as error:
        raise InputError(f"{log} cannot be written: {error.strerror or error}") from None


def _write(logs: Mapping[str, Path], path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.attrs.update({"kind": COMPARISON, "psmpc_version": __version__, "format_version": FORMAT_VERSION})
        file.attrs["runs"] = list(logs)
        for name, log in logs.items():
            with h5py.File(log, "r", locking=False) as source:
                _copy(source, file.create_group(f"runs/{name}"))


def _copy(source: h5py.Group, target: h5py.Group) -> None:
    """Copy a log into a group; its dimension scales are made anew there."""
    target.attrs.update(source.attrs)
    datasets = dict(_datasets(source))
    for path, dataset in datasets.items():
        source.copy(
            dataset, target.require_group(path.rpartition("/")[0] or "."), path.rpartition("/")[2], without_attrs=True
        )
        target[path].attrs.update({key: value for key, value in dataset.attrs.items() if key not in OF_DIMENSIONS})
        if dataset.is_scale:
            target[path].make_scale(dataset.attrs["NAME"])
    for path, dataset in datasets.items():
        for i, dimension in enumerate(dataset.dims):
            for scale in dimension.values():
                target[path].dims[i].attach_scale(target[scale.name.removeprefix(source.name).lstrip("/")])


def _datasets(group: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """Give every dataset below a group with its path in it."""
    for name, member in group.items():
        if isinstance(member, h5py.Group):
            yield from ((f"{name}/{path}", dataset) for path, dataset in _datasets(member))
        else:
            yield name, member
