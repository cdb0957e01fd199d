"""Draws the figures of a log into a directory."""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from psmpc_cli.errors import InputError
from psmpc_cli.figures.animation import animation_files, write_animation
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
    animate: bool = False,
) -> list[Path]:
    """Draw figures of a log, each into a file a format, and return the files.

    Args:
        log: The log.
        directory: Where the files go; made where it does not exist.
        formats: Of png, pdf, svg.
        only: Names of the figures to draw; all by default.
        force: Overwrite files that exist.
        animate: Write an animation of the robot as well.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: There is nothing to draw, or the log does not say what ran.
        RunError: The animation could not be encoded.
    """
    names = _chosen("figure", FIGURES if only is None else only, FIGURES)
    endings = _chosen("format", formats, FORMATS)
    figures = [(name, [directory / f"{name}.{ending}" for ending in endings]) for name in names]
    films = animation_files(directory) if animate else []
    files = [*(path for _, paths in figures for path in paths), *films]
    run = load_run(log)
    _prepare(directory, files, force)
    with in_style():
        for name, paths in figures:
            _save(FIGURES[name](run), paths)
        for path in films:
            write_animation(run, path)
    return files


def default_directory(log: Path) -> Path:
    """Return where the figures of a log go by default: beside it, into a folder of its name."""
    return log.with_suffix("") if log.suffix else log.with_name(f"{log.name}_figures")


def _save(figure: Figure, paths: Iterable[Path]) -> None:
    for path in paths:
        try:
            figure.savefig(path, metadata=_UNDATED[path.suffix[1:]])
        except OSError as error:
            raise InputError(f"{path} cannot be written: {error.strerror or error}") from None


def _prepare(directory: Path, files: Iterable[Path], force: bool) -> None:
    """Make a directory and make sure that nothing is overwritten unasked."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        taken = [path.name for path in files if path.exists()]
    except OSError as error:
        raise InputError(f"{directory} cannot be made: {error.strerror or error}; choose another with -o") from None
    if taken and not force:
        raise InputError(
            f"{directory} holds {', '.join(taken)} already: choose another directory with -o, or overwrite with --force"
        )


def _chosen(kind: str, wanted: Iterable[str], known: Collection[str]) -> list[str]:
    """Return what is wanted, each once and in the order of what is known."""
    wanted = list(wanted)
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise InputError(f"found no {kind} '{unknown[0]}', expected one of {', '.join(known)}")
    return [name for name in known if name in wanted]
