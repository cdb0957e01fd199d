"""From C source to a shared library that can be loaded, compiled once and kept."""

import ctypes
import hashlib
import logging
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from psmpc_cli.native.cache import cache_directory, intact, keep
from psmpc_cli.native.compiler import CompilationError, Compiler, find_compiler

logger = logging.getLogger(__name__)

FLAGS = ("-O2",)
"""How C is compiled unless told otherwise."""

SUFFIX = ".dylib" if sys.platform == "darwin" else ".so"


def library(source: str, name: str, flags: Sequence[str] = FLAGS) -> Path | None:
    """Return the shared library of a C source, from the cache where it is kept already.

    Its file is keyed by the digest of source, flags, compiler version and machine. With `-march=native` among the
    flags the machine's instruction set is part of the key too. The library loads; whoever wants its symbols loads it
    again, by `ctypes.CDLL` or `casadi.external`, at no cost.

    Args:
        source: C, with no includes but the system's.
        name: What its file's name begins with.
        flags: Flags of the compiler.

    Returns:
        The library; None where there is no compiler or it failed. That is logged once, as information: whoever asks
        has another way.
    """
    try:
        return _library(source, name, tuple(flags))
    except (CompilationError, OSError) as error:
        _say_once(f"{error}; going on without compiled code")
        return None


def _library(source: str, name: str, flags: tuple[str, ...]) -> Path:
    """Return the library.

    Raises:
        CompilationError: There is no compiler or it failed.
        OSError: The library cannot be written or loaded.
    """
    compiler, directory = find_compiler(), cache_directory()
    key = "\0".join((source, " ".join(flags), compiler.identity(flags)))
    entry = directory / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:24]}{SUFFIX}"
    if not (intact(entry) and _loads(entry)):
        _make(compiler, source, entry, flags)
        ctypes.CDLL(str(entry))
    return entry


def _make(compiler: Compiler, source: str, entry: Path, flags: tuple[str, ...]) -> None:
    """Compile beside the entry, then move into its place."""
    with tempfile.TemporaryDirectory(prefix=".making-", dir=entry.parent) as folder:
        # The same file name everywhere: compilers write it into the library, and equal sources shall give equal ones.
        written, made = Path(folder) / "source.c", Path(folder) / f"made{SUFFIX}"
        written.write_text(source, encoding="utf-8")
        compiler.build(written, made, flags)
        keep(made, entry)


def _loads(entry: Path) -> bool:
    try:
        ctypes.CDLL(str(entry))
    except OSError:
        return False
    return True


@cache
def _say_once(message: str) -> None:
    logger.info(message)
