from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.figures.scenario import configurations, draw_scenario, object_poses, plot_scenario
from psmpc_cli.figures.style import in_style
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task


def test_every_stage_is_drawn_at_its_target(transport: Task, model: RobotModel, stages: tuple[Stage, ...]) -> None:
    stops = configurations(transport, model, stages)
    assert len(stops) == 5
    for stage, Q in zip(stages, stops[1:], strict=True):
        reached = Q if stage.space == "joint" else np.asarray(model.g(Q)).ravel()
        np.testing.assert_allclose(np.exp(1j * reached), np.exp(1j * stage.target), atol=2e-3)
        np.testing.assert_allclose(reached[:2], stage.target[:2], atol=1e-3)


def test_the_object_rests_is_carried_and_is_left(transport: Task, model: RobotModel, stages: tuple[Stage, ...]) -> None:
    approach, capture, transported, released = object_poses(transport, model, configurations(transport, model, stages))
    np.testing.assert_array_equal(approach, transport.spec.object.pose)
    np.testing.assert_array_equal(capture, approach)
    assert np.linalg.norm(transported[:2] - capture[:2]) > 1
    np.testing.assert_array_equal(released, transported)


def test_one_panel_a_stage_with_its_name_and_priority(transport: Task) -> None:
    with in_style():
        figure = plot_scenario(transport)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == [
        "1. approach, priority 1",
        "2. capture, priority 100",
        "3. transport, priority 1",
        "4. release, priority 0.01",
    ]


def test_nothing_is_overwritten(transport: Task, tmp_path: Path) -> None:
    path = draw_scenario(transport, tmp_path / "scenario.png")
    before = path.read_bytes()
    with pytest.raises(InputError, match="overwrite with --force"):
        draw_scenario(transport, path)
    assert path.read_bytes() == before
