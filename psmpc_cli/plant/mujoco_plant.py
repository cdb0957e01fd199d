"""MuJoCo, rigid-body dynamics of other authors, under the computed-torque loop (7)."""

import logging

import mujoco
import numpy as np

from psmpc_cli.plant.base import Ticks
from psmpc_cli.robot.mjcf import mjcf
from psmpc_cli.robot.model import RobotModel

logger = logging.getLogger(__name__)


class MujocoPlant:
    """Steps MuJoCo's model of the robot with its Runge-Kutta integrator, `substeps` steps a tick.

    Only the low-level law asks the robot model here: it is the controller's. MuJoCo gives back nothing but Q and Qdot,
    so momentum and energy of the robot model at its states, less impulse and work, tell whether the two agree.
    """

    def __init__(self, model: RobotModel, tick: float, substeps: int = 1) -> None:
        self.model, self.tick, self.substeps = model, tick, substeps
        self.engine = mujoco.MjModel.from_xml_string(mjcf(model.spec))
        self.engine.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        self.engine.opt.timestep = tick / substeps
        self.engine.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged state is to be seen
        mujoco.set_mju_user_warning(logger.warning)  # MuJoCo's own way is a file in the current directory
        self._data = mujoco.MjData(self.engine)
        self._base = self.engine.body("base").id

    def advance(self, start: float, x: np.ndarray, u: np.ndarray) -> Ticks:
        """Advance over len(u) ticks."""
        n, M = self.model.n, len(u)
        X, F = np.vstack([x, np.empty((M, 2 * n))]), np.empty((M, n))
        for k in range(M):
            F[k] = np.asarray(self.model.low_level(X[k, :n], X[k, n:], u[k])).ravel()
            X[k + 1] = self.step(X[k], F[k])
        return Ticks(start + self.tick * np.arange(M + 1), X, F, impulse(X, F, self.tick), work(X, F))

    def replay(self, x: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return the states (M + 1, 2n) from x (2n,) on under given forces (M, n), held a tick each: no feedback."""
        X = np.vstack([x, np.empty((len(F), len(x)))])
        for k, force in enumerate(F):
            X[k + 1] = self.step(X[k], force)
        return X

    def step(self, x: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return the state (2n,) a tick after x (2n,): F (n,) held, a wrench on the base and torques of the motors."""
        n, data = self.model.n, self._data
        data.qpos[:], data.qvel[:] = x[:n], x[n:]
        data.xfrc_applied[self._base, [0, 1, 5]] = F[:3]
        data.ctrl[:] = F[3:]
        mujoco.mj_step(self.engine, data, self.substeps)
        return np.concatenate([data.qpos, data.qvel])


def impulse(X: np.ndarray, F: np.ndarray, tick: float) -> np.ndarray:
    """Return the integral (3,) [N s, N m s] of the external wrench, from states X (M + 1, 2n) and held forces F (M, n).

    The arm of a held force is the base's position, integrated over a tick by the trapezoidal rule with its end
    correction: cubic between the states, an error of the order of tick^5.
    """
    n = X.shape[1] // 2
    position, velocity = X[:, :2], X[:, n : n + 2]
    arm = tick / 2 * (position[1:] + position[:-1]) - tick**2 / 12 * np.diff(velocity, axis=0)
    angular = tick * F[:, 2] + arm[:, 0] * F[:, 1] - arm[:, 1] * F[:, 0]
    return np.array([*(tick * F[:, :2].sum(axis=0)), angular.sum()])


def work(X: np.ndarray, F: np.ndarray) -> float:
    """Return the integral of F' Qdot [J]: exactly that of held forces, whatever the path between the states."""
    return float(np.sum(F * np.diff(X[:, : F.shape[1]], axis=0)))
