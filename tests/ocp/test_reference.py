import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from psmpc_cli.ocp.problem import build_problem, build_stages
from psmpc_cli.ocp.reference import Constant, Trajectory
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_task

from .. import free_flyer

TRACKING = load_task("tracking")


@pytest.fixture(scope="module")
def trace(model: RobotModel) -> Stage:
    """The stage of the tracking task that follows a trajectory."""
    return build_stages(TRACKING.spec, TRACKING.robot, model)[1]


def test_reference_is_linear_between_the_times_and_held_after_the_last(trace: Stage) -> None:
    assert isinstance(trace.reference, Trajectory)
    times, values = trace.reference.times, trace.reference.values
    np.testing.assert_allclose(trace.wanted(times), values)
    np.testing.assert_allclose(trace.wanted((times[:-1] + times[1:]) / 2), (values[:-1] + values[1:]) / 2)
    np.testing.assert_allclose(trace.wanted(times[-1] + np.array([0.0, 1.0, 50.0])), np.tile(values[-1], (3, 1)))
    np.testing.assert_allclose(trace.wanted(np.array([-3.0])), values[:1])


@given(since=st.floats(-1, 20))
def test_rate_is_the_slope_of_the_reference_just_after(trace: Stage, since: float) -> None:
    h = 1e-6
    ahead, now = trace.wanted(since + h), trace.wanted(since)
    if np.ceil(since) - since > h:
        np.testing.assert_allclose(trace.reference.at(since)[1], (ahead - now) / h, atol=1e-6)


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
    values, inside, h = stage.wanted(since), np.clip(since, 0, 7), 1e-6
    wanted = Slerp(times, rows)(inside)
    assert (wanted.inv() * Rotation.from_quat(values[:, [4, 5, 6, 3]])).magnitude().max() < 1e-7
    np.testing.assert_allclose(values[:, 0], np.interp(inside, times, np.arange(5)))
    np.testing.assert_allclose(stage.reference.at(since)[1], (stage.wanted(since + h) - values) / h, atol=1e-5)


def test_a_target_at_rest_is_the_same_at_all_times() -> None:
    numbers = np.array([1.0, 2.0])
    still = Constant(numbers)
    values, rates = still.at(np.linspace(0.0, 3.0, 5))
    np.testing.assert_array_equal(values, numbers)
    np.testing.assert_array_equal(rates, [0.0, 0.0])
    assert not still.moves
    np.testing.assert_array_equal(still.mapped(lambda row: 2 * row).points, [[2.0, 4.0]])


def test_a_waypoint_is_followed_in_place_of_the_target_and_ends_nothing(trace: Stage) -> None:
    placed = trace.unplaced_copy()
    on_way = placed.with_waypoint(placed.target + 1.0)
    np.testing.assert_array_equal(on_way.target_at_rest, placed.target + 1.0)
    np.testing.assert_array_equal(on_way.target, placed.target)
    assert not on_way.end.is_planned
    off_it = placed.with_waypoint(None)
    assert off_it.reference is placed.reference
    assert np.isnan(off_it.waypoint).all()
