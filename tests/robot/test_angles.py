"""Unwrapped angles and their equivalents."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.robot.model import RobotModel, angle_rows, build_model, nearest_equivalent
from psmpc_cli.specs.robot import RobotSpec

from .strategies import laws, robots

angles = st.floats(-100, 100)


@given(angles, angles)
def test_nearest_equivalent_is_equivalent_and_within_half_a_turn(angle: float, target: float) -> None:
    nearest = float(nearest_equivalent(angle, target))
    turns = (nearest - target) / (2 * math.pi)
    assert abs(turns - round(turns)) < 1e-9
    assert abs(nearest - angle) <= math.pi + 1e-9


def test_nearest_equivalent_works_row_by_row() -> None:
    nearest = nearest_equivalent([0.0, 6.0, -9.0], [0.5, 0.5, 0.5])
    assert nearest.tolist() == [0.5, 0.5 + 2 * math.pi, 0.5 - 4 * math.pi]


def test_angles_are_the_last_row_of_every_planar_pose(model: RobotModel) -> None:
    rows = angle_rows(model)
    assert rows.Q == (2,)
    assert rows.xi == (2, 5, 8)


@given(robots(most=2))
@laws
def test_a_turn_of_the_base_changes_the_angle_rows_alone(spec: RobotSpec) -> None:
    model = build_model(spec)
    rows = angle_rows(model)
    Q = np.zeros(model.n)
    turned = Q.copy()
    turned[list(rows.Q)] = 2 * math.pi
    change = (model.g(turned) - model.g(Q)).full().ravel()
    expected = np.zeros(model.m)
    expected[list(rows.xi)] = 2 * math.pi
    np.testing.assert_allclose(change, expected, atol=1e-12)
