"""`psmpc plot`: the figures, and an animation, of any log."""

from pathlib import Path
from typing import Annotated

import typer


def plot(
    log: Annotated[Path, typer.Argument(help="A log written by psmpc simulate.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Directory of the figures. Default: beside the log."),
    ] = None,
    formats: Annotated[
        list[str] | None, typer.Option("--format", metavar="png|pdf|svg", help="File format; repeatable. Default: png.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help="Draw this figure only; repeatable. A wrong name lists them all."),
    ] = None,
    animate: Annotated[
        bool, typer.Option("--animate", help="Write a GIF of the robot moving as well, and an MP4 if ffmpeg is there.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")] = False,
) -> None:
    """Draw the figures of a log: states, velocities, controls, forces, errors, instants, snapshots, solve_time."""
    from psmpc_cli.figures.draw import default_directory, draw
    from psmpc_cli.logs.read import read_log

    directory = default_directory(log) if output is None else output
    for path in draw(read_log(log), directory, formats or ("png",), only or None, force, animate):
        typer.echo(str(path))
