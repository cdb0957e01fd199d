"""Figures as images inside a page."""

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO

from matplotlib.figure import Figure

from psmpc_cli.figures.style import in_style
from psmpc_cli.report.html import Html, element, image

DPI = 200
"""Pixels an inch in the file, about twice what a page shows."""

CSS_DPI = 96
"""Pixels an inch on a page."""

NARROW, WIDE = "narrow", "wide"
"""Kinds of figures: one column and a page wide."""


@dataclass(frozen=True)
class Picture:
    """A figure in a page.

    Attributes:
        draw: Draws it.
        alt: What it shows, for those who do not see it.
        caption: What is written below it.
    """

    draw: Callable[[], Figure]
    alt: str
    caption: str


def embed(picture: Picture, kind: str) -> Html:
    """Return a picture as an element, narrow or wide."""
    with in_style():
        figure, file = picture.draw(), BytesIO()
        figure.savefig(file, format="png", dpi=DPI)
    width, height = (round(inches * CSS_DPI) for inches in figure.get_size_inches())
    shown = image(file.getvalue(), picture.alt, width, height)
    if kind == WIDE:  # on a narrow page it is scrolled, by keyboard too
        shown = element("div", shown, class_="scroll", role="region", tabindex=0, aria_label=picture.caption)
    return element("figure", shown, element("figcaption", picture.caption), class_=kind)
