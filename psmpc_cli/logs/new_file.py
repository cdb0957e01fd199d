"""New files: written in one piece, and nothing is overwritten unasked."""

import os
from pathlib import Path

import h5py

from psmpc_cli.errors import InputError


def write_new(path: Path, image: bytes, force: bool = False) -> None:
    """Write the image of an HDF5 file, whole or not at all.

    Raises:
        InputError: The file exists already or cannot be written; with `force`, it exists and is no HDF5 file.
    """
    target = path.resolve()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        refuse(path, force)
        if force:
            target.unlink(missing_ok=True)
        _write(target, image)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{path} cannot be written: {path.parent} is no directory") from None
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None


def refuse(path: Path, force: bool) -> None:
    """Refuse to write where something else stands.

    Raises:
        InputError: The path is taken; with `force`, by what is no log.
    """
    if path.is_dir():
        raise InputError(f"{path} is a directory: name a file in it with -o, such as {path / 'run.h5'}")
    if not path.exists():
        return
    if not force:
        raise InputError(f"{path} exists already: choose another file with -o, or overwrite it with --force")
    if not (path.is_file() and (path.stat().st_size == 0 or h5py.is_hdf5(path))):
        raise InputError(f"{path} is no log: --force overwrites logs only; choose another file with -o")


def _write(path: Path, content: bytes) -> None:
    """Write a new file, which is there whole or not at all, whatever happens meanwhile."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        _rename(part, path)
    finally:
        part.unlink(missing_ok=True)


def _rename(part: Path, path: Path) -> None:
    """Give a file its name, unless another has it by now."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        os.replace(part, path)
