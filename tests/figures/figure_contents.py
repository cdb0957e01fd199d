"""What is in a drawn figure, as numbers and words, and what a referee would ask of every figure."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from psmpc_cli.figures.style import COLUMN, DIRECT_LABEL, PAGE, TEXT


def points(line: Line2D) -> np.ndarray:
    """The points (., 2) of a line."""
    return np.asarray(line.get_xydata())


def curves(axes: Axes) -> dict[str, np.ndarray]:
    """The lines the panel's legend names, as points."""
    lines = [handle for handle in axes.get_legend_handles_labels()[0] if isinstance(handle, Line2D)]
    return {str(line.get_label()): points(line) for line in lines}


def long_curves(axes: Axes) -> list[np.ndarray]:
    """The points of every line that is more than a straight one."""
    return [points(line) for line in axes.lines if len(points(line)) > 2]


def bars(axes: Axes) -> list[tuple[float, float, float]]:
    """Left, right and height of the horizontal bars."""
    found = [collection for collection in axes.collections if isinstance(collection, LineCollection)]
    segments = [np.asarray(segment) for collection in found for segment in collection.get_segments()]
    return [(float(segment[0, 0]), float(segment[1, 0]), float(segment[0, 1])) for segment in segments]


def legend(axes: Axes) -> list[str]:
    """The entries of a panel's legend, or the names beside the ends of its lines, from the lowest."""
    found = axes.get_legend()
    return names_at_ends(axes) if found is None else [text.get_text() for text in found.get_texts()]


def names_at_ends(axes: Axes) -> list[str]:
    """The names beside the ends of a panel's lines, from the lowest."""
    return [text.get_text() for text in axes.texts if text.get_gid() == DIRECT_LABEL]


def common_legend(figure: Figure) -> list[str]:
    """The entries of the figure's legend."""
    return [text.get_text() for found in figure.legends for text in found.get_texts()]


def all_axes(figure: Figure) -> list[Axes]:
    """The visible panels of a figure, and the axes in or beside them, such as a bar of colours."""
    return [each for axes in figure.axes if axes.get_visible() for each in (axes, *axes.child_axes)]


def check_figure(figure: Figure) -> None:
    """Draw a figure and assert that its texts are large enough, apart, on the page, and that axes have units."""
    figure.draw_without_rendering()
    texts = list(visible_texts(figure))
    assert figure.get_figwidth() in (COLUMN, PAGE)
    assert min(float(text.get_fontsize()) for text in texts) >= TEXT
    check_inside(figure, texts)
    check_apart(texts)
    check_labels(figure)
    check_room(figure)
    check_legends(figure)


def visible_texts(figure: Figure) -> Iterator[Text]:
    hidden = {text for axes in all_axes(figure) for text in unseen_texts(axes)}
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_visible() and text.get_text().strip() and text not in hidden:
            yield text


def unseen_texts(axes: Axes) -> Iterator[Text]:
    """Texts Matplotlib keeps but does not draw: of axes switched off, of ticks outside the view."""
    for axis in (axes.xaxis, axes.yaxis, getattr(axes, "zaxis", axes.yaxis)):
        if not axes.axison:
            yield from (text for text in axis.findobj(Text) if isinstance(text, Text))
        scale = axis.get_transform().transform
        low, high = sorted(scale(axis.get_view_interval()))
        room = 1e-6 * (high - low)
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low - room <= scale(np.array([tick.get_loc()]))[0] <= high + room:
                yield from (tick.label1, tick.label2)


def check_inside(figure: Figure, texts: list[Text]) -> None:
    page = figure.bbox
    for text in texts:
        box = text.get_window_extent()
        assert page.x0 - 1 <= box.x0 and box.x1 <= page.x1 + 1, f"'{text.get_text()}' leaves the page"
        assert page.y0 - 1 <= box.y0 and box.y1 <= page.y1 + 1, f"'{text.get_text()}' leaves the page"


def check_apart(texts: list[Text]) -> None:
    boxes = [(text.get_text(), Text.get_window_extent(text)) for text in texts]  # without the leaders of names
    for (one, box), (other, box_of_other) in combinations(boxes, 2):
        overlap = Bbox.intersection(box, box_of_other)
        assert overlap is None or min(overlap.width, overlap.height) <= 1, f"'{one}' overlaps '{other}'"


def check_labels(figure: Figure) -> None:
    """Every axis with numbers has a label with a unit; a count has none."""
    for axes in all_axes(figure):
        for axis in (axes.xaxis, axes.yaxis):
            shown = [label.get_text() for label in axis.get_ticklabels() if label.get_visible()]
            numbers = [text for text in shown if any(map(str.isdigit, text))]
            label = axis.get_label_text()
            assert not axes.axison or not numbers or label.endswith(")"), label


def check_room(figure: Figure) -> None:
    """The axes were not squeezed by what is written around them; names beside lines belong to their panel."""
    boxes = [axes.get_position() for axes in all_axes(figure)]
    beside = [text for axes in figure.axes for text in axes.texts if text.get_gid() == DIRECT_LABEL]
    left = min(box.x0 for box in boxes)
    right = max(box.x1 for box in boxes)
    ends = [Text.get_window_extent(text).x1 / figure.bbox.width for text in beside]
    assert right - left > 0.45
    assert max([right, *ends]) - left > 0.7


def check_legends(figure: Figure) -> None:
    """Every drawn line with a label is in a legend, or has it beside its end."""
    named = {*common_legend(figure), *(text for axes in figure.axes for text in legend(axes))}
    for axes in figure.axes:
        labels = {str(line.get_label()) for line in axes.lines if np.isfinite(points(line)).all(axis=1).any()}
        assert {label for label in labels if not label.startswith("_")} <= named
