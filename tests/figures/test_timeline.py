from collections.abc import Callable
from typing import Any

import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EARLY, STAGE
from psmpc_cli.figures.timeline import open_timeline

from .drawn import common_legend, points

Load = Callable[..., Run]


def bands(axes: Axes, color: str) -> list[tuple[float, float]]:
    """Left and right of the rectangles of a colour."""
    filled = [patch for patch in axes.patches if isinstance(patch, Rectangle) and patch.get_fill()]
    found = [patch for patch in filled if to_hex(patch.get_facecolor()) == color.lower()]
    return [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in found]


def strip_texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.axes[0].texts]


def test_every_other_stage_is_shaded_in_every_panel(run: Run) -> None:
    for panel in open_timeline(run, 3, 1.0).panels:
        assert bands(panel, STAGE) == [(10.0, 13.0), (23.0, pytest.approx(29.6))]


def test_a_premature_start_is_marked_in_panels_strip_and_legend(run: Run) -> None:
    timeline = open_timeline(run, 1, 1.0)
    figure = timeline.finish()
    assert bands(timeline.panels[0], EARLY) == bands(figure.axes[0], EARLY) == [(6.4, 10.0)]
    assert 6.4 in [points(line)[0, 0] for line in timeline.panels[0].lines]
    assert {"next stage acts already", "premature start"} < set(common_legend(figure))


def test_nothing_is_marked_where_no_stage_is_premature(load: Load) -> None:
    figure = open_timeline(load(early={}), 1, 1.0).finish()
    assert common_legend(figure) == ["every other stage"]
    assert not any(bands(axes, EARLY) for axes in figure.axes)


def test_a_run_of_one_stage_needs_no_legend(load: Load, one_arm: dict[str, Any]) -> None:
    assert common_legend(open_timeline(load(**one_arm), 1, 1.0).finish()) == []


def test_the_strip_names_the_stages(run: Run) -> None:
    assert strip_texts(open_timeline(run, 1, 1.0).finish()) == ["approach", "capture", "transport", "release"]


def test_names_that_do_not_fit_become_numbers_with_a_key(load: Load, many_stages: dict[str, Any]) -> None:
    figure = open_timeline(load(**many_stages), 1, 1.0).finish()
    assert strip_texts(figure) == [str(number) for number in range(1, 15)]
    keys = [text for text in common_legend(figure) if ":" in text]
    assert [key.split(":")[0] for key in keys] == strip_texts(figure)
    assert len({key.split(":")[1] for key in keys}) == 14


def test_the_first_and_the_last_value_keep_off_the_frame(run: Run) -> None:
    low, high = open_timeline(run, 1, 1.0).panels[0].get_xlim()
    assert low < run.time[0] and run.end < high
