"""What is in a drawn figure, as numbers and words."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D


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
    """The entries of a panel's legend."""
    found = axes.get_legend()
    return [] if found is None else [text.get_text() for text in found.get_texts()]


def common_legend(figure: Figure) -> list[str]:
    """The entries of the figure's legend."""
    return [text.get_text() for found in figure.legends for text in found.get_texts()]
