"""One look for all figures: journal column width, fonts, a colour-blind safe palette, legends and axes."""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.style import context
from matplotlib.textpath import text_to_path
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import ArrayLike

from psmpc_cli.figures.layout import PAD, arrange, new_canvas

COLUMN = 3.5
PAGE = 7.16
"""Widths of one column and of a page of two columns [in]."""

AXIS_WIDTH = 2.85
"""About the width of the axes in one column [in]: what names and legends have to fit."""

CHARACTER = 0.056
"""Width of a character of the smallest text, about [in]."""

TEXT = 7.0
"""Smallest text [pt]."""

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
"""Okabe and Ito's colours, those that show on white; yellow is left out."""

DASHES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.2)),
    (0, (5, 1.2, 1, 1.2)),
    (0, (1.5, 1)),
    (0, (8, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)
"""Line styles that go with the colours, so that a print in grey can be read as well."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""Markers that go with the colours."""

LINE_HEIGHT = 1.4 * TEXT / 72
"""Height of a line of the smallest text [in]."""

LEADER = 0.17
"""Length of the piece of a line that leads from its end to its name [in]."""

DIRECT_LABEL = "direct label"
"""Group id of names beside the ends of lines."""

PEAK_RATIO = 5.0
"""A peak so many times as large as the 95th percentile of the values hides the rest."""

BETTER: Mapping[str, str] = {"up": "↑", "down": "↓", "left": "←", "down and left": "↙"}
"""Arrows to the better side of an axis."""

NO_LABEL = "_"
"""Label of an artist that has an entry in no legend."""

LIMIT_DASH = 4.0
"""Length of a dash of a limit that several lines share [line widths]."""

LONGEST_NAME = 16
"""Characters of a name that are shown."""

TITLES = {"psmpc": "PSMPC", "smpc": "SMPC", "htmpc": "HTMPC", "hard": "Hard switching"}
"""Controllers as figures write them."""

STAGE = "#ECECEC"
EARLY = "#FAD28A"
EDGE = "#444444"
BODY = "#C9D3DA"
OBJECT = "#F5EDA0"
OBSTACLE = "#CFC4BC"
CAPSULE = "#882255"
"""Colours of every other stage, a stage that acts early, limits and outlines, base, object, obstacles, capsules."""

DASHED = (0, (5, 2))
DOTTED = (0, (1, 1.5))

ARROW = {"arrowstyle": "-|>", "mutation_scale": 8, "linewidth": 0.5, "shrinkA": 0, "shrinkB": 0}
"""Look of an arrow."""

LEVEL: Mapping[str, Any] = {"color": EDGE, "linewidth": 0.7, "zorder": 1.5}
"""Look of a line at a level: a limit, a tolerance, a threshold, the present time."""

RING = {"markersize": 6.5, "markeredgewidth": 0.6, "markerfacecolor": "none"}

STAR = {"markersize": 8.0, "markeredgewidth": 0.4, "markeredgecolor": "white"}

PUBLISHED = {"marker": "v", "color": "black", "markerfacecolor": "white", "markersize": 5.0, "linestyle": "none"}

LOOKS: Mapping[str, Mapping[str, Any]] = {
    "every other stage": {"facecolor": STAGE, "edgecolor": "none", "zorder": 0},
    "next stage already acts": {"facecolor": EARLY, "edgecolor": "none", "zorder": 0.1},
    "early start": {"color": "black", "linestyle": DOTTED, "linewidth": 0.8, "zorder": 1.2},
    "seen by the controller": {"color": "#7A7A7A", "linewidth": 0.55, "zorder": 1.4},
    "commanded, cut": {"color": "black", "linestyle": DOTTED, "linewidth": 1.2, "zorder": 2.1},
    "failed": {"color": "black", "marker": "x", "markersize": 3.5, "linestyle": "none"},
    "waiting": {"color": EDGE, "marker": "o", "markerfacecolor": "white", "linestyle": "none"},
    "ring around a failed run": {"color": "black", "marker": "o", "linestyle": "none", "zorder": 1.8, **RING},
    "weights of the run": {"color": "black", "marker": "*", "linestyle": "none", "zorder": 5, **STAR},
    "recommended": {
        "color": PALETTE[1],
        "marker": "o",
        "linestyle": "none",
        "zorder": 5,
        "markersize": 9.0,
        "markeredgewidth": 1.2,
        "markerfacecolor": "none",
    },
    "dominated": {"color": "#A0A0A0", "marker": "x", "linestyle": "none", "zorder": 4},
    "published start": PUBLISHED,
    "published end": PUBLISHED,
    "other pairs": {"color": "#A0A0A0", "linewidth": 0.8, "zorder": 1.6},
    "bound": {**LEVEL, "linestyle": DASHED},
    "broken": {"color": PALETTE[1], "marker": "X", "markersize": 6.0, "linestyle": "none", "zorder": 3},
    "base": {"facecolor": BODY, "edgecolor": "black", "linewidth": 0.7},
    "object": {"facecolor": OBJECT, "edgecolor": EDGE, "linewidth": 0.6},
    "object, lost": {"facecolor": "none", "edgecolor": EDGE, "linewidth": 0.8, "linestyle": (0, (3, 1.5))},
    "obstacle": {"facecolor": OBSTACLE, "edgecolor": EDGE, "linewidth": 0.6, "hatch": "//////"},
    "path of an obstacle": {"color": EDGE, "linewidth": 0.6, "linestyle": DOTTED},
    "capsules of the bodies": {"color": CAPSULE, "linewidth": 0.5},
    "advised posture of the arms": {"color": "black", "linewidth": 0.7, "linestyle": (0, (3, 1))},
    "target": {"linestyle": "none", "marker": "+", "markersize": 5.5, "markeredgewidth": 0.9},
    "path of the base": {"color": EDGE, "linewidth": 0.7, "linestyle": (0, (2, 1.5))},
}
"""Looks by what legends call them."""

STYLE: Mapping[str, Any] = {
    "font.size": TEXT,
    "axes.labelsize": 7.5,
    "axes.titlesize": TEXT,
    "axes.titlelocation": "left",
    "axes.titlepad": 3.5,
    "axes.titley": 1.0,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    **{f"{axis}tick.labelsize": TEXT for axis in "xy"},
    **{f"{axis}tick.direction": "in" for axis in "xy"},
    **{f"{axis}tick.major.{key}": size for axis in "xy" for key, size in (("size", 2.5), ("width", 0.6))},
    **{f"{axis}tick.minor.{key}": size for axis in "xy" for key, size in (("size", 1.5), ("width", 0.4))},
    "figure.titlesize": TEXT,
    "legend.fontsize": TEXT,
    "legend.title_fontsize": TEXT,
    "legend.frameon": False,
    "legend.borderpad": 0.1,
    "legend.borderaxespad": 0.2,
    "legend.handlelength": 1.5,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 0.9,
    "legend.labelspacing": 0.25,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.0,
    "hatch.linewidth": 0.5,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,
    "svg.hashsalt": "psmpc",
}
"""Matplotlib settings in force while a figure is drawn and written."""


def in_style() -> AbstractContextManager[None]:
    """Apply the settings above for a while, instead of the user's own."""
    settings: Any = dict(STYLE)  # the type of its keys differs between versions of Matplotlib
    return context(settings, after_reset=True)


def new_figure(width: float = COLUMN) -> Figure:
    """Return an empty figure of a width [in], without a window and unknown to pyplot; `finish` sets its height."""
    return new_canvas(width)


def stack(
    labels: Sequence[str], heights: Sequence[float], xlabel: str, sharex: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels below each other, with the labels of their vertical axes and heights [in]."""
    figure = new_figure()
    rows = figure.subplots(len(labels), 1, sharex=sharex, squeeze=False, height_ratios=heights)[:, 0]
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel(xlabel)
    return figure, list(rows)


def line_look(index: int) -> dict[str, Any]:
    """Return colour and line style of the line at this place of its panel."""
    return {"color": PALETTE[index % len(PALETTE)], "linestyle": DASHES[index % len(DASHES)]}


def mark_look(index: int) -> dict[str, Any]:
    """Return colour and marker of what has this place in its panel."""
    return {"color": PALETTE[index % len(PALETTE)], "marker": MARKERS[index % len(MARKERS)]}


def look(name: str, **more: Any) -> dict[str, Any]:
    """Return the look of what legends call by this name, with the label by which `finish` finds it."""
    return {"label": shared_label(name), **LOOKS[name], **more}


def shared_label(text: str) -> str:
    """Return the label of an artist that has an entry in the legend that all panels share and `finish` writes.

    Labels that begin with an underscore are those that Matplotlib leaves out of the panels' own legends.
    """
    return f"_{text}"


def words_of(name: str) -> str:
    """Return a name from a specification as words, such as arm 1 for arm_1; a very long one without its middle."""
    words = name.replace("_", " ")
    half = LONGEST_NAME // 2
    return words if len(words) <= LONGEST_NAME else f"{words[:half].rstrip()}…{words[1 - half :].lstrip()}"


def escape_dollars(text: str) -> str:
    """Write a text so that Matplotlib shows it as it is: it reads what stands between two dollar signs as a formula."""
    return text.replace("$", r"\$")


def readable(name: str) -> str:
    """Return a name from a specification as words for a figure."""
    return escape_dollars(words_of(name))


def text_width(text: str) -> float:
    """Measure how wide a text of the smallest size is [in]."""
    points, _, _ = text_to_path.get_text_width_height_descent(text, FontProperties(size=TEXT), ismath=False)
    return float(points) / 72


def shortened(text: str, width: float) -> str:
    """Shorten a text at its end to a width [in], to its first letter at least; one that fits stays as it is."""
    kept = text
    while text_width(kept) > width and len(kept) > 2:
        kept = f"{kept.removesuffix('…')[:-1].rstrip()}…"
    return kept


def title_of(controller: str) -> str:
    """Return the name of a controller as pages write it, and figures as a `escape_dollars`."""
    return TITLES.get(controller, words_of(controller))


def finish(figure: Figure, title: str = "", above: bool = False) -> Figure:
    """Complete a figure once its panels are drawn: write the legend that they share, place them, and set its height.

    Entries of the shared legend are the artists whose labels begin with an underscore, which Matplotlib leaves out of
    the panels' own legends; of several with one label the first counts. Panels get the heights of their grid's rows
    [in], and those with equal scales the height that goes with their width.

    Args:
        figure: The figure with all its panels drawn.
        title: Title of the shared legend.
        above: Whether the legend is above the panels instead of below.

    Returns:
        The same figure.
    """
    artists = [artist for axes in figure.axes for artist in axes.get_children()]
    entries: dict[str, Artist] = {}
    for artist in artists:
        # Matplotlib itself gives labels _child... and _nolegend_
        if re.match("_(?!child|nolegend).", label := str(artist.get_label())):
            entries.setdefault(label[1:], artist)
    room = {"upper": 0.0, "lower": 0.0}  # that legend and heading need above and below the panels [in]
    if entries:
        content: dict[str, Any] = {"handles": [*entries.values()], "labels": [*entries], "title": title or None}
        side = "upper" if above else "lower"
        _fit_legend(figure, figure.get_figwidth() - 0.05, loc=f"{side} center", alignment="left", **content)
        for patch in figure.legends[0].get_patches():
            patch.set(edgecolor=EDGE, linewidth=0.4)
        room[side] = figure.legends[0].get_window_extent().height / figure.dpi + 2 * PAD
    if heading := figure.get_suptitle():
        heading_text = figure.suptitle(heading, va="top")
        room["upper"] = heading_text.get_window_extent().height / figure.dpi + 2 * PAD
    arrange(figure, below=room["lower"], above=room["upper"])
    if heading:  # again, since its place is a part of the height that the figure has only now
        figure.suptitle(heading, y=1.0 - PAD / figure.get_figheight(), va="top")
    return figure


def panel_legend(axes: Axes, note: str = "", title: str | None = None) -> None:
    """Write a note and the legend above a panel, where they cover no curve."""
    figure: Any = axes.figure
    written = axes.set_title(note)
    if axes.get_legend_handles_labels()[0]:
        width = AXIS_WIDTH - written.get_window_extent().width / figure.dpi
        _fit_legend(axes, width, loc="lower right", bbox_to_anchor=(1.0, 1.0), title=title, alignment="left")


def width_beside(labels: Iterable[str]) -> float:
    """Return about the width that names beside the ends of lines need right of their panel, with some room [in]."""
    widths = [text_width(label) for label in labels]
    return LEADER + 0.2 + max(widths) if widths else 0.0


def label_ends(axes: Axes) -> None:
    """Write the names of a panel's lines right of it, beside their ends, instead of in a legend.

    Names are moved apart so that none overlap, and a piece of each line leads to its name. Where several lines of one
    look make one curve, the name is at the end of the line that ends last. Heights are fractions of the panel's height.
    """
    axes.autoscale_view()  # sets the limits of the axes, in which the ends of lines are then measured
    ends: list[tuple[float, Line2D]] = []
    for line in axes.get_legend_handles_labels()[0]:
        if isinstance(line, Line2D) and np.isfinite(end_height := _height_of_end(axes, line)):
            ends.append((end_height, line))
    ends.sort(key=lambda end: end[0])
    text_heights = _moved_apart([end_height for end_height, _ in ends], gap=LINE_HEIGHT / _panel_height(axes))
    figure: Any = axes.get_figure()
    width = axes.get_window_extent().width / figure.dpi
    for text_height, (end_height, line) in zip(text_heights, ends, strict=True):
        color = line.get_color()
        leader = {"arrowstyle": "-", "color": color, "linestyle": line.get_linestyle(), "shrinkA": 0, "shrinkB": 0}
        axes.annotate(
            str(line.get_label()),
            xy=(1.0, end_height),
            xytext=(1.0 + LEADER / width, text_height),
            xycoords="axes fraction",
            textcoords="axes fraction",
            arrowprops={**leader, "linewidth": line.get_linewidth(), "relpos": (0.0, 0.5)},
            color=color,
            va="center",
            annotation_clip=False,
            gid=DIRECT_LABEL,
        )


def _height_of_end(axes: Axes, line: Line2D) -> float:
    """Find at which height of a panel a curve ends, so that its name can be written there.

    A curve may consist of several lines of one look (colour, style and width), of which any may be given. Its end is
    their point with the largest x.

    Returns:
        The height as a fraction of the panel's height, from 0 to 1; NaN if no line of this look has a point.
    """
    look = (line.get_color(), line.get_linestyle(), line.get_linewidth())
    last_point = (-np.inf, np.nan)
    for other in axes.lines:
        points = np.asarray(other.get_xydata(), dtype=float)
        points = points[np.isfinite(points).all(axis=1)]
        has_same_look = (other.get_color(), other.get_linestyle(), other.get_linewidth()) == look
        if has_same_look and len(points) and points[-1, 0] > last_point[0]:
            last_point = (float(points[-1, 0]), float(points[-1, 1]))
    if np.isnan(last_point[1]):
        return np.nan
    _, pixel = axes.transData.transform(last_point)
    panel_box = axes.get_window_extent()
    return float(np.clip((pixel - panel_box.y0) / panel_box.height, 0.0, 1.0))


def _moved_apart(places: Sequence[float], gap: float) -> np.ndarray:
    """Move places in [0, 1] by as little as possible, in least squares, so that neighbours are at least a gap apart.

    With the place of number i less i times the gap, this is a fit by numbers that do not fall. It is solved by pooling
    adjacent violators: neighbours that would fall get their common mean.

    Args:
        places: The places, sorted.
        gap: Smallest distance of neighbours.
    """
    offset = gap * np.arange(len(places))
    blocks: list[list[float]] = []
    for wanted in np.asarray(places) - offset:
        blocks.append([float(wanted)])
        while len(blocks) > 1 and np.mean(blocks[-2]) > np.mean(blocks[-1]):
            blocks[-2:] = [blocks[-2] + blocks[-1]]
    pooled = np.array([float(np.mean(block)) for block in blocks for _ in block])
    lowest = 0.5 * min(gap, 1.0)
    highest = max(1.0 - lowest - (offset[-1] if len(offset) else 0.0), lowest)
    return np.asarray(np.clip(pooled, lowest, highest) + offset)


def _panel_height(axes: Axes) -> float:
    """Return the height of a panel [in]; those of a grid are its height ratios."""
    spot = axes.get_subplotspec()
    if spot is None:
        figure: Any = axes.get_figure()
        return float(axes.get_window_extent().height / figure.dpi)
    heights = np.array(spot.get_gridspec().get_height_ratios(), dtype=float)
    return float(heights[spot.rowspan.start : spot.rowspan.stop].sum())


def draw_limit(axes: Axes, x: ArrayLike, y: ArrayLike, colors: Sequence[Any], label: str) -> None:
    """Draw a limit in the colours of the lines that it bounds; several have dashes in turn.

    In the legend it has no line's colour.
    """
    every = len(colors)
    axes.plot([], [], label=shared_label(label), **LEVEL)
    for turn, color in enumerate(colors):
        dashes: Any = (turn * LIMIT_DASH, (LIMIT_DASH, LIMIT_DASH * (every - 1))) if every > 1 else "-"
        axes.plot(
            x, y, **{**LEVEL, "color": color, "linestyle": dashes, "dash_capstyle": "butt"}, label=shared_label(label)
        )


def use_symlog_if_peaks_hide_rest(axes: Axes, values: np.ndarray) -> str:
    """Make the vertical axis linear near 0 and logarithmic beyond if a few peaks would hide all other values.

    That is so if the largest size is more than `PEAK_RATIO` times the 95th percentile. The axis is then linear up to a
    tenth of the largest value's power of ten.

    Returns:
        A note on the axis for a reader; empty if it stays linear.
    """
    size = np.abs(values[np.isfinite(values)])
    peak = float(np.max(size, initial=0.0))
    if peak == 0.0 or peak <= PEAK_RATIO * float(np.quantile(size, 0.95)):
        return ""
    threshold = 10.0 ** (np.floor(np.log10(peak)) - 1)
    axes.set_yscale("symlog", linthresh=threshold)
    axes.set_yticks(threshold * np.array([-10.0, -1.0, 0.0, 1.0, 10.0]), minor=False)
    axes.set_yticks([], minor=True)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.autoscale_view(scalex=False)  # ticks beyond the values do not widen the view
    return f"log beyond {'±' if np.nanmin(values) < 0 else ''}{threshold:g}"


def better_side(direction: str, word: str = "better") -> str:
    """Return a note which side of an axis is better, such as down, as an arrow and a word."""
    return f"{BETTER[direction]} {word}"


def join_notes(*parts: str) -> str:
    """Join the notes that are to be written above a panel; empty ones are left out."""
    return "; ".join(filter(None, parts))


def _fit_legend(host: Figure | Axes, width: float, **content: Any) -> None:
    """Write the legend of a figure or panel in as many columns as fit a width [in]."""
    figure: Any = host.get_figure()
    for columns in range(8, 0, -1):
        legend = host.legend(ncols=columns, **content)
        if columns == 1 or legend.get_window_extent().width <= width * figure.dpi:
            return
        legend.remove()


def make_logarithmic(axes: Axes, along: str = "y", subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Make the x or y axis logarithmic, with plain numbers at these parts of every decade."""
    axes.set(**{f"{along}scale": "log"})
    axis = axes.yaxis if along == "y" else axes.xaxis
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())
