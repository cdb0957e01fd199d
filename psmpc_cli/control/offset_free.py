"""Integral action: what the robot accelerates by that no plan knows of, estimated and taken off the control."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Offset:
    """What is known of the disturbance at a sample.

    Attributes:
        d: Estimated acceleration (n,) [m/s^2, rad/s^2] that comes on top of the commanded one.
        Qdot: Velocity it was estimated at (n,) [m/s, rad/s].
        u: Mean acceleration commanded over the sample that begins there (n,) [m/s^2, rad/s^2].
    """

    d: np.ndarray
    Qdot: np.ndarray
    u: np.ndarray


def estimate(before: Offset | None, Qdot: np.ndarray, sample_time: float, gain: float) -> np.ndarray:
    """Return the estimated disturbance (n,) [m/s^2, rad/s^2] at a sample.

    It is taken for constant: what the velocity changed by over the last sample, less what was commanded, passes a
    first-order filter, d + gain ((Qdot - Qdot_before) / T_s - u_before - d).

    Args:
        before: What was known a sample earlier; None at the first.
        Qdot: Measured velocity (n,) [m/s, rad/s].
        sample_time: T_s [s].
        gain: Of the filter, from 0 to 1.
    """
    if before is None:
        return np.zeros(len(Qdot))
    surplus = (Qdot - before.Qdot) / sample_time - before.u
    return np.asarray(before.d + gain * (surplus - before.d))
