"""Integral action: what the robot accelerates by that no plan knows of, estimated and taken off the control."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Offset:
    """What is known of the disturbance at a sample.

    Attributes:
        d: Estimated acceleration (n,) [m/s^2, rad/s^2] that comes on top of the commanded one.
        Qdot: Velocity (n,) [m/s, rad/s] that was measured last: now, or as many samples ago as are known of a delay.
        u: Mean accelerations commanded (n,) [m/s^2, rad/s^2], from the sample of that measurement to this one.
    """

    d: np.ndarray
    Qdot: np.ndarray
    u: tuple[np.ndarray, ...]

    @classmethod
    def unknown(cls, Qdot: np.ndarray, delay: int) -> "Offset":
        """Return that of a run's first sample, whose measurement Qdot (n,) is so many samples old."""
        none = np.zeros(len(Qdot))
        return cls(none, Qdot, (none,) * delay)

    def commanding(self, u: np.ndarray) -> "Offset":
        """Return the same once accelerations u (M, n) have been commanded for the sample."""
        return replace(self, u=(*self.u, u.mean(axis=0)))

    def after(self, Qdot: np.ndarray, sample_time: float, gain: float) -> "Offset":
        """Return what is known a sample later.

        The disturbance is taken for constant: what the velocity changed by over the last sample that was measured, less
        what was commanded in it, passes a first-order filter, d + gain ((Qdot - Qdot_before) / T_s - u - d). Where a
        measurement is not finite the estimate stays.

        Args:
            Qdot: Velocity measured now (n,) [m/s, rad/s].
            sample_time: T_s [s].
            gain: Of the filter, from 0 to 1.
        """
        surplus = (Qdot - self.Qdot) / sample_time - self.u[0]
        d = np.where(np.isfinite(surplus), self.d + gain * (surplus - self.d), self.d)
        return Offset(d, Qdot, self.u[1:])
