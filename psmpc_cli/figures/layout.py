"""Where the panels of a figure are: rows as high as asked for, columns that share the width, labels around them.

Matplotlib's constrained layout measures every label four times for a figure and again at each output, and needs the
height of the figure beforehand. Here panels have their heights from the beginning, so that their ticks stay as they
are: what is written around them is measured once, and the figure becomes as tall as all of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecBase
from matplotlib.transforms import Bbox

PAD = 0.04
"""Distance between what is written around neighbouring panels, and from the edge of the page [in]."""

ESTIMATED_LABEL_ROOM = 0.6
"""About the room left and right of a column of panels with labels of its own [in], before it is measured."""


@dataclass(frozen=True)
class Panel:
    """A panel in its grid.

    Attributes:
        axes: The panel.
        grid: Its grid.
        rows, columns: Those it covers in the grid.
        equal: Whether its scales are equal, so that its height follows from its width.
    """

    axes: Axes
    grid: GridSpecBase
    rows: range
    columns: range
    equal: bool


def new_canvas(width: float) -> Figure:
    """Return an empty figure of a width [in], without a window and unknown to pyplot, that can measure its texts."""
    figure = Figure(figsize=(width, width))
    FigureCanvasAgg(figure)
    return figure


def arrange(figure: Figure, below: float = 0.0, above: float = 0.0) -> None:
    """Place the panels of a figure so that their labels fit, and make the figure as tall as that needs.

    Matplotlib's own layouts change the sizes of panels to make room for labels. Here the sizes of panels come first and
    the figure grows around them: each row of the grid has the height [in] that is given as its height ratio. A row of
    panels with equal scales has the height that follows from their width and data. The columns share the width that
    labels leave. The vertical labels of a column of panels are in line.

    Args:
        figure: Its panels are in one grid. A figure whose panels are in no grid is left as it is.
        below: Room to leave below the panels, such as for a legend [in].
        above: Room to leave above the panels [in].
    """
    panels = _panels_of(figure)
    if not panels:
        return
    grid = panels[0].grid
    heights = np.array(grid.get_height_ratios(), dtype=float)  # of the rows [in]
    width_shares = np.array(grid.get_width_ratios(), dtype=float)
    width_shares /= width_shares.sum()
    figure_width = figure.get_figwidth()

    for panel in panels:
        if panel.equal:
            # only while it is measured: an axes narrower than its cell of the grid would seem to need less room
            panel.axes.set_aspect("auto")
    _place_to_measure(figure, panels, heights, width_shares)
    margins = [_room_around_panel(figure, panel.axes) for panel in panels]
    offsets = {panel.axes: _label_offsets(figure, panel.axes) for panel in panels}
    # all vertical labels of a column are as far left as the one that is farthest from its panel
    aligned_offset = {
        panel.axes: max(offsets[other.axes][0] for other in panels if other.columns[0] == panel.columns[0])
        for panel in panels
    }
    for panel, margin in zip(panels, margins, strict=True):
        margin[0] = max(margin[0], aligned_offset[panel.axes] + _label_width(figure, panel.axes))
    left, right, bottom, top = _room_around_cells(panels, margins, len(heights), len(width_shares))

    widths = width_shares * (figure_width - (left + right).sum())
    column_starts = np.cumsum(left + np.r_[0.0, (widths + right)[:-1]])
    column_ends = column_starts + widths
    for panel in panels:
        if panel.equal:
            panel_width = column_ends[panel.columns[-1]] - column_starts[panel.columns[0]]
            heights[panel.rows[0]] = panel_width * panel.axes.get_data_ratio()
    # distances of the rows' upper edges from the upper edge of the figure
    row_tops = above + np.cumsum(top + np.r_[0.0, (heights + bottom)[:-1]])
    figure_height = float(row_tops[-1] + heights[-1] + bottom[-1] + below)

    figure.set_figheight(figure_height)
    for panel in panels:
        x0 = column_starts[panel.columns[0]]
        x1 = column_ends[panel.columns[-1]]
        y1 = figure_height - row_tops[panel.rows[0]]
        y0 = figure_height - row_tops[panel.rows[-1]] - heights[panel.rows[-1]]
        size = np.array([figure_width, figure_height])
        panel.axes.set_position(Bbox(np.array([[x0, y0], [x1, y1]]) / size))
        _fix_labels(panel.axes, aligned_offset[panel.axes], offsets[panel.axes][1], x1 - x0, y1 - y0)
        if panel.equal:
            panel.axes.set_aspect("equal")


def _panels_of(figure: Figure) -> list[Panel]:
    """List the panels of a figure that are in a grid."""
    panels = []
    for axes in figure.axes:
        spot = axes.get_subplotspec()
        if spot is not None:
            rows = range(spot.rowspan.start, spot.rowspan.stop)
            columns = range(spot.colspan.start, spot.colspan.stop)
            equal = axes.get_aspect() != "auto" and axes.name != "3d"
            panels.append(Panel(axes, spot.get_gridspec(), rows, columns, equal))
    return panels


def _place_to_measure(figure: Figure, panels: Sequence[Panel], heights: np.ndarray, shares: np.ndarray) -> None:
    """Give every panel its height and about its final width, so that it is measured with the ticks that it will have.

    The figure keeps its own height, beyond which panels may reach: with another height, Matplotlib would measure all
    texts anew.

    Args:
        figure: The figure.
        panels: Its panels.
        heights: Heights of the rows of their grid (rows,) [in].
        shares: Shares of the columns in the width (columns,), with sum 1.
    """
    width, height = figure.get_size_inches()
    columns = shares * max(width - ESTIMATED_LABEL_ROOM * len(shares), 0.5 * width)
    for panel in panels:
        wide = columns[list(panel.columns)].sum() / width
        high = heights[list(panel.rows)].sum() / height
        panel.axes.set_position((0.1, 0.0, wide, high))


def _room_around_panel(figure: Figure, axes: Axes) -> np.ndarray:
    """Measure the room that a panel's labels need left, right, below and above it [in]."""
    axes.apply_aspect()
    around = axes.get_tightbbox(for_layout_only=True)
    inner = axes.get_window_extent()
    if around is None or not axes.get_visible():
        return np.zeros(4)
    pixels = (inner.x0 - around.x0, around.x1 - inner.x1, inner.y0 - around.y0, around.y1 - inner.y1)
    return np.maximum(pixels, 0.0) / figure.dpi


def _room_around_cells(
    panels: Sequence[Panel], margins: Sequence[np.ndarray], rows: int, columns: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compute how much room labels need between the columns and rows of a grid of panels, to place the panels [in].

    A panel that spans several columns needs room left of its first one and right of its last one, and likewise for
    rows. A column or row leaves as much room as the panel that needs most, and `PAD` besides.

    Args:
        panels: The panels, with the columns and rows that they cover.
        margins: For each panel the room that its labels need left, right, below and above (4,) [in].
        rows: Number of rows of the grid.
        columns: Number of its columns.

    Returns:
        Room left of each column and right of it (columns,), below each row and above it (rows,) [in].
    """
    left = np.full(columns, PAD)
    right = np.full(columns, PAD)
    bottom = np.full(rows, PAD)
    top = np.full(rows, PAD)
    for panel, (at_left, at_right, at_bottom, at_top) in zip(panels, margins, strict=True):
        first_column = panel.columns[0]
        last_column = panel.columns[-1]
        first_row = panel.rows[0]
        last_row = panel.rows[-1]
        left[first_column] = max(left[first_column], at_left + PAD)
        right[last_column] = max(right[last_column], at_right + PAD)
        bottom[last_row] = max(bottom[last_row], at_bottom + PAD)
        top[first_row] = max(top[first_row], at_top + PAD)
    return left, right, bottom, top


def _label_offsets(figure: Figure, axes: Axes) -> tuple[float, float]:
    """Return how far the measured panel's vertical label is left of it, and its horizontal one below it [in], or 0."""
    inner = axes.get_window_extent()
    written = [axes.axison and bool(axis.get_label_text()) for axis in (axes.yaxis, axes.xaxis)]
    x, _ = axes.yaxis.label.get_position()
    _, y = axes.xaxis.label.get_position()
    left = (inner.x0 - x) / figure.dpi if written[0] else 0.0
    below = (inner.y0 - y) / figure.dpi if written[1] else 0.0
    return left, below


def _label_width(figure: Figure, axes: Axes) -> float:
    """Return how wide the measured panel's vertical label is, with all its lines [in]; 0 where there is none."""
    is_written = axes.get_visible() and axes.axison and axes.name != "3d" and bool(axes.yaxis.get_label_text())
    return axes.yaxis.label.get_window_extent().width / figure.dpi if is_written else 0.0


def _fix_labels(axes: Axes, left: float, below: float, width: float, height: float) -> None:
    """Fix the labels of a panel of a size at these distances from it [in], so that none is measured again."""
    if axes.name == "3d":
        return
    axes.yaxis.set_label_coords(-left / width, 0.5)
    axes.xaxis.set_label_coords(0.5, -below / height)
