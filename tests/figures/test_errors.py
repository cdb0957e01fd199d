from collections.abc import Callable
from typing import Any

import numpy as np

from psmpc_cli.figures.errors import plot_errors, pose_errors
from psmpc_cli.figures.run import Run

from .drawn import bars, legend, long_curves

Load = Callable[..., Run]


def test_the_error_of_a_task_space_stage_is_against_its_poses(run: Run) -> None:
    start, end = pose_errors(run, run.spans[1], np.array([10.0, 13.0]))
    assert np.max(np.abs(end)) < 0.05  # interpolated between samples 0.4 s apart
    np.testing.assert_allclose(start, run.poses_at(np.array([10.0]))[0] - run.stages[1].target)


def test_the_error_of_a_joint_space_stage_is_against_the_poses_of_its_target(run: Run) -> None:
    start, end = pose_errors(run, run.spans[2], np.array([13.0, 23.0]))
    np.testing.assert_allclose(start[:3], [-2.0, 2.0, np.pi / 6], atol=0.05)
    assert np.max(np.abs(end)) < 0.05


def test_the_error_of_a_moving_target_is_against_where_it_has_got_to(load: Load, one_arm: dict[str, Any]) -> None:
    moving = "target: {times: [0, 6], base: [[0, 0, 0], [1, 2, 0.1]], arm: [[0, 0], [0.5, 0.5]]}"
    task = one_arm["task"].replace("target: {base: [1, 2, 0.1], arm: [0.5, 0.5]}", moving)
    run = load(**{**one_arm, "task": task, "sample": 0.5})
    first, halfway, last = pose_errors(run, run.spans[0], np.array([0.0, 3.0, 6.0]))
    np.testing.assert_allclose([first, halfway, last], np.zeros((3, run.model.m)), atol=1e-9)


def test_curves_start_anew_with_every_stage(run: Run) -> None:
    spans = {(curve[0, 0], curve[-1, 0]) for curve in long_curves(plot_errors(run).axes[1])}
    assert spans == {(0.0, 10.0), (10.0, 13.0), (13.0, 23.0), (23.0, 29.6)}


def test_tolerances_are_drawn_over_their_stages(run: Run) -> None:
    for axes in plot_errors(run).axes[1:]:
        assert bars(axes) == [(0.0, 10.0, 2e-3), (10.0, 13.0, 2e-3), (13.0, 23.0, 2e-3), (23.0, 29.6, 0.05)]


def test_base_and_arms_are_named_once(run: Run) -> None:
    assert legend(plot_errors(run).axes[1]) == ["base", "arm 1", "arm 2"]


def test_a_robot_with_one_arm_has_two_curves(load: Load, one_arm: dict[str, Any]) -> None:
    assert len(long_curves(plot_errors(load(**one_arm)).axes[1])) == 2
