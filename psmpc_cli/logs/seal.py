"""The seal of a finished file: a checksum behind the end of what HDF5 reads, and who put it there.

HDF5 does not look beyond the end that the file itself states, and a program that opens the file to write marks it and
cuts the seal off when it closes it. So a checksum that does not fit means damage and never an edit. Anyone can compute
a checksum; that it was this user's psmpc shows a code over it, made with a key that lies beside the compiled libraries.
"""

import hashlib
import hmac
import os
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from pathlib import Path

from psmpc_cli.native.library import cache_directory

MARK = b"psmpc sha-256\n"

SIZE = hashlib.sha256().digest_size
"""Bytes of a checksum, of a code and of a key."""

LENGTH = len(MARK) + 2 * SIZE

BLOCK = 2**20
"""Bytes read at a time."""


class Seal(Enum):
    """What a file's seal says of it."""

    NONE = "not sealed"
    OWN = "as it was when this user's psmpc closed it"
    FOREIGN = "as it was when somebody closed it"
    BROKEN = "changed since"


def seal(path: Path) -> None:
    """Seal a closed file; where there is no room for that it stays as it is, and is read with more care."""
    with suppress(OSError):
        unseal(path)
        digest = _digest(path, path.stat().st_size)
        with path.open("ab") as file:
            file.write(MARK + digest + _code(digest))


def sealed(image: bytes) -> bytes:
    """Return the image of a file with its seal."""
    digest = hashlib.sha256(image).digest()
    return image + MARK + digest + _code(digest)


def unseal(path: Path) -> None:
    """Take the seal off a file that is to be changed."""
    size = path.stat().st_size
    if _tail(path, size).startswith(MARK):
        os.truncate(path, size - LENGTH)


def seal_of(path: Path) -> Seal:
    """Return what the seal of a file says of it."""
    size = path.stat().st_size
    tail = _tail(path, size)
    if not tail.startswith(MARK):
        return Seal.NONE
    digest, code = tail[len(MARK) : -SIZE], tail[-SIZE:]
    if digest != _digest(path, size - LENGTH):
        return Seal.NONE if _is_being_written(path) else Seal.BROKEN
    return Seal.OWN if any(code) and hmac.compare_digest(code, _code(digest)) else Seal.FOREIGN


def _code(digest: bytes) -> bytes:
    """Return the code over a checksum that only who has the key can make; zeros without one."""
    key = _key(cache_directory() / "seal.key")
    return hmac.digest(key, digest, "sha256") if len(key) == SIZE else bytes(SIZE)


def _key(path: Path) -> bytes:
    """Return the key in a file, which is made where there is none; nothing where that cannot be."""
    with suppress(OSError):
        with (
            suppress(FileExistsError),
            open(path, "xb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file,
        ):
            file.write(os.urandom(SIZE))
        return path.read_bytes()
    return b""


def _is_being_written(path: Path) -> bool:
    """Return whether HDF5 has a file open to write, or had when it was killed: its consistency flags say so."""
    with path.open("rb") as file:
        head = file.read(24)
    return any(head[20:24] if head[8] < 2 else head[11:12])


def _tail(path: Path, size: int) -> bytes:
    """Return the bytes of a file where its seal is, if it has one."""
    if size < LENGTH:
        return b""
    with path.open("rb") as file:
        file.seek(size - LENGTH)
        return file.read(LENGTH)


def _digest(path: Path, length: int) -> bytes:
    """Return the checksum of the first bytes of a file."""
    digest = hashlib.sha256()
    for block in _blocks(path, length):
        digest.update(block)
    return digest.digest()


def _blocks(path: Path, length: int) -> Iterator[bytes]:
    with path.open("rb") as file:
        while length > 0 and (block := file.read(min(BLOCK, length))):
            length -= len(block)
            yield block
