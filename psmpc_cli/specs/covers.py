"""Capsules that together cover a body, and how far they reach beyond it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_CAPSULES = 4
"""Capsules that cover a box."""

COVER_EXCESS = 0.15
"""Excess of a box's cover, in lengths of its longest edge, that needs no more capsules."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Capsules of one radius.

    Attributes:
        ends: Both ends of the segments that they are about (capsules, 2, 3) [m].
        radius: [m].
        excess: Largest distance of a point of them to the body, or a bound of it [m].
    """

    ends: Array
    radius: float
    excess: float

    def moved(self, frame: Array) -> Self:
        """Return the capsules of a body whose frame is at a frame (4, 4)."""
        return type(self)(self.ends @ frame[:3, :3].T + frame[:3, 3], self.radius, self.excess)


def cover_box(edges: Sequence[float]) -> Cover:
    """Cover a box about the origin, with the least number of capsules whose excess is small.

    The capsules are along the longest edge, a of them beside each other along the second and b along the third one, so
    that each has a share of half edges u and v across. With m the smaller of the two, its segment ends m before the end
    of the box, its radius is sqrt(u^2 + v^2 + m^2), which reaches the corners, and the excess is radius - m. Of
    a b = 1 to MOST_CAPSULES the least number is taken whose excess is at most COVER_EXCESS times the longest edge, and
    if there is none the one with the least excess. In the plane there is no third edge: v is 0, and m is u.

    Args:
        edges: Lengths along x and y, and in space z [m].
    """
    length = np.array(edges, dtype=float)
    order = np.argsort(-length, kind="stable")
    along, *across = (int(axis) for axis in order)
    found = []
    for shares in _grids(len(across)):
        halves = length[across] / shares / 2
        inset = float(halves.min())
        radius = float(np.sqrt((halves**2).sum() + inset**2))
        found.append((int(np.prod(shares)), radius - inset, radius, inset, shares))
    small = [each for each in found if each[1] <= COVER_EXCESS * length[along]]
    least = min(each[1] for each in found)
    as_good = small or [each for each in found if each[1] <= least * (1 + 1e-9)]
    _, excess, radius, inset, shares = min(as_good, key=lambda each: each[:2])
    middles = [
        (np.arange(share) + 0.5) / share * edge - edge / 2 for share, edge in zip(shares, length[across], strict=True)
    ]
    rows = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, len(across))
    ends = np.zeros((len(rows), 2, 3))
    ends[:, :, across] = rows[:, None]
    ends[:, :, along] = (length[along] / 2 - inset) * np.array([-1.0, 1.0])
    return Cover(ends, radius, excess)


def _grids(dimension: int) -> list[tuple[int, ...]]:
    """Return how many capsules may be beside each other along the other edges of a box."""
    counts = range(1, MOST_CAPSULES + 1)
    if dimension == 1:
        return [(a,) for a in counts]
    return [(a, b) for a in counts for b in counts if a * b <= MOST_CAPSULES]
