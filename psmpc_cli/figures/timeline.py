"""The frame of every figure over time: a strip that names the stages, and panels below it, a column for each run."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.run import Run, Span

STRIP_ROW = 0.15
"""Height of a row of the strip [in]."""


class Timeline:
    """A figure of empty panels along time, in columns that share their axes, below a strip that names the stages.

    Attributes:
        figure: The figure.
        runs: A run for each column.
        panels: Its axes below the strip (rows, runs).
        handles: What its common legend says of the stages.
    """

    def __init__(self, runs: Mapping[str, Run] | Run, rows: int, height: float, shaded: bool = True) -> None:
        """Open a figure.

        Args:
            runs: A run, or several by controller, whose names then stand above their columns.
            rows: Number of panels below each other.
            height: Of one panel [in].
            shaded: Whether the panels are shaded by stage.
        """
        named, self.runs = not isinstance(runs, Run), runs_of(runs)
        columns, ends = len(self.runs), [run.motion.time[[0, -1]] for run in self.runs]
        start, end = float(np.min(ends)), float(np.max(ends))
        wide, width = (style.PAGE, (style.PAGE - 1.3) / columns) if named else (style.COLUMN, style.AXIS_WIDTH)
        bars = [bar_rows(run.spans, style.CHARACTER * (end - start) / width) for run in self.runs]
        strip = STRIP_ROW * max(2, *(1 + max(placed) for placed in bars))
        self.figure = style.new_figure(strip + 0.5 + 0.15 * named + rows * (height + 0.05 * (not named)), wide)
        heights = [strip] + [height] * rows
        axes = self.figure.subplots(rows + 1, columns, sharex=True, sharey="row", squeeze=False, height_ratios=heights)
        room = 0.012 * (end - start) or 0.55 * self.runs[0].task.spec.controller.sample_time
        axes[0, 0].set_xlim(start - room, end + room)
        axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=4 if named else 7, steps=[1, 2, 5, 10]))
        axes[0, 0].set_ylim(strip / STRIP_ROW, 0)
        for column, placed, run in zip(axes.T, bars, self.runs, strict=True):
            _draw_strip(column[0], run.spans, placed)
            for panel in column[1:] if shaded else ():
                _shade(panel, run.spans)
            column[-1].set_xlabel("Time (s)")
        for column, name in zip(axes[0], () if isinstance(runs, Run) else runs, strict=False):
            column.set_title(style.title_of(name), fontsize=8.0, pad=3)
        self.figure.align_ylabels(axes[1:, 0])
        self.panels, self.handles = axes[1:], [each for run in self.runs for each in _stage_handles(run.spans, shaded)]

    def label(self, row: int, label: str, note: str = "") -> None:
        """Label the vertical axis of a row and write its legend: above a single panel, with a note, else beside it."""
        axes: Axes = self.panels[row, 0]
        axes.set_ylabel(label)
        if self.panels.shape[1] == 1:
            style.panel_legend(axes, note)
        elif self.panels[row, -1].get_legend_handles_labels()[0]:
            self.panels[row, -1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))

    def finish(self, handles: Sequence[Artist] = ()) -> Figure:
        """Write the common legend below the panels and return the figure."""
        style.add_legend(self.figure, (*handles, *self.handles))
        return self.figure


def runs_of(runs: Mapping[str, Run] | Run) -> list[Run]:
    """Return the runs of a figure, one or several."""
    return [runs] if isinstance(runs, Run) else list(runs.values())


def bar_rows(spans: Sequence[Span], character: float) -> list[int]:
    """Return the row of the strip on which each stage has its bar: no two bars or names of a row overlap.

    Stages that follow each other alternate between two rows, which leaves room for their names; a character of a name
    is as wide as this time [s].
    """
    rows: list[int] = []
    ends = [-np.inf, -np.inf]  # up to where each row is taken
    for span in spans:
        left = span.start if span.early is None else span.early
        beyond = max(0.0, character * (1 + len(style.readable(span.name))) - (span.end - left)) / 2
        free = [row for row in (span.index % 2, *range(len(ends))) if ends[row] <= left - beyond]
        if not free:
            free = [len(ends)]
            ends.append(-np.inf)
        rows.append(free[0])
        ends[free[0]] = span.end + beyond
    return rows


def _shade(axes: Axes, spans: Sequence[Span]) -> None:
    """Shade every other stage, and where the next one acts early; a dotted line marks each early start."""
    for span in spans:
        if span.index % 2:
            axes.axvspan(span.start, span.end, facecolor=style.STAGE, edgecolor="none", zorder=0)
        if span.early is not None:
            axes.axvspan(span.early, span.start, facecolor=style.EARLY, edgecolor="none", zorder=0.1)
            axes.axvline(span.early, color="black", linestyle=style.DOTTED, linewidth=0.8, zorder=0.2)


def _stage_handles(spans: Sequence[Span], shaded: bool) -> list[Artist]:
    """Return what a legend says of the shades."""
    handles: list[Artist] = []
    if len(spans) > 1 and shaded:
        handles.append(style.patch_entry("every other stage", facecolor=style.STAGE))
    if any(span.early is not None for span in spans):
        handles.append(style.patch_entry("next stage already acts", facecolor=style.EARLY, edgecolor="none"))
        handles.append(style.entry("early start", color="black", linestyle=style.DOTTED, linewidth=0.8))
    return handles


def _draw_strip(axes: Axes, spans: Sequence[Span], rows: Sequence[int]) -> None:
    """Draw the stages as bars with their names."""
    axes.set_axis_off()
    for span, row in zip(spans, rows, strict=True):
        left = span.start if span.early is None else span.early
        face = style.STAGE if span.index % 2 else "white"
        if span.early is not None:
            axes.barh(row + 0.5, span.start - left, 0.86, left, facecolor=style.EARLY)
        axes.barh(row + 0.5, span.end - span.start, 0.86, span.start, facecolor=face)
        look: dict[str, Any] = {"fill": False, "edgecolor": style.EDGE, "linewidth": 0.5, "clip_on": False}
        outline = axes.barh(row + 0.5, span.end - left, 0.86, left, **look)
        stroke = withStroke(linewidth=1.5, foreground="white")
        name = style.readable(span.name)
        axes.bar_label(outline, [name], label_type="center", fontsize=style.TEXT, path_effects=[stroke])
