from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import Polygon

from psmpc_cli.figures.robot_drawing import View, base_outline, draw_scene, reach, show, view_of
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import new_figure

Load = Callable[..., Run]


def drawn_points(run: Run, time: float) -> np.ndarray:
    axes = new_figure(3.0).add_subplot()
    draw_scene(axes, run, time)
    outlines = [patch.get_xy() for patch in axes.patches if isinstance(patch, Polygon)]
    return np.vstack([*outlines, *(line.get_xydata() for line in axes.lines)])


@given(share=st.floats(0, 1))
def test_the_view_shows_all_that_is_drawn(run: Run, share: float) -> None:
    time = share * run.end
    view, points = view_of(run, np.array([time])), drawn_points(run, time)
    low, high = np.array([view.x[0], view.y[0]]), np.array([view.x[1], view.y[1]])
    assert np.all((low < points) & (points < high))


def test_the_arms_hang_on_the_base(run: Run) -> None:
    np.testing.assert_allclose(np.abs(base_outline(run.model, np.zeros(9))), [[0.3, 0.18]] * 4)
    assert reach(run.model) == pytest.approx(1.2)


def test_a_base_turns_and_moves_with_its_pose(run: Run) -> None:
    Q = np.zeros(9)
    Q[:3] = 1.0, 2.0, np.pi / 2
    corners = base_outline(run.model, Q)
    np.testing.assert_allclose(corners.mean(axis=0), [1.0, 2.0])
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.36, 0.6])


@pytest.mark.parametrize(("width", "step"), [(5.4, 1.0), (6.1, 2.0), (0.5, 0.1), (31.0, 10.0)])
def test_ticks_are_round_and_few(width: float, step: float) -> None:
    assert View((0.0, width), (0.0, 1.0)).step == pytest.approx(step)


def test_both_axes_have_the_same_scale(run: Run) -> None:
    axes = new_figure(3.0).add_subplot()
    show(axes, view_of(run, run.time))
    assert axes.get_aspect() == 1.0
    assert axes.get_xticks()[1] - axes.get_xticks()[0] == axes.get_yticks()[1] - axes.get_yticks()[0]


def test_a_motion_along_one_line_keeps_a_panel_of_sensible_shape(load: Load, one_arm: dict[str, Any]) -> None:
    up = (np.zeros(5), np.array([0.0, 50.0, 0.0, 0.0, 0.0]))
    along = (np.zeros(5), np.array([50.0, 0.0, 0.0, 0.0, 0.0]))
    runs = [load(f"{k}.h5", **{**one_arm, "points": points}) for k, points in enumerate((up, along))]
    aspects = [view_of(run, np.array([0.0, 6.0])).aspect for run in runs]
    assert aspects == pytest.approx([1.6, 0.45])
