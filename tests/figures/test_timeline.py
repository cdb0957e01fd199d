"""What the time axes of figures show: stages, their switches, and early starts."""

from collections.abc import Callable, Mapping
from typing import Any

import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.style import EARLY, STAGE
from psmpc_cli.logs.run import Run

from .figure_contents import common_legend, points

Load = Callable[..., Run]


def bands(axes: Axes, color: str) -> list[tuple[float, float]]:
    """Left and right of the rectangles of a colour."""
    filled = [patch for patch in axes.patches if isinstance(patch, Rectangle) and patch.get_fill()]
    found = [patch for patch in filled if to_hex(patch.get_facecolor()) == color.lower()]
    return [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in found]


def test_every_other_stage_and_early_starts_are_marked_in_every_panel_and_explained(run: Run) -> None:
    figure = plot_states(run)
    for panel in figure.axes[1:]:
        assert bands(panel, STAGE) == [(10.0, 13.0), (23.0, pytest.approx(29.6))]
        assert bands(panel, EARLY) == [(6.4, 10.0)]
        assert 6.4 in [points(line)[0, 0] for line in panel.lines]
    assert bands(figure.axes[0], EARLY) == [(6.4, 10.0)]
    assert [text.get_text() for text in figure.axes[0].texts] == ["approach", "capture", "transport", "release"]
    assert {"every other stage", "next stage already acts", "early start"} <= set(common_legend(figure))


def check_names(figure: Figure) -> None:
    """Assert that every name in the strips is within its bar or beside all bars, and within the axis."""
    figure.draw_without_rendering()
    for strip in (axes for axes in figure.axes if not axes.axison):
        outlines = [patch.get_window_extent() for patch in strip.patches if not patch.get_fill()]
        for text in strip.texts:
            box = text.get_window_extent()
            touched = [bar for bar in outlines if bar.overlaps(box)]
            assert not touched or touched[0].x0 <= box.x0 < box.x1 <= touched[0].x1, text.get_text()
            assert strip.bbox.x0 <= box.x0 < box.x1 <= strip.bbox.x1, text.get_text()


@pytest.mark.parametrize(
    "ends", [(10.0, 10.4, 23.0, 29.6), (0.4, 13.0, 23.0, 29.6), (10.0, 13.0, 29.2, 29.6), (28.4, 28.8, 29.2, 29.6)]
)
def test_a_stage_s_name_that_is_wider_than_its_bar_stands_beside_it(load: Load, ends: tuple[float, ...]) -> None:
    figure = plot_states(load(ends=ends, early={}))
    check_names(figure)
    assert [text.get_text() for text in figure.axes[0].texts] == ["approach", "capture", "transport", "release"]


@pytest.mark.slow
def test_names_stay_within_the_strip_of_many_stages_and_of_many_runs(
    load: Load, many_stages: Mapping[str, Any], runs: Mapping[str, Run]
) -> None:
    check_names(plot_states(load(**many_stages)))
    check_names(plot_states(runs))
