"""The ideal plant: the double integrator (8), as the controller believes; forces from inverse dynamics."""

import numpy as np

from psmpc_cli.native.functions import BatchFunction
from psmpc_cli.plant.base import Disturbance, Setpoints, Ticks
from psmpc_cli.plant.grasp import PlantSetup
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.motion import over_ticks


class IdealPlant:
    """Advances Q and v exactly under constant accelerations; nothing disturbs it."""

    def __init__(self, model: RobotModel, tick: float) -> None:
        self.model = model
        self.tick = tick
        self._force = BatchFunction(model.dynamics.inverse)

    def advance(
        self, start: float, state: np.ndarray, setpoints: Setpoints, disturbance: Disturbance | None = None
    ) -> Ticks:
        """Advance over the M ticks of a sample with exactly the commanded accelerations: a plant without dynamics.

        It shows what a controller does when the robot moves as the controller believes. Motion is integrated from u
        alone; rates in task space are first turned into accelerations. Disturbances, grippers and
        which coordinates of the base are driven have no effect.

        Args:
            start: When the sample begins [s].
            state: State [Q; v] when it begins (nq + n,).
            setpoints: Accelerations u (M, n), or rates in task space (M, k); the others are not used.
            disturbance: Not used.

        Returns:
            The motion. F is the force that would be needed where each tick begins, by inverse dynamics; impulse and
            work are the change of momentum and kinetic energy over the sample.
        """
        model = self.model
        u = setpoints.u
        if setpoints.twist_rates is not None:
            u = self._accelerations(state, setpoints.twist_rates)
        Q, v = over_ticks(model.space, state[: model.nq], state[model.nq :], u, self.tick)
        (F,) = self._force(Q[:-1], v[:-1], u, model.nominal.vector, rows=len(u))
        momentum_and_energy = model.balance(Q[[0, -1]], v[[0, -1]])
        impulse_and_work = momentum_and_energy[1] - momentum_and_energy[0]
        return Ticks(start + self.tick * np.arange(len(u) + 1), np.hstack([Q, v]), F, impulse_and_work)

    def _accelerations(self, state: np.ndarray, twist_rates: np.ndarray) -> np.ndarray:
        """Return the accelerations (M, n) by which base and end-effectors follow rates of their velocities (M, k).

        The accelerations of a tick depend on the state where it begins, so the motion is integrated along.
        """
        model = self.model
        Q = state[: model.nq]
        v = state[model.nq :]
        u = np.empty((len(twist_rates), model.n))
        for k, rates in enumerate(twist_rates):
            u[k] = model.task_space_acceleration(Q, v, rates)
            path, velocities = over_ticks(model.space, Q, v, u[k : k + 1], self.tick)
            Q = path[-1]
            v = velocities[-1]
        return u


def build(setup: PlantSetup) -> IdealPlant:
    """Build the plant."""
    return IdealPlant(setup.model, setup.tick)
