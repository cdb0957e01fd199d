"""Draws the figures of a comparison into a directory."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from psmpc_cli.figures.comparison.registry import FIGURES
from psmpc_cli.figures.files import draw_chosen
from psmpc_cli.figures.run import load_run
from psmpc_cli.logs.read import Log


def draw_comparison(
    logs: Mapping[str, Log],
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
) -> list[Path]:
    """Draw figures of a comparison, each into a file a format, and return the files.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: There is nothing to draw, or a log does not say what ran.
    """
    runs = {name: load_run(log) for name, log in logs.items()}
    return draw_chosen(FIGURES, runs, directory, formats, only, force)
