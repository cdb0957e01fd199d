"""One look for all figures: journal column width, fonts, a colour-blind safe palette."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath

COLUMN, PAGE = 3.5, 7.16
"""Widths of one column and of a page of two columns [in]."""

AXIS_WIDTH = 2.75
"""About the width of the axes in one column [in]: what names and legends have to fit."""

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

LONGEST_NAME = 16
"""Characters of a name that are shown."""

LINE = 0.125
"""Height of a line of text [in]."""

HANDLE, LEGEND_GAP = 1.7, 0.12
"""Length of the lines in a legend [em]; of the gap between two entries [in]."""

STAGE, EARLY, SWITCH, EDGE, BODY, OBJECT = "#ECECEC", "#FAD28A", "#A0A0A0", "#444444", "#C9D3DA", "#F5EDA0"
"""Every other stage; a stage acting early; switching instants; limits and outlines; the base; the object."""

STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "mathtext.fontset": "dejavusans",
    "axes.labelsize": 7.5,
    "axes.titlesize": TEXT,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "xtick.labelsize": TEXT,
    "ytick.labelsize": TEXT,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "legend.fontsize": TEXT,
    "legend.frameon": False,
    "legend.borderpad": 0.1,
    "legend.borderaxespad": 0.2,
    "legend.handlelength": HANDLE,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.1,
    "legend.labelspacing": 0.25,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.0,
    "hatch.linewidth": 0.5,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,
    "svg.hashsalt": "psmpc",
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.02,
    "figure.constrained_layout.hspace": 0.02,
    "figure.constrained_layout.wspace": 0.02,
}
"""Matplotlib settings in force while a figure is drawn and written."""


@contextmanager
def in_style() -> Iterator[None]:
    """Put the settings above in force for a while, whatever the user's own are."""
    settings: Any = dict(STYLE)  # the type of its keys differs between versions of Matplotlib
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings)
        yield


def new_figure(height: float, width: float = COLUMN) -> Figure:
    """Return an empty figure of the given size [in], without a window and unknown to pyplot."""
    return Figure(figsize=(width, height), layout="constrained")


def grow(axes: Axes, more: float) -> None:
    """Make the figure of these axes taller [in], for what is written around them."""
    figure = axes.get_figure(root=True)
    if figure is not None:
        figure.set_figheight(figure.get_figheight() + more)


def line_look(index: int) -> dict[str, Any]:
    """Return colour and line style of the line at this place of its panel."""
    return {"color": PALETTE[index % len(PALETTE)], "linestyle": DASHES[index % len(DASHES)]}


def readable(name: str) -> str:
    """Return a name from a specification as words, such as arm 1 for arm_1; a very long one without its middle."""
    words = name.replace("_", " ")
    half = LONGEST_NAME // 2
    return words if len(words) <= LONGEST_NAME else f"{words[:half].rstrip()}…{words[1 - half :].lstrip()}"


def text_width(text: str) -> float:
    """Return the width of a text in the smallest size [in]."""
    return float(TextPath((0, 0), text, size=TEXT).get_extents().width) / 72 if text.strip() else 0.0


def legend_columns(labels: Iterable[str], width: float, handle: float = HANDLE) -> int:
    """Return in how many columns these entries of a legend, with lines of length `handle` [em], fit a width [in]."""
    line = (handle + 0.5) * TEXT / 72
    widths = [line + text_width(label) + LEGEND_GAP for label in labels]
    if sum(widths) <= width + LEGEND_GAP:
        return max(1, len(widths))
    return max(1, int((width + LEGEND_GAP) / max(widths)))
