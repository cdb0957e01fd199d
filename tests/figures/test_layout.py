"""Where panels are: their heights, their labels in line, the room around them; and that a figure is drawn once."""

from io import BytesIO
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from psmpc_cli.figures.style import COLUMN, finish, new_figure, stack

from .figure_contents import check_figure

HEIGHTS = [0.8, 1.2, 0.5]


def panels_in_inches(figure: Figure) -> np.ndarray:
    """Left, bottom, width and height of the panels [in]."""
    width, height = figure.get_size_inches()
    boxes = [axes.get_position().bounds for axes in figure.axes]
    return np.array(boxes) * [width, height, width, height]


def stacked() -> Figure:
    """A figure of three panels, whose numbers are of different widths, with a legend and a heading."""
    figure, rows = stack(["First (m)", "Second (m)", "Third (m)"], HEIGHTS, "Time (s)")
    for axes, most in zip(rows, (1.0, 1e5, 10.0), strict=True):
        axes.plot([0.0, 1.0], [0.0, most], label="_curve")
    figure.suptitle("Heading")
    return finish(figure)


def test_panels_are_as_high_as_asked_for_and_share_the_width() -> None:
    figure = stacked()
    check_figure(figure)
    found = panels_in_inches(figure)
    assert found[:, 3] == pytest.approx(HEIGHTS)
    assert np.ptp(found[:, 0]) == pytest.approx(0.0)
    assert np.ptp(found[:, 2]) == pytest.approx(0.0)
    assert (found[:-1, 1] > found[1:, 1] + found[1:, 3]).all()


def test_labels_of_a_column_are_in_line_beside_the_widest_numbers() -> None:
    figure = stacked()
    figure.draw_without_rendering()
    edges = [axes.yaxis.label.get_window_extent().x0 for axes in figure.axes]
    assert edges == pytest.approx([edges[0]] * len(edges))
    numbers = [label.get_window_extent().x0 for axes in figure.axes for label in axes.get_yticklabels()]
    assert max(axes.yaxis.label.get_window_extent().x1 for axes in figure.axes) < min(numbers)


def test_panels_with_equal_scales_are_as_high_as_their_width_wants() -> None:
    figure = new_figure()
    first, second = figure.subplots(1, 2, sharey=True)
    for axes in (first, second):
        axes.set(xlim=(0, 2), ylim=(0, 3), xlabel="x (m)", aspect="equal")
    first.set_ylabel("y (m)")
    finish(figure)
    figure.draw_without_rendering()
    found = panels_in_inches(figure)
    assert found[:, 3] == pytest.approx(1.5 * found[:, 2])
    assert found[1, 0] + found[1, 2] == pytest.approx(COLUMN, abs=0.2)


def test_a_figure_is_drawn_once_for_a_file_and_nothing_moves() -> None:
    drawn = []

    class Watched(Line2D):
        def draw(self, renderer: Any) -> None:
            drawn.append(renderer)
            super().draw(renderer)

    figure = stacked()
    figure.axes[0].add_line(Watched([0.0, 1.0], [1.0, 0.0]))
    before = panels_in_inches(figure)
    figure.savefig(BytesIO(), format="png")
    assert len(drawn) == 1
    np.testing.assert_array_equal(panels_in_inches(figure), before)
