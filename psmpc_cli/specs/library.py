"""Where the built-in robots and tasks are, and what a reference to a description stands for."""

import json
import os
import re
import stat
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from psmpc_cli.errors import InputError, SpecError
from psmpc_cli.specs.messages import quoted, suggestion
from psmpc_cli.specs.robot import RobotSpec
from psmpc_cli.specs.task import TaskSpec

LARGEST_FILE = 2**20
"""Bytes of a description; the built-in ones have some three thousand."""

_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_text(path: Path) -> str:
    """Return the text of a regular UTF-8 file.

    Raises:
        SpecError: It is missing, unreadable, no regular file, too large or not UTF-8.
    """
    try:
        status = path.stat()
        kind = next((name for test, name in _KINDS if test(status.st_mode)), None)
        if kind is not None:
            raise SpecError(f"{path}: found {kind}, expected a YAML file")
        if status.st_size > LARGEST_FILE:
            raise SpecError(f"{path}: found {status.st_size} bytes, expected a YAML file of at most {LARGEST_FILE}")
        content = _bounded(path)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise SpecError(f"{path}: found no readable file ({reason}), expected a YAML file") from None
    return _decode(path, content)


def _bounded(path: Path) -> bytes:
    """Read at most `LARGEST_FILE` bytes, and never wait for a writer."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(descriptor, "rb") as file:
        content = file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise SpecError(f"{path}: found more than {LARGEST_FILE} bytes, expected a YAML file of at most so many")
    return content


def _decode(path: Path, content: bytes) -> str:
    """Decode UTF-8, with or without a byte order mark."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - (content.rfind(b"\n", 0, error.start) + 1) + 1
        raise SpecError(
            f"{path}:{line}:{column}: found the byte 0x{content[error.start]:02x}, expected UTF-8 text"
        ) from None


Kind = Literal["robot", "task"]


def folder(kind: Kind) -> Path:
    """Return the folder of the built-in robots or tasks: in the package as installed, beside it in a source tree."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "builtin" / f"{kind}s"
    return installed if installed.is_dir() else package.parent / f"{kind}s"


def built_ins(kind: Kind) -> dict[str, Path]:
    """Return the built-in robots or tasks by name."""
    return {path.stem: path for path in sorted(folder(kind).glob("*.yaml"))}


def find(kind: Kind, reference: str | Path, beside: Path | None = None) -> Path:
    """Return the file a reference stands for: a path (relative to the folder `beside`), else a built-in name.

    Raises:
        SpecError: There is no such file and no such built-in.
    """
    try:
        return look_up(kind, reference, beside)
    except LookupError as error:
        raise SpecError(f"{reference}: {error.args[0]}") from None


def look_up(kind: Kind, reference: str | Path, beside: Path | None = None) -> Path:
    """Do the work of `find`.

    Raises:
        LookupError: What was found and expected instead.
    """
    path = Path(reference) if beside is None else beside / reference
    known = built_ins(kind)
    if _exists(path) and not (os.path.isdir(path) and str(reference) in known):
        return path
    if str(reference) in known:
        return known[str(reference)]
    near = suggestion(Path(reference).stem, known)
    hint = f' (did you mean "{near}"?)' if near else ""
    options = ", ".join(known) or "of which there is none"
    raise LookupError(f"found no file {quoted(shown(path))}{hint}, expected a path or a built-in {kind}: {options}")


def shown(path: Path) -> str:
    """Return how messages name a path: relative to where the user is, if it is below."""
    relative = os.path.relpath(path) if path.is_absolute() else str(path)
    return str(path) if relative.startswith(os.pardir) else relative


def _exists(path: Path) -> bool:
    """Tell whether something is at a path, even if it cannot be read."""
    try:
        return path.exists()
    except ValueError:
        return False
    except OSError:
        return True


DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(kind: Kind) -> dict[str, Any]:
    """Return the JSON Schema of one kind of description."""
    model = RobotSpec if kind == "robot" else TaskSpec
    schema = _untitled(model.model_json_schema())
    return {"$schema": DIALECT, "title": f"psmpc {kind}", **schema}


def json_schemas() -> dict[str, Any]:
    """Return the JSON Schema of both kinds, by kind."""
    return {"robot": json_schema("robot"), "task": json_schema("task")}


def _untitled(schema: Any) -> Any:
    """Return a schema without the titles that only repeat the keys."""
    if isinstance(schema, dict):
        return {
            key: _untitled(value) for key, value in schema.items() if not (key == "title" and isinstance(value, str))
        }
    return [_untitled(item) for item in schema] if isinstance(schema, list) else schema


KINDS: tuple[Kind, ...] = ("robot", "task")

_MODE_LINE = re.compile(r"(?<=\$schema=)\S*/(?=(?:robot|task)\.json)")
_ROBOT_LINE = re.compile(r"^robot: *([^\s#]+)", re.MULTILINE)


def starter_files() -> dict[str, str]:
    """Return the texts of all built-in robots and tasks and their schemas, by relative path.

    Tasks refer to the copied robots, so that editing those has an effect; editors find the copied schemas.
    """
    files = {f"schema/{kind}.json": json.dumps(json_schema(kind), indent=2) + "\n" for kind in KINDS}
    for kind in KINDS:
        for path in built_ins(kind).values():
            text = _MODE_LINE.sub("../schema/", read_text(path), count=1)
            files[f"{kind}s/{path.name}"] = _ROBOT_LINE.sub(_to_copy, text, count=1) if kind == "task" else text
    return dict(sorted(files.items()))


def write_starter(folder: Path, overwrite: bool) -> list[Path]:
    """Write the starter files into a folder and return their paths.

    Raises:
        InputError: A file is there already and may not be overwritten (nothing is written then), or cannot be.
    """
    files = {folder / PurePosixPath(name): text for name, text in starter_files().items()}
    try:
        there = [str(path) for path in files if path.exists() or path.is_symlink()]
        if there and not overwrite:
            raise InputError(f"found {', '.join(there)}, expected no such file (--force overwrites)")
        for path, text in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"{error.filename or folder}: found no place to write to ({error.strerror})") from None
    return list(files)


def _to_copy(match: re.Match[str]) -> str:
    """Let a task refer to the copied robot."""
    return f"robot: ../robots/{match[1]}.yaml" if match[1] in built_ins("robot") else match[0]
