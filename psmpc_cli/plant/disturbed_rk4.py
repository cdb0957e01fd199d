"""The full dynamics of a robot that is not quite the one its low-level law (7) knows, Runge-Kutta between ticks."""

import casadi as ca
import numpy as np

from psmpc_cli.native.arrays import ArrayFunction
from psmpc_cli.native.functions import compiled
from psmpc_cli.plant.base import Ticks
from psmpc_cli.plant.disturbance import Disturbance, Resistance
from psmpc_cli.plant.rk4 import runge_kutta
from psmpc_cli.robot.inertial import WeighedRobot, weigh
from psmpc_cli.robot.model import RobotModel


class DisturbedRk4Plant:
    """Integrates state, external impulse and work together, `substeps` steps a tick; `native`, as compiled C.

    All that is uncertain is an argument of one function: every draw, with and without a payload, runs the same code.
    """

    def __init__(
        self, model: RobotModel, tick: float, resistance: Resistance, substeps: int = 1, native: bool = False
    ) -> None:
        self.model, self.tick, self.resistance = model, tick, resistance
        one = disturbed_tick(model, tick, substeps)
        self._tick = compiled(one) if native else one
        self._sample: dict[int, ArrayFunction] = {}

    def advance(self, start: float, x: np.ndarray, u: np.ndarray, disturbance: Disturbance) -> Ticks:
        """Advance over len(u) ticks."""
        M, n, way = len(u), self.model.n, self.resistance
        if M not in self._sample:
            self._sample[M] = ArrayFunction(self._tick.mapaccum(M))
        weights = np.concatenate([disturbance.robot.vector, disturbance.law.vector])
        resistance = np.concatenate([way.viscous, way.coulomb, [way.width], way.largest])
        given = (u, disturbance.noise, disturbance.push, weights, resistance)
        Z, F = self._sample[M](np.r_[x, np.zeros(4)], *given)
        X = np.vstack([x, Z[:, : 2 * n]])
        time = start + self.tick * np.arange(M + 1)
        return Ticks(time, X, F, Z[-1, 2 * n : 2 * n + 3], float(Z[-1, 2 * n + 3]))


def disturbed_tick(model: RobotModel, tick: float, substeps: int) -> ca.Function:
    """Return one tick z, u, noise, push, weights, resistance -> z_next, F with z = [x; impulse (3,); work].

    The weights are the vectors of `Inertials` of the robot and of the law; the resistance is viscous and Coulomb
    friction (n,) each, the width, and the largest forces (n,).
    """
    n, robot = model.n, weigh(model.spec)
    z, u, noise, push = (ca.MX.sym(name, size) for name, size in zip("zued", (2 * n + 4, n, 2 * n, n), strict=True))
    weights, resistance = ca.MX.sym("w", 2 * robot.size), ca.MX.sym("r", 3 * n + 1)
    true, believed = weights[: robot.size], weights[robot.size :]
    seen, largest = z[: 2 * n] + noise, resistance[2 * n + 1 :]
    F = ca.fmin(ca.fmax(robot.inverse_dynamics(seen[:n], seen[n:], u, believed), -largest), largest)
    flow, after = _flow(robot, n), z
    held = ca.vertcat(F + push, resistance[: 2 * n + 1], true)
    for _ in range(substeps):
        after = runge_kutta(flow, after, held, tick / substeps)
    names = ["z", "u", "noise", "push", "weights", "resistance"]
    return ca.Function("disturbed", [z, u, noise, push, weights, resistance], [after, F], names, ["z_next", "F"])


def _flow(robot: WeighedRobot, n: int) -> ca.Function:
    """Return the time derivative of z at z and [F (n,); viscous (n,); coulomb (n,); width; w], force from outside in F.

    Friction acts between the links: it does work, but no impulse on the whole.
    """
    z, held = ca.SX.sym("z", 2 * n + 4), ca.SX.sym("held", 3 * n + 1 + robot.size)
    F, viscous, coulomb, width, w = ca.vertsplit(held, list(np.cumsum([0, n, n, n, 1, robot.size])))
    Q, Qdot = z[:n], z[n : 2 * n]
    acting = F - viscous * Qdot - coulomb * ca.tanh(Qdot / width)
    wrench = ca.vertcat(F[0], F[1], F[2] + Q[0] * F[1] - Q[1] * F[0])
    rate = ca.vertcat(Qdot, robot.forward_dynamics(Q, Qdot, acting, w), wrench, ca.dot(acting, Qdot))
    return ca.Function("flow", [z, held], [rate])
