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
        """What the wheels store together, along the base's axes (k,) [N m s]."""
        return np.array(self.wheels.along_base(self.momentum.tolist()))

    def with_unloading(self, F: np.ndarray, driven: tuple[float, ...]) -> np.ndarray:
        """Return the force of the low-level law (n,) with what balances motors that unload wheels in this tick.

        Unloading means that motors bring the wheels back to their first momenta while thrusters push the base.

        Args:
            F: The force [N, N m].
            driven: 1 for each coordinate of the base on which something acts, else 0 (n_twist,).
        """
        F, self._unloading = self.wheels.with_unloading(F, self.momentum, driven, self._tick)
        return F

    def without_unloading(self, F: np.ndarray) -> np.ndarray:
        """Return a generalized force (n,) less the part that balances motors which unload wheels in this tick."""
        return self.wheels.with_moment(F, -self._unloading)

    def begin_tick(self, F: np.ndarray, driven: tuple[float, ...]) -> np.ndarray:
        """Set the torques of the motors for a tick, and return the force that acts over it; see `Wheels.with_turning`.

        Args:
            F: Generalized force as `with_unloading` returns it, cut at its limits (n,) [N, N m].
            driven: 1 for each coordinate of the base on which something acts, else 0 (n_twist,).
        """
        F, self.torque = self.wheels.with_turning(F, self.momentum, driven, self._tick, self._unloading)
        return F

    def without_motors(self, F: np.ndarray) -> np.ndarray:
        """Return a generalized force that acts in this tick (n,), less what motors of wheels give to the base."""
        return self.wheels.with_moment(F, self.torque)

    def end_tick(self) -> None:
        """Record the tick that has passed: each wheel has stored what its motor gave."""
        self.record_tick(self.momentum + self._tick * self.torque, self.torque)

    def record_tick(self, momentum: np.ndarray, torque: np.ndarray) -> None:
        """Record a tick: what the wheels store after it (W,) [N m s], and the torques over it (W,) [N m]."""
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
