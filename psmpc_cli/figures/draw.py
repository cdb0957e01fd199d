"""Draws the figures of a log into a directory."""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from psmpc_cli.errors import InputError
from psmpc_cli.figures.registry import FIGURES
from psmpc_cli.figures.run import load_run
from psmpc_cli.figures.style import in_style
from psmpc_cli.logs.read import Log

FORMATS = ("png", "pdf", "svg")

_UNDATED: dict[str, dict[str, Any]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Metadata that keep the same log giving the same file."""


def draw(
    log: Log,
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
) -> list[Path]:
    """Draw figures of a log, each into a file a format, and return the files.

    Args:
        log: The log.
        directory: Where the files go; made where it does not exist.
        formats: Of png, pdf, svg.
        only: Names of the figures to draw; all by default.
        force: Overwrite files that exist.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: There is nothing to draw, or the log does not say what ran.
    """
    names = _chosen("figure", FIGURES if only is None else only, FIGURES)
    endings = _chosen("format", formats, FORMATS)
    targets = {name: [directory / f"{name}.{ending}" for ending in endings] for name in names}
    run = load_run(log)
    prepare(directory, [path for paths in targets.values() for path in paths], force)
    with in_style():
        for name, paths in targets.items():
            figure = FIGURES[name](run)
            for path in paths:
                figure.savefig(path, metadata=_UNDATED[path.suffix[1:]])
    return [path for paths in targets.values() for path in paths]


def default_directory(log: Path) -> Path:
    """Return where the figures of a log go by default: beside it."""
    return log.with_name(f"{log.stem}_figures")


def prepare(directory: Path, files: Iterable[Path], force: bool) -> None:
    """Make a directory and make sure that nothing is overwritten unasked.

    Raises:
        InputError: Some of the files exist and `force` is not set, or the directory cannot be made.
    """
    taken = [path.name for path in files if path.exists()]
    if taken and not force:
        raise InputError(
            f"{directory} holds {', '.join(taken)} already: choose another directory with -o, or overwrite with --force"
        )
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{directory} cannot be made: {error.strerror or error}; choose another directory with -o"
        ) from None


def _chosen(kind: str, wanted: Iterable[str], known: Collection[str]) -> list[str]:
    """Return what is wanted, each once and in the order of what is known."""
    wanted = list(wanted)
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise InputError(f"no {kind} '{unknown[0]}'; choose from {', '.join(known)}")
    return [name for name in known if name in wanted]
