"""Draws the figures of a comparison into a directory."""

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path

from psmpc_cli.figures.comparison.registry import FIGURES
from psmpc_cli.figures.files import FORMATS, chosen, write_figures
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

    Args:
        logs: Logs of one task, by controller.
        directory: Where the files go; made where it does not exist.
        formats: Of png, pdf, svg.
        only: Names of the figures to draw; all by default.
        force: Overwrite files that exist.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: There is nothing to draw, or a log does not say what ran.
    """
    names = chosen("figure", FIGURES if only is None else only, FIGURES)
    endings = chosen("format", formats, FORMATS)
    runs = {name: load_run(log) for name, log in logs.items()}
    return write_figures({name: partial(FIGURES[name], runs) for name in names}, directory, endings, force)
