"""The ideal plant: the double integrator (8), as the controller believes; forces from inverse dynamics."""

import numpy as np

from psmpc_cli.native.functions import RowFunction
from psmpc_cli.plant.base import Disturbance, Ticks
from psmpc_cli.plant.grasp import PlantSetup
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.motion import over_ticks


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
        Q, v = over_ticks(model.space, x[:nq], x[nq:], u, tick)
        X = np.hstack([Q, v])
        (F,) = self._force(X[:-1, :nq], v[:-1], u, model.nominal.vector, rows=len(u))
        first, last = model.balance(X[[0, -1], :nq], X[[0, -1], nq:])
        return Ticks(start + tick * np.arange(len(u) + 1), X, F, last - first)


def build(setup: PlantSetup) -> IdealPlant:
    """Build the plant."""
    return IdealPlant(setup.model, setup.tick)
