"""Shared libraries from C source: compiled on first use, kept in a cache by their content."""

import atexit
import ctypes
import hashlib
import logging
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

logger = logging.getLogger(__name__)

CACHE_VARIABLE = "PSMPC_CACHE"
"""Environment variable that names the cache directory."""

COMPILERS = ("cc", "gcc", "clang")
"""Compilers looked up on PATH where the environment variable CC is not set."""

SUFFIX = ".dylib" if sys.platform == "darwin" else ".so"


class CompilationError(Exception):
    """There is no compiler, or it failed; `library` reports it and returns None."""


def library(source: str, name: str, flags: Sequence[str] = ("-O2",)) -> Path | None:
    """Compile C source to a shared library, or find it in the cache.

    The file is keyed by the digest of source, flags, compiler version and machine; with `-march=native` among the flags
    by the instruction set of the machine too. The library has been loaded once, so `ctypes.CDLL` or `casadi.external`
    can load it. The first compilation of a program, and the reason of a failure, are logged as information.

    Args:
        source: C, with no includes but the system's.
        name: Beginning of the file's name.
        flags: Flags of the compiler.

    Returns:
        Path of the library; None where there is no compiler or it failed.
    """
    try:
        compiler, directory = find_compiler(), cache_directory()
        key = "\0".join((source, " ".join(flags), _macros(compiler, tuple(flags))))
        entry = directory / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:24]}{SUFFIX}"
        if not _loads(entry):
            _report(f"compiling solver and plant code with {Path(compiler[0]).name} (once, kept in {directory})")
            _compile(compiler, source, entry, flags)
            ctypes.CDLL(str(entry))
        return entry
    except (CompilationError, OSError) as error:
        _report(f"{error}; continuing without compiled code")
        return None


def make_all(makers: Iterable[Callable[[], Path | None]]) -> bool:
    """Make libraries several at once; return whether there were any and all could be made.

    Args:
        makers: What returns the path of a library or None, as `library` does.
    """
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        made = list(threads.map(lambda make: make(), makers))
    return bool(made) and all(path is not None for path in made)


def cache_directory() -> Path:
    """Return the directory of compiled libraries: PSMPC_CACHE, else `psmpc` below XDG_CACHE_HOME or ~/.cache.

    It exists and is writable; where that is not possible, it is a temporary directory that is deleted at exit.
    """
    chosen, base = os.environ.get(CACHE_VARIABLE), os.environ.get("XDG_CACHE_HOME", "")
    try:
        # The XDG specification says that a relative XDG_CACHE_HOME is ignored.
        default = (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "psmpc"
        directory = Path(chosen).expanduser().resolve() if chosen else default
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (OSError, RuntimeError):  # it cannot be made, or the user has no home
        return _temporary_directory()
    return directory if os.access(directory, os.W_OK | os.X_OK) else _temporary_directory()


def find_compiler() -> tuple[str, ...]:
    """Return the command of the C compiler: the environment variable CC, else the first of cc, gcc, clang on PATH.

    Raises:
        CompilationError: There is none.
    """
    chosen = os.environ.get("CC", "").strip()
    commands = [shlex.split(chosen)] if chosen else [[name] for name in COMPILERS]
    for command in commands:
        if program := shutil.which(command[0]):
            return (program, *command[1:])
    found = f"CC is {chosen!r}, which is not a program" if chosen else f"none of {', '.join(COMPILERS)} on PATH"
    raise CompilationError(f"no C compiler: {found}")


@cache
def _macros(compiler: tuple[str, ...], flags: tuple[str, ...]) -> str:
    """Return the predefined macros of a compiler; they give its version, the system, machine and instruction set."""
    return _run([*compiler, *flags, "-dM", "-E", "-x", "c", os.devnull], None)


def _compile(compiler: tuple[str, ...], source: str, entry: Path, flags: Sequence[str]) -> None:
    """Compile in a temporary directory beside the entry, then rename: safe for several processes at once."""
    with tempfile.TemporaryDirectory(prefix=".making-", dir=entry.parent) as folder:
        # The file names are always the same because compilers write them into the library.
        written, made = Path(folder) / "source.c", Path(folder) / f"made{SUFFIX}"
        written.write_text(source, encoding="utf-8")
        _run([*compiler, *flags, "-fPIC", "-shared", written.name, "-o", made.name, "-lm"], written.parent)
        made.replace(entry)


def _run(command: Sequence[str], folder: Path | None) -> str:
    """Run a compiler and return its standard output."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise CompilationError(f"{command[0]} did not run: {error}") from None
    if done.returncode:
        reason = next((line for line in done.stderr.splitlines() if "error" in line), f"exit code {done.returncode}")
        raise CompilationError(f"{command[0]} failed: {reason.strip()}")
    return done.stdout


def _loads(entry: Path) -> bool:
    try:
        ctypes.CDLL(str(entry))
    except OSError:
        return False
    return True


@cache
def _temporary_directory() -> Path:
    path = Path(tempfile.mkdtemp(prefix="psmpc-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


@cache
def _report(message: str) -> None:
    logger.info(message)
