"""What the points of fronts dominate, and how much."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from psmpc_cli.studies.fronts import dominated, hypervolume

CLOUDS = st.integers(2, 3).flatmap(
    lambda count: arrays(float, st.tuples(st.integers(1, 12), st.just(count)), elements=st.integers(0, 6).map(float))
)
"""Points on a coarse lattice, so that ties are frequent."""


@given(CLOUDS)
def test_what_is_not_dominated_is_never_better_in_every_criterion(points: np.ndarray) -> None:
    kept = points[~dominated(points)]
    assert len(kept)
    for one in kept:
        assert not np.any(np.all(points < one, axis=1))


@given(CLOUDS)
def test_every_dominated_point_is_worse_than_one_that_is_not(points: np.ndarray) -> None:
    marks = dominated(points)
    for one in points[marks]:
        assert np.any(np.all(points[~marks] <= one, axis=1) & np.any(points[~marks] < one, axis=1))


def test_what_could_not_be_solved_for_neither_dominates_nor_is_dominated() -> None:
    assert dominated(np.array([[np.nan, np.nan], [1.0, 1.0], [2.0, 2.0]])).tolist() == [False, False, True]
    assert hypervolume(np.array([[np.nan, np.nan], [1.0, 1.0]]), np.array([2.0, 3.0])) == 2.0


@given(CLOUDS)
def test_the_hypervolume_is_that_of_the_boxes_counted_one_by_one(points: np.ndarray) -> None:
    reference = np.full(points.shape[1], 6.0)
    cells = np.stack(np.meshgrid(*[np.arange(6.0)] * points.shape[1], indexing="ij"), axis=-1)
    covered = np.any([np.all(cells >= one, axis=-1) for one in points], axis=0)
    assert hypervolume(points, reference) == pytest.approx(covered.sum())
