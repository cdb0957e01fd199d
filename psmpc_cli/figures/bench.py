"""How near solves come against how long they take, back-end by back-end and mesh by mesh."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterMathtext, LogLocator, NullFormatter, StrMethodFormatter

from psmpc_cli.figures.files import prepare, save
from psmpc_cli.figures.style import AXIS_WIDTH, EDGE, PALETTE, TEXT, in_style, legend_columns, new_figure

FLOOR = 1e-10
"""Below this the optimum that solves are held against is itself not certain; smaller gaps stand here."""

HEIGHT, AROUND = 1.75, 1.15
"""Height of a panel, and of what is around them [in]."""

MARKERS = ("o", "^", "s", "D", "v", "p")
"""Marks of the meshes, in their order; an automatic mesh has a star."""

WIDE = 2000.0
"""Longest over shortest time from which on the axis has room for powers of ten alone."""

WHISKER = 0.6
"""How opaque whiskers are."""

COLD: Any = (0, (3, 1.5))
"""Lines through cold starts, whose marks are open."""

SIZE, STAR = 3.6, 6.0
"""Sizes of the marks [pt]."""

LOOKS = {"sqp": PALETTE[0], "fatrop": PALETTE[2], "ipopt": PALETTE[1], "reference": PALETTE[6]}
"""Colours of the back-ends."""

NAMES = {"reference": "CasADi, IPOPT"}
"""What a back-end is called where that is not its name in a task."""

Row = Mapping[str, Any]


def draw_bench(found: Mapping[str, Any], path: Path, force: bool = False) -> None:
    """Draw a bench from its document into a file.

    Raises:
        InputError: The file exists or cannot be written.
    """
    prepare(path.parent, [path], force)
    with in_style():
        save(plot_bench(found), [path])


def plot_bench(found: Mapping[str, Any]) -> Figure:
    """Return how far solves are from the optimum on their own mesh and on the finest one, over their time [ms]."""
    rows = [row for row in found["summary"] if row["stages"] is None and row["time"]["count"]]
    meshes = list(dict.fromkeys(row["nodes"] for row in rows))
    figure = new_figure(2 * HEIGHT + AROUND)
    panels = figure.subplots(2, 1, sharex=True)
    gaps = ("objective_gap", "to_finest")
    labels = (
        "Gap in $J$ to the optimum\non the same mesh (1)",
        "Gap in cost over time to\nthat of the finest mesh (1)",
    )
    for axes, letter, gap, label in zip(panels, "ab", gaps, labels, strict=True):
        for way in dict.fromkeys((row["way"]["solver"], row["way"]["start"]) for row in rows):
            mine = [row for row in rows if (row["way"]["solver"], row["way"]["start"]) == way]
            _plot_way(axes, mine, gap, meshes)
        _set_scales(axes)
        axes.set_ylabel(label)
        axes.set_title(f"({letter})", loc="left", pad=3.0, fontsize=TEXT)
    panels[0].axhline(FLOOR, color=EDGE, linewidth=0.6, linestyle=(0, (1, 1.5)), zorder=1)
    panels[-1].set_xlabel("Solve time, median and 99th percentile (ms)")
    figure.align_ylabels()
    handles = _handles(rows, meshes)
    columns = legend_columns([str(handle.get_label()) for handle in handles], AXIS_WIDTH)
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)
    return figure


def _plot_way(axes: Axes, rows: Sequence[Row], gap: str, meshes: Sequence[str]) -> None:
    """Plot one way: a mark a mesh and a line through those whose nodes are given.

    Whiskers go up to the 99th percentile of the time, and to the gap of the worst window.
    """
    way, points = rows[0]["way"], []
    color, open_mark = LOOKS[way["solver"]], way["start"] == "cold"
    for row in rows:
        if row[gap]["median"] is None:
            continue
        time, off = row["time"], max(row[gap]["median"], FLOOR)
        x, whisker = 1e3 * time["median"], 1e3 * max(time["p99"] - time["median"], 0.0)
        marker, size = _mark(row["nodes"], meshes)
        axes.errorbar(
            x,
            off,
            xerr=[[0.0], [whisker]],
            yerr=[[0.0], [max(row[gap]["largest"] - off, 0.0)]],
            marker=marker,
            markersize=size,
            color=color,
            markerfacecolor="white" if open_mark else color,
            markeredgewidth=0.7,
            ecolor=(color, WHISKER),
            elinewidth=0.4,
            zorder=3,
        )
        if row["nodes"] != "auto":
            points.append((x, off))
    axes.plot(*zip(*points, strict=True), color=color, linewidth=0.7, linestyle=COLD if open_mark else "-")


def _mark(nodes: str, meshes: Sequence[str]) -> tuple[str, float]:
    """Return the mark of a mesh and its size."""
    if nodes == "auto":
        return "*", STAR
    numbered = [each for each in meshes if each != "auto"]
    return MARKERS[numbered.index(nodes) % len(MARKERS)], SIZE


def _set_scales(axes: Axes) -> None:
    """Make both axes logarithmic, time in plain numbers."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if high < WIDE * low else (1.0,)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_locator(LogLocator(numticks=7))
    axes.yaxis.set_major_formatter(LogFormatterMathtext())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.margins(0.05)


def _handles(rows: Sequence[Row], meshes: Sequence[str]) -> list[Line2D]:
    """Return the legend: colours for back-ends, full and open marks for starts, marks for meshes, the floor."""
    solvers = dict.fromkeys(row["way"]["solver"] for row in rows)
    handles = [
        Line2D([], [], color=LOOKS[solver], linewidth=1.4, label=NAMES.get(solver, solver)) for solver in solvers
    ]
    mark: dict[str, Any] = {"color": EDGE, "linestyle": "none", "markeredgewidth": 0.7}
    handles += [
        Line2D([], [], label="warm", **{**mark, "linestyle": "-", "linewidth": 0.7}, marker="s", markersize=2.6),
        Line2D(
            [],
            [],
            label="cold",
            **{**mark, "linestyle": COLD, "linewidth": 0.7},
            marker="s",
            markersize=2.6,
            markerfacecolor="white",
        ),
    ]
    for nodes in meshes:
        marker, size = _mark(nodes, meshes)
        label = "auto" if nodes == "auto" else f"$N_s$ = {nodes}"
        handles.append(Line2D([], [], marker=marker, markersize=size, label=label, **mark))
    handles.append(Line2D([], [], color=EDGE, linewidth=0.6, linestyle=(0, (1, 1.5)), label="floor"))
    return handles
