"""Pareto fronts between the costs of two stages at several samples of a run. Paper Fig. 7."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.logs.results import Results
from psmpc_cli.studies.fronts import CONSTRAINED, WEIGHTED, front_points

STAR: dict[str, Any] = {"color": "black", "marker": "*", "linestyle": "none", "markersize": 6.5}
"""Look of the run's own weights."""

CROSS: dict[str, Any] = {"color": "#A0A0A0", "marker": "x", "linestyle": "none"}
"""Look of a dominated point."""

ARROW: Mapping[str, Any] = {
    "arrowstyle": "-|>,head_width=0.25,head_length=0.5",
    "linewidth": 0.4,
    "shrinkA": 0,
    "shrinkB": 0,
}
"""Look of an arrow along a front."""

SHADOW = "#D5D5D5"
"""Colour of the fronts on the floor."""


Points = tuple[np.ndarray, np.ndarray]
"""J_1 and J_2 of the points of one method at one instant (P, 2), and which are dominated (P,)."""


def in_plane(results: Results) -> list[list[Points]]:
    """Return the points with the instant held at the run's optimum, by sample, then by method."""
    found = [front_points(results, name) for name in (WEIGHTED, CONSTRAINED) if f"{name}_J_1" in results.quantities]
    return [[(J[i, 0], dominated[i, 0]) for J, dominated in found] for i in range(len(results["instant"]))]


def in_space(results: Results) -> bool:
    """Return whether the instant is a criterion of a study."""
    return "later" in results.quantities


def plot_fronts(results: Results) -> Figure:
    """Plot the fronts in the plane of both costs [s], J_2 to the right and J_1 up, a curve a sample.

    The axes of a second panel are logarithmic if the costs differ so much that a linear one cannot show them all.
    """
    samples = in_plane(results)
    every = np.concatenate([J for points in samples for J, _ in points])
    smallest, largest = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    panels = 2 if np.all(smallest > 0) and np.any(largest > 30.0 * smallest) else 1
    figure = style.new_figure(panels * (2.1 + 0.35) - style.LINE)
    rows = figure.subplots(panels, 1, squeeze=False)[:, 0]
    first, second = (style.readable(str(name)) for name in results["stage"])
    rows[0].xaxis.set_major_locator(MaxNLocator(nbins=6))
    if panels > 1:
        for along, wide in zip("yx", largest > 100.0 * smallest, strict=True):
            style.make_logarithmic(rows[1], along, subs=(1.0,) if wide else (1.0, 2.0, 5.0))
    for axes, letter in zip(rows, "ab", strict=False):
        for i, points in enumerate(samples):
            _plot_sample(axes, points, i)
            chosen = results["chosen_J_2"][i], results["chosen_J_1"][i]
            axes.plot(*chosen, markeredgecolor="white", zorder=5, markeredgewidth=0.4, **STAR)
        axes.set(xlabel=f"Cost of {second}, $J_2$ (s)", ylabel=f"Cost of {first}, $J_1$ (s)")
        axes.margins(0.04)
        axes.set_title(f"({letter})" if panels > 1 else "", loc="left", pad=3.5, fontsize=style.TEXT)
    _name_samples(rows[0], results)
    marks: list[Artist] = [style.entry("growing $ω_2/ω_1$", color="black", marker=">", markersize=4, linewidth=0.9)]
    marks.append(style.entry(_chosen_label(results), **STAR))
    if len(samples[0]) > 1:
        marks.append(style.entry("$J_2$ bounded", color="black", marker="+", linestyle="none"))
    if any(dominated.any() for points in samples for _, dominated in points):
        marks.append(style.entry("dominated", **CROSS))
    style.add_legend(figure, marks)
    figure.align_ylabels()
    return figure


def _plot_sample(axes: Axes, found: Sequence[Points], index: int) -> None:
    """Plot a sample's points, of the first method joined, with arrows to larger ratios, dominated ones crossed."""
    look = style.mark_look(index)
    for order, (J, dominated) in enumerate(found):
        kept = J[~dominated].T[::-1]
        if order == 0:
            axes.plot(*kept, linewidth=0.9, markersize=2.2, **look)
        else:
            axes.plot(*kept, "+", color=look["color"], markersize=3.5, markeredgewidth=0.6)
        axes.plot(*J[dominated].T[::-1], markersize=4.5, markeredgewidth=0.9, zorder=4, **CROSS)
    curve = found[0][0][np.isfinite(found[0][0]).all(axis=1)][:, ::-1]
    if len(curve) < 2:
        return
    length = np.cumsum(np.linalg.norm(np.diff(curve, axis=0) / np.maximum(np.ptp(curve, axis=0), 1e-12), axis=1))
    for k in np.searchsorted(length, [0.3 * length[-1], 0.75 * length[-1]]):
        axes.annotate("", xy=curve[k + 1], xytext=curve[k], arrowprops={**ARROW, "facecolor": look["color"]}, zorder=4)


def _name_samples(axes: Axes, results: Results) -> None:
    """Name the samples, in the plane with their hypervolumes."""
    third = in_space(results)
    handles: list[Artist] = []
    for i, (instant, volume) in enumerate(zip(results["instant"], results["hypervolume"], strict=True)):
        label = f"{instant:.1f} s" if third else f"{instant:.1f} s: {volume:.3g} s$^2$"
        handles.append(style.entry(label, linewidth=0.9, markersize=2.2, **style.mark_look(i)))
    title = "Sampling instant $T_0$" + ("" if third else ": hypervolume")
    axes.legend(handles=handles, title=title, title_fontsize=style.TEXT, loc="upper right", alignment="left")


def _chosen_label(results: Results) -> str:
    """Return the legend entry of the run's own weights."""
    ratio = results["chosen_ratio"]
    return f"$ω_2/ω_1$ = {ratio[0]:g}" if np.ptp(ratio) <= 1e-9 * ratio[0] else "weights of the run"


def plot_in_space(results: Results) -> Figure:
    """Plot for each sample the fronts with the instant held ever later, over the plane of both costs [s].

    On the floor is their projection: fronts of later instants cross those of earlier ones.
    """
    samples = len(results["instant"])
    rows = -(-samples // 3)
    figure = style.new_figure(rows * 2.15 + 0.15, style.PAGE)
    for i in range(samples):
        axes: Any = figure.add_subplot(rows, 3, i + 1, projection="3d")
        _plot_in_space(axes, results, i)
    marks = [
        style.entry("instant held", color=style.PALETTE[0], marker="o", markersize=2.6, linewidth=0.9),
        style.entry("instant free", color=style.PALETTE[1], marker="s", markersize=2.6, linewidth=0.9),
        style.entry(_chosen_label(results), **STAR),
        style.entry("dominated", **CROSS),
        style.entry("in the plane of $J_1$ and $J_2$", color=SHADOW, linewidth=0.9),
    ]
    style.add_legend(figure, marks)
    return figure


def _plot_in_space(axes: Any, results: Results, i: int) -> None:
    """Plot the fronts of one sample; `axes` are three-dimensional ones, for which Matplotlib has no types."""
    method = WEIGHTED if f"{WEIGHTED}_J_1" in results.quantities else CONSTRAINED
    (J, marks), waits = front_points(results, method), results[f"{method}_wait"][i]
    floor = float(np.nanmin(waits))
    span = float(np.nanmax(waits)) - floor
    floor -= 0.15 * span
    for later, found in enumerate(waits):
        if not np.isfinite(found).any():
            continue
        wait = float(np.nanmax(found))
        (y, x), dominated = J[i, later].T, marks[i, later]
        axes.plot(x, y, floor, color=SHADOW, linewidth=0.9)
        axes.plot(x, y, wait, color=style.PALETTE[0], linewidth=0.9)
        axes.plot(x[~dominated], y[~dominated], wait, "o", color=style.PALETTE[0], markersize=2.6)
        axes.plot(x[dominated], y[dominated], wait, markersize=3.5, markeredgewidth=0.8, **CROSS)
    free = [results[f"free_{name}"][i] for name in ("J_2", "J_1", "wait")]
    axes.plot(*free, color=style.PALETTE[1], marker="s", markersize=2.2, linewidth=0.9)
    chosen = (results["chosen_J_2"][i], results["chosen_J_1"][i], results["t_s"][i] - results["instant"][i])
    axes.plot(*([value] for value in chosen), zorder=5, **STAR)
    first, second = (style.readable(str(name)) for name in results["stage"])
    axes.set_xlabel(f"{second}, $J_2$ (s)", labelpad=-3)
    axes.set_ylabel(f"{first}, $J_1$ (s)", labelpad=-4)
    axes.set_zlabel("$t_s - T_0$ (s)", labelpad=-2)
    axes.set_zlim(floor, floor + 1.2 * span)
    axes.set_title(f"$T_0$ = {results['instant'][i]:.1f} s", fontsize=style.TEXT, y=0.95)
    axes.tick_params(pad=-3)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(nbins=4))
    axes.view_init(elev=24.0, azim=-52.0)
    axes.set_box_aspect(None, zoom=0.77)
