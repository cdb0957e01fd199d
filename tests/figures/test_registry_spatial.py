"""Figures of a run in space."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axis import Axis
from scipy.spatial.transform import Rotation

from psmpc_cli.figures import animation
from psmpc_cli.figures.coordinates import attitude_error, plot_overlay, plot_states, plot_velocities
from psmpc_cli.figures.registry import draw, figures_of
from psmpc_cli.figures.scene import OBLIQUE, scene_of
from psmpc_cli.figures.snapshots import plot_robot, plot_scenario
from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.feasibility.postures import configurations_at_stops
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.robot.configuration import pose_frames
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import load_robot, load_task, parse_task

from .figure_contents import check_figure, common_legend, curves, points

pytestmark = pytest.mark.slow

TASK = """
robot: free_flyer_arm
initial: {base: {position: [0, 0, 0]}, arm: [0, 0, 0]}
controller: {nodes: 8}
skills:
  go: {space: joint, weights: {base: [1, 1, 1, 1, 1, 1], arm: [1, 1, 1], control: 1}}
stages:
  - name: fly
    skill: go
    target: {base: {position: [0.4, 0.2, 0.1], attitude: {axis: [0.6, 0, 0.8], angle: 40 deg}}, arm: [0.2, 0.2, 0]}
    ends_when: {coordinates: [base], tolerance: 0.02}
"""


@pytest.fixture(scope="module")
def run() -> Run:
    """A free-flyer turns by 40 degrees."""
    return simulate(parse_task(TASK, find("robot", "free_flyer_arm").read_text(), "fly"))


def test_every_figure_is_fit_to_print(run: Run) -> None:
    for kind, subject in (("run", run), ("comparison", {"psmpc": run, "smpc": run})):
        for make in figures_of(kind, subject).values():
            check_figure(make(subject))


def test_attitude_is_a_rotation_vector_beside_its_angle_to_the_target(run: Run) -> None:
    panel = plot_states(run).axes[2]
    assert panel.get_ylabel() == "Base attitude\n(rad)"
    shown = curves(panel)
    vector = np.array([shown[axis][:, 1] for axis in "xyz"]).T
    turned = Rotation.from_rotvec(vector)
    np.testing.assert_allclose(
        turned.as_matrix(), Rotation.from_quat(run.motion.Q[:, 3:7], scalar_first=True).as_matrix(), atol=1e-9
    )
    target = Rotation.from_rotvec(np.radians(40) * np.array([0.6, 0, 0.8]))
    np.testing.assert_allclose(attitude_error(run), (target.inv() * turned).magnitude(), atol=1e-6)
    np.testing.assert_allclose(shown["to the target"][:, 1], attitude_error(run))
    assert plot_velocities(run).axes[2].get_ylabel() == "Base velocity\n(rad/s)"
    assert plot_overlay({"psmpc": run}).axes[3].get_ylabel() == "Base attitude x\n(rad)"


def test_the_lowest_panel_of_each_column_has_the_axis_of_time() -> None:
    run = simulate(load_task("servicing", {"controller.nodes": 5, "time_limit": 0.3, "log.shares": False}))
    panels = plot_overlay({"psmpc": run}).axes
    shown = [axes for axes in panels if axes.get_visible()]
    assert len(shown) < len(panels)  # the last row is not full
    has_time = [axes.get_xlabel() == "Time (s)" and axes.xaxis.get_tick_params()["labelbottom"] for axes in shown]
    assert has_time == [False] * (len(shown) - 3) + [True] * 3


@pytest.mark.parametrize("figure", ["states", "velocities", "controls", "errors"])
def test_all_angles_of_a_figure_are_in_radians(run: Run, figure: str) -> None:
    labels = [axes.get_ylabel() for axes in figures_of("run")[figure](run).axes]
    assert any("(rad" in label for label in labels)
    assert not any("(deg" in label for label in labels)


def test_targets_of_a_scene_are_frames_in_its_view(run: Run) -> None:
    scene = scene_of(run)
    (base, tip) = scene.target_frames(0, 0.0)
    np.testing.assert_allclose(base[:3, 3], [0.4, 0.2, 0.1])
    np.testing.assert_allclose(np.linalg.det([base[:3, :3], tip[:3, :3]]), 1.0)
    view = OBLIQUE.view(scene.extent([0.0, run.motion.end]))
    seen = OBLIQUE.project(np.array([base[:3, 3], tip[:3, 3]]))
    assert np.all((view.min < seen) & (seen < view.max))


def test_a_scenario_has_the_hands_at_their_targets() -> None:
    problem = build_problem(load_task("servicing"))
    stop = configurations_at_stops(problem.task, problem.model, problem.stages)[2]
    wanted = pose_frames(problem.stages[1].target.reshape(3, 7))
    np.testing.assert_allclose(pose_frames(problem.model.poses(stop)), wanted, atol=3e-3)


def test_a_scenario_has_the_points_that_are_looked_at_in_its_view() -> None:
    figure = plot_scenario(load_task("fly_and_point"))
    check_figure(figure)
    hatch = figure.axes[1]
    (mark,) = [line for line in hatch.lines if line.get_marker() == "+"]
    (at,) = points(mark)
    np.testing.assert_allclose(at, OBLIQUE.project(np.array([0.6, 3, -1.4])))
    assert np.all((hatch.viewLim.min < at) & (at < hatch.viewLim.max))
    assert "point to look at" in common_legend(figure)


def check_ticks(axis: Axis) -> None:
    """Assert that an axis has more than one number, and a unit."""
    low, high = axis.get_view_interval()
    ticks = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    assert len([label for label in ticks if label.get_visible() and label.get_text()]) > 1
    assert axis.get_label_text().endswith("(m)")


@pytest.mark.parametrize("task", ["servicing", "transport"])
def test_a_scenario_has_ticks_with_units_at_its_outer_panels(task: str) -> None:
    panels = plot_scenario(load_task(task)).axes
    for axis in (panels[0].yaxis, panels[2].yaxis, panels[2].xaxis, panels[3].xaxis):
        check_ticks(axis)


def test_every_view_of_a_robot_has_ticks_with_units() -> None:
    for panel in plot_robot(load_robot("dual_arm_servicer")).axes:
        check_ticks(panel.xaxis)
        check_ticks(panel.yaxis)


def test_snapshots_say_from_where_they_are_seen_and_the_run_is_animated(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(animation, "DPI", 30)
    figure = figures_of("run")["snapshots"](run)
    assert "azimuth −60°" in figure.legends[0].get_title().get_text()
    assert "x axis of a target" in common_legend(figure)
    short = parse_task(f"{TASK}time_limit: 0.5\n", find("robot", "free_flyer_arm").read_text(), "fly")
    files = draw("run", simulate(short), tmp_path, only=(), films=["animation"])
    assert files[0].stat().st_size > 0
