"""The robot, its object, targets and paths: where they are drawn, and in which frames."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from psmpc_cli.figures.coordinates import error_curves
from psmpc_cli.figures.scene import object_frames, scene_of
from psmpc_cli.figures.snapshots import plot_robot, plot_scenario, plot_snapshots
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.feasibility.postures import configurations_at_stops
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.configuration import pose_frames
from psmpc_cli.robot.geometry import pieces_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import Task, load_robot, load_task
from psmpc_cli.specs.object import OnObject

from .figure_contents import check_figure, common_legend, points

Load = Callable[..., Run]


def titles(figure: Figure) -> list[str]:
    found = (axes.get_title(loc="left").replace("\n", " ").replace("\N{NO-BREAK SPACE}", " ") for axes in figure.axes)
    return [title.rstrip() for title in found if title]


def test_a_frame_for_each_key_instant_all_to_one_scale(run: Run) -> None:
    figure = plot_snapshots(run)
    assert titles(figure) == [
        "0.0 s: start",
        "6.4 s: capture starts",
        "10.0 s: approach ends",
        "13.0 s: capture ends",
        "23.0 s: transport ends",
        "29.6 s: release ends",
    ]
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes}) == 1
    assert all(axes.get_aspect() == 1.0 for axes in figure.axes)
    for axes in figure.axes:
        assert len([patch for patch in axes.patches if isinstance(patch, Polygon)]) == 2  # base and object
    assert {"base", "arm 1", "arm 2", "object", "target", "path of the base", "path of an arm's end"} == set(
        common_legend(figure)
    )


@pytest.mark.slow
def test_instants_within_a_sample_share_a_frame(load: Load) -> None:
    assert titles(plot_snapshots(load(early={1: 0.1})))[0] == "0.0 s: start, capture starts"
    assert titles(plot_snapshots(load(early={1: 0.3})))[:2] == ["0.0 s: start", "0.3 s: capture starts"]


@pytest.mark.slow
def test_a_target_on_an_object_moves_with_it() -> None:
    run = simulate(load_task("catch_drifting", ["controller.nodes=12", "time_limit=2"]))
    scene, target = scene_of(run), run.task.spec.stages[0].target["base"]
    assert isinstance(target, OnObject) and np.ptp(run["object/pose"], axis=0).max() > 0.03
    for time in run.time[[0, 7, -1]]:
        (aim, *_), thing = scene.target_frames(0, float(time)), scene.object_frame(float(time))
        assert thing is not None
        np.testing.assert_allclose(np.linalg.inv(thing) @ aim, pose_frames(target.object), atol=1e-9)
    first, *_ = [curve for curve in error_curves(run) if curve.part == "base" and not curve.angular]
    assert first.error[first.time == run.time[-1]] == pytest.approx(np.abs(run.Q[-1, :2] - aim[:2, 3]).max())


@pytest.mark.slow
def test_the_loss_of_the_object_and_the_end_of_a_killed_run_have_frames(load: Load) -> None:
    events = [title.rsplit(": ", 1)[-1] for title in titles(plot_snapshots(load(early={1: 6.4, 3: 17.0})))]
    assert events.index("release starts") < events.index("object lost") < events.index("transport ends")
    assert titles(plot_snapshots(load(last=8.0)))[-1] == "7.6 s: end of the run"


def marks(axes: Axes) -> np.ndarray:
    """Where targets are marked."""
    return np.vstack([points(line) for line in axes.lines if line.get_marker() == "+"])


def test_targets_of_the_stages_that_act_are_marked(run: Run) -> None:
    first, second, *_ = plot_snapshots(run).axes
    stage = run.problem.stages[0]
    xi = np.asarray(run.problem.model.g(stage.target)).ravel()
    expected = np.array([xi[rows][:2] for rows in run.problem.model.pose_rows.values()])
    np.testing.assert_allclose(marks(first), expected)
    capture = np.array([run.problem.stages[1].target[rows][:2] for rows in run.problem.model.pose_rows.values()])
    np.testing.assert_allclose(marks(second), np.vstack([expected, capture]))  # it starts early


def test_snapshots_of_several_runs_show_where_their_stages_end(runs: Mapping[str, Run]) -> None:
    figure = plot_snapshots(runs)
    expected = ["10.0 s: approach ends", "13.0 s: capture ends", "23.0 s: transport ends", "29.6 s: release ends"]
    assert titles(figure)[:4] == expected
    assert titles(figure)[12:] == ["10.4 s: approach ends", "19.0 s: capture ends"]
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes if axes.axison}) == 1
    assert [axes.get_ylabel() for axes in figure.axes[:5:4]] == ["PSMPC\ny (m)", "SMPC\ny (m)"]
    assert "object, lost" in common_legend(figure)


def test_a_scenario_has_every_stage_at_its_target(
    transport: Task, model: RobotModel, stages: tuple[Stage, ...]
) -> None:
    stops = configurations_at_stops(transport, model, stages)
    for stage, Q in zip(stages, stops[1:], strict=True):
        reached = Q if stage.space == "joint" else np.asarray(model.g(Q)).ravel()
        np.testing.assert_allclose(np.exp(1j * reached), np.exp(1j * stage.target), atol=2e-3)
        np.testing.assert_allclose(reached[:2], stage.target[:2], atol=1e-3)
    approach, capture, transported, released = object_frames(transport, model, stops)
    np.testing.assert_array_equal(approach, pose_frames(transport.spec.object.pose))
    np.testing.assert_array_equal(capture, approach)
    assert np.linalg.norm(transported[:2, 3] - capture[:2, 3]) > 1
    np.testing.assert_array_equal(released, transported)
    figure = plot_scenario(transport)
    check_figure(figure)
    expected = ["1. approach, priority 1", "2. capture, priority 100", "3. transport, priority 1"]
    assert titles(figure) == [*expected, "4. release, priority 0.01"]


def test_a_scenario_has_the_arms_where_they_are_advised_to_be(
    transport: Task, model: RobotModel, stages: tuple[Stage, ...]
) -> None:
    """Those of Approach end where Capture's end-effectors are, as the base is there already."""
    figure = plot_scenario(transport)
    advised = [[line for line in axes.lines if "advised" in str(line.get_label())] for axes in figure.axes]
    assert [bool(lines) for lines in advised] == [True, False, False, False]
    drawn = np.vstack([line.get_xydata() for line in advised[0]])
    wanted = stages[1].target.reshape(3, -1)[1:, :2]
    assert np.linalg.norm(drawn[:, None] - wanted, axis=2).min(axis=0).max() < 0.1


def test_obstacles_are_drawn_where_they_are_at_the_time(load: Load, keeping_clear: dict[str, Any]) -> None:
    run = load(**keeping_clear)
    figure = plot_snapshots(run)
    check_figure(figure)
    assert {"obstacle", "path of an obstacle"} <= set(common_legend(figure))
    times = [0.0, 6.4, 10.0, 13.0, 23.0, 29.6]
    for axes, time in zip(figure.axes, times, strict=True):
        found = [np.asarray(patch.get_xy()) for patch in axes.patches if "obstacle" in str(patch.get_label())]
        ball, beam, crate, wall = found
        assert (ball.min(axis=0) + ball.max(axis=0)) / 2 == pytest.approx([-1 + 0.05 * time, 1.2], abs=1e-3)
        assert np.ptp(ball, axis=0) == pytest.approx(0.4, abs=1e-3)
        assert (beam.min(axis=0) + beam.max(axis=0)) / 2 == pytest.approx([-1.5, 3.0], abs=1e-3)
        assert crate[:-1].mean(axis=0) == pytest.approx([0.8, -0.5])
        assert wall.max(axis=0)[0] == pytest.approx(-3.2)


@pytest.mark.parametrize("clearance", ["{}", None], ids=["kept", "not kept"])
def test_a_scenario_has_obstacles_and_what_keeps_clear_of_them(clearance: str | None) -> None:
    ball = "{name: ball, shape: {sphere: 0.2}, pose: [-1, 1.2, 0], velocity: [0.05, 0]}"
    changes = [f"obstacles=[{ball}]", *([] if clearance is None else [f"clearance={clearance}"])]
    figure = plot_scenario(load_task("transport", changes))
    check_figure(figure)
    assert "obstacle at the start" in common_legend(figure)
    assert ("capsules of the bodies" in common_legend(figure)) == (clearance is not None)
    outlines = [line for line in figure.axes[0].lines if "capsules" in str(line.get_label())]
    assert len(outlines) == (0 if clearance is None else len(pieces_of(load_task("transport").robot)))


def test_the_figure_of_a_robot_has_the_geometry_of_its_file() -> None:
    spec = load_robot("planar_dual_arm")
    shape = {"shape": {"capsule": (0.2, 0.9)}, "pose": (0.0, 0.5, 0.0)}
    covered = type(spec).model_validate({**spec.model_dump(by_alias=True), "geometry": {"base": [shape]}})
    assert "capsules of the bodies" not in common_legend(plot_robot(spec))
    figure = plot_robot(covered)
    check_figure(figure)
    assert "capsules of the bodies" in common_legend(figure)
    (outline,) = [points(line) for line in figure.axes[0].lines if "capsules" in str(line.get_label())]
    assert outline.max(axis=0) == pytest.approx([0.65, 0.7], abs=1e-3)
    assert figure.axes[0].get_ylim()[1] > 0.7
