"""The actual start over the plane of the two priorities as a surface. Paper Fig. 6."""

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.style import EDGE, new_figure
from psmpc_cli.figures.sweep.plane import (
    SEEN,
    StartScale,
    count_decades,
    failed_mark,
    legend_above,
    start_label,
    start_scale,
    starts_of,
)
from psmpc_cli.simulation.sweep_cells import SweepCells

HEIGHT = 2.7

ELEVATION, AZIMUTH = 24.0, -128.0
"""From where the surface is seen [deg]: its slope faces the reader."""

PLACE, BOX, ZOOM = (0.09, 0.0, 0.91, 1.0), (1.0, 1.0, 0.78), 1.03
"""Where the axes stand in the figure; their proportions; how far they fill their place."""


def plot_surface(cells: SweepCells) -> Figure:
    """Return the actual start [s] over omega_1 and omega_2, between frames at t_s and at t_s - T_h."""
    figure = new_figure(HEIGHT)
    figure.set_layout_engine("none")  # it makes no room for the labels of axes in three dimensions
    axes: Any = figure.add_axes(PLACE, projection="3d", proj_type="ortho", computed_zorder=False)
    scale, shape = start_scale(cells), cells.results["status"].shape
    x, y = np.meshgrid(*(np.log10(cells.results[name]) for name in ("omega_1", "omega_2")))
    start, failed = starts_of(cells).reshape(shape), cells.failed.reshape(shape)
    handles: list[Artist] = []
    if cells.ended.any():
        handles = _plot_surface(axes, x, y, start, scale)
    if failed.any():
        axes.plot(x[failed], y[failed], np.full(failed.sum(), scale.low), "x", color="black", markersize=3.5)
        handles.append(failed_mark())
    if cells.waiting.any():
        handles.append(Line2D([], [], linestyle="none", label="blank: waiting"))
    _set_axes(axes, cells, scale)
    legend_above(figure, handles)
    return figure


def _plot_surface(axes: Any, x: np.ndarray, y: np.ndarray, start: np.ndarray, scale: StartScale) -> list[Artist]:
    """Draw the surface and both frames from the lowest to the highest, as they cover each other."""
    floor = _plot_frame(axes, x, y, scale.low, (0, (4, 1.5)), SEEN)
    colors = scale.colors.to_rgba(start)
    axes.plot_surface(x, y, start, facecolors=colors, rstride=1, cstride=1, edgecolor=EDGE, linewidth=0.2, shade=False)
    return [*_plot_frame(axes, x, y, scale.high, "-", "$t_s$"), *floor]


def _plot_frame(axes: Any, x: np.ndarray, y: np.ndarray, height: float, dashes: object, label: str) -> list[Artist]:
    """Draw the outline of the plane at a height; return what the legend says of it."""
    left, right, front, back = x.min(), x.max(), y.min(), y.max()
    corners = [left, right, right, left, left], [front, front, back, back, front], [height] * 5
    return list(axes.plot(*corners, color=EDGE, linewidth=0.8, linestyle=dashes, label=label))


def _set_axes(axes: Any, cells: SweepCells, scale: StartScale) -> None:
    axes.view_init(ELEVATION, AZIMUTH)
    axes.set_box_aspect(BOX, zoom=ZOOM)
    axes.set_xlabel("ω₁ (1)", labelpad=-6)
    axes.set_ylabel("ω₂ (1)", labelpad=-6)
    axes.set_zlabel(start_label(cells, "\n"), labelpad=-4)
    for axis in (axes.xaxis, axes.yaxis):
        count_decades(axis, 4)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_tick_params(pad=-3)
        axis.pane.set_facecolor("white")
    axes.grid(visible=False)
    axes.set_zlim(scale.low, scale.high)
    if not cells.ended.any():
        axes.set_zticks([])
