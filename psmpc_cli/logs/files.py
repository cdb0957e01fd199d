"""The files that psmpc writes: how they are opened, and how new ones come to be without loss of old ones."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import h5py

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.schema import FORMAT_VERSION, RUN
from psmpc_cli.specs.messages import shortened

T = TypeVar("T")

OF_DIMENSIONS = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Dimid")
"""Attributes in which HDF5 keeps dimension scales."""

DAMAGE = (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError, MemoryError)
"""What h5py and NumPy raise for a damaged file."""

TRIES = 5
"""How often a file is read that changes meanwhile, because its run still writes it."""


def read_file(path: Path, read: Callable[[h5py.File], T], expected: str = "a log written by psmpc simulate") -> T:
    """Open a file of this format version, also while it is written, and read it.

    Args:
        path: The file.
        read: Reads the open file; what it returns is returned.
        expected: What was expected, for the messages.

    Raises:
        LogError: The file is missing, empty, no HDF5 file, damaged, or of another program or format version.
    """
    for tries_left in reversed(range(TRIES)):
        before = _state(path)
        try:
            return _read_once(path, read, expected)
        except LogError:
            if not tries_left or _state(path) == before:
                raise
    raise AssertionError("unreachable")


def kind_of(path: Path) -> str:
    """Return what a file of this version holds: RUN, COMPARISON or the kind of a study.

    Raises:
        LogError: As for `read_file`.
    """
    return read_file(path, kind_in)


def kind_in(file: h5py.File) -> str:
    """Return what an open file holds; RUN if it has no attribute `kind`."""
    return str(file.attrs.get("kind", RUN))


def _read_once(path: Path, read: Callable[[h5py.File], T], expected: str) -> T:
    def rejected(found: str) -> LogError:
        return LogError(f"{path}: found {found}, expected {expected}")

    try:
        if path.is_dir():
            raise rejected("a directory")
        if not path.exists():
            raise rejected("no such file")
        if not path.is_file():
            raise rejected("no regular file")
        if not path.stat().st_size:
            raise rejected("an empty file")
        with path.open("rb"):
            pass
    except OSError as error:
        raise rejected(f"no readable file ({error.strerror or error})") from None
    if not h5py.is_hdf5(path):
        raise rejected("no HDF5 file")
    try:
        with h5py.File(path, "r", locking=False) as file:
            if "format_version" not in file.attrs or "psmpc_version" not in file.attrs:
                raise rejected("an HDF5 file of another program")
            _check_version(path, file)
            if (found := _foreign(file)) is not None:
                raise rejected(found)
            return read(file)
    except DAMAGE as error:
        reason = (str(error) or type(error).__name__).partition("\n")[0][:200]
        raise rejected(f"an HDF5 file that is cut off or damaged ({reason})") from None


def _state(path: Path) -> tuple[int, int] | None:
    """Return what shows that a file has changed; None if there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def _foreign(group: h5py.Group, levels: int = 4) -> str | None:
    """Return what below a group psmpc never writes: links, references, data in other files; None if there is none."""
    if not levels:
        return "groups within groups within groups"
    for name in group:
        where = ascii(name[:60])
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            return f"a link to another object at {where}"
        item = group[name]
        if isinstance(item, h5py.Group):
            found = _foreign(item, levels - 1)
        else:
            elsewhere = item.external or item.is_virtual
            references = item.dtype.hasobject and h5py.check_string_dtype(item.dtype) is None
            found = f"references or data of another file at {where}" if elsewhere or references else None
        if found is not None:
            return found
    return None


def _check_version(path: Path, file: h5py.File) -> None:
    """Reject a file of another format version."""
    found = file.attrs["format_version"]
    if found != FORMAT_VERSION:
        version, writer = (shortened(ascii(str(value))[1:-1]) for value in (found, file.attrs["psmpc_version"]))
        raise LogError(
            f"{path}: found log format {version}, written by psmpc {writer}; this version reads "
            f"format {FORMAT_VERSION}: read it with that version, or run the experiment again"
        )


def check_output(path: Path, force: bool) -> None:
    """Make sure that a new file may be written at a path.

    Raises:
        InputError: The path is taken; with `force`, by a file that psmpc did not write.
    """
    if path.is_dir():
        raise InputError(f"{path} is a directory: name a file in it with -o, such as {path / 'run.h5'}")
    if not path.exists():
        return
    if not force:
        raise InputError(f"{path} exists already: choose another file with -o, or overwrite it with --force")
    if not (path.is_file() and (path.stat().st_size == 0 or h5py.is_hdf5(path))):
        raise InputError(f"{path} is no log: --force overwrites logs only; choose another file with -o")


def image_of(fill: Callable[[h5py.File], None], versions: tuple[str, str] = ("latest", "latest")) -> bytes:
    """Create an HDF5 file in memory, so that HDF5 never meets a full disk, and return its bytes.

    Args:
        fill: Creates the content of the open file.
        versions: Lowest and highest format of HDF5. From v108 on metadata have checksums; from v110 on HDF5 marks a
            file that it opens to write, and does not open it again after a kill.
    """
    with h5py.File("memory", "w", driver="core", backing_store=False, libver=versions) as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def copy_group(source: h5py.Group, target: h5py.Group) -> None:
    """Copy attributes and datasets of a group into another file; dimension scales are created anew there."""
    target.attrs.update(source.attrs)
    names: list[str] = []
    source.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    for name in names:
        folder, _, last = name.rpartition("/")
        source.copy(source[name], target.require_group(folder or "."), last, without_attrs=True)
        attributes = {key: value for key, value in source[name].attrs.items() if key not in OF_DIMENSIONS}
        target[name].attrs.update(attributes)
        if source[name].is_scale:
            target[name].make_scale(source[name].attrs["NAME"])
    for name in names:
        for dimension, copied in zip(source[name].dims, target[name].dims, strict=True):
            for scale in dimension.values():
                copied.attach_scale(target[scale.name.removeprefix(source.name).lstrip("/")])


def write_new(path: Path, image: bytes, force: bool = False) -> None:
    """Write a new file, whole or not at all; its folder is created if necessary.

    Raises:
        InputError: The path is taken, see `check_output`, or the file cannot be written.
    """
    target = path.resolve()
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        check_output(path, force)
        try:
            part.write_bytes(image)
            check_output(path, force)  # another process may have written it meanwhile
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{path} cannot be written: {path.parent} is no directory") from None
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None
