"""The chart of attitude: what it maps to and fro, and what it does in the plane."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.configuration import AttitudeChart, PlanarSpace, SpatialSpace

Array = NDArray[np.float64]


def quaternion(turn: Array) -> Array:
    """w, x, y, z of a rotation vector."""
    return np.asarray(Rotation.from_rotvec(turn).as_quat())[[3, 0, 1, 2]]


def states(count: int, largest: float, seed: int = 0) -> tuple[Array, Array]:
    """Coordinates (K, 9) and velocities (K, 8) of a robot with two joints; turns up to `largest` [rad]."""
    random = np.random.default_rng(seed)
    axis = random.standard_normal((count, 3))
    turn = largest * random.uniform(0, 1, (count, 1)) * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    Q = random.standard_normal((count, 9))
    Q[:, 3:7] = np.array([quaternion(each) for each in turn])
    return Q, random.standard_normal((count, 8))


@pytest.mark.parametrize("largest", [1e-9, 1e-3, 1.0, 3.1])
def test_entering_and_leaving_are_inverses(largest: float) -> None:
    Q, v = states(20, largest)
    chart = AttitudeChart(np.array([1.0, 0, 0, 0]))
    again, rates = chart.from_chart(chart.to_chart(Q, v))
    signs = np.sign((again[:, 3:7] * Q[:, 3:7]).sum(axis=1))
    again[:, 3:7] *= signs[:, None]
    np.testing.assert_allclose(again, Q, atol=1e-12)
    np.testing.assert_allclose(rates, v, atol=1e-10)


def test_the_measured_state_is_at_the_chart_s_origin() -> None:
    """phi is 0 and its rate the body's angular velocity."""
    Q, v = states(1, 3.0)
    x = SpatialSpace(2).chart_at(Q[0]).to_chart(Q, v)[0]
    np.testing.assert_allclose(x, [*Q[0, :3], 0, 0, 0, *Q[0, 7:], *v[0]], atol=1e-12)


def test_a_motion_in_one_chart_is_the_same_in_another() -> None:
    """Attitude and angular velocity do not depend on the chart."""
    Q, v = states(10, 1.0)
    one, other = (AttitudeChart(quaternion(np.array(turn))) for turn in ([0.3, -0.2, 0.5], [-0.4, 0.1, 0.2]))
    X = one.to_chart(Q, v)
    np.testing.assert_allclose(one.moved(X, other), other.to_chart(Q, v), atol=1e-12)


def test_rates_in_the_chart_are_derivatives_of_its_coordinates() -> None:
    Q, v = states(1, 2.0)
    chart = AttitudeChart(quaternion(np.array([0.2, 0.1, -0.3])))
    step = 1e-6
    ahead, behind = (turned(Q, sign * step * v[:, 3:6]) for sign in (1, -1))
    rate = (chart.to_chart(ahead, v) - chart.to_chart(behind, v))[0, 3:6] / (2 * step)
    np.testing.assert_allclose(chart.to_chart(Q, v)[0, 11:14], rate, atol=1e-8)


def turned(Q: Array, by: Array) -> Array:
    """Coordinates after a turn by a rotation vector (1, 3) in the body's frame."""
    after = Rotation.from_quat(Q[0, [4, 5, 6, 3]]) * Rotation.from_rotvec(by[0])
    return np.hstack([Q[:, :3], after.as_quat()[[3, 0, 1, 2]][None], Q[:, 7:]])


def test_the_shift_of_the_rates_is_what_the_chart_adds_to_the_angular_velocity() -> None:
    Q, v = states(5, 1.5)
    chart = AttitudeChart(np.array([1.0, 0, 0, 0]))
    X = chart.to_chart(Q, v)
    shift = chart.rate_shift(X)
    np.testing.assert_allclose(X[:, 8:] - shift, v, atol=1e-12)
    assert np.abs(shift[:, 3:6]).max() > 0.1
    assert not np.delete(shift, [3, 4, 5], axis=1).any()


def test_a_planar_robot_s_chart_changes_nothing() -> None:
    Q, v = np.arange(6.0).reshape(2, 3), np.ones((2, 3))
    chart = PlanarSpace().chart_at(Q[0])
    X = chart.to_chart(Q, v)
    np.testing.assert_array_equal(X, np.hstack([Q, v]))
    np.testing.assert_array_equal(chart.moved(X, chart), X)
    assert not chart.rate_shift(X).any()
