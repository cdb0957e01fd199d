"""The ideal plant: the double integrator (8), as the controller believes; forces from inverse dynamics."""

import numpy as np

from psmpc_cli.plant.base import Ticks
from psmpc_cli.robot.model import RobotModel


class IdealPlant:
    """Advances Q and Qdot exactly under constant accelerations."""

    def __init__(self, model: RobotModel, tick: float) -> None:
        self.model, self.tick = model, tick

    def advance(self, start: float, x: np.ndarray, u: np.ndarray) -> Ticks:
        """Advance over len(u) ticks. The external impulse and the work are those of the exact motion."""
        n, h, M = self.model.n, self.tick, len(u)
        X = double_integrator(x, u, h)
        Q, Qdot = X[:, :n], X[:, n:]
        F = np.asarray(self.model.low_level(Q[:-1].T, Qdot[:-1].T, u.T)).T
        momentum = np.asarray(self.model.momentum(Q[[0, -1]].T, Qdot[[0, -1]].T)).T
        energy = np.asarray(self.model.kinetic_energy(Q[[0, -1]].T, Qdot[[0, -1]].T)).ravel()
        time = start + h * np.arange(M + 1)
        return Ticks(time, X, F, momentum[1] - momentum[0], float(energy[1] - energy[0]))


def double_integrator(x: np.ndarray, u: np.ndarray, tick: float) -> np.ndarray:
    """Return the states (M + 1, 2n) from x (2n,) on under accelerations u (M, n), each held for a tick [s]. Eq. (8)."""
    n = len(x) // 2
    Qdot = np.vstack([x[n:], x[n:] + tick * np.cumsum(u, axis=0)])
    Q = np.vstack([x[:n], x[:n] + np.cumsum(tick * Qdot[:-1] + tick**2 / 2 * u, axis=0)])
    return np.hstack([Q, Qdot])
