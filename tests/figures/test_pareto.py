from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from psmpc_cli.errors import LogError
from psmpc_cli.figures.pareto import plot_fronts, plot_fronts_over_instant
from psmpc_cli.figures.registry import draw
from psmpc_cli.logs.results import Quantity, Results

from .figure_contents import common_legend, points

RATIOS = np.geomspace(1e-3, 1e3, 9)
INSTANTS = np.array([6.1, 7.1, 8.0])


def fronts(narrow: bool = False) -> np.ndarray:
    """J_1 and J_2 (instants, ratios, 2); narrow ones fit a linear axis."""
    along = np.linspace(0.2, 1.0, len(RATIOS))
    low = 0.5 if narrow else 0.01
    return np.array(
        [np.column_stack([1.5 * along**2 / (i + 1) + low, i / 3 + (1 - along) ** 2 + low]) for i in range(3)]
    )


def made_up(
    narrow: bool = False, later: int = 0, method: str = "both", ratio: tuple[float, ...] = (100,) * 3
) -> Results:
    """A study of three instants, with the instant held at `later` further times."""
    J = fronts(narrow)
    held = np.repeat(J[:, None], later + 1, axis=1) * (1 + 0.2 * np.arange(later + 1))[:, None, None]
    values = held if later else J
    dims = ("instant", *(("later",) if later else ()))
    marks = np.zeros(values.shape[:-1], "i1")
    marks[0, ..., 2] = 1
    found = [
        Quantity("instant", ("instant",), INSTANTS, "s", ""),
        Quantity("stage", ("stage",), np.array(["approach", "capture"]), "1", ""),
        Quantity("t_s", ("instant",), np.full(3, 10.0), "s", ""),
        Quantity("chosen_ratio", ("instant",), np.array(ratio, float), "1", ""),
        Quantity("chosen_J_1", ("instant",), J[:, 6, 0], "s", ""),
        Quantity("chosen_J_2", ("instant",), J[:, 6, 1], "s", ""),
        Quantity("hypervolume", ("instant",), np.array([1.0, 2.0, 3.0]), "s^2", ""),
    ]
    wait = np.broadcast_to((10.0 - INSTANTS)[:, None, None] + 0.3 * np.arange(later + 1)[:, None], held.shape[:-1])
    for name in ("weighted", "constrained"):
        if method in (name, "both"):
            along = (*dims, "ratio" if name == "weighted" else "bound")
            found += [Quantity(f"{name}_J_{s + 1}", along, values[..., s], "s", "") for s in range(2)]
            found += [Quantity(f"{name}_dominated", along, marks, "1", "")]
            found += [Quantity(f"{name}_wait", along, wait, "s", "")] if later else []
    if later:
        found += [Quantity("later", ("later",), np.linspace(0.0, 0.8, later + 1), "1", "")]
        found += [Quantity(f"free_J_{s + 1}", ("instant", "ratio"), J[..., s], "s", "") for s in range(2)]
        found += [Quantity("free_wait", ("instant", "ratio"), wait[:, 0], "s", "")]
    return Results(Path("made_up.h5"), {}, {quantity.name: quantity for quantity in found})


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


def unsolved(results: Results, point: int | slice) -> Results:
    """The study without those points that could be solved for by no method."""
    for name in results.quantities:
        if name.endswith(("_J_1", "_J_2")) and not name.startswith("chosen"):
            results[name][..., point] = np.nan
    return results


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
