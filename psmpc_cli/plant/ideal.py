"""The ideal plant: the double integrator (8), as the controller believes; forces from inverse dynamics."""

from itertools import accumulate

import numpy as np

from psmpc_cli.native.functions import RowFunction
from psmpc_cli.plant.base import Disturbance, Ticks
from psmpc_cli.robot.kinematics import moved
from psmpc_cli.robot.model import RobotModel


class IdealPlant:
    """Advances Q and v exactly under constant accelerations; nothing disturbs it."""

    def __init__(self, model: RobotModel, tick: float) -> None:
        self.model = model
        self.tick = tick
        self._force = RowFunction(model.dynamics.inverse)

    def advance(
        self,
        start: float,
        x: np.ndarray,
        u: np.ndarray,
        disturbance: Disturbance | None = None,
        closed: np.ndarray | None = None,
    ) -> Ticks:
        """Advance over len(u) ticks. External impulse and work are those of the exact motion."""
        nq = self.model.nq
        model = self.model
        tick = self.tick
        v = np.vstack([x[nq:], x[nq:] + tick * np.cumsum(u, axis=0)])
        steps = tick * v[:-1] + tick**2 / 2 * u  # paper eq. (8)
        if model.dimension == 3:
            steps[:, 3:6] += turn_defect(v[:-1, 3:6], v[1:, 3:6], tick)
        X = np.hstack([np.array(list(accumulate(steps.tolist(), moved, initial=x[:nq].tolist()))), v])
        (F,) = self._force(X[:-1, :nq], v[:-1], u, model.nominal.vector, rows=len(u))
        first, last = model.balance(X[[0, -1], :nq], X[[0, -1], nq:])
        return Ticks(start + tick * np.arange(len(u) + 1), X, F, last - first)


def turn_defect(before: np.ndarray, after: np.ndarray, step: float) -> np.ndarray:
    """Compute by how much the turn over a step [s] differs from the integral of the body's angular velocity (..., 3).

    Angular velocities at different times do not commute; the second term of the Magnus expansion, for one that goes
    from `before` to `after` (..., 3) [rad/s] linearly. What is left is of the order of step^5. Iserles, Norsett: On the
    solution of linear differential equations in Lie groups (1999).
    """
    return np.asarray(step**2 / 12 * np.cross(before, after))
