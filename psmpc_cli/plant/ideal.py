"""The ideal plant: the double integrator (8), as the controller believes; forces from inverse dynamics."""

import numpy as np

from psmpc_cli.plant.base import Disturbance, Ticks
from psmpc_cli.robot.model import RobotModel


class IdealPlant:
    """Advances Q and Qdot exactly under constant accelerations; nothing disturbs it."""

    def __init__(self, model: RobotModel, tick: float) -> None:
        self.model, self.tick = model, tick

    def advance(self, start: float, x: np.ndarray, u: np.ndarray, disturbance: Disturbance | None = None) -> Ticks:
        """Advance over len(u) ticks. External impulse and work are those of the exact motion."""
        n, model, tick = self.model.n, self.model, self.tick
        Qdot = np.vstack([x[n:], x[n:] + tick * np.cumsum(u, axis=0)])
        Q = np.vstack([x[:n], x[:n] + np.cumsum(tick * Qdot[:-1] + tick**2 / 2 * u, axis=0)])  # paper eq. (8)
        X = np.hstack([Q, Qdot])
        motion = X[:-1, :n].T, X[:-1, n:].T, u.T, model.nominal.vector
        F = np.asarray(model.dynamics.inverse(*motion)).T
        first, last = ((state[:n], state[n:]) for state in X[[0, -1]])
        impulse = model.momentum(*last) - model.momentum(*first)
        work = model.kinetic_energy(*last) - model.kinetic_energy(*first)
        return Ticks(start + tick * np.arange(len(u) + 1), X, F, impulse, work)
