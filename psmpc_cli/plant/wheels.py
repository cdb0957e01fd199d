"""How motors of reaction wheels are driven, tick by tick, and what the wheels then store; robot/actuators/wheels.py."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True, eq=False)
class WheelTicks:
    """What the W wheels of a base did over one sample.

    Attributes:
        momentum: What each stores at each tick and at the end (M + 1, W) [N m s].
        torque: Of each motor over each tick (M, W) [N m].
    """

    momentum: np.ndarray
    torque: np.ndarray


class WheelDrive:
    """The wheels of one run.

    Attributes:
        wheels: The wheels.
        momentum: What they store now (W,) [N m s].
        torque: Of their motors over the tick that has begun (W,) [N m].
    """

    def __init__(self, wheels: Wheels, tick: float) -> None:
        self.wheels = wheels
        self.momentum = wheels.initial.copy()
        self.torque = np.zeros(wheels.count)
        self._tick = tick
        self._unloading = self.torque
        self._momenta = [self.momentum]
        self._torques: list[np.ndarray] = []

    @property
    def stored(self) -> np.ndarray:
        """What they store together, along the base's axes (k,) [N m s]."""
        return np.array(self.wheels.along_base(self.momentum.tolist()))

    def commanded(self, F: np.ndarray, driven: tuple[float, ...]) -> np.ndarray:
        """Return the force of the low-level law (n,) with what balances motors that unload wheels, by `Wheels`."""
        F, self._unloading = self.wheels.with_unloading(F, self.momentum, driven, self._tick)
        return F

    def against_unloading(self, F: np.ndarray) -> np.ndarray:
        """Return what of a generalized force (n,) is left on the base where motors unload the wheels in this tick."""
        return self.wheels.with_moment(F, -self._unloading)

    def begin_tick(self, F: np.ndarray, driven: tuple[float, ...]) -> np.ndarray:
        """Return what of that force, within its limits (n,), acts over a tick that begins; `Wheels.with_turning`."""
        F, self.torque = self.wheels.with_turning(F, self.momentum, driven, self._tick, self._unloading)
        return F

    def of_thrusters(self, F: np.ndarray) -> np.ndarray:
        """Return a generalized force that acts in this tick (n,) without what the motors of the wheels give."""
        return self.wheels.with_moment(F, self.torque)

    def end_tick(self) -> None:
        """Take in that the tick has passed."""
        self.record(self.momentum + self._tick * self.torque, self.torque)

    def record(self, momentum: np.ndarray, torque: np.ndarray) -> None:
        """Take in what the wheels store after a tick (W,), and the torques over it (W,)."""
        self.momentum = momentum
        self._momenta.append(momentum)
        self._torques.append(torque)

    def end_sample(self) -> WheelTicks:
        """Return what the wheels did over the sample that ends, and begin the next one."""
        sample = WheelTicks(np.array(self._momenta), np.array(self._torques))
        self._momenta = [self.momentum]
        self._torques = []
        return sample


def drive_of(task: TaskSpec, model: RobotModel) -> WheelDrive | None:
    """Return how the wheels of a task's robot are driven; None where it has none, or the plant has no forces."""
    if not (model.spec.wheels and task.plant.traits.has_forces):
        return None
    return WheelDrive(Wheels.of(model.spec), 1 / task.plant.low_level_rate)
