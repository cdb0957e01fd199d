"""Poses, their Jacobians, points and angles, for any robot."""

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given

from psmpc_cli.errors import SpecError
from psmpc_cli.ocp.skills import skill_in
from psmpc_cli.robot.model import RobotModel, load_robot

from .strategies import State, assert_close_to_differences, flat, jacobian_by_differences, laws, moving_robots


def test_a_robot_is_loaded_by_name() -> None:
    robot = load_robot("planar_dual_arm")
    assert robot.n == len(robot.names) == 9
    assert robot.names[:4] == ("base.x", "base.y", "base.theta", "arm_1.1")
    np.testing.assert_allclose(robot.poses(np.zeros(9)), [[0, 0, 0], [1.5, 0, 0], [-1.5, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(robot.momentum(np.zeros(9), np.eye(9)[0]), [robot.nominal.mass.sum(), 0, 0], atol=1e-12)


def test_an_unknown_robot_is_an_error_with_the_choices() -> None:
    with pytest.raises(SpecError, match="planar_dual_arm"):
        load_robot("planar_dual_arms")


def test_poses_at_the_grasp_are_the_capture_targets(model: RobotModel) -> None:
    pi = math.pi
    base, left, right = model.poses([-2, 2, pi / 6, pi / 4, pi / 6, pi / 3, -pi / 4, -pi / 6, -pi / 3])
    np.testing.assert_allclose(base, [-2, 2, pi / 6], atol=1e-12)
    np.testing.assert_allclose(left, [-1.9334, 3.1677, math.radians(165)], atol=1e-4)
    np.testing.assert_allclose(right, [-3.0446, 2.5261, math.radians(-105)], atol=1e-4)


@given(moving_robots())
@laws
def test_jacobians_are_derivatives_of_the_poses(state: State) -> None:
    model, Q, v, _ = state
    assert_close_to_differences(model.J_C(Q).full(), jacobian_by_differences(lambda q: model.poses(q).ravel(), Q))
    by_differences = jacobian_by_differences(lambda q: np.asarray(model.J_C(q).full() @ v), Q) @ v
    assert_close_to_differences(flat(model.Jdot_v(Q, v)), by_differences)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_functions_accept_both_kinds_of_symbols(model: RobotModel, kind: type[Any]) -> None:
    Q, q = np.linspace(-1, 1, 9), kind.sym("q", 9)
    np.testing.assert_allclose(ca.Function("xi", [q], [model.g(q)])(Q).full(), model.g(Q).full(), atol=1e-15)


@given(moving_robots(most=2))
@laws
def test_a_turn_of_the_base_changes_the_angle_rows_alone(state: State) -> None:
    model, Q, _, _ = state
    turned, expected = Q.copy(), np.zeros(model.m)
    turned[skill_in("joint").angles(model)] += 2 * math.pi
    expected[skill_in("task").angles(model)] = 2 * math.pi
    np.testing.assert_allclose((model.poses(turned) - model.poses(Q)).ravel(), expected, atol=1e-12)
