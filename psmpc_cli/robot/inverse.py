"""Inverse kinematics of one planar arm within its joint limits: closed form, then bounded descent."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STARTS, STEPS, SEED = 64, 60, 0


@dataclass(frozen=True)
class Chain:
    """Link lengths (links,) [m] and joint limits `low`, `high` (links,) [rad], infinite where there are none."""

    lengths: Array
    low: Array
    high: Array


def configuration(chain: Chain, pose: Array, tolerance: float) -> Array | None:
    """Joint angles (links,) [rad] within the limits whose tip is at `pose` (x, y, angle modulo 2 pi), (3,) [m, rad].

    Of several in closed form the one with the smallest angles. With more than three links, and where links of three
    leave a joint free, it is searched for from seeded random starts, and None does not prove that there is none.

    Args:
        chain: The arm.
        pose: Of the last link's end in the shoulder frame.
        tolerance: By which position [m] and angle [rad] may be missed.
    """
    ends = [_descend(chain, q, pose) for q in _closed_form(chain.lengths, pose)]
    good = [q for q in ends if _meets(chain, q, pose, tolerance)]
    if good:
        return min(good, key=lambda q: float(q @ q))
    searched = (_descend(chain, q, pose) for q in _random_starts(chain, pose, tolerance))
    return next((q for q in searched if _meets(chain, q, pose, tolerance)), None)


def tip_pose(lengths: Array, q: Array) -> Array:
    """Pose (x, y, angle) of the last link's end at joint angles q (links,) [rad], (3,) [m, rad]."""
    angles = np.cumsum(q)
    return np.array([lengths @ np.cos(angles), lengths @ np.sin(angles), angles[-1]])


def wrist_of(lengths: Array, pose: Array) -> Array:
    """Where the last joint is when the tip has `pose`, (2,) [m]."""
    return np.asarray(pose[:2] - lengths[-1] * np.array([np.cos(pose[2]), np.sin(pose[2])]))


def annulus(lengths: Array) -> tuple[float, float]:
    """Least and largest distance [m] that links of these lengths, freely jointed, span."""
    if not lengths.size:
        return 0.0, 0.0
    return max(0.0, float(2 * lengths.max() - lengths.sum())), float(lengths.sum())


def _closed_form(lengths: Array, pose: Array) -> Iterator[Array]:
    """All configurations of an arm of up to three links, of a longer one none; out of reach, the nearest ones."""
    x, y = wrist_of(lengths, pose)
    bearing = float(np.arctan2(y, x))
    proximal: list[list[float]]
    match lengths.size:
        case 1:
            proximal = [[]]
        case 2:
            proximal = [[bearing]]
        case 3:
            proximal = _both_elbows(lengths[0], lengths[1], float(np.hypot(x, y)), bearing)
        case _:
            proximal = []
    for q in proximal:
        yield np.array([*q, pose[2] - sum(q)])


def _both_elbows(first: float, second: float, distance: float, bearing: float) -> list[list[float]]:
    """The two configurations of two links whose end is at (distance [m], bearing [rad])."""
    product = 2 * first * second
    cosine = np.clip((distance**2 - first**2 - second**2) / product, -1, 1) if product else 1.0
    bend = float(np.arccos(cosine))
    return [[bearing - np.arctan2(second * np.sin(e), first + second * np.cos(e)), e] for e in (bend, -bend)]


def _random_starts(chain: Chain, pose: Array, tolerance: float) -> Iterator[Array]:
    """Seeded starts for the search; none where the closed form is complete."""
    lengths = chain.lengths
    folded = lengths.size == 3 and np.hypot(*wrist_of(lengths, pose)) <= tolerance
    if lengths.size > 3 or folded or (lengths.size > 1 and lengths[:-1].min() <= tolerance):
        random = np.random.default_rng(SEED)
        low, high = np.maximum(chain.low, -np.pi), np.minimum(chain.high, np.pi)
        for _ in range(STARTS):
            yield random.uniform(np.minimum(low, high), np.maximum(low, high))


def _within(chain: Chain, q: Array) -> Array:
    """Of every angle the equivalent inside its limits and nearest to zero, or else the limit nearest to it."""
    turns = 2 * np.pi * np.array([-1.0, 0.0, 1.0])[:, None]
    centre = np.clip(0.0, chain.low, chain.high)
    options = q + 2 * np.pi * np.round((centre - q) / (2 * np.pi)) + turns
    inside = np.clip(options, chain.low, chain.high)
    rank = np.abs(options - inside) * 1e6 + np.abs(inside)
    return np.asarray(inside[np.argmin(rank, axis=0), np.arange(q.size)])


def _descend(chain: Chain, start: Array, pose: Array) -> Array:
    """Damped Gauss-Newton on the tip's error, joints held at limits they push against."""
    q, damping = _within(chain, start), 1e-4
    error = _error(chain, q, pose)
    for _ in range(STEPS):
        J = _jacobian(chain.lengths, q)
        slope = J.T @ error
        free = ~(((q <= chain.low) & (slope > 0)) | ((q >= chain.high) & (slope < 0)))
        if np.linalg.norm(slope[free]) < 1e-12:
            break
        J = J[:, free]
        trial = q.copy()
        trial[free] -= J.T @ np.linalg.solve(J @ J.T + damping * np.eye(3), error)
        trial = np.clip(trial, chain.low, chain.high)
        change = _error(chain, trial, pose)
        if change @ change < error @ error:
            q, error, damping = trial, change, max(damping / 4, 1e-12)
        else:
            damping *= 8
    return q


def _jacobian(lengths: Array, q: Array) -> Array:
    """Of the tip's pose with respect to q, (3, links)."""
    angles = np.cumsum(q)
    from_joint = [np.cumsum((lengths * side)[::-1])[::-1] for side in (-np.sin(angles), np.cos(angles))]
    return np.vstack([*from_joint, np.ones(q.size)])


def _error(chain: Chain, q: Array, pose: Array) -> Array:
    """Tip's pose less the wanted one, the angle to the nearest turn, (3,) [m, rad]."""
    error = tip_pose(chain.lengths, q) - pose
    error[2] -= 2 * np.pi * np.round(error[2] / (2 * np.pi))
    return error


def _meets(chain: Chain, q: Array, pose: Array, tolerance: float) -> bool:
    """Whether the tip is at the pose."""
    error = _error(chain, q, pose)
    return bool(np.hypot(*error[:2]) <= tolerance and abs(error[2]) <= tolerance)
