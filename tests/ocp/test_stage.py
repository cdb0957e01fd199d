import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from psmpc_cli.ocp.problem import build_problem, build_stages
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_task

from .. import free_flyer

TRACKING = load_task("tracking")


@pytest.fixture(scope="module")
def trace(model: RobotModel) -> Stage:
    """The stage of the tracking task that follows a trajectory."""
    return build_stages(TRACKING.spec, TRACKING.robot, model)[1]


def turning(model: RobotModel, degrees: list[float], *changes: str) -> Stage:
    """A stage whose base turns through some angles [deg]."""
    rows = ", ".join(f"[0, 0, {angle} deg]" for angle in degrees)
    still = ", ".join("[0, 0, 0]" for _ in degrees)
    target = f"{{times: {list(range(len(degrees)))}, base: [{rows}], arms: [{still}]}}"
    task = load_task("transport", [f"stages.approach.target={target}", *changes])
    return build_stages(task.spec, task.robot, model)[0]


def test_reference_is_linear_between_the_times_and_held_after_the_last(trace: Stage) -> None:
    assert trace.trajectory is not None
    times, values = trace.trajectory.times, trace.trajectory.values
    np.testing.assert_allclose(trace.reference(times), values)
    np.testing.assert_allclose(trace.reference((times[:-1] + times[1:]) / 2), (values[:-1] + values[1:]) / 2)
    np.testing.assert_allclose(trace.reference(times[-1] + np.array([0.0, 1.0, 50.0])), np.tile(values[-1], (3, 1)))
    np.testing.assert_allclose(trace.reference(np.array([-3.0])), values[:1])


@given(since=st.floats(-1, 20))
def test_rate_is_the_slope_of_the_reference_just_after(trace: Stage, since: float) -> None:
    h = 1e-6
    ahead, now = trace.reference(since + h), trace.reference(since)
    if np.ceil(since) - since > h:
        np.testing.assert_allclose(trace.trajectory.at(since)[1], (ahead - now) / h, atol=1e-6)


@pytest.mark.parametrize("signs", [0b00000, 0b10110])
def test_attitudes_turn_at_a_constant_rate_between_rows(signs: int) -> None:
    """As scipy's Slerp has them, whichever of its two quaternions a row is written with."""
    turns = np.array([[0, 0, 0], [0, 1.8, 2.4], [0, 1.8, 2.4], [0.3, 0, 0], [0, 0, -1.5]])
    rows, times, since = Rotation.from_rotvec(turns), np.array([0.0, 2, 3, 4, 7]), np.linspace(-1, 9, 123)
    written = [
        {"position": [k, 0, 0], "attitude": {"quaternion": ((-1) ** (signs >> k) * q[[3, 0, 1, 2]]).tolist()}}
        for k, q in enumerate(rows.as_quat())
    ]
    target = {"times": times.tolist(), "base": written, "arm": [[0, 0, 0]] * 5}
    (stage, _) = build_problem(free_flyer.turning(0, f"stages.fly.target={json.dumps(target)}")).stages
    values, inside, h = stage.reference(since), np.clip(since, 0, 7), 1e-6
    wanted = Slerp(times, rows)(inside)
    assert (wanted.inv() * Rotation.from_quat(values[:, [4, 5, 6, 3]])).magnitude().max() < 1e-7
    np.testing.assert_allclose(values[:, 0], np.interp(inside, times, np.arange(5)))
    np.testing.assert_allclose(stage.trajectory.at(since)[1], (stage.reference(since + h) - values) / h, atol=1e-5)


@pytest.mark.parametrize(("dwell", "least"), [(0, 16), (3, 16), (20, 20)])
def test_stage_lasts_as_long_as_its_trajectory(dwell: float, least: float, model: RobotModel) -> None:
    task = load_task("tracking", [f"stages.trace.dwell={dwell}"])
    assert build_stages(task.spec, task.robot, model)[1].end.dwell == least


@pytest.mark.parametrize(
    ("given_angles", "meant"),
    [
        ([170, -170, -100], [170, 190, 260]),
        ([350, 340, 10], [-10, -20, 10]),
        ([0, 120, 240, 360], [0, 120, 240, 360]),
        ([0, 120, 240, 0, 120], [0, 120, 240, 360, 480]),
    ],
)
def test_every_row_of_angles_is_nearest_to_the_row_before(
    given_angles: list[float], meant: list[float], model: RobotModel
) -> None:
    nearest = turning(model, given_angles)
    np.testing.assert_allclose(np.degrees(nearest.waypoints[:, 2]), meant, atol=1e-9)
    np.testing.assert_array_equal(nearest.target, nearest.waypoints[-1])
    exact = turning(model, given_angles, "stages.approach.angles=exact")
    np.testing.assert_allclose(np.degrees(exact.waypoints[:, 2]), given_angles, atol=1e-9)


def test_the_stage_after_a_trajectory_counts_angles_from_its_last_row(model: RobotModel) -> None:
    rows = "base: [[0, 0, 0], [0, 0, 120 deg], [0, 0, 240 deg]], arms: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]"
    task = load_task("transport", [f"stages.approach.target={{times: [0, 1, 2], {rows}}}"])
    after = build_stages(task.spec, task.robot, model)[1]
    assert np.degrees(after.target[2]) == pytest.approx(390)  # 30 deg, from 240
