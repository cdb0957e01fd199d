"""Laws of rotations, on numbers and as expressions."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.rotations import (
    body_rate,
    chart_rate,
    conjugate,
    exp,
    log,
    matrix,
    product,
    rotate,
    shorter,
    turn,
    turn_matrix,
)

NUMBER = st.floats(-1.5, 1.5)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)
"""Rotation vectors of at most 1.5 sqrt(3) = 2.6 rad, less than half a turn."""


def in_scipy(q: list[float]) -> Rotation:
    """The rotation of a quaternion (w, x, y, z)."""
    return Rotation.from_quat(np.array(q, float)[[1, 2, 3, 0]])


@given(VECTOR)
def test_the_logarithm_is_the_inverse_of_the_exponential(phi: tuple[float, ...]) -> None:
    q = exp(phi)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-12)
    assert log(q) == pytest.approx(phi, abs=1e-12)
    assert (in_scipy(q) * Rotation.from_rotvec(phi).inv()).magnitude() < 1e-12


@given(VECTOR)
def test_expressions_are_the_numbers(phi: tuple[float, ...]) -> None:
    symbols = ca.SX.sym("phi", 3)
    quaternion = exp(ca.vertsplit(symbols))
    function = ca.Function("f", [symbols], [ca.vertcat(*quaternion), ca.vertcat(*log(quaternion))])
    q, back = (np.asarray(each).ravel() for each in function(phi))
    assert q == pytest.approx(exp(phi), abs=1e-14)
    assert back == pytest.approx(phi, abs=1e-12)


@given(VECTOR, VECTOR, VECTOR)
def test_a_product_turns_by_one_rotation_after_the_other(
    first: tuple[float, ...], second: tuple[float, ...], r: tuple[float, ...]
) -> None:
    a = exp(second)
    b = exp(first)
    assert rotate(product(a, b), r) == pytest.approx(rotate(a, rotate(b, r)), abs=1e-12)
    assert np.array(matrix(a)) @ r == pytest.approx(rotate(a, r), abs=1e-12)
    assert rotate(conjugate(a), rotate(a, r)) == pytest.approx(r, abs=1e-12)


@given(VECTOR, VECTOR)
def test_the_body_s_rate_is_the_derivative_of_the_exponential(phi: tuple[float, ...], rate: tuple[float, ...]) -> None:
    """R(phi + h phidot) is R(phi) Exp(h omega) to first order in h."""
    h = 1e-6
    omega = body_rate(phi, rate)
    after, before = (exp(np.array(phi) + sign * h * np.array(rate)) for sign in (1, -1))
    turned = log(product(conjugate(before), after))
    assert np.array(turned) / (2 * h) == pytest.approx(omega, abs=1e-8)
    assert chart_rate(phi, omega) == pytest.approx(rate, abs=1e-9)


@given(angle=st.floats(-6.0, 6.0))
def test_a_turn_is_its_matrix_and_the_shorter_one_is_the_same_rotation(angle: float) -> None:
    axis = np.array([1.0, -2.0, 2.0]) / 3
    q = turn(axis, angle)
    assert np.array(turn_matrix(list(axis), angle)) == pytest.approx(np.array(matrix(q)), abs=1e-12)
    short = shorter(q)
    assert short[0] >= 0
    assert np.array(matrix(short)) == pytest.approx(np.array(matrix(q)), abs=1e-12)
