"""The full rigid-body dynamics under the computed-torque law (7): force held over a tick, Runge-Kutta between ticks."""

import casadi as ca
import numpy as np

from psmpc_cli.native.functions import ArrayFunction, compiled
from psmpc_cli.plant.base import Disturbance, Resistance, Ticks
from psmpc_cli.robot.model import RobotModel


class Rk4Plant:
    """Integrates state, external impulse and work together, `substeps` steps a tick; `native`, as compiled C.

    With a resistance it is a disturbed plant: all that differs from what the controller knows is an argument of one
    function, so every draw, with and without a payload, runs the same code. Without one these arguments are constants.
    """

    def __init__(
        self,
        model: RobotModel,
        tick: float,
        substeps: int = 1,
        native: bool = False,
        resistance: Resistance | None = None,
    ) -> None:
        self.model, self.tick, self.resistance = model, tick, resistance
        one = tick_function(model, tick, substeps, resistance is not None)
        self._tick = compiled(one) if native else one
        self._sample: dict[int, ArrayFunction] = {}

    def advance(self, start: float, x: np.ndarray, u: np.ndarray, disturbance: Disturbance | None = None) -> Ticks:
        """Advance over len(u) ticks."""
        M, n = len(u), self.model.n
        if M not in self._sample:
            self._sample[M] = ArrayFunction(self._tick.mapaccum(M))
        differences: tuple[np.ndarray, ...] = ()
        if self.resistance is not None and disturbance is not None:
            vectors = disturbance.robot.vector, disturbance.law.vector, self.resistance.vector
            differences = disturbance.noise, disturbance.push, np.concatenate(vectors)
        Z, F = self._sample[M](np.concatenate([x, np.zeros(4)]), u, *differences)
        X = np.concatenate([x[None], Z[:, : 2 * n]])
        time = start + self.tick * np.arange(M + 1)
        return Ticks(time, X, F, Z[-1, 2 * n : 2 * n + 3], float(Z[-1, 2 * n + 3]))


def tick_function(model: RobotModel, tick: float, substeps: int, disturbed: bool) -> ca.Function:
    """Return one tick z, u -> z_next, F with z = [x; impulse (3,); work]: the law (7) sets F once.

    A disturbed one has the further arguments noise (2n,), push (n,) and p: the inertial parameters of the robot and of
    the law, then the vector of a `Resistance`.
    """
    n, (law, flow) = model.n, _law_and_flow(model, disturbed)
    z, u, noise, push = (ca.MX.sym(*each) for each in (("z", 2 * n + 4), ("u", n), ("noise", 2 * n), ("push", n)))
    if disturbed:
        p = ca.MX.sym(law.name_in(2), law.size1_in(2))
        F = law(z[: 2 * n] + noise, u, p)
        after = _runge_kutta(flow, z, [F + push, p], tick, substeps)
        return ca.Function("disturbed", [z, u, noise, push, p], [after, F])
    F = law(z[: 2 * n], u)
    return ca.Function("tick", [z, u], [_runge_kutta(flow, z, [F], tick, substeps), F])


def _law_and_flow(model: RobotModel, disturbed: bool) -> tuple[ca.Function, ca.Function]:
    """Return the low-level law x, u, p -> F, and the time derivative of z at z, F, p with the external force in F.

    Of an undisturbed plant p is constant, and no argument. Friction acts between the links: it does work, but has no
    impulse on the whole. The flow is called, not written out, in each stage of an integration step: as C it compiles in
    a third of the time.
    """
    n, w = model.n, model.nominal.vector
    known = np.concatenate([w, w, Resistance.none(n).vector])
    p = ca.SX.sym("p", known.size) if disturbed else ca.SX(known)
    robot, believed, viscous, coulomb, largest, width = ca.vertsplit(
        p, np.cumsum([0, w.size, w.size, n, n, n, 1]).tolist()
    )
    x, u, z, F = (ca.SX.sym(*each) for each in (("x", 2 * n), ("u", n), ("z", 2 * n + 4), ("F", n)))
    Q, Qdot = z[:n], z[n : 2 * n]
    commanded = model.dynamics.inverse(x[:n], x[n:], u, believed)
    acting = F - viscous * Qdot - coulomb * ca.tanh(Qdot / width)
    wrench = ca.vertcat(F[0], F[1], F[2] + Q[0] * F[1] - Q[1] * F[0])
    rate = ca.vertcat(Qdot, model.dynamics.forward(Q, Qdot, acting, robot), wrench, ca.dot(acting, Qdot))
    if not disturbed:
        return ca.Function("law", [x, u], ca.cse([commanded])), ca.Function("flow", [z, F], ca.cse([rate]))
    limited = ca.fmin(ca.fmax(commanded, -largest), largest)
    return ca.Function("law", [x, u, p], [limited], ["x", "u", "p"], ["F"]), ca.Function("flow", [z, F, p], [rate])


def _runge_kutta(flow: ca.Function, z: ca.MX, held: list[ca.MX], tick: float, substeps: int) -> ca.MX:
    """Return z after a tick of classical Runge-Kutta steps, the other arguments of the flow held."""
    h = tick / substeps
    for _ in range(substeps):
        k1 = flow(z, *held)
        k2 = flow(z + h / 2 * k1, *held)
        k3 = flow(z + h / 2 * k2, *held)
        k4 = flow(z + h * k3, *held)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return z
