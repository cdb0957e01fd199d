"""Where the robot is at the targets of stages: joints that take poses, poses of joints, and the load there."""

import numpy as np
import pytest

from psmpc_cli.ocp.feasibility.checks import load_task
from psmpc_cli.ocp.feasibility.forecast import forecast_stages
from psmpc_cli.ocp.feasibility.postures import arm_postures, configurations_at_stops, largest_load_ratio
from psmpc_cli.robot.model import RobotModel


@pytest.mark.parametrize("name", ["transport", "catch_tumbling"])
def test_joints_and_pose_of_every_arm_belong_together(name: str) -> None:
    task = load_task(name)
    model = RobotModel(task.robot)
    forecasts = forecast_stages(task)
    stages = [forecast.stage for forecast in forecasts]
    stops = configurations_at_stops(task, model, stages, [forecast.reaches for forecast in forecasts])
    found = list(arm_postures(model, stages, stops))
    assert [(each.stage, each.arm) for each in found] == [
        (stage.name, arm) for stage in stages for arm in model.spec.arms
    ]
    for stage, Q in zip(stages, stops[1:], strict=True):
        for each in (each for each in found if each.stage == stage.name):
            there = Q.copy()
            assert each.joints is not None
            there[model.nq - model.n :][model.parts[each.arm]] = each.joints
            pose = model.poses(there)[1 + list(model.spec.arms).index(each.arm)]
            assert np.abs(model.space.pose_error(pose, each.pose)).max() < 2e-3


def test_an_arm_that_cannot_reach_has_no_joints() -> None:
    task = load_task("transport", ["stages.release.target.arm_1=[1.2, 0, 180 deg]"], feasibility=False)
    model = RobotModel(task.robot)
    stages = [forecast.stage for forecast in forecast_stages(task)]
    *_, first, second = arm_postures(model, stages, configurations_at_stops(task, model, stages))
    assert first.joints is None
    assert second.joints is not None
    np.testing.assert_allclose(first.pose[:2], [1.2, 0])


@pytest.mark.parametrize("elbow", [40, -40])
def test_an_arm_takes_a_pose_on_the_branch_on_which_it_was(elbow: float) -> None:
    """Where the stage before bends the elbow the other way, the posture at the grasp is another one."""
    changes = {"stages.approach.target.arm_1": ["0 deg", f"{elbow} deg", "0 deg"]}
    task = load_task("transport", changes)
    model = RobotModel(task.robot)
    stages = [forecast.stage for forecast in forecast_stages(task)]
    stops = configurations_at_stops(task, model, stages)
    taken = stops[2][model.nq - model.n :][model.parts["arm_1"]]
    assert np.sign(taken[1]) == np.sign(elbow)
    poses = dict(zip(model.pose_rows, model.poses(stops[2]), strict=True))
    assert np.abs(model.space.pose_error(poses["arm_1"], stages[1].target[model.pose_rows["arm_1"]])).max() < 2e-3


@pytest.mark.parametrize("mass", [5, 20])
def test_the_ratio_of_a_load_is_proportional_to_it(mass: float) -> None:
    """20 kg have 2.308 times the inertia of the robot where they are the largest load: docs/grasp_model.md."""
    changes = [f"object.mass={mass}", f"object.inertia={2.67 * mass / 20}"]
    task = load_task("transport_grasp", changes)
    model = RobotModel(task.robot)
    stages = [forecast.stage for forecast in forecast_stages(task)]
    found = largest_load_ratio(task, model, configurations_at_stops(task, model, stages))
    assert found is not None
    assert found.ratio == pytest.approx(2.308 * mass / 20, rel=1e-3)
    assert found.stage == "transport"
    no_body = load_task("transport")
    assert largest_load_ratio(no_body, model, []) is None
