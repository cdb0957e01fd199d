"""One run's uncertainty: what is measured, what the plant meets, and what its grippers hold."""

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.plant import DisturbedPlant, Plant, Ticks, build_disturbed_plant
from psmpc_cli.plant.disturbance import Disturbance, Resistance
from psmpc_cli.plant.draw import Draw, draw, measurement_noise, resistance, shares
from psmpc_cli.plant.payload import Contact, let_go, take_up
from psmpc_cli.robot.inertial import Inertials, WeighedRobot, described, weigh
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.quantities import Quantities
from psmpc_cli.specs.task import TaskSpec


class Uncertainty:
    """What the controller of a task does not know; without any, the plant as it is.

    It holds no state: what is measured follows from seed and sample, and whether the object is held from the current
    stage.
    """

    def __init__(self, task: TaskSpec, model: RobotModel, quantities: Quantities, native: bool) -> None:
        self.spec, self._task, self._model, self._quantities = task.uncertainty, task, model, quantities
        self._ticks = round(task.controller.sample_time * task.plant.low_level_rate)
        self.draw: Draw = draw(self.spec, model.spec, task.seed)
        self._true, self._believed = self.draw.applied(model.spec), described(model.spec)
        self._robot: WeighedRobot | None = None
        self._disturbed: DisturbedPlant | None = None
        if disturbs(task):
            way = resistance(self.spec.friction, self.spec.force_limits, model.spec)
            self._robot = weigh(model.spec)
            _ensure_steps_are_short(task, self._robot, self._true, way)
            self._disturbed = build_disturbed_plant(task.plant, model, way, native)

    def measured(self, sample: int, x: np.ndarray) -> np.ndarray:
        """Return what is measured of the true state x (2n,) at a sample."""
        return x + self._noise(sample)[0] if self.spec.measures_with_noise else x

    def holds(self, stage: int) -> bool:
        """Return whether the grippers hold the payload during a stage."""
        if self.spec.payload is None or self._task.object is None:
            return False
        names = [stage.name for stage in self._task.stages]
        return names.index(self._task.object.taken_by) < stage < names.index(self._task.object.let_go_by)

    def contact(self, x: np.ndarray, before: int, after: int) -> Contact:
        """Return what a hand-over from one stage to another does to the true state x (2n,)."""
        if self._robot is None or self.holds(before) == self.holds(after):
            return Contact(x, np.zeros(3), 0.0)
        free, holding = self._true, self._with_payload(self._true)
        return (take_up if self.holds(after) else let_go)(self._robot, x, free, holding)

    def advance(self, plant: Plant, sample: int, start: float, x: np.ndarray, u: np.ndarray, stage: int) -> Ticks:
        """Advance over a sample of a stage from the true state x (2n,), u (M, n) applied one a tick.

        By the plant itself where there is nothing that disturbs it.
        """
        if self._disturbed is None:
            return plant.advance(start, x, u)
        robot, law = self._true, self._believed
        if self.spec.payload is not None and self.holds(stage):
            robot = self._with_payload(robot)
            law = self._with_payload(law) if self.spec.payload.known else law
        return self._disturbed.advance(start, x, u, Disturbance(robot, law, self._noise(sample), self._push(start)))

    def kept(self, stage: int, x: np.ndarray) -> tuple[np.ndarray, float]:
        """Return momentum (3,) [N s, N m s] and energy [J] of the robot and what it holds in a stage, at x (2n,)."""
        if self._robot is None:
            return self._quantities.momentum_and_energy(x)
        weighed = self._with_payload(self._true) if self.holds(stage) else self._true
        momentum, energy = self._robot.kept(x, weighed.vector)
        return np.asarray(momentum).ravel(), float(energy)

    def _with_payload(self, free: Inertials) -> Inertials:
        payload = self.spec.payload
        if payload is None:
            return free
        share = shares(payload, self._model.spec)
        return free.holding(share * payload.mass, share * payload.inertia)

    def _noise(self, sample: int) -> np.ndarray:
        return measurement_noise(self.spec.noise, self._model.spec, self._task.seed, sample, self._ticks)

    def _push(self, start: float) -> np.ndarray:
        """Return the generalized force from outside at each tick of the sample that begins at `start` (M, n)."""
        push, impulse = np.zeros((self._ticks, self._model.n)), self.spec.impulse
        if impulse is not None:
            rate = self._task.plant.low_level_rate
            tick = int(np.floor((impulse.at - start) * rate + 1e-6))
            if 0 <= tick < self._ticks:
                push[tick, :3] = rate * np.array([*impulse.linear, impulse.angular])
        return push


def disturbs(task: TaskSpec) -> bool:
    """Return whether the plant of a task, with its low-level law, is not the one that the controller knows."""
    spec = task.uncertainty
    return task.plant.kind != "ideal" and (spec.changes_the_plant or spec.measures_with_noise)


def _ensure_steps_are_short(task: TaskSpec, robot: WeighedRobot, weighed: Inertials, way: Resistance) -> None:
    """Make sure that friction, stiffest near rest, does not outrun the integrator.

    Raises:
        InputError: It does.
    """
    n = len(way.viscous)
    step = task.plant.step or 1 / task.plant.low_level_rate
    damping = way.viscous + way.coulomb / way.width
    inertia = np.asarray(robot.H(np.zeros(n), weighed.vector))
    if not np.linalg.cond(inertia) < 1 / np.finfo(float).eps:
        raise InputError(
            "uncertainty: found bodies whose inertia matrix no number can invert, expected masses and centres of mass "
            "nearer to the described ones"
        )
    if step * (fastest := _fastest(inertia, damping)) > 1.0:
        wider = ", a larger uncertainty.friction.width" if step * _fastest(inertia, way.viscous) <= 1.0 else ""
        raise InputError(
            f"uncertainty.friction: found a step of {step:g} s, expected at most {0.95 / fastest:.2g} s for this "
            f"friction: take a smaller plant.step{wider}, or less friction"
        )


def _fastest(inertia: np.ndarray, damping: np.ndarray) -> float:
    """Return the largest rate [1/s] at which damping (n,) [N m s/rad] brakes an inertia (n, n)."""
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(damping)))).max())
