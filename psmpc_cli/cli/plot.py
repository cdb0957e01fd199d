"""`psmpc plot`: the figures, and an animation, of any log, of a comparison, or of a study's results."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from psmpc_cli.cli.options import FOLDERS
from psmpc_cli.errors import InputError, LogError


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
    from psmpc_cli.figures.animation import mp4_possible
    from psmpc_cli.figures.registry import default_directory, draw
    from psmpc_cli.logs.files import kind_of
    from psmpc_cli.logs.run import read_comparison
    from psmpc_cli.logs.schema import COMPARISON, RUN

    films = [name for name, chosen in (("animation", animate), ("render", render)) if chosen]
    kind = RUN if run is not None else kind_of(log)
    directory = output or (default_directory(log) if run is None else default_directory(log) / run)
    if films and kind != RUN:
        instead = "but a run of it is: choose one with --run" if kind == COMPARISON else "but the log of a run is"
        raise InputError(f"--{'animate' if animate else 'render'}: a {kind} is not animated, {instead}")
    if run is None:
        subject = _subject(kind, log)
    else:
        logs = read_comparison(log)
        if run not in logs:
            raise InputError(f"--run: found no run '{run}' in {log}, expected one of {', '.join(logs)}")
        subject = logs[run]
    for path in draw(kind.replace("-", "_"), subject, directory, formats or ("png",), only or None, force, films):
        typer.echo(str(path))
    if films and not mp4_possible():
        typer.echo("psmpc: no MP4 was written: found no ffmpeg on the PATH", err=True)


def _subject(kind: str, path: Path) -> object:
    """Return what is drawn of a file of this kind.

    Raises:
        LogError: The file is damaged, or there is nothing to draw of its kind.
    """
    from psmpc_cli.logs.results import read_results
    from psmpc_cli.logs.run import read_comparison, read_run
    from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, RUN, SWEEP
    from psmpc_cli.studies.fronts import read_pareto
    from psmpc_cli.studies.monte_carlo import read_monte_carlo
    from psmpc_cli.studies.weights import sweep_cells

    read: dict[str, Callable[[Path], object]] = {
        RUN: read_run,
        COMPARISON: read_comparison,
        PARETO: read_pareto,
        SWEEP: lambda path: sweep_cells(read_results(path, SWEEP)),
        MONTE_CARLO: read_monte_carlo,
    }
    if kind not in read:
        raise LogError(f"{path}: found a {kind}, expected a log or one of: {', '.join(kind for kind in read)}")
    return read[kind](path)
