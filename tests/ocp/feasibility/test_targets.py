"""What check says of starts and targets that touch, are inside a margin, or outside a cone."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.ocp.feasibility.checks import remarks, review
from psmpc_cli.ocp.feasibility.forecast import forecast_configurations, forecast_stages
from psmpc_cli.ocp.feasibility.targets import shut_thrusters
from psmpc_cli.robot.model import load_robot
from psmpc_cli.robot.shape import RobotShape
from psmpc_cli.specs.document import dotted
from psmpc_cli.specs.load import load_task

from ...plumed import AHEAD, before_a_panel


@pytest.mark.parametrize(
    ("stage", "frame", "side", "says"),
    [
        ("approach", "base", "within: 50 deg", "axis of base at 60 deg where"),
        ("approach", "base", "within: 61 deg", None),
        ("approach", "base", "outside: 65 deg", "expected at least 65 deg there"),
        ("approach", "arm_1", "within: 50 deg", "axis of arm_1 at 60 deg where"),
        ("approach", "arm_2", "within: 50 deg", None),
        ("capture", "arm_1", "within: 74 deg", "axis of arm_1 at 75 deg where"),
    ],
    ids=["outside", "within", "within_what_to_avoid", "end_effector", "not_asked_for", "end_effector_in_task_space"],
)
def test_a_cone_that_the_stages_own_target_violates_is_remarked(
    stage: str, frame: str, side: str, says: str | None
) -> None:
    """Nobody asks where arm_2 is in the first stage."""
    cones = f"[{{frame: {frame}, axis: [1, 0], of: {{direction: [0, 2]}}, {side}}}]"
    task = load_task("transport", [f"stages.{stage}.cones={cones}", "skills.move.weights.arm_2=[0, 0, 0]"])
    found = remarks(task, forecast_stages(task))
    if says is None:
        assert found == []
    else:
        (remark,) = found
        assert dotted(remark.path) == f"stages[{['approach', 'capture'].index(stage)}].cones[0]"
        assert says in remark.message
        assert stage in remark.message


def post(x: float, y: float, **more: object) -> dict[str, object]:
    return {"name": "post", "shape": {"sphere": 0.1}, "pose": [x, y, 0], **more}


def too_close(name: str = "transport", **changes: object) -> dict[str, str]:
    """The remarks about a task that keeps clear, by path."""
    task = load_task(name, {"clearance": {"margin": 0.05}, **changes})
    return {dotted(remark.path): remark.message for remark in remarks(task, forecast_stages(task))}


RADIUS = RobotShape(load_robot("planar_dual_arm").spec).radius
"""Of the capsules about the links of the planar robot [m]."""


@pytest.mark.parametrize(("gap", "says"), [(0.06, ""), (0.02, "20.0 mm apart"), (-0.03, "30.0 mm deep in each other")])
def test_a_start_inside_the_margin_is_remarked_with_pair_and_depth(gap: float, says: str) -> None:
    """The arm is straight along x, from 0.3 m on; the post is beside the middle of its second link."""
    found = too_close(obstacles=[post(1.05, RADIUS + 0.1 + gap)]).get("initial", "")
    expected = f"found arm_1.2 and post {says} at the start, expected at least the margin of 50 mm between them"
    assert found == (expected if says else "")


def test_targets_inside_the_margin_are_remarked_at_their_stage() -> None:
    """With the base at -2, 2 m, turned by 30 deg, arms are stretched at first, then as inverse kinematics say."""
    along = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    across = np.array([-along[1], along[0]])
    x, y = [-2, 2] + 1.05 * along + (RADIUS + 0.1 + 0.02) * across
    stretched = too_close(obstacles=[post(x, y)])
    assert stretched["stages[0].target"].startswith('found arm_1.2 and post 20.0 mm apart where "approach" leads, exp')
    assert "initial" not in stretched
    bent = too_close(obstacles=[post(-1.93, 3.17)])
    assert list(bent) == ["stages[1].target"]
    assert 'deep in each other where "capture" leads, by inverse kinematics, expected' in bent["stages[1].target"]


def test_further_pairs_inside_the_margin_are_counted() -> None:
    """The post is beside the joint of two links, which are equally near."""
    found = too_close(obstacles=[post(0.8, RADIUS + 0.1 + 0.02)])["initial"]
    assert found.endswith(
        "20.0 mm apart at the start, expected at least the margin of 50 mm between them (1 more pair inside it)"
    )


def test_the_margin_of_a_stage_counts_at_its_target() -> None:
    near = post(-1.93, 3.17)
    assert too_close(clearance=None, **{"obstacles": [near], "stages.approach.clearance": {}}) == {}
    for margin in (0.0, 0.3):
        found = too_close(**{"obstacles": [near], "stages.capture.clearance": {"margin": margin}})
        assert f"at least the margin of {1e3 * margin:g} mm" in found["stages[1].target"]


def test_where_an_obstacle_has_moved_to_is_not_guessed() -> None:
    assert too_close(obstacles=[post(-1.93, 3.17, velocity=[0.1, 0])]) == {}
    at_start = too_close(obstacles=[post(1.05, 0.1, velocity=[0.1, 0])])
    assert list(at_start) == ["initial"]


def test_a_held_object_is_remarked_where_it_is_in_its_gripper() -> None:
    """At the end of transport it is 1.2 m by 0.4 m about (0, 0.978) m; capsules cover it, with some excess."""
    found = too_close("transport_grasp", obstacles=[post(0, 0.978 + 0.2 + 0.1 + 0.04)])
    assert list(found) == ["stages[2].target"]
    assert re.match(
        r'found object and post [\d.]+ mm (apart|deep in each other) where "transport"', found["stages[2].target"]
    )
    assert too_close("transport_grasp", obstacles=[post(0, 0.978 + 0.2 + 0.1 + 0.15)]) == {}


def test_of_a_base_that_reacts_to_its_arms_only_the_robot_itself_is_known() -> None:
    task = load_task("float_and_reach", {"clearance": {"margin": 2.0}, "obstacles": [post(0.5, 0.5)]})
    paths = {dotted(remark.path): remark.message for remark in remarks(task, forecast_stages(task))}
    assert " and post " in paths.pop("initial")
    assert paths and not any("post" in message for message in paths.values())


def test_obstacles_that_nothing_keeps_clear_of_are_remarked() -> None:
    without = 'found no "clearance", expected one: without it nothing keeps clear of obstacles'
    assert too_close(clearance=None, obstacles=[post(9, 9)])["obstacles"] == without


def test_a_monitor_of_parts_that_are_no_pair_is_a_fault() -> None:
    def monitored(of: list[str]) -> dict[str, object]:
        bound = {"name": "far", "quantity": "clearance", "of": of, "during": "approach", "at_least": 0.1}
        return {"clearance": {"except": [["arm_2", "post"]]}, "obstacles": [post(9, 9)], "monitors": [bound]}

    for of in ([], ["arm_1", "post"], ["post", "arm_1.3"], ["arm_1", "arm_2.3"]):
        assert review(load_task("transport", monitored(of))) == []
    for of in (["arm_1.1", "arm_1.2"], ["arm_2", "post"]):
        (fault,) = review(load_task("transport", monitored(of)))
        assert dotted(fault.path) == "monitors[0].of"
        assert fault.message.startswith(f'found "{of[0]}" and "{of[1]}", expected parts that keep clear in "approach"')


def shut(folder: Path, **changes: Any) -> dict[str, tuple[int, ...] | None]:
    """Which thrusters are shut at the targets of the platform before a panel, which has changes."""
    task = before_a_panel(folder, **changes)
    forecasts = forecast_stages(task)
    stages = [forecast.stage for forecast in forecasts]
    return shut_thrusters(task, forecasts[0].model, stages, forecast_configurations(task, forecasts))


def test_thrusters_whose_plumes_reach_an_obstacle_are_shut_at_the_target(tmp_path: Path) -> None:
    """Only those that brake blow at the panel, which is 0.65 m from their nozzles, or 1.65 m; plumes are 1.5 m long."""
    assert shut(tmp_path) == {"fly": tuple(number + 1 for number in AHEAD)}
    farther = [{"name": "panel", "shape": {"box": [0.2, 0.6]}, "pose": [3.2, 0, 0]}]
    assert shut(tmp_path, obstacles=farther) == {"fly": ()}
    drifting = [{**farther[0], "velocity": [-0.01, 0]}]
    assert shut(tmp_path, obstacles=drifting) == {"fly": None}
    assert shut(tmp_path, plumes="ignored") == {}


def test_obstacles_without_clearance_are_remarked_unless_plumes_keep_off_them(tmp_path: Path) -> None:
    def said(plumes: str) -> list[str]:
        task = before_a_panel(tmp_path, plumes=plumes)
        return [remark.message for remark in remarks(task, forecast_stages(task)) if remark.path == ("obstacles",)]

    assert said("avoided") == []
    (remark,) = said("ignored")
    assert "nothing keeps clear of obstacles" in remark
