"""What a stage's cost follows: the numbers of a target over the time since the stage began."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Reference(ABC):
    """What a stage's cost follows."""

    @property
    @abstractmethod
    def points(self) -> np.ndarray:
        """The numbers that it leads through (T, numbers) [m, rad]."""

    @property
    def moves(self) -> bool:
        """Whether it is another at other times."""
        return len(self.points) > 1

    @abstractmethod
    def at(self, since: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers, and their rates just after, at times since the stage began (...,) [s].

        Both are (..., numbers) [m, rad, 1/s of them]; those of a reference at rest stand for all times, (numbers,).
        """

    @abstractmethod
    def mapped(self, of: Callable[[np.ndarray], np.ndarray]) -> "Reference":
        """Return the reference with what a function makes of its numbers (..., numbers)."""


@dataclass(frozen=True, eq=False)
class Constant(Reference):
    """A target at rest, or a point on the way to one.

    Attributes:
        numbers: Of it (numbers,) [m, rad].
    """

    numbers: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """Its numbers, as one row."""
        return self.numbers[None]

    def at(self, since: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return its numbers, and no rates."""
        return self.numbers, np.zeros_like(self.numbers)

    def mapped(self, of: Callable[[np.ndarray], np.ndarray]) -> "Constant":
        """Return the reference with what a function makes of its numbers."""
        return Constant(of(self.numbers))


@dataclass(frozen=True, eq=False)
class Trajectory(Reference):
    """A desired trajectory: values (T, numbers) at times (T,) [s] since the stage began.

    Between them numbers change at a constant rate, and attitudes turn at one about an axis (Shoemake: Animating
    rotation with quaternion curves, 1985).

    Attributes:
        attitudes: First columns of unit quaternions; from row to row each is the nearer one of the two for an attitude.
    """

    times: np.ndarray
    values: np.ndarray
    attitudes: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"<Trajectory of {self.values.shape[1]} numbers: {len(self.times)} times to {self.times[-1]:g} s>"

    @property
    def points(self) -> np.ndarray:
        """Its values."""
        return self.values

    @cached_property
    def _angles(self) -> np.ndarray:
        """Angle by which the quaternion of each column turns from row to row (T - 1, rows) [rad]; 0 of a number."""
        angles = np.zeros((len(self.times) - 1, self.values.shape[1]))
        for at in self.attitudes:
            q = self.values[:, at : at + 4]
            difference = np.linalg.norm(q[1:] - q[:-1], axis=1)
            total = np.linalg.norm(q[1:] + q[:-1], axis=1)
            angles[:, at : at + 4] = 2 * np.arctan2(difference, total)[:, None]
        return angles

    def at(self, since: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate the trajectory between its rows: numbers linearly, quaternions along the arc (Shoemake's slerp).

        Between the rows a and b, which lie an angle phi apart, at the fraction s of the interval,

            value(s) = (sin((1 - s) phi) a + sin(s phi) b) / sin(phi).

        A number has phi = 0, where the limit is linear interpolation; so sin(x) is written as x sinc(x), which needs no
        case of its own. Before the first time and after the last one the trajectory stands still.

        Args:
            since: Times since the stage began, (...,) [s].

        Returns:
            The values (..., numbers) [m, rad], and their rates just after these times (..., numbers) [m/s, rad/s].
        """
        interval = np.clip(self.times.searchsorted(since, side="right") - 1, 0, len(self.times) - 2)
        duration = np.diff(self.times)[interval][..., None]
        fraction = np.clip((since - self.times[interval])[..., None] / duration, 0.0, 1.0)
        is_moving = np.asarray((since >= self.times[0]) & (since < self.times[-1]))
        phi = self._angles[interval]
        before = self.values[interval]
        after = self.values[interval + 1]
        weight_before = (1 - fraction) * _sinc((1 - fraction) * phi) / _sinc(phi)
        weight_after = fraction * _sinc(fraction * phi) / _sinc(phi)
        values = weight_before * before + weight_after * after
        rates = (np.cos(fraction * phi) * after - np.cos((1 - fraction) * phi) * before) / _sinc(phi) / duration
        return values, rates * is_moving[..., None]

    def mapped(self, of: Callable[[np.ndarray], np.ndarray]) -> "Trajectory":
        """Return the trajectory with what a function makes of its values."""
        return replace(self, values=of(self.values))


def _sinc(angle: np.ndarray) -> np.ndarray:
    """Return sin(angle) / angle."""
    return np.asarray(np.sinc(angle / np.pi))
