"""What the figures of a sweep show, read back from the drawing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.figures.registry import draw, figures_of
from psmpc_cli.figures.sweep import plot_heat_map, plot_sensitivity, plot_starts, plot_surface
from psmpc_cli.studies.sweep import ALLOWED_ERROR, SweepCells, recommend

from ..synthetic_sweep import T_H, T_S, numbers, synthetic_sweep
from .figure_contents import check_figure, common_legend, curves, legend, points

Sweep = Callable[..., SweepCells]


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return lambda sampling, **given: SweepCells(synthetic_sweep(tmp_path / "sweep.h5", sampling, **given))


@pytest.mark.parametrize(
    ("sampling", "names"),
    [
        ("3x3", ["surface", "heat_map", "starts", "sensitivity"]),
        ("5", ["starts", "sensitivity"]),
        ("random:4", ["draws", "starts", "sensitivity"]),
    ],
)
def test_a_sampling_has_the_figures_that_go_with_it(
    sweep: Sweep, tmp_path: Path, sampling: str, names: list[str]
) -> None:
    cells = sweep(sampling)
    assert list(figures_of("sweep", cells)) == names
    drawn = draw("sweep", cells, tmp_path / "figures", only=["starts"])
    assert drawn == [tmp_path / "figures" / "starts.png"]
    other = "draws" if "draws" not in names else "surface"
    with pytest.raises(InputError, match=f"no figure '{other}', expected one of {names[0]}"):
        draw("sweep", cells, tmp_path, only=[other])


def test_a_sweep_that_has_not_begun_has_nothing_to_draw(sweep: Sweep, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no cell that was run"):
        draw("sweep", sweep("2", waiting=(0, 1)), tmp_path / "figures")
    assert not (tmp_path / "figures").exists()


def mesh(figure: Figure) -> np.ma.MaskedArray:
    """The colours of the heat map as times (omega_2, omega_1) [s]."""
    found, *_ = [collection for collection in figure.axes[0].collections if isinstance(collection, QuadMesh)]
    return np.ma.asarray(found.get_array())


def contours(figure: Figure) -> list[np.ndarray]:
    sets = [collection for collection in figure.axes[0].collections if isinstance(collection, QuadContourSet)]
    return [path.vertices for one in sets[:1] for path in one.get_paths()]


def test_the_heat_map_has_omega_1_to_the_right_and_omega_2_up(sweep: Sweep) -> None:
    figure = plot_heat_map(sweep("5x7"))
    expected = [
        [numbers(omega_2 / omega_1)["actual_start"][1] for omega_1 in np.logspace(-3, 3, 5)]
        for omega_2 in np.logspace(-3, 3, 7)
    ]
    np.testing.assert_allclose(mesh(figure), expected)
    axes = figure.axes[0]
    assert "approach, ω₁" in axes.get_xlabel()
    assert "capture, ω₂" in axes.get_ylabel()


def test_the_contour_is_where_starts_come_down_to_t_s_less_the_horizon(sweep: Sweep) -> None:
    figure = plot_heat_map(sweep("7x7"))
    (line,) = contours(figure)
    decades = line[:, 1] - line[:, 0]
    # of the made-up starts 6.2 s is the first sample after t_s - T_h = 6.14 s; they are there from 10^3 on, not at 10^2
    assert np.all((decades > 2) & (decades <= 3))
    assert any("t_s - T_h" in text for text in common_legend(figure))


def test_cells_that_wait_are_blank_and_failed_ones_are_marked(sweep: Sweep) -> None:
    cells = sweep("3x3", waiting=(1,), failed=(5,))
    figure = plot_heat_map(cells)
    masked = np.ma.getmaskarray(mesh(figure))
    assert list(zip(*np.nonzero(masked), strict=True)) == [(0, 1), (1, 2)]
    (marks,) = [line for line in figure.axes[0].lines if line.get_label() == "_failed"]
    np.testing.assert_allclose(points(marks), [[3.0, 0.0]])
    assert {"failed", "waiting"} <= set(common_legend(figure))
    for plot in (plot_starts, plot_sensitivity):
        axes = plot(cells).axes[0]
        np.testing.assert_allclose(curves(axes)["failed"][:, 0], 1e-3)


def test_the_sensitivity_has_what_a_recommendation_compares(sweep: Sweep) -> None:
    ratios = np.logspace(-6, 6, 7)
    failing = sweep("7", of=lambda ratio: {**numbers(ratio), "succeeded": float(ratio > 1e-3)})
    ends, effort, force, error = plot_sensitivity(failing).axes[:4]
    known = [np.nan if ratio < 1e-3 else numbers(ratio)["completion_time"] for ratio in ratios]
    (line,) = [each for each in ends.lines if len(each.get_xdata()) == 7]
    np.testing.assert_allclose(line.get_ydata(), known)
    np.testing.assert_allclose(curves(ends)["failed"][:, 0], ratios[:2])
    np.testing.assert_allclose(curves(ends)["recommended 100"][:, 0], 100.0)
    np.testing.assert_allclose(curves(effort)["task's own"][:, 1], numbers(100.0)["control_effort"])
    np.testing.assert_allclose(curves(force)["task's own"][:, 1], numbers(100.0)["peak_base_force"])
    np.testing.assert_allclose(curves(error)["allowed"][:, 1], ALLOWED_ERROR)


def test_the_end_error_is_left_out_where_no_stage_has_an_end_condition(sweep: Sweep) -> None:
    timed = sweep("3", of=lambda ratio: {**numbers(ratio), "end_error": [np.nan], "final_error": np.nan})
    assert [axes.get_ylabel().split("\n")[0] for axes in plot_sensitivity(timed).axes] == [
        "Mission ends",
        "Control effort",
        "Peak base force",
    ]


def test_starts_are_drawn_by_threshold_between_t_s_and_t_s_less_the_horizon(sweep: Sweep) -> None:
    axes = plot_starts(sweep("7")).axes[0]
    ratios = np.logspace(-6, 6, 7)
    lines = curves(axes)
    assert legend(axes) == list(lines)
    for i, name in enumerate(("ε = 0.001", "ε = 0.1")):
        starts = [numbers(ratio)["actual_start"][i] for ratio in ratios]
        np.testing.assert_allclose(lines[name], np.column_stack([ratios, starts]))
    np.testing.assert_allclose(lines["$t_s$"][:, 1], T_S)
    np.testing.assert_allclose(lines["$t_s - T_h$"][:, 1], T_S - T_H)


def test_the_surface_stands_between_the_earliest_start_and_the_switch(sweep: Sweep) -> None:
    figure = plot_surface(sweep("3x3"))
    axes: Any = figure.axes[0]
    assert axes.get_zlim() == pytest.approx((T_S - T_H, T_S))
    assert axes.get_xlabel() == "ω₁ (1)"
    assert axes.get_ylabel() == "ω₂ (1)"
    assert "(s)" in axes.get_zlabel()


@pytest.mark.parametrize(("sampling", "name"), [("7x7", "heat_map"), ("7x7", "surface"), ("random:40", "draws")])
def test_the_recommended_run_and_failed_missions_are_marked_over_the_plane(
    sweep: Sweep, sampling: str, name: str
) -> None:
    def failing(ratio: float) -> dict[str, Any]:
        return {**numbers(ratio), "succeeded": float(ratio < 200)}

    cells = sweep(sampling, of=failing, failed=(3, 8), own={"control_effort": 3.0})
    best = recommend(cells)
    assert best.omega is not None and best.ratio == pytest.approx(best.omega[1] / best.omega[0])
    figure = figures_of("sweep", cells)[name](cells)
    lines = {line.get_label(): line for axes in figure.axes for line in axes.lines}

    def marked(label: str) -> np.ndarray:
        line = lines[label]
        assert line.get_markerfacecolor() == "none"  # an open ring hides nothing
        x, y = line.get_data_3d()[:2] if name == "surface" else line.get_data()
        return 10.0 ** np.column_stack([x, y])

    np.testing.assert_allclose(marked(f"_recommended, ω₂/ω₁ = {best.ratio:.4g}"), [best.omega])
    np.testing.assert_allclose(marked("_mission failed"), cells.omega[cells.ended & ~cells.succeeded])
    assert {"failed", "mission failed"} <= set(common_legend(figure))
    check_figure(figure)


def test_the_recommended_ratio_is_marked_over_ratios(sweep: Sweep) -> None:
    cells = sweep("13", own={"control_effort": 3.0})
    (axes,) = plot_starts(cells).axes
    (line,) = (line for line in axes.lines if line.get_label() == f"recommended {recommend(cells).ratio:.4g}")
    assert line.get_xdata()[0] == recommend(cells).ratio
