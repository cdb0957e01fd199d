"""The actual start against the ratio of the priorities, for every threshold. What paper Fig. 6 shows, in one curve."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.style import EDGE, STAGE, line_look, new_figure, readable
from psmpc_cli.figures.sweep.along import label_ratio, mark_failed, plot_along, set_ratio
from psmpc_cli.figures.sweep.plane import SEEN
from psmpc_cli.simulation.sweep_cells import SweepCells, along_ratio

HEIGHT = 2.7

MARGIN = 0.06
"""Free height beyond t_s and t_s - T_h, as part of T_h."""

LEGEND = 1.005
"""Where the legend begins, as part of the axes' height: its subscripts stay clear of the frame."""


def plot_starts(cells: SweepCells) -> Figure:
    """Return the actual start [s] over omega_2 / omega_1, a line a threshold, between t_s and t_s - T_h."""
    figure = new_figure(HEIGHT)
    axes = figure.add_subplot()
    set_ratio(axes, cells)
    if cells.ended.any():
        _plot_bounds(axes, cells)
        starts = cells.of("actual_start")
        for i in map(int, np.argsort(cells.epsilons)):
            plot_along(axes, along_ratio(cells, starts[:, i]), label=f"ε = {cells.epsilons[i]:g}", **line_look(i))
    else:
        axes.set_yticks([])
    mark_failed(axes, cells)
    label_ratio(axes)
    axes.set_ylabel(f"Actual start of {readable(cells.names[1])} (s)")
    panel_legend(axes)
    if (legend := axes.get_legend()) is not None:
        legend.set_bbox_to_anchor((1.0, LEGEND), transform=axes.transAxes)
    return figure


def _plot_bounds(axes: Axes, cells: SweepCells) -> None:
    """Plot t_s and t_s - T_h, below which no switch is in the window."""
    instant, floor = along_ratio(cells, cells.instant), along_ratio(cells, cells.floor)
    room = MARGIN * cells.task.spec.controller.horizon
    low, high = float(floor.lowest.min()) - room, float(instant.highest.max()) + room
    look: dict[str, Any] = {
        "color": EDGE,
        "linewidth": 0.8,
        "zorder": 1.6,
        "marker": "_" if len(floor.ratio) == 1 else "",
    }
    axes.plot(instant.ratio, instant.middle, label="$t_s$", **look)
    axes.plot(floor.ratio, floor.middle, linestyle=(0, (1, 1)), label=SEEN, **look)
    axes.fill_between(floor.ratio, low, floor.middle, color=STAGE, linewidth=0, zorder=0.5)
    axes.set_ylim(low, high)
