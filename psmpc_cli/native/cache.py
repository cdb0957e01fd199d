"""Where compiled libraries are kept: one file and its checksum an entry, put there by rename, safe for many writers."""

import atexit
import hashlib
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path

VARIABLE = "PSMPC_CACHE"
"""Environment variable that names the cache directory."""


def cache_directory() -> Path:
    """Return the directory of compiled libraries: PSMPC_CACHE, else `psmpc` below XDG_CACHE_HOME or ~/.cache.

    It exists and can be written to; where that cannot be had, it is a directory that lasts as long as the program.
    """
    for wanted in _wanted():
        try:
            wanted.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        if os.access(wanted, os.W_OK | os.X_OK):
            return wanted
    return _temporary()


def _wanted() -> list[Path]:
    """Return the directory asked for; none where the user has no home."""
    if chosen := os.environ.get(VARIABLE):
        return [Path(chosen).expanduser().resolve()]
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # A relative XDG_CACHE_HOME does not count, says its specification.
        return [(Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "psmpc"]
    except RuntimeError:
        return []


@cache
def _temporary() -> Path:
    """Return this program's own directory."""
    path = Path(tempfile.mkdtemp(prefix="psmpc-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


def intact(entry: Path) -> bool:
    """Whether an entry is there whole, as it was kept."""
    try:
        return _checksum_file(entry).read_text(encoding="ascii").strip() == _checksum(entry)
    except (OSError, UnicodeDecodeError):
        return False


def keep(made: Path, entry: Path) -> None:
    """Move a file made in the same directory to its place, and write down its checksum.

    A reader between the two renames finds an entry that is not intact, and makes its own: equal sources give equal
    libraries.

    Raises:
        OSError: It cannot be written.
    """
    note = made.with_suffix(".sum")
    note.write_text(_checksum(made), encoding="ascii")
    made.replace(entry)
    note.replace(_checksum_file(entry))


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _checksum_file(entry: Path) -> Path:
    return entry.with_suffix(".sha256")
