"""`psmpc plot`: the figures, and an animation, of any log."""

from pathlib import Path

import typer


def plot(
    log: Path = typer.Argument(..., help="Log written by psmpc simulate (HDF5).", show_default=False),
    output: Path | None = typer.Option(
        None, "-o", "--output", metavar="DIR", help="Directory of the figures; default <log>_figures beside the log."
    ),
    formats: list[str] = typer.Option(["png"], "--format", metavar="png|pdf|svg", help="File format; may be repeated."),
    only: list[str] | None = typer.Option(
        None, "--only", metavar="NAME", help="Draw this figure only; may be repeated. A wrong name lists them."
    ),
    animate: bool = typer.Option(False, "--animate", help="Also write a GIF of the robot moving, and MP4 with ffmpeg."),
    force: bool = typer.Option(False, "--force", help="Overwrite files that exist."),
) -> None:
    """Draw the figures of a log: states, velocities, controls, forces, errors, instants, snapshots, solve_time."""
    from psmpc_cli.figures.draw import default_directory, draw
    from psmpc_cli.logs.read import read_log

    directory = default_directory(log) if output is None else output
    for path in draw(read_log(log), directory, formats, only or None, force, animate):
        typer.echo(str(path))
