"""What a skill kind is: an error against a target and its rate of change. A new kind is one more file here."""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from psmpc_cli.robot.model import RobotModel


@dataclass(frozen=True)
class Skill:
    """One kind of skill.

    Attributes:
        space: Its name in a task file (`space:`).
        rows: Number of rows of the error for a robot.
        error: Error against a target (rows,) at Q (n,); units of the coordinates.
        rate: Time derivative of the error (rows,) for a constant target at (Q, Qdot).
    """

    space: str
    rows: Callable[[RobotModel], int]
    error: Callable[[RobotModel, ca.SX, ca.SX], ca.SX]
    rate: Callable[[RobotModel, ca.SX, ca.SX], ca.SX]


def quadratic_cost(error: ca.SX, u: ca.SX, weights: ca.SX, control_weights: ca.SX) -> ca.SX:
    """Return Lbar = |e|^2_W + |u|^2_Wr, a scalar. Paper eq. (10)."""
    return ca.dot(weights * error, error) + ca.dot(control_weights * u, u)
