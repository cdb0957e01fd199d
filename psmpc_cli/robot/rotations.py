"""Rotations: unit quaternions (w, x, y, z) and rotation vectors, on numbers, arrays and CasADi expressions alike.

A vector is a list of its components; a component is a number, an array (the same operation at many places at once) or
an expression. The chart of attitude about an anchor A is R = A Exp(phi), with the body's angular velocity
omega = J_r(phi) phidot. Sola, Deray, Atchuthan: A micro Lie theory (2018), section on S^3 and SO(3).
"""

import math
from collections.abc import Sequence
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

Vector = Sequence[Any]

TERMS = 13
"""Terms of the series below in |phi|^2: exact to 1e-13 up to |phi| = pi, without a branch and smooth everywhere."""


def times(x: Any, y: Any) -> Any:
    """Compute x y of two components.

    `times`, `plus` and `minus` build the same expressions as the operators of CasADi, which try arrays of numbers first
    and take ten times as long: the equations of motion of a robot in space have thousands of operations.
    """
    return SX.binary(ca.OP_MUL, x, y) if type(x) is SX or type(y) is SX else x * y


def plus(x: Any, y: Any) -> Any:
    """Compute x + y of two components, see `times`."""
    return SX.binary(ca.OP_ADD, x, y) if type(x) is SX or type(y) is SX else x + y


def minus(x: Any, y: Any) -> Any:
    """Compute x - y of two components, see `times`."""
    return SX.binary(ca.OP_SUB, x, y) if type(x) is SX or type(y) is SX else x - y


def dot(a: Vector, b: Vector) -> Any:
    """Compute the inner product."""
    return reduce(plus, (times(x, y) for x, y in zip(a, b, strict=True)))


def cross(a: Vector, b: Vector) -> list[Any]:
    """Compute the cross product of vectors (3,)."""
    return [minus(times(a[i], b[j]), times(a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1))]


def add(a: Vector, *more: Vector) -> list[Any]:
    """Compute the sum of vectors."""
    return [reduce(plus, components) for components in zip(a, *more, strict=True)]


def scaled(a: Vector, factor: Any) -> list[Any]:
    """Compute factor times a."""
    return [times(factor, x) for x in a]


def conjugate(q: Vector) -> list[Any]:
    """Compute the inverse of a unit quaternion."""
    return [q[0], -q[1], -q[2], -q[3]]


def product(a: Vector, b: Vector) -> list[Any]:
    """Compute the quaternion of the rotation b followed by a."""
    v = cross(a[1:], b[1:])
    real = minus(times(a[0], b[0]), dot(a[1:], b[1:]))
    return [real, *add(scaled(b[1:], a[0]), scaled(a[1:], b[0]), v)]


def rotate(q: Vector, r: Vector) -> list[Any]:
    """Compute R(q) r of a vector r (3,)."""
    t = scaled(cross(q[1:], r), 2)
    return add(r, scaled(t, q[0]), cross(q[1:], t))


def matrix(q: Vector) -> list[list[Any]]:
    """Compute the rows of the rotation matrix R(q), 3 by 3, of a unit quaternion."""
    w, x, y, z = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def matrix_vector(A: Sequence[Vector], b: Vector) -> list[Any]:
    """Compute A b of a matrix row by row."""
    return [dot(row, b) for row in A]


def matrix_product(A: Sequence[Vector], B: Sequence[Vector]) -> list[list[Any]]:
    """Compute A B of matrices row by row."""
    return transposed([matrix_vector(A, column) for column in transposed(B)])


def transposed(A: Sequence[Vector]) -> list[list[Any]]:
    """Return the transpose of a matrix row by row."""
    return [list(column) for column in zip(*A, strict=True)]


def turn(axis: Vector, angle: Any) -> list[Any]:
    """Compute the quaternion of a turn by `angle` [rad] about a unit vector (3,)."""
    library = _library(angle)
    return [library.cos(angle / 2), *scaled(axis, library.sin(angle / 2))]


def turn_matrix(axis: Sequence[float], angle: Any) -> list[list[Any]]:
    """Compute the rows of the matrix of a turn by `angle` [rad] about a unit vector of numbers (3,)."""
    library = _library(angle)
    x, y, z = axis
    c = library.cos(angle)
    s = library.sin(angle)
    skew = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))

    def entry(i: int, j: int) -> Any:
        return plus(plus(times(1 - c, axis[i] * axis[j]), times(s, skew[i][j])), times(c, float(i == j)))

    return [[entry(i, j) for j in range(3)] for i in range(3)]


def exp(phi: Vector) -> list[Any]:
    """Compute the unit quaternion of a rotation vector (3,) [rad]; smooth everywhere."""
    t = dot(phi, phi) / 4
    return [1 - t * _series(t, 2), *scaled(phi, _series(t, 1) / 2)]


def log(q: Vector) -> list[Any]:
    """Compute the rotation vector (3,) [rad] of a quaternion q = (w, v) of any norm but 0: 2 atan2(|v|, w) v / |v|.

    Its length is less than 2 pi. q and -q are the same rotation, but have different rotation vectors; the caller
    chooses the sign, by `shorter` or as the one nearer to a neighbour, so that an error that passes pi within a horizon
    stays smooth. The function is smooth everywhere except at v = 0, w < 0: a whole turn has no axis. It takes numbers,
    arrays and CasADi expressions.
    """
    w = q[0]
    v = q[1:]
    s2 = dot(v, v)
    if _library(s2) is ca:
        # the branch that is not taken gets harmless numbers, or its derivative would be 0 times infinity
        near = ca.logic_and(s2 < 1e-4 * w * w, w > 0)
        # near |v| = 0, atan(|v| / w) / |v| as a series in z = |v|^2 / w^2: its derivatives are exact where |v| is 0
        z = ca.if_else(near, s2 / ca.if_else(near, w * w, 1.0), 0.0)
        small = (1 - z * (1 / 3 - z * (1 / 5 - z * (1 / 7 - z / 9)))) / ca.if_else(near, w, 1.0)
        s = ca.sqrt(ca.if_else(near, 1.0, s2))
        return scaled(v, 2 * ca.if_else(near, small, ca.atan2(s, w) / s))
    s = np.sqrt(s2)
    # values need no derivatives: as near as this, atan2(|v|, w) is the quotient to the last digit
    near = s <= 1e-12 * np.abs(w)
    return scaled(v, 2 * np.where(near, 1 / np.where(near, w, 1.0), np.arctan2(s, w) / np.where(near, 1.0, s)))


def shorter(q: Vector) -> list[Any]:
    """Compute the one of q and -q that turns by at most half a turn."""
    choose = ca.if_else if _library(q[0]) is ca else np.where
    return scaled(q, choose(q[0] < 0, -1.0, 1.0))


def body_rate(phi: Vector, rate: Vector) -> list[Any]:
    """Compute the body's angular velocity J_r(phi) phidot (3,) [rad/s]."""
    t = dot(phi, phi)
    a = cross(phi, rate)
    return add(rate, scaled(a, -_series(t, 2)), scaled(cross(phi, a), _series(t, 3)))


def chart_rate(phi: Vector, omega: Vector) -> list[Any]:
    """Compute phidot = J_r(phi)^-1 omega (3,) [rad/s], where |phi| < 2 pi."""
    t = dot(phi, phi)
    a = cross(phi, omega)
    c = (_series(t, 3) - 2 * _series(t, 4)) / (2 * _series(t, 2))  # 1/|phi|^2 - (1 + cos|phi|) / (2 |phi| sin|phi|)
    return add(omega, scaled(a, 0.5), scaled(cross(phi, a), c))


def _library(x: Any) -> Any:
    return ca if isinstance(x, ca.SX | ca.MX) else np


def _series(t: Any, first: int) -> Any:
    """Compute the sum of (-t)^k / (2 k + first)! by Horner's rule.

    At t = a^2 it is sin(a)/a, (1 - cos a)/a^2 and (a - sin a)/a^3 for first = 1, 2 and 3.
    """
    value = 1.0
    for k in range(TERMS, 0, -1):
        value = 1 - t * value / ((2 * k + first - 1) * (2 * k + first))
    return value / math.factorial(first)
