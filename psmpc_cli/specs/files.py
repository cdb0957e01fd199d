"""Files to text, or a word on why not; never hangs on a device and never swallows a giant."""

import os
import stat
from pathlib import Path as FilePath

from psmpc_cli.errors import SpecError

LARGEST = 2**20
"""Bytes of a description; the built-in ones have some three thousand."""

_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_text(path: FilePath) -> str:
    """Return the text of a regular UTF-8 file.

    Raises:
        SpecError: It is missing, unreadable, no regular file, too large or not UTF-8.
    """
    try:
        status = path.stat()
        kind = next((name for test, name in _KINDS if test(status.st_mode)), None)
        if kind is not None:
            raise SpecError(f"{path}: found {kind}, expected a YAML file")
        if status.st_size > LARGEST:
            raise SpecError(f"{path}: found {status.st_size} bytes, expected a YAML file of at most {LARGEST}")
        content = _bounded(path)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise SpecError(f"{path}: found no readable file ({reason}), expected a YAML file") from None
    return _decode(path, content)


def _bounded(path: FilePath) -> bytes:
    """Read at most `LARGEST` bytes, and never wait for a writer."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(descriptor, "rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise SpecError(f"{path}: found more than {LARGEST} bytes, expected a YAML file of at most so many")
    return content


def _decode(path: FilePath, content: bytes) -> str:
    """Decode UTF-8, with or without a byte order mark."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - (content.rfind(b"\n", 0, error.start) + 1) + 1
        raise SpecError(
            f"{path}:{line}:{column}: found the byte 0x{content[error.start]:02x}, expected UTF-8 text"
        ) from None
