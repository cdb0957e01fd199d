"""Figures of robots without thrusters: what a stage wants nowhere has neither an error nor a mark."""

import json
import re
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes

from psmpc_cli.figures.coordinates import error_curves, plot_controls, plot_errors, plot_states
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.figures.scene import scene_of
from psmpc_cli.figures.snapshots import plot_scenario, plot_snapshots
from psmpc_cli.logs.run import Run
from psmpc_cli.report.view import view
from psmpc_cli.robot.model import load_robot
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.library import find
from psmpc_cli.specs.load import load_task

from .figure_contents import check_figure, common_legend, legend, points

Load = Callable[..., Run]

TASK = find("task", "float_and_reach").read_text()
HANDS = np.array([[1.382, 0.387], [-1.394, 0.368]])
"""Where both hands are to be in the first stage [m]."""

FOLDED = np.r_[0, 0, 0, 0.3, 0.3, 0.3, -0.3, -0.3, -0.3]
REACHED = np.r_[0.02, 0.03, -0.3, 0.9, -0.5, 0.5, -0.2, 0.6, -0.4]


def floating(load: Load, task: str = TASK) -> Run:
    """A made-up run of both stages, in which the base moves."""
    return load(task=task, ends=(4.0, 10.0), points=(FOLDED, REACHED, FOLDED), early={})


def wanting_the_base() -> str:
    """The task with a target of the base in its second stage."""
    weighted = TASK.replace("{arms: [30, 30, 30]", "{base: [1, 1, 1], arms: [30, 30, 30]")
    return weighted.replace("target: {arm_1: [0.3", "target: {base: [0, 0, 0], arm_1: [0.3")


def marks(axes: Axes) -> list[tuple[float, float]]:
    """Where targets are marked."""
    return [tuple(points(line)[0]) for line in axes.lines if line.get_marker() == "+"]


@pytest.mark.slow
def test_every_figure_is_fit_to_print(load: Load) -> None:
    run = floating(load)
    for make in figures_of("run", run).values():
        check_figure(make(run))


def test_only_what_a_stage_asks_for_has_an_error(load: Load) -> None:
    run = floating(load)
    found = {(curve.span.index, curve.part, curve.angular) for curve in error_curves(run)}
    poses = {(0, arm, angular) for arm in ("arm_1", "arm_2") for angular in (False, True)}
    assert found == poses | {(1, "arm_1", True), (1, "arm_2", True)}
    for panel in plot_errors(run).axes[1:]:
        assert sorted(legend(panel)) == ["arm 1", "arm 2"]
    wanted = {(curve.span.index, curve.angular) for curve in error_curves(floating(load, wanting_the_base()))}
    assert {(1, False), (1, True)} < wanted


def test_coordinates_of_a_group_that_weights_leave_free_do_not_count(load: Load) -> None:
    """Of the first arm's joints the second stage weights the first one; its end condition is about the second arm."""
    task = TASK.replace("arms: [30, 30, 30]", "arms: [30, 0, 0]")
    task = task.replace(
        "coordinates: [arms], tolerance: 5e-3, velocity", "coordinates: [arm_2], tolerance: 5e-3, velocity"
    )
    run = floating(load, task)
    curves = {curve.part: curve for curve in error_curves(run) if curve.span.index == 1}
    off = np.abs(REACHED - FOLDED)
    assert curves["arm_1"].error[0] == pytest.approx(off[3])
    assert curves["arm_2"].error[0] == pytest.approx(off[6:].max())


def test_only_what_a_stage_wants_somewhere_is_marked(load: Load) -> None:
    figure = plot_snapshots(floating(load))
    start, reached, folded = figure.axes[:3]
    np.testing.assert_allclose(marks(start), HANDS)
    assert marks(reached) == marks(folded) == []  # joints have the hands nowhere in particular
    assert "target" in common_legend(figure)
    joints = plot_snapshots(floating(load, wanting_the_base())).axes[1]
    np.testing.assert_allclose(marks(joints), load_robot("planar_dual_arm").poses(FOLDED)[:, :2], atol=1e-9)


@pytest.mark.parametrize(("mobility", "called"), [("free-floating", "base as if it stayed"), ("fixed", "fixed base")])
def test_a_scenario_says_where_a_base_is_that_is_wanted_nowhere(mobility: str, called: str) -> None:
    entries = common_legend(plot_scenario(load_task("float_and_reach", {"mobility": mobility})))
    assert called in entries
    assert "base at the target" not in entries


def test_a_base_without_thrusters_has_accelerations_and_no_controls(load: Load) -> None:
    labels = [axes.get_ylabel() for axes in plot_controls(floating(load)).axes[1:]]
    assert labels[:3] == ["Base\nacceleration\n(m/s²)", "Base\nacceleration\n(rad/s²)", "Arm 1 control\n(rad/s²)"]


def test_the_viewer_leaves_out_the_same(load: Load) -> None:
    page = re.search(r'<script id="data" type="application/json">(.*?)</script>', view(floating(load)).html, re.DOTALL)
    assert page is not None
    (run,) = json.loads(page[1])
    (errors,) = [tab for tab in run["plots"] if tab["name"] == "Errors"]
    for panel in errors["panels"]:
        assert [series["label"] for series in panel["series"]] == ["arm 1", "arm 2", "tolerance"]


@pytest.mark.slow
def test_in_space_an_attitude_that_is_wanted_nowhere_has_no_axes_and_no_angle() -> None:
    run = simulate(load_task("float_and_look", ["controller.nodes=8", "time_limit=1"]))
    base, hand = scene_of(run).target_frames(0, 0.5)
    assert np.isnan(base[:3]).all()
    np.testing.assert_array_equal(hand[:3, 3], [2, 1, -1.5])
    assert np.isnan(hand[:3, :3]).all()
    assert "to the target" not in legend(plot_states(run).axes[2])
    assert [axes.get_ylabel() for axes in plot_errors(run).axes[1:]] == ["Angle error\n(rad)"]
    assert not [entry for entry in common_legend(plot_snapshots(run)) if "axis of a target" in entry]
    for make in figures_of("run", run).values():
        check_figure(make(run))
