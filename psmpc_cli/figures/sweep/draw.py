"""Draws the figures of a sweep into a directory."""

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path

from psmpc_cli.errors import LogError
from psmpc_cli.experiment.sweep_cells import sweep_cells
from psmpc_cli.figures.files import FORMATS, chosen, write_figures
from psmpc_cli.figures.sweep.registry import FIGURES
from psmpc_cli.logs.results import Results


def draw_sweep(
    results: Results,
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
) -> list[Path]:
    """Draw figures of a sweep, complete or not, each into a file a format, and return the files.

    Args:
        results: What the sweep's file holds.
        directory: Where the files go; made where it does not exist.
        formats: Of png, pdf, svg.
        only: Names of the figures to draw; by default all that go with its sampling.
        force: Overwrite files that exist.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: All cells wait, or the file does not say what ran.
    """
    cells = sweep_cells(results)
    known = FIGURES[cells.sampling]
    names = chosen("figure", known if only is None else only, known)
    endings = chosen("format", formats, FORMATS)
    if cells.waiting.all():
        raise LogError(f"{results.path}: found no cell that was run, expected one at least to draw")
    return write_figures({name: partial(known[name], cells) for name in names}, directory, endings, force)
