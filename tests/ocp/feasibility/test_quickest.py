import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.ocp.feasibility.quickest import Begin, RestToRest, earliest_arrival
from psmpc_cli.robot.model import RobotModel, load_robot

LIMITS = st.floats(0.05, 5.0) | st.just(np.inf)


def motion_of(velocity: float, acceleration: float, n: int = 1) -> RestToRest:
    """How n coordinates move with the same limits of their velocity and acceleration, and none of their place."""
    return RestToRest(np.full(n, velocity), np.full(n, acceleration), np.full(n, -np.inf), np.full(n, np.inf))


@given(velocity=LIMITS, acceleration=LIMITS, distance=st.floats(1e-3, 20.0))
def test_distance_and_time_are_inverse(velocity: float, acceleration: float, distance: float) -> None:
    motion = motion_of(velocity, acceleration)
    (time,) = motion.times(np.array([-distance]))
    if np.isinf(velocity) and np.isinf(acceleration):
        assert time == 0.0
    else:
        assert motion.distances(np.array([time])) == pytest.approx(distance, rel=1e-9)


@given(velocity=LIMITS, acceleration=st.floats(0.05, 5.0), time=st.floats(0.1, 20.0))
def test_slope_is_the_derivative_of_the_distance(velocity: float, acceleration: float, time: float) -> None:
    motion = motion_of(velocity, acceleration)
    step = 1e-6
    (before,), (after,) = (motion.distances(np.array([time + sign * step])) for sign in (-1, 1))
    (slope,) = motion.slopes(np.array([time]))
    assert slope == pytest.approx((after - before) / (2 * step), abs=acceleration * step + 1e-6)


def test_a_coordinate_that_cannot_move_never_arrives() -> None:
    np.testing.assert_array_equal(motion_of(0.0, 1.0, n=2).times(np.array([0.0, 0.1])), [0.0, np.inf])
    np.testing.assert_array_equal(motion_of(0.0, 1.0).distances(np.array([9.0])), [0.0])


def dual_arm(robot: str) -> tuple[RobotModel, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """A robot, coordinates at which it rests, others, and the poses that its arms have at the others."""
    model = load_robot(robot)
    begin = np.zeros(model.nq)
    begin[model.space.base_coordinates] = model.space.neutral[model.space.base_coordinates]
    begin[model.space.joint_coordinates] = np.linspace(0.4, 0.9, model.nq - model.space.n_pose)
    end = begin.copy()
    end[model.space.joint_coordinates] += np.linspace(-0.5, 0.6, model.nq - model.space.n_pose)
    poses = dict(zip(list(model.pose_rows)[1:], model.poses(end)[1:], strict=True))
    return model, begin, end, poses


@pytest.mark.parametrize("robot", ["planar_dual_arm", "dual_arm_servicer"])
def test_a_base_that_may_move_shortens_the_motion_and_the_poses_are_taken(robot: str) -> None:
    model, begin, end, poses = dual_arm(robot)
    motion = motion_of(0.15, 0.5, model.n)
    at_rest = Begin(begin, np.zeros(model.n))
    fixed = np.zeros(model.n, bool)
    alone, _ = earliest_arrival(model, motion, at_rest, end, poses, is_free=fixed)
    assert alone == pytest.approx(0.6 / 0.15 + 0.15 / 0.5)

    together, Q = earliest_arrival(model, motion, at_rest, end, poses, is_free=~fixed)
    assert 0.0 < together < 0.9 * alone
    for arm, pose in poses.items():
        reached = model.poses(Q)[list(model.pose_rows).index(arm)]
        np.testing.assert_allclose(model.space.pose_error(reached, pose), 0.0, atol=2e-3)  # of the last linearization
    moved = np.array(model.space.difference(begin, Q))
    assert (np.abs(moved) <= motion.distances(np.full(model.n, together)) + 1e-9).all()


def test_what_begins_ahead_arrives_earlier() -> None:
    model, begin, end, poses = dual_arm("planar_dual_arm")
    motion = motion_of(0.15, 0.5, model.n)
    fixed = np.zeros(model.n, bool)
    ahead = np.zeros(model.n)
    ahead[model.space.joint_rates] = 3.0
    alone, _ = earliest_arrival(model, motion, Begin(begin, ahead), end, poses, is_free=fixed)
    assert alone == pytest.approx(0.6 / 0.15 + 0.15 / 0.5 - 3.0)
    nothing_left, Q = earliest_arrival(model, motion, Begin(begin, 3 * ahead), end, poses, is_free=~fixed)
    assert nothing_left == 0.0
    np.testing.assert_array_equal(Q, end)


def test_limits_of_places_are_kept() -> None:
    model, begin, end, poses = dual_arm("planar_dual_arm")
    free = motion_of(0.15, 0.5, model.n)
    margin = np.where(np.arange(model.n) < 3, 0.01, 0.7)
    near = RestToRest(free.velocity, free.acceleration, low=begin - margin, high=begin + margin)
    at_rest = Begin(begin, np.zeros(model.n))
    is_free = np.ones(model.n, bool)
    within, Q = earliest_arrival(model, near, at_rest, end, poses, is_free=is_free)
    sooner, elsewhere = earliest_arrival(model, free, at_rest, end, poses, is_free=is_free)
    assert (np.abs(Q - begin) <= margin + 1e-9).all()
    assert (np.abs(elsewhere - begin) > margin + 0.01).any()
    assert sooner < within
