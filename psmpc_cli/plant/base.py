"""The interface every plant has: advance over one sample under the low-level controller, return what happened."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True, eq=False)
class Ticks:
    """What the physics did over one sample, tick by tick.

    Attributes:
        time: (M + 1,) [s], the first is the sample's start.
        X: States [Q; Qdot] at those times (M + 1, 2n).
        F: Generalized force held over each tick (M, n) [N, N m].
        impulse: Integral of the external wrench over the sample: linear (x, y) [N s] and angular about the inertial
            origin [N m s], (3,).
        work: Integral of F' Qdot over the sample [J].
    """

    time: np.ndarray
    X: np.ndarray
    F: np.ndarray
    impulse: np.ndarray
    work: float


class Plant(Protocol):
    """Simulated physics of a robot under its low-level controller."""

    def advance(self, start: float, x: np.ndarray, u: np.ndarray) -> Ticks:
        """Advance from the state x (2n,) at `start` [s], the controls u (M, n) applied one a tick."""
        ...
