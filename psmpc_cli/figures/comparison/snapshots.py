"""The robot at the switching instants, a row a controller. Fig. 5 of the paper."""

from collections.abc import Collection, Iterable, Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.figures.robot_drawing import View, base_outline, draw_scene, show, view_of
from psmpc_cli.figures.run import Run, Span
from psmpc_cli.figures.snapshots import AROUND, AXIS, GAP, handles_of, letters, wrapped
from psmpc_cli.figures.style import LINE, PAGE, TEXT, legend_columns, new_figure, readable
from psmpc_cli.robot.model import arm_points

ACROSS = 4
"""Stages side by side; of a task with more, a controller takes several rows."""

NO_BREAK = "\N{NO-BREAK SPACE}"
"""Between a number and its unit."""

GHOST = "#9A9A9A"
"""Colour of the robot at an early start."""


def plot_snapshots(runs: Mapping[str, Run]) -> Figure:
    """Return the robot at the end of every stage [m] and, faint, at the early start of the stage after it.

    All panels are to the same scale.
    """
    names = next(iter(runs.values())).log.stage_names
    across = min(ACROSS, len(names))
    rows = -(-len(names) // across)
    view = _common_view(runs.values())
    width = (PAGE - AROUND) / across
    titles = _titles(runs.values(), width - 0.1)
    lines = 1 + max(title.count("\n") for title in titles)
    figure = new_figure(len(runs) * rows * (width * view.aspect + lines * LINE + GAP) + AXIS, PAGE)
    grid = figure.subplots(len(runs) * rows, across, sharex=True, sharey=True, squeeze=False)
    for k, (name, run) in enumerate(runs.items()):
        block = grid[k * rows : (k + 1) * rows]
        for stage, axes in enumerate(block.ravel()):
            if stage < len(names):
                _plot_cell(axes, run, stage)
                show(axes, view)
                title = titles[k * len(names) + stage]
                axes.set_title(title + "\n " * (lines - 1 - title.count("\n")), loc="left", pad=2, fontsize=TEXT)
            else:
                axes.set_axis_off()
        for axes in block[:, 0]:
            axes.set_ylabel(f"{title_of(name)}\ny (m)")
    for axes in grid[-1]:
        axes.set_xlabel("x (m)")
    _legend(figure, runs.values())
    return figure


def _titles(runs: Collection[Run], width: float) -> list[str]:
    """Return every panel's title, in lines no wider than this [in]: when a stage ends, and when the next one starts."""
    titles: list[str] = []
    for run in runs:
        for stage, name in enumerate(run.log.stage_names):
            end, start = float(run.log.stages["switch_time"][stage]), _next_start(run, stage)
            ended = f"ends at {end:.1f}{NO_BREAK}s" if np.isfinite(end) else "did not end"
            lines = [wrapped(f"({letters(len(titles))}) {readable(name)} {ended}", width)]
            if np.isfinite(end) and start is not None:
                begun = "starts then" if start.early is None else f"starts at {start.early:.1f}{NO_BREAK}s"
                lines.append(wrapped(f"{readable(start.name)} {begun}", width))
            titles.append("\n".join(lines))
    return titles


def _plot_cell(axes: Axes, run: Run, stage: int) -> None:
    """Draw the robot at the end of a stage, if it ended, and at the early start of the next."""
    end, start = float(run.log.stages["switch_time"][stage]), _next_start(run, stage)
    if not np.isfinite(end):
        return
    if start is not None and start.early is not None:
        _draw_ghost(axes, run, start.early)
    draw_scene(axes, run, end)


def _next_start(run: Run, stage: int) -> Span | None:
    return next((span for span in run.spans if span.index == stage + 1), None)


def _draw_ghost(axes: Axes, run: Run, time: float) -> None:
    Q = run.coordinates_at(time)
    axes.add_patch(Polygon(base_outline(run.model, Q), fill=False, edgecolor=GHOST, linewidth=0.6, zorder=1.1))
    for points in arm_points(run.model, Q).values():
        axes.plot(*points.T, color=GHOST, linewidth=0.9, solid_joinstyle="round", zorder=1.1)


def _common_view(runs: Iterable[Run]) -> View:
    """Return the smallest view that shows everything that is drawn."""
    views = [view_of(run, _times(run)) for run in runs]
    return View(
        (min(view.x[0] for view in views), max(view.x[1] for view in views)),
        (min(view.y[0] for view in views), max(view.y[1] for view in views)),
    )


def _times(run: Run) -> np.ndarray:
    """Return the times a run is drawn at [s]."""
    ends = run.log.stages["switch_time"]
    early = [span.early for span in run.spans if span.early is not None]
    return np.concatenate([run.time[:1], ends[np.isfinite(ends)], early])


def _legend(figure: Figure, runs: Collection[Run]) -> None:
    """Write what the drawings mean, each once, below the panels."""
    entries: dict[str, Artist] = {str(h.get_label()): h for run in runs for h in handles_of(run)}
    if any(span.early is not None for run in runs for span in run.spans):
        ghost = Line2D([], [], color=GHOST, linewidth=0.9, label="robot at the early start of the next stage")
        entries[str(ghost.get_label())] = ghost
    columns = legend_columns(entries, PAGE - 0.1)
    figure.set_figheight(figure.get_figheight() + -(-len(entries) // columns) * LINE + 0.05)
    figure.legend(handles=list(entries.values()), loc="outside lower center", ncols=columns)
