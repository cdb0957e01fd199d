"""One look for all figures: journal column width, fonts, a colour-blind safe palette, legends and axes."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

COLUMN, PAGE = 3.5, 7.16
"""Widths of one column and of a page of two columns [in]."""

AXIS_WIDTH = 2.85
"""About the width of the axes in one column [in]: what names and legends have to fit."""

CHARACTER = 0.056
"""Width of a character of the smallest text, about [in]."""

MOST_COLUMNS = 8
"""Most columns of a legend."""

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

LONGEST_NAME = 16
"""Characters of a name that are shown."""

TITLES = {"psmpc": "PSMPC", "smpc": "SMPC", "htmpc": "HTMPC", "hard": "Hard switching"}
"""Controllers as figures write them."""

LINE = 0.125
"""Height of a line of text [in]."""

STAGE, EARLY, EDGE, BODY, OBJECT = "#ECECEC", "#FAD28A", "#444444", "#C9D3DA", "#F5EDA0"
"""Colours of every other stage, a stage that acts early, limits and outlines, the base, the object."""

DASHED, DOTTED = (0, (5, 2)), (0, (1, 1.5))

LEVEL: Mapping[str, Any] = {"color": EDGE, "linewidth": 0.7, "zorder": 1.5}
"""Look of a line at a level: a limit, a tolerance, a threshold, the present time."""

FAILED: Mapping[str, Any] = {"color": "black", "marker": "x", "markersize": 3.5, "linestyle": "none"}
"""Look of what failed."""

TICKS: Mapping[str, Any] = {"labelsize": TEXT, "direction": "in", "major.width": 0.6, "minor.width": 0.4}

STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "mathtext.fontset": "dejavusans",
    "axes.labelsize": 7.5,
    "axes.titlesize": TEXT,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    **{f"{axis}tick.{key}": value for axis in "xy" for key, value in TICKS.items()},
    **{f"{axis}tick.{kind}.size": size for axis in "xy" for kind, size in (("major", 2.5), ("minor", 1.5))},
    "legend.fontsize": TEXT,
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
    **{f"figure.constrained_layout.{pad}": 0.02 for pad in ("w_pad", "hspace", "wspace")},
    "figure.constrained_layout.h_pad": 0.03,
}
"""Matplotlib settings in force while a figure is drawn and written."""


@contextmanager
def in_style() -> Iterator[None]:
    """Apply the settings above for a while, instead of the user's own."""
    settings: Any = dict(STYLE)  # the type of its keys differs between versions of Matplotlib
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings)
        yield


def new_figure(height: float, width: float = COLUMN) -> Figure:
    """Return an empty figure of the given size [in], without a window and unknown to pyplot."""
    return Figure(figsize=(width, height), layout="constrained")


def stack(
    labels: Sequence[str], heights: Sequence[float], xlabel: str, sharex: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels below each other, with the labels of their vertical axes and heights [in]."""
    figure = new_figure(sum(heights))
    rows = figure.subplots(len(labels), 1, sharex=sharex, squeeze=False, height_ratios=heights)[:, 0]
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel(xlabel)
    figure.align_ylabels()
    return figure, list(rows)


def line_look(index: int) -> dict[str, Any]:
    """Return colour and line style of the line at this place of its panel."""
    return {"color": PALETTE[index % len(PALETTE)], "linestyle": DASHES[index % len(DASHES)]}


def mark_look(index: int) -> dict[str, Any]:
    """Return colour and marker of what has this place in its panel."""
    return {"color": PALETTE[index % len(PALETTE)], "marker": MARKERS[index % len(MARKERS)]}


def readable(name: str) -> str:
    """Return a name from a specification as words, such as arm 1 for arm_1; a very long one without its middle."""
    words = name.replace("_", " ")
    half = LONGEST_NAME // 2
    return words if len(words) <= LONGEST_NAME else f"{words[:half].rstrip()}…{words[1 - half :].lstrip()}"


def title_of(controller: str) -> str:
    """Return the name of a controller as figures write it."""
    return TITLES.get(controller, readable(controller))


def entry(label: str, **look: Any) -> Line2D:
    """Return a legend entry for a line or a marker."""
    return Line2D([], [], label=label, **look)


def patch_entry(label: str, **look: Any) -> Patch:
    """Return a legend entry for an area."""
    return Patch(label=label, **{"edgecolor": EDGE, "linewidth": 0.4, **look})


def add_legend(figure: Figure, handles: Iterable[Artist], above: bool = False, title: str = "") -> None:
    """Write a legend, each label once, below or above all axes, and make the figure taller by its height.

    Its entries are what the axes name after an underscore, which is in no legend of theirs, then the handles.
    """
    artists = [artist for axes in figure.axes for artist in axes.get_children()]
    named = [artist for artist in artists if re.match("_(?!child|nolegend).", str(artist.get_label()))]
    entries = {str(artist.get_label()).removeprefix("_"): artist for artist in (*named, *handles)}
    if entries:
        place = "outside upper center" if above else "outside lower center"
        look: dict[str, Any] = {"handles": [*entries.values()], "labels": [*entries], "loc": place}
        if title:
            look |= {"title": title, "title_fontsize": TEXT, "alignment": "left"}
        height = _fit_legend(figure, figure, figure.get_figwidth() - 0.05, **look)
        figure.set_figheight(figure.get_figheight() + height + 0.05)


def panel_legend(axes: Axes, note: str = "") -> None:
    """Write a note and the legend above a panel, where they cover no curve; rows after the first make room."""
    figure: Any = axes.figure
    written = axes.set_title(note, loc="left", pad=3.5, fontsize=TEXT)
    if axes.get_legend_handles_labels()[0]:
        width = AXIS_WIDTH - written.get_window_extent().width / figure.dpi
        height = _fit_legend(figure, axes, width, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        figure.set_figheight(figure.get_figheight() + max(height - LINE, 0.0))


def _fit_legend(figure: Figure, host: Figure | Axes, width: float, **look: Any) -> float:
    """Write the legend of a figure or panel in as many columns as fit a width [in]; return its height [in]."""
    for columns in range(MOST_COLUMNS, 0, -1):
        legend = host.legend(ncols=columns, **look)
        size = legend.get_window_extent()
        if size.width <= width * figure.dpi:
            break
        if columns > 1:
            legend.remove()
    return float(size.height / figure.dpi)


def make_logarithmic(axes: Axes, along: str = "y", subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Make the x or y axis logarithmic, with plain numbers at these parts of every decade."""
    axes.set(**{f"{along}scale": "log"})
    axis = axes.yaxis if along == "y" else axes.xaxis
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_locator(NullLocator())
