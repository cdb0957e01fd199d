"""Laws of configuration spaces: the same for the plane and for space."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from psmpc_cli.robot.configuration import PLANE, SPACE, ConfigurationSpace, PlanarSpace, SpatialSpace, pose_frames

Array = NDArray[np.float64]

JOINTS = 2
SPACES = [PlanarSpace(JOINTS), SpatialSpace(JOINTS)]
in_both = pytest.mark.parametrize("space", SPACES, ids=["plane", "space"])
free_bodies = pytest.mark.parametrize("space", [PLANE, SPACE], ids=["plane", "space"])


def some_Q(space: ConfigurationSpace, random: np.random.Generator) -> Array:
    return space.normalized(random.standard_normal(space.nq))


@in_both
@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_difference_is_the_inverse_of_integrate(space: ConfigurationSpace, seed: int) -> None:
    random = np.random.default_rng(seed)
    Q = some_Q(space, random)
    step = 0.8 * random.uniform(-1, 1, space.n)
    after = np.array(space.integrate(Q, step))
    np.testing.assert_allclose(space.difference(Q, after), step, atol=1e-12)
    np.testing.assert_allclose(space.normalized(after), after, atol=1e-12)


@in_both
def test_neutral_has_the_frame_of_the_inertial_one(space: ConfigurationSpace) -> None:
    assert space.neutral.shape == (space.nq,)
    np.testing.assert_allclose(pose_frames(space.neutral[space.base_coordinates]), np.eye(4))


@in_both
def test_rate_is_the_derivative_of_integrate(space: ConfigurationSpace) -> None:
    random = np.random.default_rng(1)
    Q = some_Q(space, random)
    v = random.standard_normal(space.n)
    h = 1e-6
    by_difference = (np.array(space.integrate(Q, h * v)) - space.integrate(Q, -h * v)) / (2 * h)
    np.testing.assert_allclose(space.rate(Q, v), by_difference, atol=1e-9)


@in_both
def test_a_path_takes_step_after_step(space: ConfigurationSpace) -> None:
    random = np.random.default_rng(2)
    Q = some_Q(space, random)
    steps = 0.1 * random.standard_normal((4, space.n))
    expected = [Q]
    for step in steps:
        expected.append(np.array(space.integrate(expected[-1], step)))
    np.testing.assert_allclose(space.path(Q, steps), expected, atol=1e-13)


@in_both
def test_the_wrench_of_a_held_force_changes_at_its_rate(space: ConfigurationSpace) -> None:
    random = np.random.default_rng(3)
    Q = some_Q(space, random)
    v = random.standard_normal(space.n)
    F = random.standard_normal(space.n)
    h = 1e-6
    ahead, behind = (np.array(space.external_wrench(space.integrate(Q, sign * h * v), F)) for sign in (1, -1))
    np.testing.assert_allclose(space.external_wrench_rate(Q, v, F), (ahead - behind) / (2 * h), atol=1e-8)


@in_both
def test_accelerations_in_the_chart_are_those_of_its_coordinates(space: ConfigurationSpace) -> None:
    random = np.random.default_rng(4)
    anchor = some_Q(space, random)
    chart = space.chart_at(anchor)
    x = np.concatenate([chart.to_chart(anchor[None], np.zeros((1, space.n)))[0], np.zeros(0)])
    x += 0.5 * random.standard_normal(len(x))
    u = random.standard_normal(space.n)
    h = 1e-5
    X = [np.concatenate([x[: space.n] + t * x[space.n :] + t**2 / 2 * u, x[space.n :] + t * u]) for t in (-h, 0, h)]
    Q, v = chart.from_chart(np.array(X))
    found = space.acceleration_at(*(ca.SX(each) for each in (Q[1], v[1], u, chart.anchor)))
    np.testing.assert_allclose(np.asarray(ca.DM(found)).ravel(), (v[2] - v[0]) / (2 * h), atol=1e-8)


@in_both
def test_accelerations_lead_into_the_chart_and_back(space: ConfigurationSpace) -> None:
    random = np.random.default_rng(7)
    Q, Qdot, u = (ca.SX(each) for each in random.uniform(-1.5, 1.5, (3, space.n)))  # turned by up to 150 deg
    vdot = space.charted_acceleration(Q, Qdot, u)
    found = ca.DM(space.acceleration_in_chart(Q, Qdot, vdot))
    np.testing.assert_allclose(np.asarray(found), np.asarray(ca.DM(u)), atol=1e-12)


@free_bodies
@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_relative_is_the_inverse_of_composed(space: ConfigurationSpace, seed: int) -> None:
    random = np.random.default_rng(seed)
    pose, inside = some_Q(space, random), some_Q(space, random)
    again = space.relative(space.composed(pose, inside), pose)
    np.testing.assert_allclose(again, inside, atol=1e-12)
    np.testing.assert_allclose(pose_frames(pose) @ pose_frames(inside), pose_frames(space.composed(pose, inside)))


@free_bodies
def test_lifted_poses_and_twists_come_back(space: ConfigurationSpace) -> None:
    random = np.random.default_rng(5)
    pose = some_Q(space, random)
    position, quaternion = space.to_3d(pose)
    np.testing.assert_allclose(space.from_3d(np.array(position), np.array(quaternion)), pose, atol=1e-12)
    twist = random.standard_normal(space.n_twist)
    assert space.twist(*space.twist_to_3d(twist)) == twist.tolist()


@given(angle=st.floats(-100, 100), wanted=st.floats(-100, 100))
def test_the_error_of_an_angle_is_within_half_a_turn(angle: float, wanted: float) -> None:
    error = PLANE.pose_error([0.0, 0.0, angle], [0.0, 0.0, wanted])[2]
    turns = (angle - wanted - error) / (2 * np.pi)
    assert abs(turns - round(turns)) < 1e-9
    assert abs(error) <= np.pi + 1e-9


def test_the_velocity_of_a_carried_pose_is_the_derivative_of_its_composition() -> None:
    random = np.random.default_rng(6)
    pose, inside = some_Q(SPACE, random), some_Q(SPACE, random)
    v = random.standard_normal(6)
    h = 1e-6
    ahead, behind = (SPACE.composed(SPACE.integrate(pose, sign * h * v), inside) for sign in (1, -1))
    rate = np.array(SPACE.difference(behind, ahead)) / (2 * h)
    np.testing.assert_allclose(SPACE.carried_rate(pose, v, inside), rate, atol=1e-8)
