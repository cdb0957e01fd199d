"""Exports a log's tables as CSV files, one a group, with named columns."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.read import Log
from psmpc_cli.logs.schema import MOMENTUM, columns


def export_csv(log: Log, directory: Path, force: bool = False) -> list[Path]:
    """Write samples.csv and stages.csv, and ticks.csv where ticks were logged, and return their paths.

    Raises:
        InputError: A file exists already, or the directory cannot be written.
    """
    tables = {"samples.csv": dict(_samples(log)), "stages.csv": dict(_stages(log))}
    if log.ticks:
        tables["ticks.csv"] = dict(_ticks(log))
    paths = [directory / name for name in tables]
    if not force and (present := [str(path) for path in paths if path.exists()]):
        raise InputError(f"{', '.join(present)} exists already: choose another directory, or overwrite with --force")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path, table in zip(paths, tables.values(), strict=True):
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(table)
                writer.writerows(zip(*table.values(), strict=True))
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{directory} cannot be written: it is no directory") from None
    except OSError as error:
        raise InputError(f"{directory} cannot be written: {error.strerror}") from None
    return paths


def _samples(log: Log) -> Iterator[tuple[str, np.ndarray]]:
    yield "time [s]", log.time
    names = {
        "coordinate": log.coordinates,
        "pose_coordinate": log.pose_coordinates,
        "stage": log.stage_names,
        "momentum": MOMENTUM,
    }
    for column in (column for column in columns("time") if column.path in log.columns):
        values = log[column.path]
        if len(column.dims) == 1:
            yield column.path if column.units == "1" else f"{column.path} [{column.units}]", values
            continue
        for name, row in zip(names[column.dims[1]], values.T, strict=True):
            yield f"{column.path}/{name}", row


def _stages(log: Log) -> Iterator[tuple[str, np.ndarray]]:
    for name in ("name", "priority", "switch_time", "actual_start", "early"):
        yield name, log.stages[name]
    for epsilon, starts in zip(log.stages["epsilon"], log.stages["actual_start_by_epsilon"].T, strict=True):
        yield f"actual_start/{epsilon:g}", starts


def _ticks(log: Log) -> Iterator[tuple[str, np.ndarray]]:
    yield "time [s]", log.ticks["time"]
    for quantity in ("Q", "Qdot", "F"):
        for name, row in zip(log.coordinates, log.ticks[quantity].T, strict=True):
            yield f"{quantity}/{name}", row
