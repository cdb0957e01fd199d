"""Statistics of a bench: spreads of what was measured, and how times grow with the size of a problem."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Spread:
    """How numbers spread; NaN throughout if there are none."""

    count: int
    median: float
    p95: float
    p99: float
    least: float
    largest: float


def spread(values: ArrayLike) -> Spread:
    """Return how numbers spread."""
    found = np.ravel(np.asarray(values, float))
    if not len(found):
        return Spread(0, *(np.nan,) * 5)
    median, p95, p99 = (float(value) for value in np.percentile(found, (50, 95, 99)))
    return Spread(len(found), median, p95, p99, float(found.min()), float(found.max()))


def exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Return p of the best fit times ~ sizes^p in the least squares of the logarithms; NaN with less than two sizes."""
    x, y = np.log(np.asarray(sizes, float)), np.log(np.asarray(times, float))
    if len(np.unique(x)) < 2:
        return np.nan
    return float(np.polyfit(x, y, 1)[0])
