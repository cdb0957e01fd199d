"""The built-in robots and tasks, the files that references mean, starter files, and JSON Schemas for editors.

What reads descriptions is imported where it is needed: `psmpc --help` names the built-in tasks, and answers at once.
"""

import json
import os
import re
from pathlib import Path
from typing import Any, Literal

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.files import read_text, shown

Kind = Literal["robot", "task"]

KINDS: tuple[Kind, ...] = ("robot", "task")

_MODE_LINE = re.compile(r"(?<=\$schema=)\S*/(?=(?:robot|task)\.json)")
_ROBOT_LINE = re.compile(r"^robot: *([^\s#]+)", re.MULTILINE)


def built_ins(kind: Kind) -> dict[str, Path]:
    """Return the built-in robots or tasks by name: in the package as installed, beside it in a source tree."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "builtin" / f"{kind}s"
    folder = installed if installed.is_dir() else package.parent / f"{kind}s"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find(kind: Kind, reference: str | Path, beside: Path | None = None) -> Path:
    """Return the file that a reference to a robot or task means: the path of a file, or else a built-in name.

    A folder that happens to have the name of a built-in does not hide it.

    Args:
        kind: Which built-ins there are to choose from.
        reference: The path or the name, as the user has written it.
        beside: Folder that a relative path begins in; by default the working directory.

    Raises:
        SpecError: There is no such file and no such built-in.
    """
    from psmpc_cli.specs.document import choice, quoted

    path = Path(reference) if beside is None else beside / reference
    built_in_files = built_ins(kind)
    if os.path.lexists(path) and not (os.path.isdir(path) and str(reference) in built_in_files):
        return path
    if str(reference) in built_in_files:
        return built_in_files[str(reference)]
    options = choice(Path(reference).stem, built_in_files)
    where = f"{reference}: " if beside is None else ""
    raise SpecError(f"{where}found no file {quoted(shown(path))}{options}: a built-in {kind}, or the path of a file")


def json_schema(kind: Kind) -> dict[str, Any]:
    """Return the JSON Schema of one kind of description."""
    if kind == "task":
        from psmpc_cli.specs.task import TaskSpec

        schema = TaskSpec.model_json_schema()
    else:
        from pydantic import TypeAdapter

        from psmpc_cli.specs.robots.robot import PlanarRobot, SpatialRobot, UrdfRobot

        schema = TypeAdapter(PlanarRobot | SpatialRobot | UrdfRobot).json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"psmpc {kind}", **schema}


def starter_files(folder: Path) -> dict[Path, str]:
    """Return the texts of all built-in robots and tasks and their schemas, by the path that each has in a folder.

    Tasks refer to the copied robots, so that editing those has an effect; editors find the copied schemas.
    """
    files = {folder / "schema" / f"{kind}.json": json.dumps(json_schema(kind), indent=2) + "\n" for kind in KINDS}
    for path in starter_sources():
        text = _MODE_LINE.sub("../schema/", read_text(path), count=1)
        text = _ROBOT_LINE.sub(lambda found: f"robot: ../robots/{found[1]}.yaml", text, count=1)
        files[folder / path.parent.name / path.name] = text
    return files


def starter_sources() -> list[Path]:
    """Return the files of the built-in robots, with their URDFs, and tasks."""
    robots = built_ins("robot")
    urdfs = next(iter(robots.values())).parent.glob("*.urdf")
    return [*urdfs, *robots.values(), *built_ins("task").values()]
