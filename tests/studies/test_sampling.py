"""Pairs of priorities: which ones a sweep tries."""

import numpy as np

from psmpc_cli.studies.sampling import parse_sampling

BOX = (1e-3, 1e3)


def test_the_papers_grid_has_49_distinct_ratios_and_they_are_those_of_49_ratios() -> None:
    grid, ratios = parse_sampling("25x25", BOX), parse_sampling("49", BOX)
    distinct = np.unique(np.round(np.log10(grid.ratio), 9))
    assert len(grid.omega) == 625
    assert len(distinct) == 49
    np.testing.assert_allclose(distinct, np.log10(ratios.ratio), atol=1e-9)


def test_random_draws_repeat_with_their_seed_and_stay_in_the_box() -> None:
    one, same, other = (parse_sampling("random:200", (0.1, 10.0), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.omega, same.omega)
    assert not np.array_equal(one.omega, other.omega)
    assert 0.1 <= one.omega.min() < one.omega.max() <= 10.0
    assert abs(np.log10(one.omega).mean()) < 0.2
