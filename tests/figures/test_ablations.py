from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from psmpc_cli.figures.ablations import EARLY, PLOTS, draw_ablation, plot_ablation
from psmpc_cli.figures.style import COLUMN, TEXT, in_style

from .drawn import curves, legend
from .fit_to_print import check_figure

TIME = np.linspace(0.0, 20.0, 41)
INSTANTS = np.linspace(1.2, 4.0, 15)
HORIZON = {"T_f": (np.array([0.0, 20.0]), np.full(2, 4.0))}
AHEAD = np.where(TIME > 5, 4.0 - (TIME - 5) % 4.0, np.nan)
MESH = np.array([10.0, 100.0])

MADE_UP = {
    "pending_cost": {
        "instant": {"printed": (TIME, np.full(41, 4.0)), "ours": (TIME, AHEAD), **HORIZON},
        "variation": {"printed": (TIME, TIME**2), "ours": (TIME, TIME)},
        "J, printed": {"1 : 1": (INSTANTS, 2.0 - INSTANTS / 4), "1 : 100": (INSTANTS, 1.0 / INSTANTS)},
        "J, ours": {"1 : 1": (INSTANTS, INSTANTS), "1 : 100": (INSTANTS, 2 * INSTANTS)},
        "minima, printed": {"1 : 1": (np.array([4.0]), np.ones(1)), "1 : 100": (np.array([4.0]), np.full(1, 0.25))},
        "minima, ours": {"1 : 1": (np.array([1.2]), np.full(1, 1.2)), "1 : 100": (np.array([1.2]), np.full(1, 2.4))},
        "found, printed": {"1 : 1": (np.full(3, 4.0), np.full(3, 1.0)), "1 : 100": (np.full(3, 4.0), np.full(3, 0.25))},
        "found, ours": {"1 : 1": (np.full(3, 1.2), np.full(3, 1.2)), "1 : 100": (np.full(3, 1.2), np.full(3, 2.4))},
    },
    "normalization": {
        "stages": {
            "ours": (np.array([0.0, 6.0, 14.0]), np.array([10.0, 14.0, 18.0])),
            "none": (np.array([0.0, 10.0, np.nan]), np.array([10.0, np.nan, np.nan])),
        },
        "instant": {"ours": (TIME, AHEAD), "none": (TIME, np.full(41, np.nan)), **HORIZON},
        "variation": {"ours": (TIME, TIME), "none": (TIME, 100 * TIME)},
    },
    "discretization": {
        "error": {"exact": (MESH, np.full(2, 1e-15)), "euler": (MESH, 1 / MESH)},
        "missed": {"exact": (MESH, np.ones(2)), "euler": (MESH, 1 + 10 / MESH)},
        "end": {"exact": (MESH, np.array([30.0, 29.0])), "euler": (MESH, np.array([np.nan, 29.1]))},
    },
}


def figure(name: str) -> Figure:
    return plot_ablation(name, MADE_UP[name])


@pytest.mark.parametrize("name", list(PLOTS))
def test_a_figure_fits_a_column_and_is_legible(name: str, tmp_path: Path) -> None:
    path = draw_ablation(name, MADE_UP[name], tmp_path / "new" / f"{name}.png")
    with Image.open(path) as image:
        assert image.width == round(300 * COLUMN)
    texts = [text for axes in figure(name).axes for text in axes.texts]
    assert all(text.get_fontsize() >= TEXT for text in texts)


@pytest.mark.parametrize("name", list(PLOTS))
def test_a_figure_is_fit_to_print(name: str) -> None:
    with in_style():
        check_figure(figure(name))


@pytest.mark.parametrize("name", list(PLOTS))
def test_every_vertical_axis_says_what_it_is(name: str) -> None:
    assert all(axes.get_ylabel() for axes in figure(name).axes if len(axes.get_yticks()))


def test_the_same_data_give_the_same_file(tmp_path: Path) -> None:
    first, second = (draw_ablation("pending_cost", MADE_UP["pending_cost"], tmp_path / f"{i}.png") for i in range(2))
    assert first.read_bytes() == second.read_bytes()


def test_every_curve_is_drawn_as_given() -> None:
    ahead, variation, printed, ours = figure("pending_cost").axes
    np.testing.assert_array_equal(curves(ahead)["ours"], np.column_stack([TIME, AHEAD]))
    np.testing.assert_array_equal(curves(variation)["as printed, δ = 0"], np.column_stack([TIME, TIME**2]))
    for axes, panel in ((printed, "J, printed"), (ours, "J, ours")):
        for label, curve in MADE_UP["pending_cost"][panel].items():
            np.testing.assert_array_equal(curves(axes)[label], np.column_stack(curve))


def test_minima_and_what_the_optimizer_returns_are_marked() -> None:
    *_, ours = figure("pending_cost").axes
    for marker in "ov":
        marked = [line.get_xydata() for line in ours.lines if line.get_marker() == marker and len(line.get_xydata())]
        assert [tuple(points[0]) for points in marked] == [(1.2, 1.2), (1.2, 2.4)]


def test_instants_that_cannot_be_met_are_shaded() -> None:
    *_, printed, ours = figure("pending_cost").axes
    for axes in (printed, ours):
        assert "infeasible" in [text.get_text() for text in axes.texts]
        (span,) = axes.patches
        assert span.get_extents().transformed(axes.transData.inverted()).x1 == pytest.approx(INSTANTS[0])


def test_stages_are_bars_and_early_starts_stand_out() -> None:
    stages, *_ = figure("normalization").axes
    bars = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in stages.patches]
    assert bars == [(0.0, 10.0), (10.0, 14.0), (6.0, 10.0), (14.0, 18.0), (0.0, 10.0)]
    assert sum(patch.get_facecolor() == _rgba(EARLY) for patch in stages.patches) == 1


def _rgba(color: str) -> tuple[float, ...]:
    return (*(int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)), 1.0)


def test_a_form_without_error_is_named_and_not_drawn() -> None:
    error, missed, _ = figure("discretization").axes
    assert legend(error) == ["Euler, as printed"]
    assert "exact: below" in error.get_title(loc="left")
    assert legend(missed) == ["exact", "Euler, as printed"]
