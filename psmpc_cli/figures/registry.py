"""Every figure in one table, and what draws them into files."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.figures import coordinates, instants, monte_carlo, pareto, reproduction, snapshots, sweep
from psmpc_cli.figures.animation import film_files, offscreen_driver, write_animation, write_film
from psmpc_cli.figures.style import in_style
from psmpc_cli.logs.files import writing
from psmpc_cli.logs.run import Run
from psmpc_cli.studies.sweep import GRID, RANDOM

FORMATS = ("png", "pdf", "svg")

_UNDATED: Mapping[str, dict[str, Any]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Metadata with which the same data give the same file."""

FILMS: Mapping[str, Callable[[Run, Iterable[Path]], None]] = {"animation": write_animation, "render": write_film}
"""What shows a run in motion, by name, which is also the stem of its files."""


@dataclass(frozen=True)
class RegisteredFigure:
    """A figure of the table.

    Attributes:
        kind: What it is of: run (a Run), comparison (Runs by controller), sweep, pareto, monte_carlo (the results of
            such a study), scenario (a Task), robot (its description), claims (a Run, or Runs by controller, and what is
            published), ablations (curves by panel and label).
        name: Its name, which is also its file's stem.
        function: Makes it from its subject.
        there: Whether a subject has it.
    """

    kind: str
    name: str
    function: Callable[..., Figure]
    there: Callable[[Any], bool] = lambda subject: True


TABLE = (
    RegisteredFigure("run", "states", coordinates.plot_states),
    RegisteredFigure("run", "velocities", coordinates.plot_velocities),
    RegisteredFigure("run", "controls", coordinates.plot_controls),
    RegisteredFigure("run", "forces", coordinates.plot_forces),
    RegisteredFigure("run", "errors", coordinates.plot_errors),
    RegisteredFigure("run", "instants", instants.plot_instants),
    RegisteredFigure("run", "shares", instants.plot_shares),
    RegisteredFigure("run", "snapshots", snapshots.plot_snapshots),
    RegisteredFigure("run", "solve_time", instants.plot_solve_time),
    RegisteredFigure("run", "pull", instants.plot_pull, instants.has_grasps),
    RegisteredFigure("comparison", "overlay", coordinates.plot_overlay),
    RegisteredFigure("comparison", "states", coordinates.plot_states),
    RegisteredFigure("comparison", "instants", instants.plot_instants),
    RegisteredFigure("comparison", "shares", instants.plot_shares),
    RegisteredFigure("comparison", "snapshots", snapshots.plot_snapshots),
    RegisteredFigure("sweep", "surface", sweep.plot_surface, lambda cells: cells.sampling == GRID),
    RegisteredFigure("sweep", "heat_map", sweep.plot_plane, lambda cells: cells.sampling == GRID),
    RegisteredFigure("sweep", "draws", sweep.plot_plane, lambda cells: cells.sampling == RANDOM),
    RegisteredFigure("sweep", "starts", sweep.plot_starts),
    RegisteredFigure("sweep", "sensitivity", sweep.plot_sensitivity),
    RegisteredFigure("pareto", "front", pareto.plot_fronts),
    RegisteredFigure("pareto", "front_3d", pareto.plot_in_space, pareto.in_space),
    RegisteredFigure("monte_carlo", "success", monte_carlo.plot_success),
    RegisteredFigure("monte_carlo", "runs", monte_carlo.plot_runs),
    RegisteredFigure("robot", "robot", snapshots.plot_robot),
    RegisteredFigure("scenario", "scenario", snapshots.plot_scenario),
    RegisteredFigure("claims", "presence", reproduction.plot_presence),
    RegisteredFigure("claims", "monitors", reproduction.plot_monitors),
    RegisteredFigure("claims", "schedule", reproduction.plot_schedule),
    RegisteredFigure("ablations", "ablation_pending_cost", reproduction.plot_pending_cost),
    RegisteredFigure("ablations", "ablation_normalization", reproduction.plot_normalization),
    RegisteredFigure("ablations", "ablation_discretization", reproduction.plot_discretization),
)


def figures_of(kind: str, subject: Any = None) -> dict[str, RegisteredFigure]:
    """Return the figures of a kind by name; of a subject, those it has."""
    return {one.name: one for one in TABLE if one.kind == kind and (subject is None or one.there(subject))}


def plot(run: Run | Mapping[str, Run], name: str) -> Figure:
    """Return a figure of a run, or of several runs by controller.

    Args:
        run: A run, or runs by controller such as psmpc, smpc.
        name: Such as states, instants or snapshots.

    Raises:
        InputError: There is no figure of this name.
    """
    known = figures_of("run" if isinstance(run, Run) else "comparison")
    (name,) = _chosen("figure", [name], known)
    with in_style():
        figure = known[name].function(run)
        figure.draw_without_rendering()  # ticks and texts are made in this style, not in the user's
    return figure


def draw(
    kind: str,
    subject: Any,
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
    films: Collection[str] = (),
) -> list[Path]:
    """Draw figures of a subject, each into a file for each format, and return the files.

    Args:
        kind: What the subject is, as in the table.
        subject: What is drawn.
        directory: Where the files go; made if necessary.
        formats: Of png, pdf, svg.
        only: Names of the figures to draw; None for all.
        force: Overwrite files that exist.
        films: Of animation and render; of runs only. Where figures exist already, all chosen, and are not to be
            overwritten, only the films are made.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written, or there is no renderer.
        LogError: There is nothing to draw.
        RunError: A film could not be rendered or encoded.
    """
    _ensure_drawable(kind, subject)
    known = figures_of(kind, subject)
    names = _chosen("figure", known if only is None else only, known)
    endings = _chosen("format", formats, FORMATS)
    figures = {name: [directory / f"{name}.{ending}" for ending in endings] for name in names}
    if films and only is None and not force and any(path.exists() for paths in figures.values() for path in paths):
        figures = {}
    moving = {name: film_files(directory, name) for name in FILMS if name in films}
    files = [path for paths in (*figures.values(), *moving.values()) for path in paths]
    if "render" in films:
        offscreen_driver()
    _make_room(files, force)
    with in_style():
        for name, paths in figures.items():
            _save(known[name].function(subject), paths)
        for name, paths in moving.items():
            FILMS[name](subject, paths)
    return files


def _ensure_drawable(kind: str, subject: Any) -> None:
    """Raise LogError where a study holds nothing to draw."""
    if kind == "sweep" and subject.waiting.all():
        raise LogError(f"{subject.results.path}: found no cell that was run, expected one at least to draw")
    if kind == "monte_carlo" and not subject.made.any():
        raise LogError(f"{subject.results.path}: found no run that was made, expected one at least to draw")
    if kind == "pareto" and not any(np.isfinite(J).any() for points in pareto.in_plane(subject) for J, _ in points):
        raise LogError(f"{subject.path}: holds no point that could be solved for, so there is nothing to draw")


def draw_file(kind: str, subject: Any, path: Path, force: bool = False) -> Path:
    """Draw the only figure of a kind, such as a task's scenario, into a file in the format of its ending; return it.

    Raises:
        InputError: The ending is unknown, the file exists or cannot be written.
    """
    _chosen("format", [path.suffix[1:]], FORMATS)
    _make_room([path], force)
    (one,) = figures_of(kind, subject).values()
    with in_style():
        _save(one.function(subject), [path])
    return path


def _save(figure: Figure, paths: Iterable[Path]) -> None:
    """Write a figure into files, each in the format of its ending; InputError if one cannot be written."""
    for path in paths:
        with writing(path):
            figure.savefig(path, metadata=_UNDATED[path.suffix[1:]])


def _make_room(files: Iterable[Path], force: bool) -> None:
    """Make the directories of files; InputError if one cannot be made, or without `force` if a file exists."""
    for path in files:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            taken = path.exists() and not force
        if taken:
            raise InputError(f"{path} exists already: choose another directory with -o, or overwrite with --force")


def default_directory(log: Path) -> Path:
    """Return where the figures of a log go by default: beside it, into a folder of its name."""
    log = log if log.name else log.resolve()
    return log.with_suffix("") if log.suffix else log.parent / f"{log.name}_figures"


def _chosen(what: str, wanted: Iterable[str], known: Collection[str]) -> list[str]:
    """Return what is wanted, each once and in the order of what is known; InputError if something is unknown."""
    wanted = list(wanted)
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise InputError(f"found no {what} '{unknown[0]}', expected one of {', '.join(known)}")
    return [name for name in known if name in wanted]
