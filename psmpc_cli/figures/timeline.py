"""The frame of every figure over time: a strip that names the stages, and panels below it, a column for each run."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import chain, count
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.run import Run, Span

STRIP_ROW = 0.15
"""Height of a row of the strip [in]."""


def timeline(runs: Mapping[str, Run] | Run, rows: int, height: float, shaded: bool = True) -> tuple[Figure, np.ndarray]:
    """Return a figure of panels (rows, runs) along time, in columns that share their axes, below a strip of the stages.

    Args:
        runs: A run, or several by controller, whose names then stand above their columns.
        rows: Number of panels below each other.
        height: Of one panel [in].
        shaded: Whether the panels are shaded by stage.
    """
    several = not isinstance(runs, Run)
    every = runs_of(runs)
    ends = [run.motion.time[[0, -1]] for run in every]
    start = float(np.min(ends))
    end = float(np.max(ends))
    page, width = (style.PAGE, (style.PAGE - 1.3) / len(every)) if several else (style.COLUMN, style.AXIS_WIDTH)
    bars = [bar_rows(run.spans, style.CHARACTER * (end - start) / width) for run in every]
    strip = max(2, *(1 + max(placed) for placed in bars))
    figure = style.new_figure(page)
    heights = [STRIP_ROW * strip] + [height] * rows
    axes = figure.subplots(rows + 1, len(every), sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    room = 0.012 * (end - start) or 0.55 * every[0].task.spec.controller.sample_time
    axes[0, 0].set_xlim(start - room, end + room)
    axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=4 if several else 7, steps=[1, 2, 5, 10]))
    axes[0, 0].set_ylim(strip, 0)
    for column, placed, run in zip(axes.T, bars, every, strict=True):
        column[0].set_axis_off()
        draw_stages(column[0], run.spans, placed)
        for panel in column[1:] if shaded else ():
            _shade(panel, run.spans)
        column[-1].set_xlabel("Time (s)")
    for column, name in zip(axes[0], () if isinstance(runs, Run) else runs, strict=False):
        column.set_title(style.title_of(name), loc="center", fontsize=8.0)
    figure.align_ylabels(axes[1:, 0])
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


def bar_rows(spans: Sequence[Span], character: float) -> list[int]:
    """Return the row in which each stage has its bar: no two bars or names of a row overlap.

    Stages that follow each other alternate between two rows, which leaves room for their names; a character of a name
    is as wide as this time [s].
    """
    rows: list[int] = []
    ends: dict[int, float] = defaultdict(lambda: -np.inf)  # up to where each row is taken
    for span in spans:
        left = span.start if span.early is None else span.early
        beyond = max(0.0, character * (1 + len(style.readable(span.name))) - (span.end - left)) / 2
        rows.append(next(row for row in chain([span.index % 2], count()) if ends[row] <= left - beyond))
        ends[rows[-1]] = span.end + beyond
    return rows


def draw_stages(axes: Axes, spans: Sequence[Span], rows: Sequence[float]) -> None:
    """Draw stages as bars with their names, each in its row."""
    frame: dict[str, Any] = {"fill": False, "edgecolor": style.EDGE, "linewidth": 0.5, "clip_on": False}
    for span, row in zip(spans, rows, strict=True):
        left = span.start if span.early is None else span.early
        if span.early is not None:
            acts = ["_next stage already acts"]  # a list labels the patch instead of its container
            axes.barh(row + 0.5, span.start - left, 0.86, left, facecolor=style.EARLY, label=acts)
        face = style.STAGE if span.index % 2 else "white"
        axes.barh(row + 0.5, span.end - span.start, 0.86, span.start, facecolor=face)
        outline = axes.barh(row + 0.5, span.end - left, 0.86, left, **frame)
        stroke = withStroke(linewidth=1.5, foreground="white")
        axes.bar_label(outline, [style.readable(span.name)], label_type="center", path_effects=[stroke])


def _shade(axes: Axes, spans: Sequence[Span]) -> None:
    """Shade every other stage, and where the next one acts early; a dotted line marks each early start."""
    for span in spans:
        if span.index % 2:
            axes.axvspan(span.start, span.end, **style.look("every other stage"))
        if span.early is not None:
            axes.axvspan(span.early, span.start, **style.look("next stage already acts"))
            axes.axvline(span.early, **style.look("early start"))
