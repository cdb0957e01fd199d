"""Poses, their Jacobians and points, for any robot."""

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given

from psmpc_cli.robot.model import RobotModel, arm_points

from .differences import assert_close_to_differences, jacobian_by_differences
from .strategies import State, flat, laws, moving_robots


def test_poses_at_zero_are_the_release_targets(model: RobotModel) -> None:
    xi = flat(model.g(np.zeros(9)))
    np.testing.assert_allclose(xi, [0, 0, 0, 1.5, 0, 0, -1.5, 0, 0], atol=1e-12)


def test_poses_at_the_grasp_are_the_capture_targets(model: RobotModel) -> None:
    pi = math.pi
    xi = flat(model.g([-2, 2, pi / 6, pi / 4, pi / 6, pi / 3, -pi / 4, -pi / 6, -pi / 3]))
    np.testing.assert_allclose(xi[model.poses["base"]], [-2, 2, pi / 6], atol=1e-12)
    np.testing.assert_allclose(xi[model.poses["arm_1"]], [-1.9334, 3.1677, math.radians(165)], atol=1e-4)
    np.testing.assert_allclose(xi[model.poses["arm_2"]], [-3.0446, 2.5261, math.radians(-105)], atol=1e-4)


def test_rows_follow_base_and_arms_in_order(model: RobotModel) -> None:
    rows = {"base": slice(0, 3), "arm_1": slice(3, 6), "arm_2": slice(6, 9)}
    assert (model.parts, model.poses) == (rows, rows)
    assert (model.n, model.m, model.bodies) == (9, 9, 7)


@given(moving_robots())
@laws
def test_jacobian_is_the_derivative_of_the_poses(state: State) -> None:
    model, Q, _, _ = state
    J_C = model.J_C(Q).full()
    assert_close_to_differences(J_C, jacobian_by_differences(lambda q: flat(model.g(q)), Q))
    np.testing.assert_array_equal(np.hstack([model.J_B(Q).full(), model.J_M(Q).full()]), J_C)


@given(moving_robots())
@laws
def test_pose_acceleration_without_control_is_the_derivative_of_the_pose_rate(
    state: State,
) -> None:
    model, Q, Qdot, _ = state
    by_differences = jacobian_by_differences(lambda q: np.asarray(model.J_C(q).full() @ Qdot), Q) @ Qdot
    assert_close_to_differences(flat(model.Jdot_Qdot(Q, Qdot)), by_differences)


@given(moving_robots())
@laws
def test_points_run_from_shoulder_to_tip_a_link_apart(state: State) -> None:
    model, Q, _, _ = state
    xi = flat(model.g(Q))
    c, s = np.cos(Q[2]), np.sin(Q[2])
    for name, points in arm_points(model, Q).items():
        arm = model.spec.arms[name]
        shoulder = Q[:2] + np.array([[c, -s], [s, c]]) @ arm.mount.position
        np.testing.assert_allclose(points[0], shoulder, atol=1e-12)
        np.testing.assert_allclose(points[-1], xi[model.poses[name]][:2], atol=1e-12)
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        np.testing.assert_allclose(lengths, [link.a + link.b for link in arm.links], atol=1e-12)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_functions_take_both_kinds_of_symbols(model: RobotModel, kind: type[Any]) -> None:
    Q, q = np.linspace(-1, 1, 9), kind.sym("q", 9)
    np.testing.assert_allclose(ca.Function("xi", [q], [model.g(q)])(Q).full(), model.g(Q).full(), atol=1e-15)
