from collections.abc import Callable
from typing import Any

import numpy as np

from psmpc_cli.figures.errors import plot_errors, pose_errors
from psmpc_cli.figures.run import Run

Load = Callable[..., Run]


def test_the_error_of_a_task_space_stage_is_against_its_poses(run: Run) -> None:
    capture = run.stages[1]
    error = pose_errors(run, capture, run.poses_at(np.array([13.0])))
    assert np.max(np.abs(error)) < 0.05  # interpolated between samples 0.4 s apart
    np.testing.assert_array_equal(pose_errors(run, capture, capture.target[None]), np.zeros((1, run.model.m)))


def test_the_error_of_a_joint_space_stage_is_against_the_poses_of_its_target(run: Run) -> None:
    approach = run.stages[0]
    start = pose_errors(run, approach, run.xi[:1])[0]
    np.testing.assert_allclose(start[:3], [2.0, -2.0, -np.pi / 6])
    assert np.max(np.abs(pose_errors(run, run.stages[2], run.poses_at(np.array([23.0]))))) < 0.05


def test_curves_start_anew_with_every_stage(run: Run) -> None:
    position = plot_errors(run).axes[1]
    spans = {(line.get_xdata()[0], line.get_xdata()[-1]) for line in position.lines if len(line.get_xdata()) > 2}
    assert spans == {(0.0, 10.0), (10.0, 13.0), (13.0, 23.0), (23.0, 29.6)}


def test_tolerances_are_drawn_over_their_stages(run: Run) -> None:
    for axes in plot_errors(run).axes[1:]:
        lines = [segment for collection in axes.collections for segment in collection.get_segments()]
        drawn = [(segment[0, 0], segment[1, 0], segment[0, 1]) for segment in lines]
        assert drawn == [(0.0, 10.0, 3e-3), (10.0, 13.0, 3e-3), (13.0, 23.0, 3e-3), (23.0, 29.6, 0.05)]


def test_base_and_arms_are_named_once(run: Run) -> None:
    legend = plot_errors(run).axes[1].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["base", "arm 1", "arm 2"]


def test_a_robot_with_one_arm_has_two_curves(load: Load, one_arm: dict[str, Any]) -> None:
    position = plot_errors(load(**one_arm)).axes[1]
    assert len([line for line in position.lines if len(line.get_xdata()) > 2]) == 2
