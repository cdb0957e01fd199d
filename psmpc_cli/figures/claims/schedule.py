"""When the stages end and start, method by method, with what is published."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from psmpc_cli.figures.claims.marks import published_mark
from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.figures.run import Run, Span
from psmpc_cli.figures.style import (
    COLUMN,
    EARLY,
    EDGE,
    STAGE,
    TEXT,
    legend_columns,
    new_figure,
    readable,
)

ROW, MARGINS = 0.55, 1.05
"""Heights of a method's row; of axis and legend [in]."""

BAR, EARLY_BAR = 0.46, 0.18
"""Heights of a stage's bar and of its early part, in rows."""


def plot_schedule(runs: Mapping[str, Run], published: Mapping[str, Mapping[str, float]]) -> Figure:
    """Return a bar a stage for every method, early starts below it, and marks at the published ends.

    Args:
        runs: By method.
        published: Published ends by method and stage [s].
    """
    figure = new_figure(MARGINS + ROW * len(runs))
    axes = figure.subplots()
    latest = max([run.end for run in runs.values()] + [time for times in published.values() for time in times.values()])
    axes.set_xlim(0.0, latest * 1.02)
    axes.set_ylim(len(runs) - 0.4, -0.6)
    for row, (name, run) in enumerate(runs.items()):
        axes.annotate(title_of(name), (0.0, row), (-3, 0), textcoords="offset points", ha="right", va="center")
        for span in run.spans:
            _draw_span(axes, row, span)
        for time in published.get(name, {}).values():
            axes.plot(time, row - BAR / 2 - 0.1, **published_mark())
    axes.set_yticks([])
    axes.set_xlabel("Time (s)")
    axes.set_title(_key(runs), loc="left", pad=4, fontsize=TEXT)
    handles = [
        Patch(facecolor=EARLY, edgecolor=EDGE, linewidth=0.4, label="next stage acts already"),
        Line2D([], [], label="published end", **published_mark()),
    ]
    columns = legend_columns((str(handle.get_label()) for handle in handles), COLUMN - 0.1)
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)
    return figure


def _draw_span(axes: Axes, row: int, span: Span) -> None:
    """Draw a stage's bar with its number, and its early part below."""
    face = STAGE if span.index % 2 else "white"
    axes.barh(row, span.end - span.start, BAR, span.start, facecolor=face, edgecolor=EDGE, linewidth=0.5)
    if span.early is not None:
        low = row + BAR / 2 + EARLY_BAR / 2
        axes.barh(low, span.start - span.early, EARLY_BAR, span.early, facecolor=EARLY, edgecolor=EDGE, linewidth=0.4)
    middle = (span.start + span.end) / 2
    axes.text(middle, row, str(span.index + 1), fontsize=TEXT, ha="center", va="center_baseline")


def _key(runs: Mapping[str, Run]) -> str:
    """Return what the numbers stand for."""
    names = next(iter(runs.values())).log.stage_names
    return ", ".join(f"{number} {readable(name)}" for number, name in enumerate(names, start=1))
