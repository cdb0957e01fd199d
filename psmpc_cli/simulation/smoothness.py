"""How smooth the control of a run is."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.logs.read import Log


@dataclass(frozen=True)
class Variation:
    """Total variation of the control at the samples, sum_k |u_{k+1} - u_k|, over the coordinates of a group.

    Attributes:
        base_position: Of the base's position [m/s^2].
        base_angle: Of its angles [rad/s^2].
        joints: Of all joints [rad/s^2].
    """

    base_position: float
    base_angle: float
    joints: float


def total_variation(log: Log) -> Variation:
    """Return the total variation of the control: 0 where it never changes, and the less the smoother."""
    return by_group(np.abs(np.diff(log["control/u"], axis=0)).sum(axis=0), log.coordinates)


def by_group(variation: np.ndarray, coordinates: tuple[str, ...]) -> Variation:
    """Return the total variation of each coordinate (n,), summed over the groups."""
    base = np.array([name.startswith("base.") for name in coordinates], bool)
    position = np.array([name in ("base.x", "base.y", "base.z") for name in coordinates], bool)
    return Variation(*(float(variation[group].sum()) for group in (position, base & ~position, ~base)))
