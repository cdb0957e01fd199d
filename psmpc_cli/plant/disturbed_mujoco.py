"""MuJoCo under a low-level law (7) that does not quite know the robot."""

import mujoco
import numpy as np

from psmpc_cli.plant.base import Ticks
from psmpc_cli.plant.disturbance import Disturbance, Resistance
from psmpc_cli.plant.mujoco_plant import MujocoPlant, impulse
from psmpc_cli.robot.inertial import Inertials, body_names, weigh
from psmpc_cli.robot.model import RobotModel


class DisturbedMujocoPlant:
    """Steps MuJoCo with bodies that weigh what they are said to.

    What a gripper holds is made one body with its link. Limits are put on the forces, and friction is added to them,
    before each step of the integrator: MuJoCo's own friction is none of a rate's smooth functions.
    """

    def __init__(self, model: RobotModel, tick: float, resistance: Resistance, substeps: int = 1) -> None:
        self.model, self.tick, self.resistance, self.substeps = model, tick, resistance, substeps
        self.engine = MujocoPlant(model, tick, substeps).engine
        self._data = mujoco.MjData(self.engine)
        self._law = weigh(model.spec).inverse_dynamics
        self._bodies = [self.engine.body(name).id for name in body_names(model.spec)]
        self._places = self.engine.body_ipos[self._bodies, 0].copy()

    def advance(self, start: float, x: np.ndarray, u: np.ndarray, disturbance: Disturbance) -> Ticks:
        """Advance over len(u) ticks."""
        n, M, believed = self.model.n, len(u), disturbance.law.vector
        self._weigh(disturbance.robot)
        X, F, done = np.vstack([x, np.empty((M, 2 * n))]), np.empty((M, n)), 0.0
        for k in range(M):
            seen = X[k] + disturbance.noise[k]
            F[k] = self.resistance.saturated(np.asarray(self._law(seen[:n], seen[n:], u[k], believed)).ravel())
            X[k + 1], work = self._step(X[k], F[k] + disturbance.push[k])
            done += work
        times = start + self.tick * np.arange(M + 1)
        return Ticks(times, X, F, impulse(X, F + disturbance.push, self.tick), done)

    def _step(self, x: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the state (2n,) a tick after x (2n,) under F (n,), and the work of all forces [J]."""
        n, data, work = self.model.n, self._data, 0.0
        data.qpos[:], data.qvel[:] = x[:n], x[n:]
        for _ in range(self.substeps):
            before, acting = data.qpos.copy(), F + self.resistance.friction(data.qvel)
            data.qfrc_applied[:] = acting
            mujoco.mj_step(self.engine, data)
            work += float(acting @ (data.qpos - before))
        return np.concatenate([data.qpos, data.qvel]), work

    def _weigh(self, robot: Inertials) -> None:
        """Give the bodies their masses, inertias and centres of mass, with what the grippers hold."""
        mass, inertia, place = robot.mass.copy(), robot.inertia.copy(), robot.offset.copy()
        place[:, 0] += self._places
        link = 0
        for number, arm in enumerate(self.model.spec.arms.values()):
            link, held, spin = link + len(arm.links), robot.held_mass[number], robot.held_inertia[number]
            tip = np.array([arm.links[-1].a + arm.links[-1].b, 0.0])
            apart, together = tip - place[link], mass[link] + held
            inertia[link] += spin + mass[link] * held / together * float(apart @ apart)
            place[link] += held / together * apart
            mass[link] = together
        self.engine.body_mass[self._bodies] = mass
        self.engine.body_inertia[self._bodies] = inertia[:, None]
        self.engine.body_ipos[self._bodies, :2] = place
        mujoco.mj_setConst(self.engine, self._data)
