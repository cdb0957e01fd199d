"""The robot at the key instants of a run. Fig. 5 of the paper."""

from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_lowercase

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from psmpc_cli.figures.object_motion import held_between
from psmpc_cli.figures.robot_drawing import TRAIL, draw_scene, object_look, show, view_of
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import (
    BODY,
    COLUMN,
    EDGE,
    LINE,
    PAGE,
    PALETTE,
    TEXT,
    legend_columns,
    new_figure,
    readable,
    text_width,
)

GAP, AXIS, LEGEND, AROUND = 0.08, 0.3, 0.35, 0.45
"""Heights of the gap above a panel's title, of the axis below the panels and of the legend; width of
the axis left of the panels [in]."""

MOST = 10
"""Snapshots that fit one column; more take a page's width."""


@dataclass(frozen=True)
class KeyInstant:
    """A time [s] worth a look, and what happens then."""

    time: float
    event: str


def key_instants(run: Run) -> tuple[KeyInstant, ...]:
    """Return start, premature starts, switching instants, loss of the object and end of a run, in the order of time."""
    found = [KeyInstant(float(run.time[0]), "start")]
    for span in run.spans:
        if span.early is not None:
            found.append(KeyInstant(span.early, f"{readable(span.name)} starts"))
        if np.isfinite(run.log.stages["switch_time"][span.index]):
            found.append(KeyInstant(span.end, f"{readable(span.name)} ends"))
    hold = held_between(run)
    if hold.lost:
        found.append(KeyInstant(hold.end, "object lost"))
    if not any(abs(key.time - run.end) < 1e-6 for key in found):
        found.append(KeyInstant(run.end, "end of the run"))
    return _merged(sorted(found, key=lambda key: key.time))


def plot_snapshots(run: Run) -> Figure:
    """Return the robot at each key instant, all panels to the same scale [m]."""
    keys = key_instants(run)
    view = view_of(run, np.array([key.time for key in keys]))
    width, columns = (COLUMN, min(2, len(keys))) if len(keys) <= MOST else (PAGE, 4)
    across = (width - AROUND) / columns
    titles = [wrapped(f"({letters(i)}) {key.time:.1f} s: {key.event}", across) for i, key in enumerate(keys)]
    rows, lines = -(-len(keys) // columns), 1 + max(title.count("\n") for title in titles)
    below = LEGEND if rows * columns == len(keys) else 0.0
    figure = new_figure(rows * (across * view.aspect + lines * LINE + GAP) + below + AXIS, width)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for i, (axes, key, title) in enumerate(zip(grid, keys, titles, strict=False)):
        draw_scene(axes, run, key.time)
        show(axes, view)
        axes.set_title(title, loc="left", pad=2, fontsize=TEXT)
        if i % columns == 0:
            axes.set_ylabel("y (m)")
        if i >= (rows - 1) * columns:
            axes.set_xlabel("x (m)")
    _place_legend(figure, list(grid[len(keys) :]), handles_of(run))
    return figure


def _merged(keys: Sequence[KeyInstant]) -> tuple[KeyInstant, ...]:
    """Return the instants with those at the same time made one."""
    merged: list[KeyInstant] = []
    for key in keys:
        if merged and abs(key.time - merged[-1].time) < 1e-6:
            merged[-1] = KeyInstant(key.time, f"{merged[-1].event}, {key.event}")
        else:
            merged.append(key)
    return tuple(merged)


def _place_legend(figure: Figure, vacant: list[Axes], handles: Sequence[Patch | Line2D]) -> None:
    """Write the legend into the first vacant place of the grid, or below the panels where there is none."""
    for axes in vacant:
        axes.set_axis_off()
    if vacant:
        vacant[0].legend(handles=handles, loc="center")
    else:
        columns = legend_columns((str(handle.get_label()) for handle in handles), figure.get_figwidth() - 0.1)
        figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def handles_of(run: Run) -> list[Patch | Line2D]:
    """Return what a legend says of the drawings of a run."""
    body = Patch(facecolor=BODY, edgecolor="black", linewidth=0.7, label="base")
    trail = Line2D([], [], color=EDGE, linewidth=0.7, linestyle=TRAIL, label="path of the base")
    arms = [
        Line2D([], [], color=PALETTE[i % len(PALETTE)], linewidth=1.5, label=readable(name))
        for i, name in enumerate(run.model.spec.arms)
    ]
    things = [] if run.task.object is None else [Patch(label="object", **object_look(lost=False))]
    if held_between(run).lost:
        things.append(Patch(label="object, lost", **object_look(lost=True)))
    return [body, *arms, *things, trail]


def wrapped(text: str, width: float) -> str:
    """Return a text broken between words into lines no wider than this [in], where its words allow."""
    lines = [""]
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}".lstrip()
        if lines[-1] and text_width(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return "\n".join(lines)


def letters(index: int) -> str:
    """Return a, b, ..., z, aa, ab, ..."""
    return ascii_lowercase[index] if index < 26 else letters(index // 26 - 1) + ascii_lowercase[index % 26]
