"""What the time axes of figures show: stages, their switches, and early starts."""

import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle

from psmpc_cli.figures.coordinates import plot_states
from psmpc_cli.figures.style import EARLY, STAGE
from psmpc_cli.logs.run import Run

from .figure_contents import common_legend, points


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
