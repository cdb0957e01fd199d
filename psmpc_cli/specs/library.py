"""Where the built-in robots and tasks are, and what a reference to a description stands for."""

import os
from pathlib import Path
from typing import Literal

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.problem import quoted, suggestion

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
