"""The empty log: every dataset in place before the run begins."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from psmpc_cli.logs.layout import (
    AXES,
    COLUMNS,
    DISTURBANCE,
    DRAWN,
    DRAWN_SCALES,
    FINAL_TRUE,
    FORMAT_VERSION,
    LEVELS,
    MOMENTUM,
    PAYLOAD,
    PLANS,
    RUN,
    SCALES,
    TABLES,
    TICK,
    TICKS,
    TIME,
    TRUE_STATE,
    Column,
    Scale,
    Table,
)
from psmpc_cli.logs.new_file import write_new

ROWS_IN_A_CHUNK, TICKS_IN_A_CHUNK, ELEMENTS_IN_A_CHUNK = 256, 4096, 4096
"""Chunks are large: space is set aside rarely, and between those times a killed run can only lose its last row."""


@dataclass(frozen=True)
class Header:
    """What a log says of the run before it begins.

    Attributes:
        attributes: Text and numbers kept as attributes of the file.
        coordinates, pose_coordinates, stages: Names along those dimensions.
        priorities: omega of each stage.
        epsilons: Thresholds of the actual start.
        ticks, plans: Whether ticks and plans are logged.
        monitors: Names of the monitors.
        levels: Whether the controller has levels to log.
        units: Units of datasets that the task decides, by path.
        noisy: Whether the true state is another than the measured one.
        payload: Whether the object has a mass.
        offset_free: Whether the controller estimates a disturbance.
        bodies: Names of the bodies; none without drawn numbers.
        drawn: What was drawn for them, by path.
    """

    attributes: Mapping[str, str | int | float | bool]
    coordinates: tuple[str, ...]
    pose_coordinates: tuple[str, ...]
    stages: tuple[str, ...]
    priorities: tuple[float, ...]
    epsilons: tuple[float, ...]
    ticks: bool
    plans: bool
    monitors: tuple[str, ...] = ()
    levels: bool = False
    units: Mapping[str, str] = field(default_factory=dict)
    noisy: bool = False
    payload: bool = False
    offset_free: bool = False
    bodies: tuple[str, ...] = ()
    drawn: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Every dataset with a row a sample."""
        levels, true = LEVELS if self.levels else (), TRUE_STATE if self.noisy else ()
        disturbance = DISTURBANCE if self.offset_free else ()
        return (*COLUMNS, *levels, *true, *(PAYLOAD if self.payload else ()), *disturbance)

    @property
    def scales(self) -> tuple[Scale, ...]:
        """Every dimension scale whose size is known before the run."""
        return (*SCALES, *(DRAWN_SCALES if self.drawn else ()))

    @property
    def tables(self) -> tuple[Table, ...]:
        """Every dataset that does not grow."""
        return (*TABLES, *(FINAL_TRUE if self.noisy else ()), *(DRAWN if self.drawn else ()))


def create_log(path: Path, header: Header, force: bool = False) -> None:
    """Write a log without samples, in one piece.

    Raises:
        InputError: The file exists already or cannot be written; with `force`, it exists and is no HDF5 file.
    """
    write_new(path, _image(header), force)


def _image(header: Header) -> bytes:
    """Return the empty log as it stands in its file."""
    with h5py.File("log", "w", driver="core", backing_store=False) as file:
        file.attrs.update(
            {"kind": RUN, "format_version": FORMAT_VERSION, "finished": False, "end_reason": "", **header.attributes}
        )
        _create_scales(file, header)
        _create_tables(file, header)
        _create_columns(file, TIME, header.columns, ROWS_IN_A_CHUNK)
        if header.ticks:
            _create_columns(file, TICK, TICKS, TICKS_IN_A_CHUNK)
        if header.plans:
            for path, long_name in PLANS:
                _create_plan(file, path, long_name)
        for path, units in header.units.items():
            file[path].attrs["units"] = units
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _create_scales(file: h5py.File, header: Header) -> None:
    values: dict[str, tuple[str, ...] | tuple[float, ...]] = {
        "coordinate": header.coordinates,
        "pose_coordinate": header.pose_coordinates,
        "stage": header.stages,
        "momentum": MOMENTUM,
        "stages/epsilon": header.epsilons,
        "monitors/name": header.monitors,
        "uncertainty/body": header.bodies,
        "uncertainty/axis": AXES,
    }
    for scale in header.scales:
        dtype = "f8" if scale.path == "stages/epsilon" else h5py.string_dtype()
        dataset = file.create_dataset(scale.path, data=np.array(values[scale.path], dtype))
        dataset.make_scale(scale.path.rpartition("/")[2])
        _describe(dataset, scale.units, scale.long_name)


def _create_tables(file: h5py.File, header: Header) -> None:
    for table in header.tables:
        text = table.dtype == "text"
        dataset = file.create_dataset(
            table.path,
            tuple(len(file[scale]) for scale in table.scales),
            h5py.string_dtype() if text else table.dtype,
            fillvalue=None if text else table.unknown,
        )
        _describe(dataset, table.units, table.long_name)
        for dimension, scale in zip(dataset.dims, table.scales, strict=True):
            dimension.attach_scale(file[scale])
    file["stages/name"][...] = header.stages
    file["stages/priority"][...] = header.priorities
    for path, values in header.drawn.items():
        file[path][...] = values


def _create_columns(file: h5py.File, along: Column, columns: tuple[Column, ...], chunk: int) -> None:
    """Create a growing dimension and the datasets along it."""
    _create_growing(file, along, (), chunk).make_scale(along.path.rpartition("/")[2])
    for column in columns:
        width = (len(file[column.scale]),) if column.scale else ()
        dataset = _create_growing(file, column, width, chunk)
        dataset.dims[0].attach_scale(file[along.path])
        if column.scale:
            dataset.dims[1].attach_scale(file[column.scale])


def _create_growing(file: h5py.File, column: Column, width: tuple[int, ...], chunk: int) -> h5py.Dataset:
    dataset = file.create_dataset(
        column.path, (0, *width), column.dtype, maxshape=(None, *width), chunks=(chunk, *width)
    )
    _describe(dataset, column.units, column.long_name)
    return dataset


def _create_plan(file: h5py.File, path: str, long_name: str) -> None:
    """Create a dataset whose rows have their own lengths; a row's chunks are compressed and written once."""
    elements = Column(f"{path}_element", "", "1", f"index into a row of {path}", "i4")
    lengths = Column(f"{path}_length", "", "1", f"number of elements in each row of {path}", "i4")
    dataset = file.create_dataset(
        path,
        (0, 0),
        "f8",
        maxshape=(None, None),
        chunks=(1, ELEMENTS_IN_A_CHUNK),
        shuffle=True,
        compression="gzip",
        compression_opts=1,
        fillvalue=np.nan,
    )
    _describe(dataset, "1", long_name)
    scale = _create_growing(file, elements, (), ELEMENTS_IN_A_CHUNK)
    scale.make_scale(elements.path.rpartition("/")[2])
    dataset.dims[0].attach_scale(file["time"])
    dataset.dims[1].attach_scale(scale)
    _create_growing(file, lengths, (), ROWS_IN_A_CHUNK).dims[0].attach_scale(file["time"])


def _describe(dataset: h5py.Dataset, units: str, long_name: str) -> None:
    dataset.attrs.update({"units": units, "long_name": long_name})
