"""Draws the figures of a sweep into a directory."""

from collections.abc import Collection, Sequence
from pathlib import Path

from psmpc_cli.errors import LogError
from psmpc_cli.figures.files import draw_chosen
from psmpc_cli.figures.sweep.registry import FIGURES
from psmpc_cli.logs.results import Results
from psmpc_cli.simulation.sweep_cells import sweep_cells


def draw_sweep(
    results: Results,
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
) -> list[Path]:
    """Draw figures of a sweep, complete or not, by default all that go with its sampling, and return the files.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: All cells wait, or the file does not say what ran.
    """
    cells = sweep_cells(results)
    if cells.waiting.all():
        raise LogError(f"{results.path}: found no cell that was run, expected one at least to draw")
    return draw_chosen(FIGURES[cells.sampling], cells, directory, formats, only, force)
