"""The frame of every figure over time: a strip that names the stages, and panels below it, a column for each run."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.run import Run, Span

STRIP_ROW = 0.15
"""Height of a row of the strip [in]."""

NAME_GAP = 0.03
"""Least distance of a name from the ends of its bar, and from what is beside it [in]."""


def timeline(runs: Mapping[str, Run] | Run, rows: int, height: float, shaded: bool = True) -> tuple[Figure, np.ndarray]:
    """Make a figure of panels (rows, runs) along time, in columns that share their axes, below a strip of the stages.

    Args:
        runs: A run, or several by controller, whose names then stand above their columns.
        rows: Number of panels below each other.
        height: Of one panel [in].
        shaded: Whether the panels are shaded by stage.
    """
    several = not isinstance(runs, Run)
    all_runs = runs_of(runs)
    ends = [run.motion.time[[0, -1]] for run in all_runs]
    start = float(np.min(ends))
    end = float(np.max(ends))

    page = style.PAGE if several else style.COLUMN
    width = (style.PAGE - 1.3) / len(all_runs) if several else style.AXIS_WIDTH
    room = 0.012 * (end - start) or 0.55 * all_runs[0].task.spec.controller.sample_time
    view = (start - room, end + room)
    bars = [place_bars(run.spans, view, width) for run in all_runs]
    strip_rows = max(2, *(1 + bar.row for placed in bars for bar in placed))

    figure = style.new_figure(page)
    heights = [STRIP_ROW * strip_rows] + [height] * rows
    axes = figure.subplots(rows + 1, len(all_runs), sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    axes[0, 0].set_xlim(*view)
    axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=4 if several else 7, steps=[1, 2, 5, 10]))
    axes[0, 0].set_ylim(strip_rows, 0)

    for column, placed, run in zip(axes.T, bars, all_runs, strict=True):
        column[0].set_axis_off()
        draw_stages(column[0], placed)
        for panel in column[1:] if shaded else ():
            _shade(panel, run.spans)
        column[-1].set_xlabel("Time (s)")
    for column, name in zip(axes[0], () if isinstance(runs, Run) else runs, strict=False):
        column.set_title(style.literal(style.title_of(name)), loc="center", fontsize=8.0)
    return figure, axes[1:]


def label_row(panels: Sequence[Axes], label: str, note: str = "") -> None:
    """Label the vertical axis of a row of panels and write its legend: above a single one, with a note, else beside."""
    panels[0].set_ylabel(label)
    if len(panels) == 1:
        style.panel_legend(panels[0], note)
    elif panels[-1].get_legend_handles_labels()[0]:
        panels[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def runs_of(runs: Mapping[str, Run] | Run) -> list[Run]:
    """Return the runs of a figure, one or several."""
    return [runs] if isinstance(runs, Run) else list(runs.values())


@dataclass(frozen=True)
class StageBar:
    """Where a stage has its bar and its name, in rows that count downwards.

    Attributes:
        span: The stage.
        row: Row of both.
        left: Where the bar begins [s]; it ends where the span does.
        name: What is written.
        name_at: Where it is written [s].
        align: Which part of it is there: its center on the bar, its left beside the bar's end, its right before it.
    """

    span: Span
    row: int
    left: float
    name: str
    name_at: float
    align: Literal["center", "left", "right"]


def place_bars(spans: Sequence[Span], view: tuple[float, float], width: float) -> list[StageBar]:
    """Place the bars of stages in rows, so that no two bars or names overlap and no name leaves its bar or the axis.

    Stages that follow each other alternate between two rows. A name that is wider than its bar stands behind the bar,
    or before it where there is no room behind it; where there is none at all it is shortened.

    Args:
        spans: The stages, in order.
        view: First and last time on the axis [s].
        width: Of the axis [in].
    """
    first, last = view
    second = (last - first) / width  # [s/in]
    bars: list[StageBar] = []
    ends: dict[int, float] = defaultdict(lambda: -np.inf)  # up to where each row is taken
    for span in spans:
        left = span.start if span.early is None else span.early
        gap = NAME_GAP * second
        room = max(span.end - left, last - span.end, left - first) - 2 * gap
        name = style.literal(style.shortened(style.words_of(span.name), room / second))
        wide = style.text_width(name) * second + 2 * gap

        taken = (left, span.end)
        name_at = (left + span.end) / 2
        align: Literal["center", "left", "right"] = "center"
        if wide > span.end - left and span.end + wide <= last:
            taken = (left, span.end + wide)
            name_at = span.end + gap
            align = "left"
        elif wide > span.end - left:
            taken = (left - wide, span.end)
            name_at = left - gap
            align = "right"

        row = next(row for row in chain([span.index % 2], count()) if ends[row] <= taken[0])
        ends[row] = taken[1]
        bars.append(StageBar(span, row, left, name, name_at, align))
    return bars


def draw_stages(axes: Axes, bars: Sequence[StageBar], first_row: float = 0.0) -> None:
    """Draw stages as bars with their names, from a row on."""
    outline: dict[str, Any] = {"fill": False, "edgecolor": style.EDGE, "linewidth": 0.5, "clip_on": False}
    stroke = withStroke(linewidth=1.5, foreground="white")
    for bar in bars:
        span = bar.span
        middle = first_row + bar.row + 0.5
        if span.early is not None:
            acts = ["_next stage already acts"]  # a list labels the patch instead of its container
            axes.barh(middle, span.start - bar.left, 0.86, bar.left, facecolor=style.EARLY, label=acts)
        face = style.STAGE if span.index % 2 else "white"
        axes.barh(middle, span.end - span.start, 0.86, span.start, facecolor=face)
        axes.barh(middle, span.end - bar.left, 0.86, bar.left, **outline)
        axes.text(bar.name_at, middle, bar.name, ha=bar.align, va="center_baseline", path_effects=[stroke])


def _shade(axes: Axes, spans: Sequence[Span]) -> None:
    """Shade every other stage, and where the next one acts early; a dotted line marks each early start."""
    for span in spans:
        if span.index % 2:
            axes.axvspan(span.start, span.end, **style.look("every other stage"))
        if span.early is not None:
            axes.axvspan(span.early, span.start, **style.look("next stage already acts"))
            axes.axvline(span.early, **style.look("early start"))
