"""`psmpc plot`: the figures, and an animation, of any log, or of a comparison."""

from pathlib import Path
from typing import Annotated

import typer

from psmpc_cli.errors import InputError


def plot(
    log: Annotated[Path, typer.Argument(help="A log written by psmpc simulate, or a file written by psmpc compare.")],
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
    run: Annotated[
        str | None, typer.Option("--run", metavar="NAME", help="Draw the figures of this run of a comparison.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")] = False,
) -> None:
    """Draw the figures of a log: states, velocities, controls, forces, errors, instants, shares, snapshots, solve_time.

    Of a comparison: states, instants, shares and snapshots side by side.
    """
    from psmpc_cli.figures.comparison.draw import draw_comparison
    from psmpc_cli.figures.draw import default_directory, draw
    from psmpc_cli.logs.comparison import read_comparison
    from psmpc_cli.logs.layout import COMPARISON
    from psmpc_cli.logs.read import kind_of, read_log

    directory, endings = output or default_directory(log), formats or ("png",)
    if run is not None:
        logs = read_comparison(log)
        if run not in logs:
            raise InputError(f"--run: found no run '{run}' in {log}, expected one of {', '.join(logs)}")
        drawn = draw(logs[run], output or directory / run, endings, only or None, force, animate)
    elif kind_of(log) == COMPARISON:
        if animate:
            raise InputError("--animate: a comparison is not animated, but a run of it is: choose one with --run")
        drawn = draw_comparison(read_comparison(log), directory, endings, only or None, force)
    else:
        drawn = draw(read_log(log), directory, endings, only or None, force, animate)
    for path in drawn:
        typer.echo(str(path))
