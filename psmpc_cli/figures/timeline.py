"""The frame of every figure over time: a strip that names the stages, and panels below it, a column for each run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.run import Run, Span

STRIP_ROW = 0.15
"""Height of a row of the strip [in]."""

DOTTED = (0, (1, 1.5))


@dataclass(frozen=True, eq=False)
class Timeline:
    """A figure over time.

    Attributes:
        figure: The figure.
        panels: Its axes below the strip (rows, runs).
        handles: What its common legend says of the stages.
    """

    figure: Figure
    panels: np.ndarray
    handles: tuple[Artist, ...]

    def label(self, row: int, label: str, note: str = "", handle: float = style.HANDLE) -> None:
        """Label the vertical axis of a row and write its legend, and a note, above it."""
        axes: Axes = self.panels[row, 0]
        axes.set_ylabel(label)
        if self.panels.shape[1] == 1:
            style.panel_legend(axes, note, handle)
            return
        axes.set_title(" ", loc="left", pad=2, fontsize=style.TEXT)
        handles, _ = axes.get_legend_handles_labels()
        legend = axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=len(handles), handlelength=handle)
        legend.set_in_layout(False)  # it may reach over the next column

    def finish(self, handles: Sequence[Artist] = ()) -> Figure:
        """Write the common legend, with more entries, below the panels and return the figure."""
        style.add_legend(self.figure, (*handles, *self.handles))
        return self.figure


def open_timeline(runs: Mapping[str, Run] | Run, rows: int, height: float, shaded: bool = True) -> Timeline:
    """Return a figure of empty panels along time, in columns that share their axes.

    Args:
        runs: A run, or several by controller, whose names then stand above their columns.
        rows: Number of panels below each other.
        height: Of one panel [in].
        shaded: Whether the panels are shaded by stage.
    """
    named = not isinstance(runs, Run)
    columns = {"": runs} if isinstance(runs, Run) else dict(runs)
    width = style.PAGE if len(columns) > 1 else style.COLUMN
    strip = STRIP_ROW * max(2, *(max(bar_rows(run.spans)) + 1 for run in columns.values()))
    above = 0.15 if named else 0.0
    figure = style.new_figure(strip + above + 0.5 + rows * (height + above), width)
    ratios = [strip] + [height] * rows
    axes = figure.subplots(rows + 1, len(columns), sharex=True, sharey="row", squeeze=False, height_ratios=ratios)
    _set_time(axes[0, 0], columns)
    axes[0, 0].set_ylim(strip / STRIP_ROW, 0)
    handles: list[Artist] = []
    keys: list[Artist] = []
    for column, (name, run) in zip(axes.T, columns.items(), strict=True):
        keys += _draw_strip(column[0], run, (width - 0.6) / len(columns) if named else style.AXIS_WIDTH)
        handles += _stage_handles(run.spans, shaded)
        if named:
            column[0].set_title(style.title_of(name), fontsize=8.0, pad=3)
        for panel in column[1:] if shaded else ():
            _shade(panel, run.spans)
        column[-1].set_xlabel("Time (s)")
    figure.align_ylabels(axes[1:, 0])
    return Timeline(figure, axes[1:], (*handles, *keys))


def bar_rows(spans: Sequence[Span]) -> list[int]:
    """Return the row of the strip on which each stage has its bar: no two bars of a row overlap.

    Stages that follow each other alternate between two rows, which leaves room for their names.
    """
    rows: list[int] = []
    ends = [-np.inf, -np.inf]  # up to where each row is taken
    for span in spans:
        free = [row for row in (span.index % 2, *range(len(ends))) if ends[row] <= _left(span)]
        if not free:
            free = [len(ends)]
            ends.append(-np.inf)
        rows.append(free[0])
        ends[free[0]] = span.end
    return rows


def _set_time(axes: Axes, runs: Mapping[str, Run]) -> None:
    """Set the common time axis, from the first start to the last end."""
    start, end = min(float(run.motion.time[0]) for run in runs.values()), max(run.motion.end for run in runs.values())
    sample_time = next(iter(runs.values())).task.spec.controller.sample_time
    room = 0.012 * (end - start) or 0.55 * sample_time
    axes.set_xlim(start - room, end + room)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=7 if len(runs) == 1 else 4, steps=[1, 2, 5, 10]))


def _shade(axes: Axes, spans: Sequence[Span]) -> None:
    """Shade every other stage, and where the next one acts early; a dotted line marks each early start."""
    for span in spans:
        if span.index % 2:
            axes.axvspan(span.start, span.end, facecolor=style.STAGE, edgecolor="none", zorder=0)
    for span in spans:
        if span.early is not None:
            axes.axvspan(span.early, span.start, facecolor=style.EARLY, edgecolor="none", zorder=0.1)
            axes.axvline(span.early, color="black", linestyle=DOTTED, linewidth=0.8, zorder=0.2)


def _stage_handles(spans: Sequence[Span], shaded: bool) -> list[Artist]:
    """Return what a legend says of the shades."""
    handles: list[Artist] = []
    if len(spans) > 1 and shaded:
        handles.append(style.patch_entry("every other stage", facecolor=style.STAGE))
    if any(span.early is not None for span in spans):
        handles.append(style.patch_entry("next stage already acts", facecolor=style.EARLY, edgecolor="none"))
        handles.append(style.entry("early start", color="black", linestyle=DOTTED, linewidth=0.8))
    return handles


def _draw_strip(axes: Axes, run: Run, width: float) -> list[Artist]:
    """Draw the stages as bars on a strip `width` wide [in]; return legend entries of those whose names do not fit."""
    axes.set_axis_off()
    rows = bar_rows(run.spans)
    names = _strip_names(run.spans, rows, axes.get_xlim(), width)
    for span, row, (centre, text) in zip(run.spans, rows, names, strict=True):
        face = style.STAGE if span.index % 2 else "white"
        left, bottom, height = _left(span), row + 0.07, 0.86
        if span.early is not None:
            axes.add_patch(Rectangle((left, bottom), span.start - left, height, facecolor=style.EARLY))
        axes.add_patch(Rectangle((span.start, bottom), span.end - span.start, height, facecolor=face))
        outline = Rectangle((left, bottom), span.end - left, height, fill=False, edgecolor=style.EDGE, linewidth=0.5)
        outline.set_clip_on(False)
        axes.add_patch(outline)
        axes.text(
            centre,
            row + 0.54,
            text,
            fontsize=style.TEXT,
            ha="center",
            va="center",
            path_effects=(withStroke(linewidth=1.5, foreground="white"),),
        )
    shortened = (span for span, (_, text) in zip(run.spans, names, strict=True) if text != style.readable(span.name))
    return [style.entry(f"{span.index + 1}: {style.readable(span.name)}", linestyle="none") for span in shortened]


def _strip_names(
    spans: Sequence[Span], rows: Sequence[int], limits: tuple[float, float], width: float
) -> list[tuple[float, str]]:
    """Return the place of each stage's name on the strip, and the name, or its number where the name does not fit.

    The text is empty where not even the number fits.
    """
    first, last = limits
    per_inch = (last - first) / width
    names: list[tuple[float, str]] = []
    written = [first] * (max(rows) + 1)  # up to where each row is written
    for span, row in zip(spans, rows, strict=True):
        others = [other for other, at in zip(spans, rows, strict=True) if other is not span and at == row]
        for text in (style.readable(span.name), str(span.index + 1), ""):
            half = (style.text_width(text) + 0.06) * per_inch / 2
            centre = min(max((_left(span) + span.end) / 2, first + half), max(last - half, first + half))
            left, right = centre - half, centre + half
            clear = all(right <= _left(other) or other.end <= left for other in others)
            if (clear and right - left <= last - first and written[row] <= left) or not text:
                break
        names.append((centre, text))
        written[row] = right if text else written[row]
    return names


def _left(span: Span) -> float:
    return span.start if span.early is None else span.early
