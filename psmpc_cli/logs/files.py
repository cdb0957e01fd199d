"""The files that psmpc writes: how they are opened, and how new ones come to be without loss of old ones."""

import fcntl
import os
import re
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import Any, BinaryIO, Self, TypeVar

import h5py
import numpy as np

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.schema import FORMAT_VERSION, OLDEST_FORMAT, RUN
from psmpc_cli.logs.walk import OF_SCALES, require_harmless, require_plain_attributes, unexpected_item
from psmpc_cli.specs.document import printable, read_regular, shortened

T = TypeVar("T")

DAMAGE = (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError, MemoryError)
"""What h5py and NumPy raise for a damaged file."""

LARGEST_TEXTS = 2**28
"""Most memory for the texts of a dataset, which all take as much as the longest one [bytes]."""

HEAD = 4096
"""Bytes at the beginning of a file that tell its kind."""


@dataclass(frozen=True)
class FileKind:
    """A kind of file that commands write, and with `--force` replace.

    Attributes:
        name: What messages call it.
        beginning: What the first bytes of such a file match.
    """

    name: str
    beginning: re.Pattern[bytes]


def _kind(name: str, beginning: bytes) -> FileKind:
    return FileKind(name, re.compile(beginning, re.DOTALL))


_XML = rb"\s*(?:<\?xml[^>]*\?>\s*)?(?:<!--.*?-->\s*)*"

LOG = _kind("an HDF5 file", rb"\x89HDF\r\n\x1a\n")
PAGE = _kind("an HTML page of psmpc", rb'<!DOCTYPE html>.{0,500}<meta name="generator" content="psmpc')
TABLE = _kind("a CSV table of psmpc", rb"time \[s\],(?:state/)?Q/|name,priority,")
CLAIMS = _kind("the claims of psmpc reproduce as JSON", rb'\{\s*"format":\s*\d+,\s*"psmpc_version"')
STARTER = _kind(
    "a robot, task or schema of psmpc init",
    rb"# yaml-language-server: \$schema=\S*(?:robot|task)\.json|" + _XML + rb'<robot\b|\{\s*"\$schema".{0,200}"psmpc ',
)
BY_ENDING: Mapping[str, FileKind] = {
    "png": _kind("a PNG image", rb"\x89PNG\r\n\x1a\n"),
    "pdf": _kind("a PDF file", rb"%PDF-"),
    "svg": _kind("an SVG image", _XML + rb"(?:<!DOCTYPE svg[^>]*>\s*)?(?:<!--.*?-->\s*)*<svg\b"),
    "gif": _kind("a GIF image", rb"GIF8[79]a"),
    "mp4": _kind("an MP4 film", rb".{4}ftyp"),
}
"""Figures and films, by the endings of their files."""

_KINDS = (
    *(LOG, PAGE, CLAIMS, STARTER, *BY_ENDING.values()),
    _kind("an HTML page of another program", rb"\s*<(?:!DOCTYPE\s+html|html\b|!doctype html)"),
)
"""Kinds by which a file that stands in the way is called."""


def read_file(
    path: Path, read: Callable[[h5py.File], T], expected: str = "a log written by psmpc simulate", kind: str = ""
) -> T:
    """Open an HDF5 file of this program, also while it is being written, and read it; say what is wrong with any other.

    A file that was downloaded may be damaged or made to do harm, so its structure is checked before any value is read.

    Args:
        path: The file.
        read: Reads the open file; what it returns is returned.
        expected: What was expected, for the messages.
        kind: Kind of file that is expected, as `kind_in` tells it. By default any, and then `read` may read attributes
            of the file alone, since the check of its structure is left out.

    Returns:
        What `read` returns.

    Raises:
        LogError: The file is missing, empty, no HDF5 file, damaged, of another program, format version or kind, or not
            what `require_harmless` allows.
    """

    def unexpected(found: str) -> LogError:
        return LogError(f"{path}: found {found}, expected {expected}")

    try:
        if not path.is_file():
            raise unexpected("a directory" if path.is_dir() else "no regular file" if path.exists() else "no such file")
        if not path.stat().st_size:
            raise unexpected("an empty file")
        path.open("rb").close()  # raises the reason why a file cannot be read, which HDF5 does not say
    except OSError as error:
        raise unexpected(f"no readable file ({error.strerror or error})") from None
    if not h5py.is_hdf5(path):
        raise unexpected("no HDF5 file")
    try:
        with h5py.File(path, "r", locking=False) as file:  # not locked, since a run may go on writing it
            if not ("format_version" in file.attrs and "psmpc_version" in file.attrs):
                raise unexpected("an HDF5 file of another program")
            require_plain_attributes(file)
            _require_readable_version(path, file)
            if kind not in ("", kind_in(file)):
                raise unexpected(f"a {kind_in(file)}")
            if kind:
                require_harmless(file)
            return read(file)
    except DAMAGE as error:
        reason = (str(error) or type(error).__name__).partition("\n")[0][:200]
        raise unexpected(f"an HDF5 file that is cut off or damaged ({reason})") from None


def read_array(dataset: h5py.Dataset) -> np.ndarray:
    """Read a dataset, text as text.

    Raises:
        LogError: One of its texts is too long.
    """
    if h5py.check_string_dtype(dataset.dtype) is None:
        return np.asarray(dataset[()])
    texts = np.asarray(dataset.asstr()[()], dtype=object)
    size = texts.size * np.dtype("U1").itemsize * max(map(len, texts.flat), default=0)
    if size > LARGEST_TEXTS:
        raise unexpected_item(dataset, f"texts that take {size} bytes", f"at most {LARGEST_TEXTS}")
    return texts.astype(str)


def read_attributes(item: h5py.HLObject) -> dict[str, Any]:
    """Read the attributes of an object; ValueError if a text is not UTF-8."""
    attributes = {name: item.attrs[name] for name in item.attrs if name not in OF_SCALES}
    "".join(value for value in attributes.values() if isinstance(value, str)).encode()
    return attributes


def kind_of(path: Path) -> str:
    """Return what a file of this version holds: RUN, COMPARISON or the kind of a study.

    Raises:
        LogError: As for `read_file`.
    """
    return read_file(path, kind_in)


def kind_in(file: h5py.File) -> str:
    """Return what an open file holds; RUN if it has no attribute `kind`."""
    return printable(shortened(str(file.attrs.get("kind", RUN))))


def _require_readable_version(path: Path, file: h5py.File) -> None:
    """Raise LogError if a file has a format version that this program does not read."""
    format_version = file.attrs["format_version"]
    if format_version not in range(OLDEST_FORMAT, FORMAT_VERSION + 1):
        version, writer = (
            shortened(ascii(str(value))[1:-1]) for value in (format_version, file.attrs["psmpc_version"])
        )
        raise LogError(
            f"{path}: found log format {version}, written by psmpc {writer}; this version reads "
            f"formats {OLDEST_FORMAT} to {FORMAT_VERSION}: read it with that version, or run the experiment again"
        )


def check_output(
    path: Path,
    force: bool,
    kind: FileKind = LOG,
    option: str = "-o",
    inputs: Iterable[Path | str] = (),
) -> None:
    """Make sure, before a long computation, that its result may be written at a path and replaces nothing by mistake.

    Args:
        path: The path.
        force: Whether a file of the same kind that is there may be replaced.
        kind: Kind of file that is to be written.
        option: Option of the command line that names the path, for the messages.
        inputs: Files that the command reads, which it never writes over, or names of built-in ones.

    Raises:
        InputError: The path is a directory, a link to nothing, or a file that is read; a file is there that may not be
            replaced; or no file can be made there.
    """
    with writing(path):  # what the system says against it becomes an InputError
        if path.is_dir():
            raise InputError(f"{path} is a directory: name a file in it with {option}")
        if path.is_symlink() and not path.exists():
            raise InputError(
                f"{path} is a symbolic link to {os.readlink(path)}, where no file is: choose another file with {option}"
            )
        if not path.exists():
            ensure_creatable(path.parent, option)
            return
        if any(os.path.exists(input_path) and os.path.samefile(input_path, path) for input_path in inputs):
            raise InputError(f"{path} is read by this command: choose another file with {option}")
        if not force:
            raise InputError(f"{path} exists already: choose another file with {option}, or overwrite it with --force")
        other_kind = _name_of_other_kind(path, kind)
        if other_kind:
            raise InputError(
                f"{path}: found {other_kind}, expected {kind.name}, which --force replaces; "
                f"choose another file with {option}"
            )
        ensure_creatable(path.resolve().parent, option)  # resolved: a link is replaced where it leads to


def _name_of_other_kind(path: Path, kind: FileKind) -> str:
    """Return what messages call a file that one of a kind must not replace; empty if it is empty or of that kind."""
    if not path.is_file():
        return "no regular file"
    if not path.stat().st_size:
        return ""
    head = read_regular(path, HEAD, cut=True)
    if kind.beginning.match(head):
        return ""
    names = (known_kind.name for known_kind in _KINDS if known_kind.beginning.match(head))
    return next(names, "a text file" if head.isascii() and b"\0" not in head else "a file of another kind")


def ensure_creatable(folder: Path, option: str = "-o") -> None:
    """Raise InputError if no file can be made in a folder, or where that is to be made itself."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise InputError(f"{existing} is no directory, but files go there: choose another place with {option}")
    try:
        TemporaryFile(dir=existing).close()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(
            f"{existing.resolve()} cannot be written: {reason}; choose another place with {option}"
        ) from None


def image_of(file: h5py.File) -> bytes:
    """Return the bytes of a file that is open in memory."""
    file.flush()
    image: bytes = file.id.get_file_image()
    return image


def new_image(fill: Callable[[h5py.File], None]) -> bytes:
    """Create an HDF5 file in memory, its metadata with checksums, fill it, and return its bytes."""
    with h5py.File("memory", "w", driver="core", backing_store=False, libver="latest") as file:
        fill(file)
        return image_of(file)


def write_new(
    path: Path,
    image: bytes,
    force: bool = False,
    kind: FileKind = LOG,
    option: str = "-o",
    inputs: Iterable[Path | str] = (),
    replace: Callable[[bytes], None] | None = None,
) -> None:
    """Write a new file, whole or not at all: a kill at any moment leaves no half of it.

    Its folder is created if necessary.

    Args:
        path: The path.
        image: Content of the file.
        force: Whether a file of the same kind that is there may be replaced.
        kind: Kind of the file.
        option: Option of the command line that names the path, for the messages.
        inputs: Files that the command reads, which it never writes over.
        replace: Called with the content to put it in the place of a file that is locked, see `FileLock.replace`; by
            default a new file is written beside the old one and takes its place.

    Raises:
        InputError: The path is taken, see `check_output`, or the file cannot be written.
    """
    with writing(path):
        check_output(path, force, kind, option, inputs)
        path.parent.mkdir(parents=True, exist_ok=True)
        if replace is None:
            replace_file(path, image)
        else:
            replace(image)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn errors of the system while a file is written into an InputError that names the file.

    Raises:
        InputError: The file, or its folder, cannot be written.
    """
    try:
        yield
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{path} cannot be written: {path.parent} is no directory; choose another with -o") from None
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None


def replace_file(path: Path, image: bytes) -> None:
    """Put a file in the place of the one at a path, in one step.

    Raises:
        OSError: It cannot be written; the one that was there stays.
    """
    with replacing(path) as part:
        part.write_bytes(image)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Provide a temporary path to write to; when it is written, the file there replaces the one at `path` in one step.

    The temporary file stands in the same folder, with the same ending, and has a name that nobody can guess: so no one
    can put a link there beforehand that leads the writing elsewhere.

    Yields:
        The temporary path, at which an empty file is.

    Raises:
        OSError: It cannot be written; the file that was there stays.
    """
    target = path.resolve()
    new_file = target.with_name(f".{secrets.token_hex(16)}.part{target.suffix}")
    new_file.open("xb").close()  # exclusively: fails if anything stands there, and follows no link
    try:
        yield new_file
        os.replace(new_file, target)
    finally:
        new_file.unlink(missing_ok=True)


class FileLock:
    """The sole right to fill in a file, which ends with its process, however that ends.

    The lock is on the file itself. Each file that takes its place is locked beforehand, so that whoever locks the one
    at the path has the right. It is a record lock: HDF5 and programs that read the file use others.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._locked: BinaryIO | None = None

    def __enter__(self) -> Self:
        """Lock the file, if there is one, so that no other process fills it in meanwhile.

        Another process may replace the file between opening and locking it. Then the lock is on a file that is gone,
        and the new one is locked instead.

        Raises:
            InputError: Another process has the lock, or the file cannot be opened for writing.
        """
        with writing(self.path):  # what the system says against it becomes an InputError
            while self._locked is None and self.path.exists():
                file = self.path.open("rb+")
                if not _could_lock(file):
                    file.close()
                    raise InputError(
                        f"{self.path} is being filled in by another process: wait for its end, or choose another file "
                        "with -o"
                    )
                if _is_at(file, self.path):
                    self._locked = file
                else:
                    file.close()  # another one took its place meanwhile
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._unlock()

    def replace(self, image: bytes) -> None:
        """Put a file, locked, in the place of the one at the path, in one step.

        Raises:
            OSError: It cannot be written; the one that was there stays.
        """
        with replacing(self.path) as part:
            file = part.open("rb+")
            _could_lock(file)  # always: nobody else knows the new file
            file.write(image)
            file.flush()
        self._unlock()
        self._locked = file

    def _unlock(self) -> None:
        if self._locked is not None:
            self._locked.close()


def _could_lock(file: BinaryIO) -> bool:
    """Lock an open file if no other process has locked it, and tell whether that is so."""
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _is_at(file: BinaryIO, path: Path) -> bool:
    """Tell whether an open file is the one at a path."""
    return path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())
