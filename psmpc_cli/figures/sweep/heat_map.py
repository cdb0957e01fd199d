"""The actual start over the plane of the two priorities as colours. Paper Fig. 6, seen from above."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from psmpc_cli.figures.style import EDGE, new_figure
from psmpc_cli.figures.sweep.plane import (
    COLORS,
    FAILED,
    SEEN,
    add_colour_bar,
    failed_mark,
    label_plane,
    legend_above,
    start_scale,
    starts_of,
)
from psmpc_cli.simulation.sweep_cells import SweepCells

HEIGHT = 2.95

FAILED_GROUND = "#D9D9D9"

ROUNDING = 1e-6
"""Times nearer to each other than this are the same [s]."""

CONTOUR = (("white", 2.0), ("black", 1.0))
"""The contour is a black line on a white one, seen on every colour."""


def plot_heat_map(cells: SweepCells) -> Figure:
    """Return the actual start [s] over omega_1 and omega_2, with the contour within which it is t_s - T_h.

    Starts are known to one sample: within the contour the start is the first sample after t_s - T_h.
    """
    figure = new_figure(HEIGHT)
    axes = figure.add_subplot()
    scale, shape = start_scale(cells), cells.results["status"].shape
    x, y = (np.log10(cells.results[name]) for name in ("omega_1", "omega_2"))
    start, failed = starts_of(cells).reshape(shape), cells.failed.reshape(shape)
    axes.pcolormesh(edges(x), edges(y), np.ma.masked_invalid(start), norm=scale.norm, cmap=COLORS)
    handles = _plot_contour(axes, x, y, start - cells.floor.reshape(shape), cells.task.spec.controller.sample_time)
    if failed.any():
        ground = np.ma.masked_equal(failed.astype(float), 0.0)
        axes.pcolormesh(edges(x), edges(y), ground, cmap=ListedColormap([FAILED_GROUND]))
        rows, columns = np.nonzero(failed)
        axes.plot(x[columns], y[rows], **FAILED)
        handles.append(failed_mark())
    if cells.waiting.any():
        handles.append(Patch(facecolor="white", edgecolor=EDGE, linewidth=0.5, label="waiting"))
    label_plane(axes, cells)
    add_colour_bar(figure, axes, cells, scale)
    legend_above(figure, handles)
    return figure


def edges(centres: np.ndarray) -> np.ndarray:
    """Return the edges (N + 1,) of cells around their centres (N,)."""
    between = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([2 * centres[:1] - between[:1], between, 2 * centres[-1:] - between[-1:]])


def _plot_contour(axes: Axes, x: np.ndarray, y: np.ndarray, above: np.ndarray, sample: float) -> list[Artist]:
    """Part the cells whose start is less than a sample above t_s - T_h from the others; return what the legend says."""
    known = np.isfinite(above)
    near = above < sample + ROUNDING
    if not known.any():
        return []
    if not near[known].any():
        return [Line2D([], [], linestyle="none", label=f"nowhere at {SEEN}")]
    if near[known].all():
        return [Line2D([], [], linestyle="none", label=f"everywhere at {SEEN}")]
    for color, width in CONTOUR:
        axes.contour(x, y, np.ma.masked_where(~known, near.astype(float)), levels=[0.5], colors=color, linewidths=width)
    return [Line2D([], [], color="black", linewidth=1.0, label=f"{SEEN}, to one sample")]
