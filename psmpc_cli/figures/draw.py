"""Draws the figures of a log into a directory."""

from collections.abc import Collection, Sequence
from pathlib import Path

from psmpc_cli.figures.animation import animation_files, write_animation
from psmpc_cli.figures.files import FORMATS, chosen, prepare, save
from psmpc_cli.figures.registry import FIGURES
from psmpc_cli.figures.rendering import offscreen_driver, write_rendering
from psmpc_cli.figures.run import load_run
from psmpc_cli.figures.style import in_style
from psmpc_cli.logs.read import Log


def draw(
    log: Log,
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
    animate: bool = False,
    render: bool = False,
) -> list[Path]:
    """Draw figures of a log, each into a file a format, and return the files.

    Args:
        log: The log.
        directory: Where the files go; made where it does not exist.
        formats: Of png, pdf, svg.
        only: Names of the figures to draw; all by default.
        force: Overwrite files that exist.
        animate: Write an animation of the robot as well.
        render: Write a film of it in three dimensions, by MuJoCo's renderer, as well.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written, or there is no renderer.
        LogError: There is nothing to draw, or the log does not say what ran.
        RunError: A film could not be rendered or encoded.
    """
    names = chosen("figure", FIGURES if only is None else only, FIGURES)
    endings = chosen("format", formats, FORMATS)
    figures = [(name, [directory / f"{name}.{ending}" for ending in endings]) for name in names]
    films = animation_files(directory) if animate else []
    rendered = animation_files(directory, "render") if render else []
    files = [*(path for _, paths in figures for path in paths), *films, *rendered]
    if render:
        offscreen_driver()
    run = load_run(log)
    prepare(directory, files, force)
    with in_style():
        for name, paths in figures:
            save(FIGURES[name](run), paths)
        for path in films:
            write_animation(run, path)
        if render:
            write_rendering(run, rendered)
    return files


def default_directory(log: Path) -> Path:
    """Return where the figures of a log go by default: beside it, into a folder of its name."""
    log = log if log.name else log.resolve()
    return log.with_suffix("") if log.suffix else log.parent / f"{log.name}_figures"
