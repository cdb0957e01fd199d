"""Files of descriptions: how they are read, and named in messages.

What reads YAML is imported where it is needed: `psmpc --help` answers at once.
"""

import os
from pathlib import Path

from psmpc_cli.errors import SpecError

LARGEST_FILE = 2**18
"""Bytes of a description; the built-in ones have some three thousand."""


def shown(path: Path) -> str:
    """Return the name of a path in messages: relative to the working directory if it is below it."""
    relative = os.path.relpath(path) if path.is_absolute() else str(path)
    return str(path) if relative.startswith(os.pardir) else relative


def read_bytes(path: Path) -> bytes:
    """Read the file of a robot or task, of at most `LARGEST_FILE` bytes.

    Raises:
        SpecError: It is missing, unreadable, no regular file or too large.
    """
    wanted = f"a {'URDF' if path.suffix.casefold() == '.urdf' else 'YAML'} file"
    try:
        from psmpc_cli.specs.document import read_regular

        return read_regular(path, LARGEST_FILE, wanted)
    except SpecError as error:
        raise SpecError(f"{path}: {error}") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise SpecError(f"{path}: found no readable file ({reason}), expected {wanted}") from None


def read_text(path: Path) -> str:
    """Read a regular UTF-8 file, with or without a byte order mark.

    Raises:
        SpecError: It cannot be read, see `read_bytes`, or is not UTF-8.
    """
    content = read_bytes(path)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        column = error.start - error.object.rfind(b"\n", 0, error.start)
        raise SpecError(f"{path}:{line}:{column}: found {error.reason}, expected UTF-8 text") from None
