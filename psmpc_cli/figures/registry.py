"""Every figure in one table, and what draws them into files."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.figures import coordinates, instants, monte_carlo, pareto, snapshots, sweep
from psmpc_cli.figures.animation import mp4_possible, offscreen_driver, write_animation, write_film
from psmpc_cli.figures.processes import make_calls
from psmpc_cli.figures.style import in_style
from psmpc_cli.logs.files import BY_ENDING, check_output, replacing, writing
from psmpc_cli.logs.run import Run, RunOrPath, resolve_runs
from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, RUN, SWEEP
from psmpc_cli.specs.arguments import require
from psmpc_cli.studies.sampling import Draws, FullFactorial

FORMATS: Mapping[str, dict[str, Any]] = {
    "png": {
        "pil_kwargs": {"compress_level": 3}
    },  # without loss at any level; this one takes half the time of the usual
    "pdf": {"metadata": {"CreationDate": None}},
    "svg": {"metadata": {"Date": None}},
}
"""How files of every format are written, so that the same data give the same file."""

FILMS: Mapping[str, Callable[[Run, Iterable[Path]], None]] = {"animation": write_animation, "render": write_film}
"""What shows a run in motion, by name, which is also the stem of its files."""


@dataclass(frozen=True)
class FigureKind:
    """One figure of the table.

    Attributes:
        make: The function that makes it.
        caption: What it shows, in a sentence.
        applies_to: Tells whether a subject, such as a run, has the data that the figure shows.
    """

    make: Callable[..., Figure]
    caption: str
    applies_to: Callable[[Any], bool] = lambda subject: True


FIGURES: Mapping[str, Mapping[str, FigureKind]] = {
    RUN: {
        "snapshots": FigureKind(
            snapshots.plot_snapshots, "The robot when stages start and end, with the targets of the stages that act."
        ),
        "instants": FigureKind(
            instants.plot_instants,
            "Planned switch times over time, and the actual ends of the stages.",
            applies_to=instants.plans_switches,
        ),
        "states": FigureKind(
            coordinates.plot_states, "Base pose and joint angles; stages are shaded, early starts dotted."
        ),
        "velocities": FigureKind(coordinates.plot_velocities, "Velocities, with the limits in force."),
        "controls": FigureKind(
            coordinates.plot_controls, "Applied accelerations, constant over each sample, with the limits in force."
        ),
        "forces": FigureKind(
            coordinates.plot_forces,
            "Generalized forces of the low-level controller, with the limits in force.",
            applies_to=lambda run: bool(np.isfinite(run["force/F"]).any()) or not len(run.time),
        ),
        "errors": FigureKind(
            coordinates.plot_errors,
            "Largest errors against the current stage's target, with the tolerances of its end condition.",
        ),
        "shares": FigureKind(instants.plot_shares, "Share of each stage in the weighted cost and in the control."),
        "solve_time": FigureKind(instants.plot_solve_time, "Wall time and iterations of every solve."),
        "grasps": FigureKind(
            instants.plot_grasps,
            "Filtered loads on each grasp while it is closed, with what it holds.",
            applies_to=lambda run: "grasp/closed_at" in run and bool(np.isfinite(run["grasp/closed_at"]).any()),
        ),
        "thrusters": FigureKind(
            instants.plot_thrusters,
            "Impulse of each thruster over every sample, of the largest that it can give.",
            applies_to=lambda run: "thrusters/impulse" in run,
        ),
        "wheels": FigureKind(
            instants.plot_wheels,
            "Angular momentum of each reaction wheel, and the torque of its motor, with their limits.",
            applies_to=lambda run: "wheels/momentum" in run,
        ),
        "clearance": FigureKind(
            instants.plot_clearance,
            "Smallest distances of the nearest parts, with the margin that the task keeps.",
            applies_to=instants.has_distances,
        ),
    },
    COMPARISON: {
        "overlay": FigureKind(
            coordinates.plot_overlay, "Every coordinate under each controller, with the ends of the stages."
        ),
        "states": FigureKind(coordinates.plot_states, "Base pose and joint angles, a column for each controller."),
        "instants": FigureKind(
            instants.plot_instants, "Planned switch times and actual ends of the stages, a column for each controller."
        ),
        "shares": FigureKind(
            instants.plot_shares, "Share of each stage in the weighted cost and in the control, by controller."
        ),
        "snapshots": FigureKind(snapshots.plot_snapshots, "The robot when each stage ends, a row for each controller."),
    },
    SWEEP: {
        "surface": FigureKind(
            sweep.plot_surface,
            "Actual start of the second stage over both priorities, between its earliest start and its switch time.",
            applies_to=lambda cells: cells.sampling is FullFactorial,
        ),
        "heat_map": FigureKind(
            sweep.plot_heat_map,
            "The same from above; the contour encloses the cells that start as early as the horizon allows.",
            applies_to=lambda cells: cells.sampling is FullFactorial,
        ),
        "draws": FigureKind(
            sweep.plot_draws,
            "Actual start of the second stage for every draw of both priorities.",
            applies_to=lambda cells: cells.sampling is Draws,
        ),
        "starts": FigureKind(
            sweep.plot_starts, "Actual start against the ratio of the priorities, for every threshold of a start."
        ),
        "sensitivity": FigureKind(
            sweep.plot_sensitivity,
            "End of the mission, effort, peak force and end error against the ratio, with the recommended one.",
            applies_to=sweep.has_compared_quantities,
        ),
    },
    PARETO: {
        "front": FigureKind(pareto.plot_fronts, "Trade-off between the costs of two stages at several samples."),
        "front_3d": FigureKind(
            pareto.plot_fronts_over_instant,
            "The same with the switch time as a third criterion, and the fronts with it held.",
            applies_to=pareto.has_instant_criterion,
        ),
    },
    MONTE_CARLO: {
        "success": FigureKind(
            monte_carlo.plot_success, "Fraction of the runs that have ended each stage over time, with its interval."
        ),
        "runs": FigureKind(
            monte_carlo.plot_runs,
            "Final error and tightest margins of every run; failed runs are ringed.",
            applies_to=monte_carlo.has_measured_quantities,
        ),
    },
    "robot": {"robot": FigureKind(snapshots.plot_robot, "The robot at rest, with its joints and frames.")},
    "scenario": {
        "scenario": FigureKind(snapshots.plot_scenario, "What each stage is to reach, before anything has run.")
    },
}
"""The figures, by what they are of and by name, which is also the stem of their files, in the order of pages.

They are of a Run, of Runs by controller, of the results of a study, of the description of a robot, or of a Task.
"""

REQUIRED_CONTENT: Mapping[str, tuple[str, Callable[[Any], bool]]] = {
    SWEEP: ("cell that was run", lambda cells: not cells.waiting.all()),
    MONTE_CARLO: ("run that was made", lambda runs: runs.made.any()),
    PARETO: ("point that could be solved for", pareto.has_points),
}
"""What a study has to hold to be drawn, as messages call it, with the test whether it does."""


def figures_of(kind: str, subject: Any = None) -> dict[str, Callable[..., Figure]]:
    """Return the figures of a kind by name; of a subject, those it has."""
    return {name: each.make for name, each in FIGURES[kind].items() if subject is None or each.applies_to(subject)}


def plot(run: RunOrPath | Mapping[str, RunOrPath], name: str) -> Figure:
    """Make one of psmpc's figures of a run, or of several runs by controller, and return it to be shown or saved.

    Args:
        run: A run, or runs by controller such as psmpc, smpc; the path of a log or of a comparison stands for its runs.
        name: Name of the figure, such as states, instants or snapshots.

    Returns:
        The figure, complete and in psmpc's style.

    Raises:
        InputError: There is no run, or the run has no figure of this name.
        LogError: A path leads to no log, or no comparison.
    """
    require("figure", name, str, "the name of a figure")
    subject = resolve_runs(run)
    makers = figures_of(RUN if isinstance(subject, Run) else COMPARISON, subject)
    (name,) = _select_known("figure", [name], makers)
    with in_style():
        figure = makers[name](subject)
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
    """Draw figures of a run or study into files, several at a time in processes of their own.

    Each figure has one file for each format, named as the figure.

    Args:
        kind: What the subject is: a key of `FIGURES`, such as `RUN` or `SWEEP`.
        subject: What is drawn: a run, several runs by controller, or the results of a study.
        directory: Where the files go; made if necessary.
        formats: Some of png, pdf and svg.
        only: Names of the figures to draw; None for all that the subject has data for.
        force: Whether files that exist are overwritten.
        films: Which films of a run are made too: some of animation and render. If any figure exists already, `only` is
            None and `force` is not set, then the films alone are made.

    Returns:
        The files that were written, those of films last.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written, or there is no renderer.
        LogError: There is nothing to draw.
        RunError: A film could not be rendered or encoded.
    """
    content, has_content = REQUIRED_CONTENT.get(kind, ("", lambda subject: True))
    if not has_content(subject):
        path = getattr(subject, "results", subject).path
        raise LogError(f"{path}: found no {content}, expected one at least to draw")
    known_figures = figures_of(kind, subject)
    names = _select_known("figure", known_figures if only is None else only, known_figures)
    endings = _select_known("format", formats, FORMATS)

    figures = figure_files(directory, names, endings)
    # with films asked for, figures that are there already need not be drawn again
    if films and only is None and not force and any(path.exists() for paths in figures.values() for path in paths):
        figures = {}
    film_files = figure_files(directory, [name for name in FILMS if name in films], _film_endings())
    files = [path for paths in (*figures.values(), *film_files.values()) for path in paths]
    if "render" in films:
        offscreen_driver()  # raises before any file is written if nothing can render here
    _prepare_files(files, force)
    with in_style():
        make_calls([partial(_make_and_save, known_figures[name], subject, paths) for name, paths in figures.items()])
        for name, paths in film_files.items():
            FILMS[name](subject, paths)
    return files


def figure_files(directory: Path, names: Iterable[str], endings: Sequence[str]) -> dict[str, list[Path]]:
    """Return the files of figures or films in a directory, one for each ending, by their names."""
    return {name: [directory / f"{name}.{ending}" for ending in endings] for name in names}


def _film_endings() -> tuple[str, ...]:
    """Return the endings of the files of a film that can be encoded here."""
    return ("gif", "mp4") if mp4_possible() else ("gif",)


def check_replaceable(directory: Path, kind: str, films: Iterable[str] = ()) -> None:
    """Make sure that figures and films can take the places of those of the same names in a directory.

    Raises:
        InputError: A file of one of these names is none that psmpc writes.
    """
    files = figure_files(directory, FIGURES[kind], ("png",)) | figure_files(directory, films, _film_endings())
    for path in (path for paths in files.values() for path in paths):
        check_output(path, True, BY_ENDING[path.suffix[1:]])


def check_figure(path: Path, force: bool, option: str = "-o", inputs: Iterable[Path | str] = ()) -> None:
    """Make sure that a figure can be written into a file, as `check_output` does.

    Raises:
        InputError: It cannot, or the ending of the file is unknown.
    """
    ending = path.suffix[1:]
    _select_known("format", [ending], FORMATS)
    check_output(path, force, BY_ENDING[ending], option, inputs)


def draw_file(kind: str, subject: Any, path: Path, force: bool = False) -> Path:
    """Draw the only figure of a kind, such as a task's scenario, into a file in the format of its ending; return it.

    Raises:
        InputError: The ending is unknown, the file exists or cannot be written.
    """
    (make,) = figures_of(kind, subject).values()
    return save_figure(partial(make, subject), path, force)


def save_figure(make: Callable[[], Figure], path: Path, force: bool = False) -> Path:
    """Make a figure, write it into a file in the format of its ending, and return the file.

    Raises:
        InputError: The ending is unknown, the file exists or cannot be written.
    """
    check_figure(path, force)
    _prepare_files([path], force)
    with in_style():
        _save(make(), [path])
    return path


def _make_and_save(make: Callable[..., Figure], subject: Any, paths: Iterable[Path]) -> None:
    """Make a figure of a subject and write it into files."""
    _save(make(subject), paths)


def _save(figure: Figure, paths: Iterable[Path]) -> None:
    """Write a figure into files, each whole and in the format of its ending; InputError if one cannot be written."""
    for path in paths:
        with writing(path), replacing(path) as part:
            figure.savefig(part, **FORMATS[path.suffix[1:]])


def _prepare_files(files: Iterable[Path], force: bool) -> None:
    """Make the directories of files; InputError if one cannot be made, or a file is not to be replaced."""
    files = list(files)
    for path in files:
        check_output(path, force, BY_ENDING[path.suffix[1:]])
    for path in files:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)


def default_directory(log: Path) -> Path:
    """Return where the figures of a log go by default: beside it, into a folder of its name."""
    log = log if log.name else log.resolve()
    return log.with_suffix("") if log.suffix else log.parent / f"{log.name}_figures"


def _select_known(what: str, wanted: Iterable[str], known: Collection[str]) -> list[str]:
    """Return the wanted names, each once and in the order of the known ones, to check what a user has chosen.

    Args:
        what: What the names are of, as a message calls it, such as figure.
        wanted: Names that the user has given.
        known: Names that there are.

    Raises:
        InputError: A wanted name is unknown.
    """
    wanted = list(wanted)
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise InputError(f"found no {what} '{unknown[0]}', expected one of {', '.join(known)}")
    return [name for name in known if name in wanted]
