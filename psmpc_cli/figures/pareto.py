"""Pareto fronts at several samples of a run, one curve a sample. Fig. 7 of the paper."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterMathtext, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from psmpc_cli.errors import LogError
from psmpc_cli.figures.files import draw_chosen
from psmpc_cli.figures.pareto_in_space import plot_in_space
from psmpc_cli.figures.pareto_points import DOMINATED, MARKERS, Points, chosen_label, in_plane, stage_words
from psmpc_cli.figures.style import AXIS_WIDTH, PALETTE, TEXT, legend_columns, new_figure
from psmpc_cli.logs.results import Results

HEIGHT, AROUND = 2.1, 0.35
"""Height of a panel, and of an axis with its label [in]."""

ARROWS = (0.3, 0.75)
"""Where on a curve arrows point to larger ratios, as parts of its length on paper."""

ARROW = 8.5
"""Length of an arrow [pt]."""

WIDE = 30.0
"""Largest over smallest value of a criterion from which on a linear axis does not show all of it."""


DECADES = 100.0
"""Largest over smallest value of a criterion from which on powers of ten are enough on its logarithmic axis."""


def draw_pareto(
    results: Results,
    directory: Path,
    formats: Sequence[str] = ("png",),
    only: Collection[str] | None = None,
    force: bool = False,
) -> list[Path]:
    """Draw figures of a Pareto study, each into a file a format, and return the files.

    Raises:
        InputError: A name or format is unknown, a file exists or cannot be written.
        LogError: No point of the study could be solved for.
    """
    figures = FIGURES if "later" in results.quantities else {"front": plot_fronts}
    if not any(np.isfinite(one.J).any() for points in in_plane(results) for one in points):
        raise LogError(f"{results.path}: holds no point that could be solved for, so there is nothing to draw")
    return draw_chosen(figures, results, directory, formats, only, force)


def plot_fronts(results: Results) -> Figure:
    """Return the fronts in the plane of both costs [s], J_2 to the right and J_1 up.

    The axes of a second panel are logarithmic if the costs differ so much that a linear one cannot show them all.
    """
    samples = in_plane(results)
    every = np.concatenate([one.J for points in samples for one in points])
    smallest, largest = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    panels = 2 if np.all(smallest > 0) and np.any(largest > WIDE * smallest) else 1
    figure = new_figure(panels * (HEIGHT + AROUND))
    rows = figure.subplots(panels, 1, squeeze=False)[:, 0]
    first, second = stage_words(results)
    for axes, letter in zip(rows, "ab", strict=False):
        if letter == "b":
            _make_logarithmic(axes, smallest, largest)
        for i, points in enumerate(samples):
            _plot_sample(axes, points, i)
            chosen_one = results["chosen_J_2"][i], results["chosen_J_1"][i]
            axes.plot(*chosen_one, "*", color="black", markersize=6.5, markeredgecolor="white", zorder=5, mew=0.4)
        axes.set_ylabel(f"Cost of {first}, $J_1$ (s)")
        axes.set_xlabel(f"Cost of {second}, $J_2$ (s)")
        axes.margins(0.04)
        if panels > 1:
            axes.set_title(f"({letter})", loc="left", pad=3.5, fontsize=TEXT)
    _write_legends(figure, rows[0], results, samples)
    figure.draw_without_rendering()  # arrows follow the curves as they lie on paper
    for axes in rows:
        for i, points in enumerate(samples):
            _draw_arrows(axes, points[0].J, PALETTE[i % len(PALETTE)])
    figure.align_ylabels()
    return figure


FIGURES: Mapping[str, Callable[[Results], Figure]] = {"front": plot_fronts, "front_3d": plot_in_space}
"""Every figure of a Pareto study by its name, which is also its file's stem."""


def _plot_sample(axes: Axes, found: Sequence[Points], index: int) -> None:
    """Plot a sample's points, those of the first method joined, dominated ones crossed out."""
    look: dict[str, Any] = {"color": PALETTE[index % len(PALETTE)], "marker": MARKERS[index % len(MARKERS)]}
    for order, points in enumerate(found):
        J, kept = points.J, ~points.dominated
        if order == 0:
            axes.plot(J[kept, 1], J[kept, 0], linewidth=0.9, markersize=2.2, **look)
        else:
            axes.plot(J[kept, 1], J[kept, 0], "+", color=look["color"], markersize=3.5, markeredgewidth=0.6)
        axes.plot(J[~kept, 1], J[~kept, 0], "x", color=DOMINATED, markersize=4.5, markeredgewidth=0.9, zorder=4)


def _draw_arrows(axes: Axes, J: np.ndarray, color: str) -> None:
    """Draw arrows along a curve (N, 2) of points with ever larger ratios."""
    J = J[np.isfinite(J).all(axis=1)]
    if len(J) < 2:
        return
    at = axes.transData.transform(J[:, ::-1])
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))]
    size = ARROW * axes.figure.dpi / 72
    if length[-1] < 3 * size:
        return
    for part in ARROWS:
        reach = part * length[-1] + np.array([-0.5, 0.5]) * size
        tail, head = np.column_stack([np.interp(reach, length, at[:, k]) for k in (0, 1)])
        ends = axes.transData.inverted().transform([tail, head])
        axes.annotate("", xy=ends[1], xytext=ends[0], arrowprops={**_ARROWHEAD, "facecolor": color}, zorder=4)


_ARROWHEAD: dict[str, Any] = {
    "arrowstyle": "simple,head_width=0.5,head_length=0.9,tail_width=0.01",
    "mutation_scale": 8.0,
    "edgecolor": "black",
    "linewidth": 0.4,
    "shrinkA": 0,
    "shrinkB": 0,
}


def _make_logarithmic(axes: Axes, low: np.ndarray, high: np.ndarray) -> None:
    """Make both axes logarithmic, with powers of ten as numbers, or plain ones where there are no two of them.

    `low` and `high` are the smallest and largest J_1 and J_2 (2,).
    """
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis, wide in zip((axes.yaxis, axes.xaxis), high > DECADES * low, strict=True):
        axis.set_major_locator(LogLocator(numticks=6) if wide else LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(LogFormatterMathtext() if wide else StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def _write_legends(figure: Figure, top: Axes, results: Results, samples: Sequence[Sequence[Points]]) -> None:
    """Name the instants with their hypervolumes in the first panel, and what the marks are below the figure."""
    top.xaxis.set_major_locator(MaxNLocator(nbins=6))
    handles = [
        Line2D([], [], linewidth=0.9, markersize=2.2, color=PALETTE[i % len(PALETTE)], marker=MARKERS[i % len(MARKERS)])
        for i in range(len(samples))
    ]
    volumes, in_space = results["hypervolume"], "later" in results.quantities
    labels = [f"{instant:.1f} s" for instant in results["instant"]]
    if not in_space:
        labels = [f"{label}: {volume:.3g} s$^2$" for label, volume in zip(labels, volumes, strict=True)]
    title = "Sampling instant $T_0$" + ("" if in_space else ": hypervolume")
    top.legend(handles, labels, title=title, title_fontsize=TEXT, loc="upper right", alignment="left")
    marks = [Line2D([], [], color="black", marker=">", markersize=4, linewidth=0.9, label="growing $ω_2/ω_1$")]
    marks += [Line2D([], [], color="black", marker="*", linestyle="none", markersize=6.5, label=chosen_label(results))]
    if len(samples[0]) > 1:
        marks += [Line2D([], [], color="black", marker="+", linestyle="none", label="$J_2$ bounded")]
    if any(one.dominated.any() for points in samples for one in points):
        marks += [Line2D([], [], color=DOMINATED, marker="x", linestyle="none", label="dominated")]
    columns = legend_columns([str(mark.get_label()) for mark in marks], AXIS_WIDTH)
    figure.legend(handles=marks, loc="outside lower center", ncols=columns)
