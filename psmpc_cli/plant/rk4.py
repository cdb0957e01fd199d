"""The full rigid-body dynamics under the computed-torque loop (7): force held over a tick, Runge-Kutta between."""

import casadi as ca
import numpy as np

from psmpc_cli.native.arrays import ArrayFunction
from psmpc_cli.native.functions import compiled
from psmpc_cli.plant.base import Ticks
from psmpc_cli.robot.model import RobotModel


class Rk4Plant:
    """Integrates state, external impulse and work together, `substeps` steps a tick; `native`, as compiled C."""

    def __init__(self, model: RobotModel, tick: float, substeps: int = 1, native: bool = False) -> None:
        self.model, self.tick = model, tick
        one = tick_function(model, tick, substeps)
        self._tick = compiled(one) if native else one
        self._sample: dict[int, ArrayFunction] = {}

    def advance(self, start: float, x: np.ndarray, u: np.ndarray) -> Ticks:
        """Advance over len(u) ticks."""
        M, n = len(u), self.model.n
        if M not in self._sample:
            self._sample[M] = ArrayFunction(self._tick.mapaccum(M))
        Z, F = self._sample[M](np.r_[x, np.zeros(4)], u)
        X = np.vstack([x, Z[:, : 2 * n]])
        time = start + self.tick * np.arange(M + 1)
        return Ticks(time, X, F, Z[-1, 2 * n : 2 * n + 3], float(Z[-1, 2 * n + 3]))


def tick_function(model: RobotModel, tick: float, substeps: int) -> ca.Function:
    """Return one tick z, u -> z_next, F with z = [x; impulse (3,); work]: the law (7) sets F once."""
    n = model.n
    z, u = ca.MX.sym("z", 2 * n + 4), ca.MX.sym("u", n)
    F = model.low_level(z[:n], z[n : 2 * n], u)
    return ca.Function("tick", [z, u], [held_force(model, tick, substeps)(z, F), F], ["z", "u"], ["z_next", "F"])


def held_force(model: RobotModel, tick: float, substeps: int) -> ca.Function:
    """Return one tick z, F -> z_next under a held generalized force.

    The flow is a function that is called, not written out four times: as C it compiles in a third of the time.
    """
    z, F = ca.SX.sym("z", 2 * model.n + 4), ca.SX.sym("F", model.n)
    flow = ca.Function("flow", [z, F], [_flow(model, z, F)])
    start, held = ca.MX.sym("z", 2 * model.n + 4), ca.MX.sym("F", model.n)
    after = start
    for _ in range(substeps):
        after = runge_kutta(flow, after, held, tick / substeps)
    return ca.Function("held", [start, held], [after], ["z", "F"], ["z_next"])


def _flow(model: RobotModel, z: ca.SX, F: ca.SX) -> ca.SX:
    """Return the time derivative of z under the generalized force F."""
    n = model.n
    Q, Qdot = z[:n], z[n : 2 * n]
    wrench = ca.vertcat(F[0], F[1], F[2] + Q[0] * F[1] - Q[1] * F[0])
    return ca.vertcat(Qdot, model.forward_dynamics(Q, Qdot, F), wrench, ca.dot(F, Qdot))


def runge_kutta(flow: ca.Function, z: ca.MX, F: ca.MX, h: float) -> ca.MX:
    """Return z after one classical Runge-Kutta step."""
    k1 = flow(z, F)
    k2 = flow(z + h / 2 * k1, F)
    k3 = flow(z + h / 2 * k2, F)
    k4 = flow(z + h * k3, F)
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
