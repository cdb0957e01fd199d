"""`psmpc plot`: the figures, and an animation, of any log, of a comparison, or of a study's results."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from psmpc_cli.cli.options import FOLDERS
from psmpc_cli.errors import InputError, LogError

Draw = Callable[[Path, Path, Sequence[str], Collection[str] | None, bool], list[Path]]
"""Draws the figures of a file into a directory, in some formats, only some of them, overwriting what exists."""


def plot(
    log: Annotated[Path, typer.Argument(help="A log, or results of any study.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help=f"Directory of the figures. {FOLDERS} Default: beside the log."
        ),
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
    render: Annotated[
        bool, typer.Option("--render", help="Film the run with MuJoCo's renderer as well; needs psmpc[mujoco].")
    ] = False,
    run: Annotated[
        str | None, typer.Option("--run", metavar="NAME", help="Draw the figures of this run of a comparison.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")] = False,
) -> None:
    """Draw the figures of a log: states, velocities, controls, forces, errors, instants, shares, snapshots, solve_time.

    Of a comparison: states, instants, shares and snapshots side by side. Of a Pareto study: its fronts. Of a
    sweep: surface, heat_map (of random draws: draws), starts and sensitivity. Of a Monte Carlo study: success and runs.
    """
    from psmpc_cli.figures.draw import default_directory, draw
    from psmpc_cli.logs.comparison import read_comparison
    from psmpc_cli.logs.read import kind_of, read_log
    from psmpc_cli.logs.schema import COMPARISON, RUN

    directory, endings = output or default_directory(log), formats or ("png",)
    if run is not None:
        logs = read_comparison(log)
        if run not in logs:
            raise InputError(f"--run: found no run '{run}' in {log}, expected one of {', '.join(logs)}")
        drawn = draw(logs[run], output or directory / run, endings, only or None, force, animate, render)
    elif (kind := kind_of(log)) == RUN:
        drawn = draw(read_log(log), directory, endings, only or None, force, animate, render)
    elif animate or render:
        instead = "but a run of it is: choose one with --run" if kind == COMPARISON else "but the log of a run is"
        raise InputError(f"--{'animate' if animate else 'render'}: a {kind} is not animated, {instead}")
    else:
        drawing = _drawing()
        if kind not in drawing:
            raise LogError(f"{log}: found a {kind}, expected a log or one of: {', '.join(drawing)}")
        drawn = drawing[kind](log, directory, endings, only or None, force)
    for path in drawn:
        typer.echo(str(path))


def _drawing() -> Mapping[str, Draw]:
    """Return what draws each kind of file but the log of a run."""
    from psmpc_cli.figures.comparison.draw import draw_comparison
    from psmpc_cli.figures.monte_carlo import draw_monte_carlo
    from psmpc_cli.figures.pareto import draw_pareto
    from psmpc_cli.figures.sweep.draw import draw_sweep
    from psmpc_cli.logs.comparison import read_comparison
    from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, SWEEP
    from psmpc_cli.simulation.monte_carlo_runs import read_monte_carlo
    from psmpc_cli.studies.pareto_file import read_pareto
    from psmpc_cli.studies.sweep_file import read_sweep

    return {
        COMPARISON: lambda path, *rest: draw_comparison(read_comparison(path), *rest),
        PARETO: lambda path, *rest: draw_pareto(read_pareto(path), *rest),
        SWEEP: lambda path, *rest: draw_sweep(read_sweep(path), *rest),
        MONTE_CARLO: lambda path, *rest: draw_monte_carlo(read_monte_carlo(path), *rest),
    }
