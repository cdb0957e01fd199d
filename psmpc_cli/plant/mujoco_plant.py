"""MuJoCo, rigid-body dynamics of other authors, under the computed-torque law (7)."""

import logging

import mujoco
import numpy as np

from psmpc_cli.plant.base import Disturbance, Resistance, Ticks
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.mujoco_model import mujoco_spec

logger = logging.getLogger(__name__)


class MujocoPlant:
    """Steps MuJoCo's model of the robot with its Runge-Kutta integrator, `substeps` steps a tick.

    The robot model serves the low-level law alone, which is part of the controller. MuJoCo returns nothing but Q and
    Qdot, so momentum and energy of the robot model at its states, less impulse and work, show whether the two agree.
    With a resistance it is a disturbed plant; friction is then added to the forces before each step of the integrator,
    because MuJoCo's own friction is not a smooth function of the rate.
    """

    def __init__(self, model: RobotModel, tick: float, substeps: int = 1, resistance: Resistance | None = None) -> None:
        self.model, self.tick, self.substeps = model, tick, substeps
        self.engine = mujoco_spec(model.spec).compile()
        self.engine.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        self.engine.opt.timestep = tick / substeps
        self.engine.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged state must be visible
        mujoco.set_mju_user_warning(logger.warning)  # by default MuJoCo writes a file in the current directory
        self._data = mujoco.MjData(self.engine)
        self._resistance = resistance
        self._bodies = [self.engine.body(name).id for name in (body.name for body in model.spec.bodies)]
        self._centres = self.engine.body_ipos[self._bodies, 0].copy()

    def advance(self, start: float, x: np.ndarray, u: np.ndarray, disturbance: Disturbance | None = None) -> Ticks:
        """Advance over len(u) ticks."""
        n, M, way = self.model.n, len(u), self._resistance
        X, F, push, work = np.vstack([x, np.empty((M, 2 * n))]), np.empty((M, n)), np.zeros((M, n)), 0.0
        noise, law = np.zeros((M, 2 * n)), self.model.nominal
        if way is not None and disturbance is not None:
            noise, law, push = disturbance.noise, disturbance.law, disturbance.push
            self._set_inertial_parameters(disturbance.robot)
        for k in range(M):
            read = X[k] + noise[k]
            F[k] = self.model.inverse_dynamics(read[:n], read[n:], u[k], law)
            if way is not None:
                F[k] = np.clip(F[k], -way.largest, way.largest)
            X[k + 1], done = self._step(X[k], F[k] + push[k])
            work += done
        time = start + self.tick * np.arange(M + 1)
        return Ticks(time, X, F, _impulse(X, F + push, self.tick), work)

    def replay(self, x: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return the states (M + 1, 2n) from x (2n,) on under given forces (M, n), held a tick each: no feedback."""
        X = np.vstack([x, np.empty((len(F), len(x)))])
        for k, force in enumerate(F):
            X[k + 1], _ = self._step(X[k], force)
        return X

    def _step(self, x: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the state (2n,) a tick after x (2n,) under F (n,), and the work of all forces [J].

        The work of a force held over a step is exact, whatever the path between the states.
        """
        n, data, way, work = self.model.n, self._data, self._resistance, 0.0
        data.qpos[:], data.qvel[:] = x[:n], x[n:]
        for _ in range(self.substeps):
            before, acting = data.qpos.copy(), F
            if way is not None:
                acting = F - way.viscous * data.qvel - way.coulomb * np.tanh(data.qvel / way.width)
            data.qfrc_applied[:] = acting
            mujoco.mj_step(self.engine, data)
            work += float(acting @ (data.qpos - before))
        return np.concatenate([data.qpos, data.qvel]), work

    def _set_inertial_parameters(self, robot: InertialParameters) -> None:
        """Set masses, inertias and centres of mass of the bodies; a load becomes one body with the last link."""
        mass, inertia, centre = robot.mass.copy(), robot.inertia[:, 0].copy(), robot.offset.copy()
        centre[:, 0] += self._centres
        for number, tool in enumerate(self.model.spec.tools.values()):
            link, held = tool.body, robot.held_mass[number]
            apart = np.array(tool.position[:2]) - centre[link]
            total = mass[link] + held
            inertia[link] += robot.held_inertia[number] + mass[link] * held / total * float(apart @ apart)
            centre[link] += held / total * apart
            mass[link] = total
        self.engine.body_mass[self._bodies] = mass
        self.engine.body_inertia[self._bodies] = inertia[:, None]
        self.engine.body_ipos[self._bodies, :2] = centre
        mujoco.mj_setConst(self.engine, self._data)


def _impulse(X: np.ndarray, F: np.ndarray, tick: float) -> np.ndarray:
    """Return the integral (3,) [N s, N m s] of the external wrench, from states X (M + 1, 2n) and held forces F (M, n).

    The lever arm of a held force is the base's position, integrated over a tick by the trapezoidal rule with its end
    correction: cubic between the states, an error of the order of tick^5.
    """
    n = X.shape[1] // 2
    position, velocity = X[:, :2], X[:, n : n + 2]
    arm = tick / 2 * (position[1:] + position[:-1]) - tick**2 / 12 * np.diff(velocity, axis=0)
    angular = tick * F[:, 2] + arm[:, 0] * F[:, 1] - arm[:, 1] * F[:, 0]
    return np.array([*(tick * F[:, :2].sum(axis=0)), angular.sum()])
