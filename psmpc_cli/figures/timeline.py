"""The frame of every figure over time: a strip that names the stages, and panels below it, a column for each run."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, count
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.run import Run, Span

STRIP_ROW = 0.15
STRIP_ROW_WITH_KEY = 0.19
"""Heights of a row of the strip, without and with a patch in the look of its stage [in]."""

STAGE_BAR_HEIGHT = 0.86
"""Height of a stage's bar, in rows of the strip."""

KEY_HEIGHT = 0.25
"""Height of the patch in a stage's own look, in rows of the strip."""

NAME_GAP = 0.03
"""Least distance of a name from the ends of its bar, and from what is beside it [in]."""


def timeline(
    runs: Mapping[str, Run] | Run,
    rows: int,
    height: float,
    shaded: bool = True,
    beside: Iterable[str] = (),
    stage_look: Callable[[int], Mapping[str, Any]] | None = None,
) -> tuple[Figure, np.ndarray]:
    """Make the frame of a figure over time: empty panels below a strip that shows the stages as named bars.

    Each run has a column, with a strip and panels of its own. All panels share the axis of time.

    Args:
        runs: A run, or several by controller, whose names then stand above their columns.
        rows: Number of panels below each other.
        height: Height of one panel [in].
        shaded: Whether the background of panels shows the stages: every other stage grey, early starts coloured.
        beside: Names that will be written right of a panel beside the ends of its lines; room is left for the widest.
        stage_look: Tells the look (keywords of a Matplotlib patch) of a stage by its index. The strip then has a patch
            in this look under each bar, as the key to panels that tell stages apart by it. None for no patches.

    Returns:
        The figure, and its panels (rows, runs).
    """
    several = not isinstance(runs, Run)
    all_runs = runs_as_list(runs)
    ends = [run.motion.time[[0, -1]] for run in all_runs]
    start = float(np.min(ends))
    end = float(np.max(ends))

    page = style.PAGE if several else style.COLUMN
    width = (style.PAGE - 1.3) / len(all_runs) if several else style.AXIS_WIDTH - style.width_beside(beside)
    # a run of one sample has start and end at one time: then about a sample is shown
    side_margin = 0.012 * (end - start) or 0.55 * all_runs[0].task.spec.controller.sample_time
    time_range = (start - side_margin, end + side_margin)
    bars = place_bars([run.spans for run in all_runs], time_range, width)
    strip_rows = max(2, *(1 + bar.row for bars_of_run in bars for bar in bars_of_run))

    figure = style.new_figure(page)
    strip_row = STRIP_ROW if stage_look is None else STRIP_ROW_WITH_KEY
    heights = [strip_row * strip_rows] + [height] * rows
    axes = figure.subplots(rows + 1, len(all_runs), sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    axes[0, 0].set_xlim(*time_range)
    axes[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=4 if several else 7, steps=[1, 2, 5, 10]))
    axes[0, 0].set_ylim(strip_rows, 0)  # rows of the strip count downwards

    for column, bars_of_run, run in zip(axes.T, bars, all_runs, strict=True):
        column[0].set_axis_off()
        draw_stages(column[0], bars_of_run, stage_look=stage_look)
        for panel in column[1:] if shaded else ():
            _shade(panel, run.spans)
        column[-1].set_xlabel("Time (s)")
    for column, name in zip(axes[0], () if isinstance(runs, Run) else runs, strict=False):
        column.set_title(style.escape_dollars(style.title_of(name)), loc="center", fontsize=8.0)
    return figure, axes[1:]


def label_row(panels: Sequence[Axes], label: str, note: str = "") -> None:
    """Label the vertical axis of a row of panels, write a note above it, and the names of lines beside their ends.

    What is no line, such as points, is explained by a legend above a single panel.
    """
    panels[0].set_ylabel(label)
    handles, _ = panels[-1].get_legend_handles_labels()
    if all(isinstance(handle, Line2D) and handle.get_linestyle() != "None" for handle in handles):
        panels[0].set_title(note)
        style.label_ends(panels[-1])
    elif len(panels) == 1:
        style.panel_legend(panels[0], note)
    else:
        panels[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def hide_panels(grid: np.ndarray, row: int, columns: Iterable[int]) -> None:
    """Leave out panels of the last row which have nothing to show; those above them then have the labels of time."""
    for column in columns:
        grid[row, column].set_visible(False)
        grid[row - 1, column].tick_params(labelbottom=True)
        grid[row - 1, column].set_xlabel("Time (s)")
    shown = [axes for axes in grid[row] if axes.get_visible()]
    if shown and shown[0] is not grid[row, 0]:
        shown[0].tick_params(labelleft=True)
        shown[0].set_ylabel(grid[row, 0].get_ylabel())
        grid[row, 0].set_ylabel("")


def runs_as_list(runs: Mapping[str, Run] | Run) -> list[Run]:
    """Return the runs of a figure, one or several."""
    return [runs] if isinstance(runs, Run) else list(runs.values())


@dataclass(frozen=True)
class StageBar:
    """Where a stage has its bar and its name, in rows that count downwards.

    Attributes:
        span: The stage.
        row: Row of both.
        left: Where the bar begins [s]; it ends where the span does.
        name: Name of the stage as it is written, perhaps shortened.
        name_at: Where it is written [s].
        align: Which point of the name is there: its center where it is on the bar, its left end where it stands behind
            the bar, its right end where it stands before it.
        taken: From when to when there is the bar or its name [s].
    """

    span: Span
    row: int
    left: float
    name: str
    name_at: float
    align: Literal["center", "left", "right"]
    taken: tuple[float, float]


def place_bars(schedules: Sequence[Sequence[Span]], view: tuple[float, float], width: float) -> list[list[StageBar]]:
    """Place the bars of stages and their names in as few rows as needed, so that none overlap.

    Stage number s is in row s modulo the number of rows, in every schedule, so that a stage is in one row wherever it
    is drawn. There are at least two rows. A name that is wider than its bar stands behind the bar, or before it if
    there is no room behind it; if there is none at all, it is shortened.

    Args:
        schedules: For each run the spans of its stages: when each was the current one, in order.
        view: First and last time on the axis [s].
        width: Width of the axis [in].

    Returns:
        The bars of each schedule.
    """
    bars = [[_place_bar(span, view, width) for span in spans] for spans in schedules]
    stages = [span.index for spans in schedules for span in spans]
    rows = next(rows for rows in count(2) if rows > max(stages, default=0) or _no_bars_overlap(bars, rows))
    return [[replace(bar, row=bar.span.index % rows) for bar in bars_of_run] for bars_of_run in bars]


def _place_bar(span: Span, view: tuple[float, float], width: float) -> StageBar:
    """Place the bar of a stage and its name along an axis of a width [in], in the first row."""
    first, last = view
    second = (last - first) / width  # [s/in]
    left = span.start if span.early is None else span.early
    gap = NAME_GAP * second
    room = max(span.end - left, last - span.end, left - first) - 2 * gap
    name = style.escape_dollars(style.shortened(style.words_of(span.name), room / second))
    wide = style.text_width(name) * second + 2 * gap
    if wide <= span.end - left:
        return StageBar(span, 0, left, name, (left + span.end) / 2, "center", (left, span.end))
    if span.end + wide <= last:
        return StageBar(span, 0, left, name, span.end + gap, "left", (left, span.end + wide))
    return StageBar(span, 0, left, name, left - gap, "right", (left - wide, span.end))


def _no_bars_overlap(schedules: Sequence[Sequence[StageBar]], rows: int) -> bool:
    """Tell whether no two bars or names overlap if stages take so many rows in turn."""
    pairs = (pair for bars in schedules for pair in combinations(bars, 2))
    in_one_row = (pair for pair in pairs if pair[0].span.index % rows == pair[1].span.index % rows)
    return all(one.taken[1] <= other.taken[0] or other.taken[1] <= one.taken[0] for one, other in in_one_row)


def draw_stages(
    axes: Axes,
    bars: Sequence[StageBar],
    first_row: float = 0.0,
    stage_look: Callable[[int], Mapping[str, Any]] | None = None,
) -> None:
    """Draw stages as bars with their names; the time for which a stage acts early is a coloured piece before its bar.

    Args:
        axes: The strip above the panels.
        bars: The bars, placed in rows by `place_bars`.
        first_row: Row of the axes in which the bars' row 0 is.
        stage_look: Tells the look (keywords of a Matplotlib patch) of a stage by its index. A patch in this look is
            drawn in the lower part of each bar, as the key to what the panels show of the stage. None for no patches.
    """
    outline: dict[str, Any] = {"fill": False, "edgecolor": style.EDGE, "linewidth": 0.5, "clip_on": False}
    stroke = withStroke(linewidth=1.5, foreground="white")
    for bar in bars:
        span = bar.span
        middle = first_row + bar.row + 0.5
        if span.early is not None:
            # a list labels the patch; a text would label its container
            early_label = [style.shared_label("next stage already acts")]
            axes.barh(
                middle, span.start - bar.left, STAGE_BAR_HEIGHT, bar.left, facecolor=style.EARLY, label=early_label
            )
        face = style.STAGE if span.index % 2 else "white"
        axes.barh(middle, span.end - span.start, STAGE_BAR_HEIGHT, span.start, facecolor=face)
        text_at = middle
        if stage_look is not None:
            patch_look = {"height": KEY_HEIGHT, "linewidth": 0, **stage_look(span.index)}
            axes.barh(middle + (STAGE_BAR_HEIGHT - KEY_HEIGHT) / 2, span.end - bar.left, left=bar.left, **patch_look)
            text_at -= KEY_HEIGHT / 2
        axes.barh(middle, span.end - bar.left, STAGE_BAR_HEIGHT, bar.left, **outline)
        axes.text(bar.name_at, text_at, bar.name, ha=bar.align, va="center_baseline", path_effects=[stroke])


def _shade(axes: Axes, spans: Sequence[Span]) -> None:
    """Shade every other stage, and where the next one acts early; a dotted line marks each early start."""
    for span in spans:
        if span.index % 2:
            axes.axvspan(span.start, span.end, **style.look("every other stage"))
        if span.early is not None:
            axes.axvspan(span.early, span.start, **style.look("next stage already acts"))
            axes.axvline(span.early, **style.look("early start"))
