"""Base pose and joint angles over time, a column a controller. Figs. 8 to 10 of the paper side by side."""

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.figures.panels import HEIGHT, Quantity, axis_label, coordinate_panels, plot_lines
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import COLUMN, LINE, PAGE, TEXT, legend_columns, new_figure
from psmpc_cli.figures.timeline import MARGINS, ROOM, STRIP, draw_strip, shade, stage_handles

LEFT = 0.6
"""Width of what stands left of the panels [in]."""

ABOVE = 0.15
"""Height of a row's legend, and of the titles [in]."""


def plot_states(runs: Mapping[str, Run]) -> Figure:
    """Return base pose [m, rad] and joint angles [rad] over time, all controllers on the same axes."""
    first = next(iter(runs.values()))
    panels, quantity = coordinate_panels(first.model), Quantity(("position", "angle"), ("m", "rad"))
    width = COLUMN if len(runs) == 1 else PAGE
    height = STRIP + ABOVE + MARGINS + len(panels) * (HEIGHT + ABOVE)
    figure = new_figure(height, width)
    ratios = [STRIP] + [HEIGHT] * len(panels)
    grid = figure.subplots(len(panels) + 1, len(runs), sharex=True, sharey="row", squeeze=False, height_ratios=ratios)
    _set_time(grid[0, 0], runs.values())
    keys: list[Artist] = []
    for column, (name, run) in zip(grid.T, runs.items(), strict=True):
        keys += draw_strip(column[0], run, (width - LEFT) / len(runs))
        column[0].set_title(title_of(name), fontsize=8.0, pad=3)
        for axes, panel in zip(column[1:], panels, strict=True):
            shade(axes, run.spans)
            plot_lines(axes, run.time, run.Q[:, panel.rows], panel.labels)
        column[-1].set_xlabel("Time (s)")
    for axes, panel in zip(grid[1:, 0], panels, strict=True):
        axes.set_ylabel(axis_label(panel, quantity))
        _row_legend(axes)
    figure.align_ylabels(grid[1:, 0])
    _stage_legend(figure, [handle for run in runs.values() for handle in stage_handles(run.spans)] + keys)
    return figure


def _set_time(axes: Axes, runs: Iterable[Run]) -> None:
    """Set the common time axis: from the first start to the last end."""
    start, end = min(float(run.time[0]) for run in runs), max(run.end for run in runs)
    room = ROOM * (end - start) or 0.05
    axes.set_xlim(start - room, end + room)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 5, 10]))


def _row_legend(axes: Axes) -> None:
    """Write the legend of a row above its first panel; it may reach over the next, where nothing stands."""
    axes.set_title(" ", loc="left", pad=2, fontsize=TEXT)
    legend = axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=len(axes.get_lines()))
    legend.set_in_layout(False)


def _stage_legend(figure: Figure, handles: Iterable[Artist]) -> None:
    """Write what the shades mean, each once, below the panels."""
    entries = list({str(handle.get_label()): handle for handle in handles}.values())
    if entries:
        columns = legend_columns((str(handle.get_label()) for handle in entries), figure.get_figwidth() - 0.1)
        figure.set_figheight(figure.get_figheight() + -(-len(entries) // columns) * LINE)
        figure.legend(handles=entries, loc="outside lower center", ncols=columns)
