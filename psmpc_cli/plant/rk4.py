"""The full rigid-body dynamics under the computed-torque loop (7): force held over a tick, Runge-Kutta between."""

import casadi as ca
import numpy as np

from psmpc_cli.plant.base import Ticks
from psmpc_cli.robot.model import RobotModel


class Rk4Plant:
    """Integrates state, external impulse and work together, `substeps` steps a tick."""

    def __init__(self, model: RobotModel, tick: float, substeps: int = 1) -> None:
        self.model, self.tick = model, tick
        self._tick = tick_function(model, tick, substeps)
        self._sample: dict[int, ca.Function] = {}

    def advance(self, start: float, x: np.ndarray, u: np.ndarray) -> Ticks:
        """Advance over len(u) ticks."""
        M, n = len(u), self.model.n
        if M not in self._sample:
            self._sample[M] = self._tick.mapaccum(M)
        Z, F = (np.asarray(block) for block in self._sample[M](np.r_[x, np.zeros(4)], u.T))
        X = np.vstack([x, Z[: 2 * n].T])
        time = start + self.tick * np.arange(M + 1)
        return Ticks(time, X, F.T, Z[2 * n : 2 * n + 3, -1], float(Z[2 * n + 3, -1]))


def tick_function(model: RobotModel, tick: float, substeps: int) -> ca.Function:
    """Return one tick z, u -> z_next, F with z = [x; impulse (3,); work]: the law (7) sets F once."""
    n = model.n
    z, u = ca.SX.sym("z", 2 * n + 4), ca.SX.sym("u", n)
    F = model.low_level(z[:n], z[n : 2 * n], u)
    after = held_force(model, tick, substeps)(z, F)
    return ca.Function("tick", [z, u], [after, F], ["z", "u"], ["z_next", "F"]).expand()


def held_force(model: RobotModel, tick: float, substeps: int) -> ca.Function:
    """Return one tick z, F -> z_next under a held generalized force."""
    z, F = ca.SX.sym("z", 2 * model.n + 4), ca.SX.sym("F", model.n)
    flow = ca.Function("flow", [z, F], [_flow(model, z, F)])
    after = z
    for _ in range(substeps):
        after = _runge_kutta(flow, after, F, tick / substeps)
    return ca.Function("held", [z, F], [after], ["z", "F"], ["z_next"]).expand()


def _flow(model: RobotModel, z: ca.SX, F: ca.SX) -> ca.SX:
    """Return the time derivative of z under the generalized force F."""
    n = model.n
    Q, Qdot = z[:n], z[n : 2 * n]
    wrench = ca.vertcat(F[0], F[1], F[2] + Q[0] * F[1] - Q[1] * F[0])
    return ca.vertcat(Qdot, model.forward_dynamics(Q, Qdot, F), wrench, ca.dot(F, Qdot))


def _runge_kutta(flow: ca.Function, z: ca.SX, F: ca.SX, h: float) -> ca.SX:
    """Return z after one classical Runge-Kutta step."""
    k1 = flow(z, F)
    k2 = flow(z + h / 2 * k1, F)
    k3 = flow(z + h / 2 * k2, F)
    k4 = flow(z + h * k3, F)
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
