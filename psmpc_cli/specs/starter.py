"""The built-in robots and tasks as files of one's own."""

import json
import re
from pathlib import Path, PurePosixPath

from psmpc_cli.errors import InputError
from psmpc_cli.specs.files import read_text
from psmpc_cli.specs.library import Kind, built_ins
from psmpc_cli.specs.schema import json_schema

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
