"""Shared libraries from C source: compiled on first use, kept in a cache by their content."""

import atexit
import ctypes
import fcntl
import hashlib
import logging
import os
import platform
import re
import shlex
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from time import time

from psmpc_cli.progress import Work
from psmpc_cli.specs.document import printable

logger = logging.getLogger(__name__)

CACHE_VARIABLE = "PSMPC_CACHE"
"""Environment variable that names the cache directory."""

COMPILERS = ("cc", "gcc", "clang")
"""Compilers looked up on PATH where the environment variable CC is not set."""

DAY = 24 * 3600.0
KEPT_FOR = 90 * DAY
"""Time after which libraries that are not used are removed [s]."""

POLL = 0.5
"""Time between two looks at what is compiled [s]."""

MAKING = ".making-"
"""Beginning of the names of folders in which libraries are made, and of locks; they stay where a process is killed."""

LIBRARY_NAME = re.compile(r"\w+-[0-9a-f]{24}(-[0-9a-f]{24})?")
"""Names of libraries in the cache, those of earlier versions included."""

SUFFIX = ".dylib" if sys.platform == "darwin" else ".so"


class CompilationError(Exception):
    """There is no compiler, or it failed; `library` reports it and returns None."""


@dataclass(frozen=True)
class Library:
    """A shared library that is compiled from C source on first use.

    Attributes:
        source: C, with no includes but the system's.
        name: Beginning of the file's name.
        flags: Flags of the compiler.
        symbols: Functions that the library must have.
    """

    source: str
    name: str
    flags: tuple[str, ...] = ("-O2",)
    symbols: tuple[str, ...] = ()

    def find(self) -> Path | None:
        """Return the library's file in the cache; None if it is not there. A damaged file is removed.

        Raises:
            CompilationError: There is no compiler.
        """
        directory = cache_directory()
        for entry in _files_by_stem(directory, directory.stat().st_mtime_ns).get(self._stem, ()):
            if _is_sound(entry) and _has_symbols(entry, self.symbols):
                _mark_used(entry)
                return entry
            entry.unlink(missing_ok=True)
        return None

    def compile(self) -> Path:
        """Compile the library into the cache and return its file. If another process compiles it, wait for that.

        Raises:
            CompilationError: There is no compiler, or it failed.
        """
        compiler = find_compiler()
        directory = cache_directory()
        with _locked(directory / f"{MAKING}{self._stem}"):
            entry = self.find() or _compile(compiler, self.source, directory, self._stem, self.flags)
        if not _has_symbols(entry, self.symbols):
            wanted = ", ".join(self.symbols) or "its functions"
            raise CompilationError(f"{_name_of(compiler)} made no library with {wanted}")
        return entry

    @property
    def _stem(self) -> str:
        """Name of the file without the digest of its content: the library's name, and a digest of all it depends on."""
        macros = _predefined_macros(find_compiler(), self.flags)
        return f"{self.name}-{_digest(chr(0).join((self.source, ' '.join(self.flags), macros)).encode())}"


def library(source: str, name: str, flags: Sequence[str] = ("-O2",), symbols: Sequence[str] = ()) -> Path | None:
    """Return the shared library of some C source, compiled now or found in the cache; None where it cannot be compiled.

    The name of the file in the cache has two digests. One is of all that the machine code depends on: source, flags,
    compiler version and machine (with `-march=native` among the flags, also the instruction set). The other is of the
    file itself. It is checked before the file is loaded, since loading a library that was cut off ends the process.
    This function has loaded the library once, so `ctypes.CDLL` or `casadi.external` can load it. The first compilation
    of a program is logged as information, and so is the reason of a failure, once.

    Args:
        source: C, with no includes but the system's.
        name: Beginning of the file's name.
        flags: Flags of the compiler.
        symbols: Functions that the library must have.

    Returns:
        Path of the library; None where there is no compiler or it failed.
    """
    return find_or_compile([Library(source, name, tuple(flags), tuple(symbols))])[0]


def find_or_compile(libraries: Sequence[Library]) -> list[Path | None]:
    """Find libraries in the cache, compile the others several at once, and return their files.

    How many are compiled is reported as progress; why one cannot be compiled is logged as information.

    Returns:
        The file of each library in the order given; None where there is no compiler or it failed, and the caller goes
        on without compiled code.
    """
    files: dict[Library, Path | None] = {}
    try:
        files = {library: library.find() for library in libraries}
        if missing := [library for library, path in files.items() if path is None]:
            files |= _compile_missing(missing)
    except (CompilationError, OSError) as error:
        _log_once(f"{error}; continuing without compiled code")
    return [files.get(library) for library in libraries]


@lru_cache(maxsize=1)
def _files_by_stem(directory: Path, changed: int) -> dict[str, list[Path]]:
    """Return the files of libraries in a cache, by their names without the digest of the content.

    Args:
        directory: The cache.
        changed: When it was changed last [ns]; as an argument, so that the list is read anew after a change.
    """
    entries: dict[str, list[Path]] = {}
    for name in os.listdir(directory):
        stem, dash, _ = name.rpartition("-")
        if dash and name.endswith(SUFFIX):  # names are stem-digest.so
            entries.setdefault(stem, []).append(directory / name)
    return entries


def _compile_missing(libraries: Sequence[Library]) -> dict[Library, Path | None]:
    """Compile libraries that the cache does not have, in several threads at once, and report progress meanwhile.

    Each thread waits for a process of the compiler. The calling thread looks every half second which have ended, and
    reports progress even where none has.

    Returns:
        The file of each library; None where the compilation failed, which is logged.

    Raises:
        CompilationError: There is no compiler.
    """
    directory = cache_directory()
    _remove_unused(directory)
    title = f"compiling solver and plant code with {_name_of(find_compiler())} (once, kept in {directory})"
    work = Work("libraries", len(libraries), title=title, small_parts=True, announced=True)
    paths: dict[Library, Path | None] = dict.fromkeys(libraries)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        library_of_job = {threads.submit(library.compile): library for library in libraries}
        running = set(library_of_job)
        while running:
            ended, running = wait(running, timeout=POLL, return_when=FIRST_COMPLETED)
            for job in ended:
                try:
                    paths[library_of_job[job]] = job.result()
                except (CompilationError, OSError) as error:
                    _log_once(f"{error}; continuing without compiled code")
                work.advance()
            work.wait()
    return paths


def compile_all(libraries: Iterable[Library]) -> bool:
    """Compile the libraries that the cache does not have; return whether there are any, and all have a file."""
    paths = find_or_compile([*libraries])
    return bool(paths) and None not in paths


def cache_directory() -> Path:
    """Return the directory in which compiled libraries are kept from run to run.

    It is that of the environment variable PSMPC_CACHE, else `psmpc` in XDG_CACHE_HOME, else `psmpc` in ~/.cache. It is
    made if it does not exist. What is in it is executed, so it must be writable for this user and for nobody else.

    Returns:
        The directory. Where it cannot be made or written to, or others may write to it, a temporary directory that is
        deleted at exit.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # The XDG specification says that a relative XDG_CACHE_HOME is ignored.
        if chosen:
            directory = Path(chosen).expanduser().resolve()
        else:
            directory = (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "psmpc"
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        is_private = _is_private(directory)
    except (OSError, RuntimeError):  # it cannot be made, or the user has no home
        return _temporary_directory()
    if not is_private:
        _log_once(
            f"{directory} belongs to or may be written by somebody else: compiled code is kept for this run alone"
        )
        return _temporary_directory()
    return directory if os.access(directory, os.W_OK | os.X_OK) else _temporary_directory()


def find_compiler() -> tuple[str, ...]:
    """Return the command of the C compiler, word by word.

    It is the environment variable CC if that is set; else the first of cc, gcc and clang on PATH; else the compiler in
    the Python package `ziglang`, which `pip install 'psmpc[compiler]'` brings.

    Raises:
        CompilationError: There is no compiler, or CC names none.
    """
    chosen = os.environ.get("CC", "").strip()
    try:
        commands = [shlex.split(chosen)] if chosen else [[name] for name in COMPILERS]
    except ValueError as error:
        raise CompilationError(f"no C compiler: CC is {chosen!r}, which is no command ({error})") from None
    for command in filter(None, commands):
        program = shutil.which(command[0])
        if program is not None:
            return (program, *command[1:])
    if not chosen and find_spec("ziglang") is not None:
        return (sys.executable, "-m", "ziglang", "cc")
    reason = f"CC is {chosen!r}, which is not a program" if chosen else f"none of {', '.join(COMPILERS)} on PATH"
    raise CompilationError(f"no C compiler: {reason}; pip install 'psmpc[compiler]' brings one")


def describe_compiler() -> str:
    """Return name and version of the compiler in one line; empty where there is none."""
    try:
        return _version_of(find_compiler())
    except CompilationError:
        return ""


@cache
def _version_of(compiler: tuple[str, ...]) -> str:
    """Return the first line of what a compiler says of its version."""
    return printable(_run_compiler([*compiler, "--version"], None).partition("\n")[0].strip())


def describe_processor() -> str:
    """Return the name of the processor, as far as the system tells it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _name_of(compiler: Sequence[str]) -> str:
    """Return what messages call a compiler."""
    return "zig cc" if "ziglang" in compiler else Path(compiler[0]).name


@cache
def _predefined_macros(compiler: tuple[str, ...], flags: tuple[str, ...]) -> str:
    """Return the predefined macros of a compiler; they give its version, the system, machine and instruction set."""
    return _run_compiler([*compiler, *flags, "-dM", "-E", "-x", "c", os.devnull], None)


def _compile(compiler: tuple[str, ...], source: str, directory: Path, name: str, flags: Sequence[str]) -> Path:
    """Compile C code into a shared library in the cache, and return its path there.

    The name of the file ends with a digest of its content, so that a damaged file is recognized later. It is compiled
    in a temporary directory inside the cache, synced to disk and then renamed: other processes never see an unfinished
    file, and neither does the next run after a crash of the machine.

    Args:
        compiler: Command of the compiler, word by word.
        source: The code.
        directory: The cache.
        name: What the name of the file begins with.
        flags: Further arguments of the compiler.

    Raises:
        CompilationError: The compiler failed, or could not be run.
    """
    with tempfile.TemporaryDirectory(prefix=MAKING, dir=directory) as folder:
        # Compilers write the names of files into the library: with constant names equal sources give equal bytes.
        source_file = Path(folder) / "source.c"
        library_file = Path(folder) / f"made{SUFFIX}"
        source_file.write_text(source, encoding="utf-8")
        _run_compiler(
            [*compiler, *flags, "-fPIC", "-shared", source_file.name, "-o", library_file.name, "-lm"], Path(folder)
        )
        library_file.chmod(0o700)
        with library_file.open("rb+") as file:
            digest = _digest(file.read())
            os.fsync(file.fileno())
        return library_file.replace(directory / f"{name}-{digest}{SUFFIX}")


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock that only one thread of all processes can have; a killed process gives it up.

    Args:
        path: Lock file, which is made and removed.
    """
    with path.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _digest(content: bytes) -> str:
    """Return the first 24 hexadecimal digits of a SHA-256 digest."""
    return hashlib.sha256(content).hexdigest()[:24]


def _is_private(path: Path) -> bool:
    """Tell whether a file or directory belongs to the user and nobody else may write to it; not so a symbolic link."""
    if not hasattr(os, "getuid"):  # a system without users
        return True
    status = path.lstat()  # of a link itself, which everybody may write to
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


_SOUND: dict[Path, tuple[int, int, int]] = {}
"""Inode, size and time of change of the files whose content was found to have the digest in their name."""


def _is_sound(entry: Path) -> bool:
    """Tell whether a library in the cache is the file that was stored there: private, and of the digest in its name.

    The content is read once in a process, and again only where the file has changed.
    """
    with suppress(OSError):
        if entry.is_file() and not entry.is_symlink() and _is_private(entry):
            status = entry.stat()
            identity = status.st_ino, status.st_size, status.st_ctime_ns
            if _SOUND.get(entry) != identity:
                if entry.stem.rpartition("-")[2] != _digest(entry.read_bytes()):
                    return False
                _SOUND[entry] = identity
            return True
    return False


def _has_symbols(entry: Path, symbols: Sequence[str]) -> bool:
    """Load a library, and tell whether that works and it has some functions."""
    try:
        loaded = ctypes.CDLL(str(entry))
    except OSError:
        return False
    return all(hasattr(loaded, symbol) for symbol in symbols)


def _mark_used(entry: Path) -> None:
    """Note that a library is used, once a day: `_remove_unused` goes by it."""
    with suppress(OSError):
        if time() - entry.stat().st_mtime > DAY:
            os.utime(entry)


def _remove_unused(directory: Path) -> None:
    """Remove libraries that were not used for `KEPT_FOR`, and what compilations left that were killed before."""
    libraries = (entry for entry in directory.glob(f"*{SUFFIX}") if LIBRARY_NAME.fullmatch(entry.stem))
    for entry in (*libraries, *directory.glob(f"{MAKING}*")):
        with suppress(OSError):
            if time() - entry.stat().st_mtime <= KEPT_FOR:
                continue
            if entry.is_dir():
                shutil.rmtree(entry)
            else:
                entry.unlink()


def _run_compiler(command: Sequence[str], folder: Path | None) -> str:
    """Run a compiler in a folder, by default the current one, and return its standard output.

    Raises:
        CompilationError: It cannot be run, or fails; the message has the first line of its output with an error.
    """
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, encoding="utf-8", errors="replace", check=False)
    except OSError as error:
        raise CompilationError(f"{command[0]} did not run: {error}") from None
    if done.returncode:
        reason = next((line for line in done.stderr.splitlines() if "error" in line), f"exit code {done.returncode}")
        raise CompilationError(f"{command[0]} failed: {reason.strip()}")
    return done.stdout


@cache
def _temporary_directory() -> Path:
    """Return a directory that is deleted at exit, the same at each call."""
    path = Path(tempfile.mkdtemp(prefix="psmpc-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


@cache
def _log_once(message: str) -> None:
    """Log a message as information, the first time that it occurs in a process."""
    logger.info(message)
