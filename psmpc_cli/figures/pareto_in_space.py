"""Fronts of three criteria: both costs, and the switching instant itself."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures.pareto_points import DOMINATED, chosen_label, held, stage_words
from psmpc_cli.figures.style import PAGE, PALETTE, TEXT, new_figure
from psmpc_cli.logs.results import Results

COLUMNS = 3
"""Panels beside each other."""

SIDE, BELOW = 2.15, 0.3
"""Height of a panel and of the legend [in]."""

ELEVATION, AZIMUTH = 24.0, -52.0
"""From where the panels are seen [deg]."""

SHADOW = "#D5D5D5"
"""Colour of the fronts on the floor."""


def plot_in_space(results: Results) -> Figure:
    """Return for each sample the fronts with the instant held ever later, over the plane of both costs [s].

    On the floor is what is seen of them in the plane: fronts of later instants cross those of earlier ones.
    """
    samples = len(results["instant"])
    rows = -(-samples // COLUMNS)
    figure = new_figure(rows * SIDE + BELOW, PAGE)
    for i in range(samples):
        axes: Any = figure.add_subplot(rows, COLUMNS, i + 1, projection="3d")
        _plot_sample(axes, results, i)
    marks = [
        Line2D([], [], color=PALETTE[0], marker="o", markersize=2.6, linewidth=0.9, label="instant held"),
        Line2D([], [], color=PALETTE[1], marker="s", markersize=2.6, linewidth=0.9, label="instant free"),
        Line2D([], [], color="black", marker="*", linestyle="none", markersize=6.5, label=chosen_label(results)),
        Line2D([], [], color=DOMINATED, marker="x", linestyle="none", label="dominated"),
        Line2D([], [], color=SHADOW, linewidth=0.9, label="in the plane of $J_1$ and $J_2$"),
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=len(marks))
    return figure


def _plot_sample(axes: Any, results: Results, i: int) -> None:
    """Plot the fronts of one sample; `axes` are three-dimensional ones, for which Matplotlib has no types."""
    method = "weighted" if "weighted_J_1" in results.quantities else "constrained"
    waits, floor = results[f"{method}_wait"][i], float(np.nanmin(results[f"{method}_wait"][i]))
    span = float(np.nanmax(waits)) - floor
    floor -= 0.15 * span
    for later, found in enumerate(waits):
        if not np.isfinite(found).any():
            continue
        wait = float(np.nanmax(found))
        points = held(results, method, i, later)
        x, y, kept = points.J[:, 1], points.J[:, 0], ~points.dominated
        axes.plot(x, y, floor, color=SHADOW, linewidth=0.9)
        axes.plot(x, y, wait, color=PALETTE[0], linewidth=0.9)
        axes.plot(x[kept], y[kept], wait, "o", color=PALETTE[0], markersize=2.6)
        axes.plot(x[~kept], y[~kept], wait, "x", color=DOMINATED, markersize=3.5, markeredgewidth=0.8)
    free = [results[f"free_{name}"][i] for name in ("J_2", "J_1", "wait")]
    axes.plot(*free, color=PALETTE[1], marker="s", markersize=2.2, linewidth=0.9)
    chosen = (results["chosen_J_2"][i], results["chosen_J_1"][i], results["t_s"][i] - results["instant"][i])
    axes.plot(*([value] for value in chosen), "*", color="black", markersize=6.5, zorder=5)
    first, second = stage_words(results)
    axes.set_xlabel(f"{second}, $J_2$ (s)", labelpad=-3)
    axes.set_ylabel(f"{first}, $J_1$ (s)", labelpad=-4)
    axes.set_zlabel("$t_s - T_0$ (s)", labelpad=-2)
    axes.set_zlim(floor, floor + 1.2 * span)
    axes.set_title(f"$T_0$ = {results['instant'][i]:.1f} s", fontsize=TEXT, y=0.95)
    axes.tick_params(pad=-3)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(nbins=4))
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)
    axes.set_box_aspect(None, zoom=0.77)
