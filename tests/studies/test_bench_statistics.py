import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.studies.bench_statistics import exponent, spread


@given(st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=30))
def test_percentiles_lie_in_order_between_the_extremes(values: list[float]) -> None:
    found = spread(values)
    assert found.count == len(values)
    ordered = [found.least, found.median, found.p95, found.p99, found.largest]
    assert all(a <= b * (1 + 1e-12) for a, b in pairwise(ordered))


def test_nothing_spreads_nowhere() -> None:
    found = spread([])
    assert found.count == 0
    assert math.isnan(found.median) and math.isnan(found.largest)


@given(st.floats(-2, 4), st.floats(1e-4, 1e2))
def test_the_exponent_of_a_power_law_is_found(power: float, factor: float) -> None:
    sizes = [25.0, 50.0, 100.0, 200.0]
    assert exponent(sizes, factor * np.array(sizes) ** power) == pytest.approx(power, abs=1e-6)


@pytest.mark.parametrize("sizes", [[], [25.0], [25.0, 25.0]])
def test_one_size_has_no_exponent(sizes: list[float]) -> None:
    assert math.isnan(exponent(sizes, [1.0] * len(sizes)))
