"""Options that commands share, and the paths of what they write."""

import logging
import os
from collections.abc import Iterator
from itertools import count, pairwise
from pathlib import Path
from typing import Annotated, Any

import typer

from psmpc_cli.errors import InputError

RUNS = Path("runs")
"""Folder of the default outputs."""

TASK = "Task file, or the name of a built-in task such as transport."


def _set_log_level(quiet: bool) -> bool:
    """Choose which messages of the library are printed: warnings and the compilation, which comes once, or errors."""
    logging.getLogger("psmpc_cli").setLevel(logging.ERROR if quiet else logging.WARNING)
    logging.getLogger("psmpc_cli.native").setLevel(logging.ERROR if quiet else logging.INFO)
    return quiet


Changes = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change any key of the task; repeatable.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files of an earlier command.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures beside the file.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", callback=_set_log_level, help="No progress, no warnings and no summary.")
]
Jobs = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Processes at once. Default: one a core.", show_default=False)
]
Dask = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Run on the Dask cluster with this scheduler.")]
Resume = Annotated[bool, typer.Option("--resume", help="Continue a study that was stopped, in its file.")]


def output_option(default: str, metavar: str = "FILE", what: str = "Results.") -> Any:
    """Build the option -o of a command whose default output is `default`."""
    help = f"{what} Missing folders are made. Default: {default}{', numbered' if '/' in default else ''}."
    return typer.Option("-o", "--output", metavar=metavar, help=help, show_default=False)


def output_file(given: Path | None, name: str, force: bool, figures: bool, resume: bool = False) -> Path:
    """Choose the file that a command writes and make sure that nothing is overwritten unasked.

    Args:
        given: The path after -o; by default the first of runs/NAME.h5, runs/NAME-2.h5, ... that neither exists nor has
            a folder of figures.
        name: Stem of the default.
        force: Overwrite an existing file; by default runs/NAME.h5.
        figures: Whether figures are drawn beside the file.
        resume: Continue an existing file; by default the last of those above.

    Raises:
        InputError: The file or its folder of figures exists and is not to be overwritten, or cannot be written.
    """
    from psmpc_cli.figures.registry import default_directory
    from psmpc_cli.logs.files import check_output

    default = RUNS / f"{name}.h5"
    if resume:
        return given or next(path for path, later in pairwise(_numbered(default)) if not later.exists())
    path = given or free_path(default, force)
    check_output(path, force)
    if figures:
        ensure_fillable(default_directory(path), force, "with --force, or leave the figures out with --no-figures")
    return path


def free_path(default: Path, force: bool) -> Path:
    """Choose the first of NAME, NAME-2, ... that neither exists nor has a folder of figures; NAME itself if forced."""
    return default if force else next(p for p in _numbered(default) if not (p.exists() or p.with_suffix("").exists()))


def _numbered(path: Path) -> Iterator[Path]:
    """Yield a path NAME and then NAME-2, NAME-3 and so on, with its ending."""
    return (path if number == 1 else path.with_stem(f"{path.stem}-{number}") for number in count(1))


def ensure_fillable(folder: Path, force: bool, overwrite: str = "with --force") -> None:
    """Raise InputError if a folder is no folder, is read-only, or has files that are not to be overwritten."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise InputError(f"{existing} is no directory, but files go there: choose another place with -o")
    if not os.access(existing, os.W_OK):
        raise InputError(f"{folder} cannot be written: {existing.resolve()} is read-only; choose another with -o")
    if folder.exists() and any(folder.iterdir()) and not force:
        raise InputError(f"{folder} holds files already: choose another place with -o, overwrite {overwrite}")
