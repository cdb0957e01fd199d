"""The actual start at random draws of the two priorities."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.style import EDGE, new_figure
from psmpc_cli.figures.sweep.plane import (
    COLORS,
    FAILED,
    add_colour_bar,
    label_plane,
    legend_above,
    start_scale,
    starts_of,
)
from psmpc_cli.simulation.sweep_cells import SweepCells

HEIGHT = 2.95

WAITING: Mapping[str, Any] = {
    "marker": "o",
    "markersize": 4.0,
    "markerfacecolor": "white",
    "markeredgecolor": EDGE,
    "markeredgewidth": 0.5,
    "linestyle": "none",
}
"""Look of a draw that waits."""


def plot_draws(cells: SweepCells) -> Figure:
    """Return the actual start [s] as the colour of a point for every draw of omega_1 and omega_2."""
    figure = new_figure(HEIGHT)
    axes = figure.add_subplot()
    scale, (x, y) = start_scale(cells), np.log10(cells.omega.T)
    ended = cells.ended
    axes.scatter(
        x[ended], y[ended], 16, starts_of(cells)[ended], norm=scale.norm, cmap=COLORS, edgecolors=EDGE, linewidths=0.3
    )
    handles: list[Artist] = []
    for which, name, look in ((cells.failed, "failed", FAILED), (cells.waiting, "waiting", WAITING)):
        if which.any():
            axes.plot(x[which], y[which], **look)
            handles.append(Line2D([], [], label=name, **look))
    label_plane(axes, cells)
    add_colour_bar(figure, axes, cells, scale)
    legend_above(figure, handles)
    return figure
