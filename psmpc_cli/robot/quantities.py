"""What is measured of a robot at a state: poses, momentum and kinetic energy, all by one call on numbers."""

import casadi as ca
import numpy as np

from psmpc_cli.native.arrays import ArrayFunction
from psmpc_cli.robot.model import RobotModel


class Quantities:
    """Evaluates them for one robot."""

    def __init__(self, model: RobotModel) -> None:
        x = ca.SX.sym("x", 2 * model.n)
        Q, Qdot = x[: model.n], x[model.n :]
        wanted = [model.g(Q), model.momentum(Q, Qdot), model.kinetic_energy(Q, Qdot)]
        self._function = ArrayFunction(ca.Function("quantities", [x], [ca.densify(each) for each in ca.cse(wanted)]))

    def poses(self, x: np.ndarray) -> np.ndarray:
        """Return xi (m,) [m, rad] at x (2n,)."""
        return np.asarray(self._function(x)[0][0])

    def momentum_and_energy(self, x: np.ndarray) -> tuple[np.ndarray, float]:
        """Return momentum (3,) [N s], [N m s] and kinetic energy [J] at x (2n,)."""
        _, momentum, energy = self._function(x)
        return momentum[0], energy.item()
