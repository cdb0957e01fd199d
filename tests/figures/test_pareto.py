from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from psmpc_cli.errors import LogError
from psmpc_cli.figures.pareto import plot_fronts, plot_fronts_over_instant
from psmpc_cli.figures.registry import draw
from psmpc_cli.logs.results import Results

from .figure_contents import common_legend, points
from .made_fronts import INSTANTS, fronts, made_up, unsolved


def figure(results: Results) -> Figure:
    return plot_fronts(results)


def test_a_logarithmic_panel_is_added_where_a_linear_one_hides_what_is_small() -> None:
    assert len(figure(made_up(narrow=True)).axes) == 1
    linear, logarithmic = figure(made_up(narrow=False)).axes
    assert (linear.get_xscale(), logarithmic.get_xscale()) == ("linear", "log")
    assert logarithmic.get_yscale() == "log"


def test_where_costs_are_negative_a_second_panel_leaves_out_the_fronts_that_hide_the_others() -> None:
    results = made_up(narrow=True, method="weighted")
    for s in (1, 2):
        results[f"weighted_J_{s}"][:2] -= 0.6
        results[f"weighted_J_{s}"][2] *= (1e3, -1e3)[s - 1]
    first, second = figure(results).axes
    assert (second.get_xscale(), second.get_yscale()) == ("linear", "linear")
    assert "without 8.0 s" in second.get_title(loc="left")
    assert np.abs(first.get_ylim()).max() > 300
    assert np.abs(second.get_ylim()).max() < 2


def test_dominated_points_are_crossed_out_and_the_run_s_weights_named() -> None:
    drawn = figure(made_up(narrow=True))
    (axes,) = drawn.axes
    crosses = np.vstack(
        [points(line) for line in axes.lines if line.get_marker() == "x" and line.get_linestyle() == "None"]
    )
    np.testing.assert_allclose(np.unique(crosses, axis=0), fronts(narrow=True)[0, 2:3, ::-1])
    stars = np.vstack([points(line) for line in axes.lines if line.get_marker() == "*"])
    np.testing.assert_allclose(stars, fronts(narrow=True)[:, 6, ::-1])
    assert "dominated" in common_legend(drawn)
    minimum = "least $J_1 + (ω_2/ω_1) J_2$ with"
    assert f"{minimum} $ω_2/ω_1$ = 100" in common_legend(drawn)
    assert f"{minimum} the weights of the run" in common_legend(figure(made_up(narrow=True, ratio=(1, 10, 100))))


@pytest.mark.parametrize("narrow", [True, False])
def test_the_legend_covers_no_panel(narrow: bool) -> None:
    drawn = figure(made_up(narrow=narrow))
    drawn.draw_without_rendering()
    legends = [*drawn.legends, *(found for axes in drawn.axes if (found := axes.get_legend()))]
    assert "6.1 s: 1 s$^2$" in [text.get_text() for found in legends for text in found.get_texts()]
    for axes in drawn.axes:
        assert not any(found.get_window_extent().overlaps(axes.get_window_extent()) for found in legends)


def test_a_study_without_a_single_point_cannot_be_drawn(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no point that could be solved for"):
        draw("pareto", unsolved(made_up(), slice(None)), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_fronts_over_the_instant_stand_on_their_projection() -> None:
    figure = plot_fronts_over_instant(made_up(later=2))
    panels: list[Any] = [axes for axes in figure.axes if axes.name == "3d"]
    assert [axes.get_title() for axes in panels] == [f"$T_0$ = {instant:.1f} s" for instant in INSTANTS]
    for axes in panels:
        lowest, highest = axes.get_zlim()
        heights = np.concatenate([np.ravel(line.get_data_3d()[2]) for line in axes.lines])
        assert heights.min() == pytest.approx(lowest)
        assert heights.max() < highest
    assert "switch time held" in common_legend(figure)
