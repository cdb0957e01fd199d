"""Figures of the ablations, from plain arrays: curves (x, y) by panel and label, as studies measure them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.style import EARLY, EDGE, LINE, PALETTE, STAGE, TEXT, in_style, line_look, new_figure

Curves = Mapping[str, tuple[np.ndarray, np.ndarray]]
Panels = Mapping[str, Curves]

HEIGHT, MARGIN, AXIS = 1.2, 0.25, 0.3
"""Height of a panel, of what stands around it all, and of an axis with its label [in]."""

ROW, NAME, BAR, ACTS = 0.38, 0.38, 0.55, 0.2
"""Height of a run's row [in]; of its name, its bars and what acts early on their lower edge, as parts of the row."""

HORIZON = "T_f"
"""The curve that says how far ahead the horizon ends."""

INFEASIBLE = "#DDDDDD"

EXACT = 1e-9
"""Errors below this are none [m, rad]."""

MARKERS = ("o", "s", "^", "D")

NAMES: Mapping[str, str] = {
    "ours": "ours",
    "printed": "as printed, δ = 0",
    "range and printed": "range, δ = 0",
    "exact": "exact",
    "euler": "Euler, as printed",
}
"""Runs and forms as the legends have them; other labels stand for themselves."""


def draw_ablation(name: str, panels: Panels, path: Path) -> Path:
    """Draw the figure of an ablation into a file and return it.

    Args:
        name: pending_cost, normalization or discretization.
        panels: Its curves.
        path: The file; its ending says the format.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with in_style():
        plot_ablation(name, panels).savefig(path)
    return path


def plot_ablation(name: str, panels: Panels) -> Figure:
    """Return the figure of an ablation."""
    return PLOTS[name](panels)


def plot_pending_cost(panels: Panels) -> Figure:
    """Return how far ahead the optimized instant is [s], the control's variation, and J over the instant [s].

    J is over its value at the earliest instant that can be met, the other variables optimized; circles are its minima,
    triangles what the free optimizer returns.
    """
    figure = new_figure(4 * HEIGHT + 2 * AXIS + MARGIN)
    ahead, variation, printed, ours = figure.subplots(4, 1)
    _plot_over_time((ahead, variation), panels)
    ours.sharex(printed)
    end = float(panels["instant"][HORIZON][1][0])
    for axes, objective, letter in ((printed, "printed", "c"), (ours, "ours", "d")):
        curves, minima, found = (panels[f"{what}, {objective}"] for what in ("J", "minima", "found"))
        _plot_scan(axes, curves, minima, found, end)
        axes.set_ylabel(f"$J$, {'ours' if objective == 'ours' else 'δ = 0'}\n(relative)")
        axes.set_title(f"({letter})", loc="left", pad=3.5, fontsize=TEXT)
    panel_legend(printed, "(c)")
    printed.tick_params(labelbottom=False)
    ours.set_xlabel("Instant $t_s$ after $T_0$ (s)")
    figure.align_ylabels()
    return figure


def plot_normalization(panels: Panels) -> Figure:
    """Return the stages of each run [s], how far ahead the optimized instant is [s], and the control's variation."""
    runs = len(panels["stages"])
    figure = new_figure(runs * ROW + 2 * HEIGHT + AXIS + MARGIN + LINE)
    stages, ahead, variation = figure.subplots(3, 1, height_ratios=[runs * ROW, HEIGHT, HEIGHT])
    _plot_stages(stages, panels["stages"])
    _plot_over_time((ahead, variation), panels, "bc")
    stages.sharex(ahead)
    sizes = [y[y > 0] for _, y in panels["variation"].values() if np.any(y > 0)]
    if sizes:
        _make_logarithmic(variation, (1.0,))
        variation.set_ylim(max(min(float(y.min()) for y in sizes), 0.1), 2.0 * max(float(y.max()) for y in sizes))
    figure.align_ylabels([ahead, variation])
    return figure


def plot_discretization(panels: Panels) -> Figure:
    """Return over N_s the prediction's error [m, rad], the miss at the switch [tolerances] and the run's end [s].

    A form whose prediction has no error to speak of is named above its panel.
    """
    figure = new_figure(3 * HEIGHT + AXIS + MARGIN)
    rows = figure.subplots(3, 1, sharex=True)
    labels = ("Prediction error\n(m, rad)", "Miss at $t_s$\n(tolerances)", "End of\nthe run (s)")
    for axes, panel, label, letter in zip(rows, ("error", "missed", "end"), labels, "abc", strict=True):
        without = []
        for i, (kind, (nodes, values)) in enumerate(panels[panel].items()):
            if panel == "error" and not np.any(values > EXACT):
                without.append(f"{NAMES.get(kind, kind)}: below 10{_raised(round(np.log10(EXACT)))}")
                continue
            axes.plot(nodes, values, marker=MARKERS[i], label=NAMES.get(kind, kind), **line_look(i))
        axes.set_ylabel(label)
        panel_legend(axes, "   ".join((f"({letter})", *without)))
    _make_logarithmic(rows[0])
    rows[1].set_ylim(bottom=0.0)
    for axes in rows:
        axes.margins(y=0.12)
    _count_nodes(rows[-1], panels["end"])
    figure.align_ylabels()
    return figure


PLOTS: Mapping[str, Callable[[Panels], Figure]] = {
    "pending_cost": plot_pending_cost,
    "normalization": plot_normalization,
    "discretization": plot_discretization,
}
"""The figure of each ablation by its name."""


def _raised(exponent: int) -> str:
    """Return a whole number as superscript."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _count_nodes(axes: Axes, curves: Curves) -> None:
    """Make the axis one of N_s, with the numbers that were tried."""
    counts = sorted({float(n) for nodes, _ in curves.values() for n in nodes})
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(counts))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_xlabel("Intervals of a stage ($N_s$)")


def _make_logarithmic(axes: Axes, ticks: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Make the vertical axis logarithmic, with plain numbers at these parts of every decade."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=ticks))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_locator(NullLocator())


def _plot_over_time(rows: tuple[Axes, Axes], panels: Panels, letters: str = "ab") -> None:
    """Plot how far ahead the optimized instant is [s], a point a sample, and the variation of the joints' control."""
    above, below = rows
    runs = [label for label in panels["instant"] if label != HORIZON]
    for i, label in enumerate(runs):
        name, color = NAMES.get(label, label), PALETTE[i]
        look: dict[str, Any] = {"marker": MARKERS[i], "linestyle": "none", "markeredgecolor": "none"}
        above.plot(*panels["instant"][label], color=color, label=name, markersize=2.0, **look)
        below.plot(*panels["variation"][label], label=name, **line_look(i))
    time, ahead = panels["instant"][HORIZON]
    above.plot(time, ahead, color=EDGE, linewidth=0.7, label="$T_f$", zorder=1.5)
    above.set_ylim(0.0, 1.06 * float(ahead[0]))
    above.set_ylabel("Optimized instant\nfrom now (s)")
    below.set_ylabel("Variation of joint\ncontrol (rad/s$^2$)")
    below.set_ylim(bottom=0.0)
    below.sharex(above)
    above.tick_params(labelbottom=False)
    above.margins(x=0.012)
    below.set_xlabel("Time (s)")
    panel_legend(above, f"({letters[0]})", 0.9)
    panel_legend(below, f"({letters[1]})")


def _plot_scan(axes: Axes, curves: Curves, minima: Curves, found: Curves, end: float) -> None:
    """Plot J over the instant for each ratio of priorities, its minima, and what the optimizer returns."""
    earliest = min(float(instants[0]) for instants, _ in curves.values())
    axes.axvspan(0.0, earliest, facecolor=INFEASIBLE, edgecolor="none", zorder=0)
    axes.text(earliest / 2, 0.5, "infeasible", transform=axes.get_xaxis_transform(), fontsize=TEXT, ha="center")
    axes.axvline(end, color=EDGE, linewidth=0.7, zorder=1.5)
    for i, (label, (instants, cost)) in enumerate(curves.items()):
        look = line_look(i + 2)
        axes.plot(instants, cost, label=label, **look)
        marks: dict[str, Any] = {"color": look["color"], "markeredgecolor": "black", "clip_on": False, "zorder": 4}
        axes.plot(*minima[label], "o", markersize=4.5, **marks)
        axes.plot(*found[label], "v", markersize=5, **marks)
    for marker, size, name in (("o", 4.5, "minimum"), ("v", 5, "returned")):
        axes.plot([], [], marker, color="white", markersize=size, markeredgecolor="black", label=name)
    axes.set_xlim(0.0, 1.01 * end)
    axes.margins(y=0.12)
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))


def _plot_stages(axes: Axes, runs: Curves) -> None:
    """Draw the stages of each run as bars, by number, and on their lower edge from when on the next one acts."""
    axes.set_ylim(len(runs), 0.0)
    axes.set_yticks([])
    axes.tick_params(labelbottom=False)
    for row, (label, (starts, ends)) in enumerate(runs.items()):
        axes.text(0.008, row + NAME / 2, NAMES.get(label, label), transform=axes.get_yaxis_transform(), **_SMALL)
        begins = np.r_[0.0, ends[:-1]]
        for stage, (start, begin, end) in enumerate(zip(starts, begins, ends, strict=True)):
            if not np.isfinite([begin, end]).all():
                break
            axes.add_patch(_bar(begin, row + NAME, end - begin, BAR, STAGE if stage % 2 else "white"))
            axes.text((begin + end) / 2, row + NAME + (BAR - ACTS) / 2, str(stage + 1), ha="center", **_SMALL)
            if start < begin:
                axes.add_patch(_bar(start, row + NAME + BAR - ACTS, begin - start, ACTS, EARLY))
    keys = [Patch(facecolor="white", label="stage, by number"), Patch(facecolor=EARLY, label="next one acts already")]
    for key in keys:
        key.set(edgecolor=EDGE, linewidth=0.5)
    axes.legend(handles=keys, loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, handlelength=1.0)
    axes.set_title("(a)", loc="left", pad=3.5, fontsize=TEXT)


def _bar(left: float, top: float, width: float, height: float, face: str) -> Rectangle:
    return Rectangle((left, top), width, height, facecolor=face, edgecolor=EDGE, linewidth=0.5)


_SMALL: dict[str, Any] = {"fontsize": TEXT, "va": "center"}
