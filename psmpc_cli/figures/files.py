"""Files that figures are written into, and nothing is overwritten unasked."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from matplotlib.figure import Figure

from psmpc_cli.errors import InputError
from psmpc_cli.figures.style import in_style

T = TypeVar("T")

FORMATS = ("png", "pdf", "svg")

_UNDATED: dict[str, dict[str, Any]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Metadata that keep the same log giving the same file."""


def save(figure: Figure, paths: Iterable[Path]) -> None:
    """Write a figure into files, each in the format of its ending.

    Raises:
        InputError: One cannot be written.
    """
    for path in paths:
        try:
            figure.savefig(path, metadata=_UNDATED[path.suffix[1:]])
        except OSError as error:
            raise InputError(f"{path} cannot be written: {error.strerror or error}") from None


def draw_chosen(
    known: Mapping[str, Callable[[T], Figure]],
    of: T,
    directory: Path,
    formats: Sequence[str],
    only: Collection[str] | None,
    force: bool,
) -> list[Path]:
    """Draw figures of something, each into a file a format, and return the files.

    Args:
        known: What draws them, by name.
        of: What they are of.
        directory: Where the files go; made where it does not exist.
        formats: Of png, pdf, svg.
        only: Names of the figures to draw; None for all.
        force: Overwrite files that exist.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
    """
    names = chosen("figure", known if only is None else only, known)
    endings = chosen("format", formats, FORMATS)
    figures = {name: [directory / f"{name}.{ending}" for ending in endings] for name in names}
    files = [path for paths in figures.values() for path in paths]
    prepare(directory, files, force)
    with in_style():
        for name, paths in figures.items():
            save(known[name](of), paths)
    return files


def prepare(directory: Path, files: Iterable[Path], force: bool) -> None:
    """Make a directory and make sure that nothing is overwritten unasked.

    Raises:
        InputError: It cannot be made, or a file exists; with `force`, a file may exist.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        taken = [path.name for path in files if path.exists()]
    except OSError as error:
        raise InputError(f"{directory} cannot be made: {error.strerror or error}; choose another with -o") from None
    if taken and not force:
        raise InputError(
            f"{directory} holds {', '.join(taken)} already: choose another directory with -o, or overwrite with --force"
        )


def chosen(kind: str, wanted: Iterable[str], known: Collection[str]) -> list[str]:
    """Return what is wanted, each once and in the order of what is known.

    Raises:
        InputError: Something unknown is wanted.
    """
    wanted = list(wanted)
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise InputError(f"found no {kind} '{unknown[0]}', expected one of {', '.join(known)}")
    return [name for name in known if name in wanted]
