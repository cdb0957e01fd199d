"""What a plant meets that the controller does not know of."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from psmpc_cli.plant.base import Ticks
from psmpc_cli.robot.inertial import Inertials


@dataclass(frozen=True, eq=False)
class Resistance:
    """What is in the way of the forces, by coordinate (n,); it stays the same throughout a run.

    Attributes:
        viscous: Coefficients of viscous friction [N m s/rad]; 0 for the base.
        coulomb: Coulomb friction [N m]; 0 for the base.
        width: Rate around 0 within which Coulomb friction turns over [rad/s].
        largest: Largest magnitudes of the commanded generalized force [N, N m]; infinite where there is no limit.
    """

    viscous: np.ndarray
    coulomb: np.ndarray
    width: float
    largest: np.ndarray

    def friction(self, Qdot: np.ndarray) -> np.ndarray:
        """Return the generalized force (n,) of friction [N, N m] at rates Qdot (n,)."""
        return np.asarray(-self.viscous * Qdot - self.coulomb * np.tanh(Qdot / self.width))

    def saturated(self, F: np.ndarray) -> np.ndarray:
        """Return a commanded generalized force (n,) within its limits."""
        return np.asarray(np.clip(F, -self.largest, self.largest))


@dataclass(frozen=True, eq=False)
class Disturbance:
    """What a plant meets over one sample.

    Attributes:
        robot: What the bodies really weigh, with what is in the grippers.
        law: What the low-level law (7) takes them for.
        noise: Of what the low-level law reads at each tick (M, 2n) [m, rad, m/s, rad/s].
        push: Generalized force from outside over each tick (M, n) [N, N m].
    """

    robot: Inertials
    law: Inertials
    noise: np.ndarray
    push: np.ndarray


class DisturbedPlant(Protocol):
    """Simulated physics of a robot that is not quite the one its low-level controller knows."""

    def advance(self, start: float, x: np.ndarray, u: np.ndarray, disturbance: Disturbance) -> Ticks:
        """Advance from the state x (2n,) at `start` [s], the controls u (M, n) applied one a tick.

        The ticks' force is the commanded one within its limits, without friction and what comes from outside; impulse
        and work are those of all of it.
        """
        ...
