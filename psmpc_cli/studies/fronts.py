"""Sets of points to be small in every criterion: which are dominated, how much they dominate, what weighted sums miss.

A point is a row of criteria (C,); NaN stands for a point that could not be solved for.
"""

import numpy as np

Vector = np.ndarray

CLEARLY, SAME = 1e-4, 1e-9
"""How much better a point has to be to dominate, and what is no difference, as parts of what the points span."""


def extents(points: Vector) -> Vector:
    """Return what points (P, C) span in each criterion (C,); 1 where that is nothing."""
    known = points[np.isfinite(points).all(axis=1)]
    span = np.ptp(known, axis=0) if len(known) else np.zeros(points.shape[1])
    return np.where(span > 0, span, 1.0)


def dominated(points: Vector, clearly: float = CLEARLY) -> Vector:
    """Return which points (P, C) another is better than in every criterion in which the two differ (P,).

    Better is what is so by `clearly` of the extent: where a front is steep, less is in solvers' last digits.
    """
    better_by = (points[:, None, :] - points[None, :, :]) / extents(points)  # [i, j]: what j is better by than i
    better, same = better_by > clearly, np.abs(better_by) <= SAME
    return np.asarray((np.all(better | same, axis=2) & np.any(better, axis=2)).any(axis=1))


def hypervolume(points: Vector, reference: Vector) -> float:
    """Return the measure of what lies between points (P, 2) or (P, 3) and a reference point (C,), and is dominated."""
    inside = points[np.all(points < reference, axis=1)]
    if not len(inside):
        return 0.0
    if points.shape[1] == 2:
        rising = inside[np.argsort(inside[:, 0])]
        lowest = np.minimum.accumulate(rising[:, 1])
        widths = np.diff(np.append(rising[:, 0], reference[0]))
        return float(widths @ (reference[1] - lowest))
    layers = np.unique(inside[:, -1])
    heights = np.diff(np.append(layers, reference[-1]))
    areas = [hypervolume(inside[inside[:, -1] <= layer, :-1], reference[:-1]) for layer in layers]
    return float(heights @ np.array(areas))


def off_weighted_sums(points: Vector, sums: Vector, ratios: Vector) -> Vector:
    """Return how far points (P, 2) lie outside of what weighted sums (M, 2) say of the front, over its extent (P,).

    The optimum of J_1 + r J_2 leaves nothing below the line of that slope through it, and a convex front does not rise
    above the chords between such optima. Between both a point agrees with them: 0. Positive, it lies above the chords,
    on a part that is not convex and that no weights lead to; negative, it lies below a line, and the optimum was none.

    Args:
        points: (J_1, J_2) of each point.
        sums: (J_1, J_2) of each weighted sum's optimum.
        ratios: omega_2 / omega_1 of each (M,).
    """
    known = np.isfinite(sums).all(axis=1)
    if not known.any():
        return np.full(len(points), np.nan)
    span = extents(sums)
    at, found, normals = (
        points / span,
        sums[known] / span,
        np.column_stack([np.ones(known.sum()), ratios[known]]) * span,
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    below = np.max(np.sum(normals * (found - at[:, None, :]), axis=2), axis=1)
    above = np.array([_above_chords(point, found) for point in at])
    return np.where(np.isnan(at).any(axis=1), np.nan, np.maximum(above, 0.0) - np.maximum(below, 0.0))


def _above_chords(point: Vector, front: Vector) -> float:
    """Return how far a point (2,) lies above the chords of a front (M, 2) that falls; 0 beyond its ends."""
    front = front[np.lexsort((front[:, 0], front[:, 1]))]  # rising in J_2
    if not front[0, 1] < point[1] < front[-1, 1]:
        return 0.0
    upper = int(np.searchsorted(front[:, 1], point[1]))
    start, along = front[upper - 1], front[upper] - front[upper - 1]
    away = point - start
    return float((away[0] * along[1] - away[1] * along[0]) / np.linalg.norm(along))
