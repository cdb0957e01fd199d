"""How numbers are written: the digits that mean something."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.logs.numbers import DIGITS, format_number, format_quantiles, with_unit


@pytest.mark.parametrize(
    ("value", "resolution", "text"),
    [
        (325.96, 0.0, "326"),
        (2973.4, 0.0, "2970"),
        (4.1699, 0.0, "4.17"),
        (0.0000268, 0.0, "2.68e-05"),
        (12345678.0, 0.0, "1.23e+07"),
        (10.0137, 0.01, "10.01"),
        (6.6, 0.01, "6.60"),
        (-0.004, 0.01, "0.00"),
        (1176.55, 60.0, "1180"),
        (3.0, 40.0, "0"),
        (3, 0.0, "3"),
        (0.0, 0.0, "0.00"),
        (0.99999, 0.0, "1.00"),
        (math.nan, 0.0, "-"),
        (math.inf, 0.0, "inf"),
    ],
)
def test_a_number_has_the_digits_that_mean_something(value: float, resolution: float, text: str) -> None:
    assert format_number(value, resolution) == text


@given(st.floats(-1e12, 1e12, allow_subnormal=False), st.sampled_from([0.0, 1e-3, 0.5, 100.0]))
def test_a_written_number_is_the_number_up_to_its_resolution(value: float, resolution: float) -> None:
    """Half of the last digit is at most half of the resolution, or of the last of `DIGITS` digits."""
    tolerance = max(resolution, 10.0 ** (1 - DIGITS) * abs(value)) / 2
    assert float(format_number(value, resolution)) == pytest.approx(value, rel=1e-9, abs=tolerance)


def test_units_stand_behind_numbers_that_have_one() -> None:
    assert [with_unit("4.17", unit) for unit in ("m", "1", "")] == ["4.17 m", "4.17", "4.17"]
    assert with_unit("-", "m") == "-"


def test_quantiles_of_few_draws_have_few_digits() -> None:
    draws = np.random.default_rng(0).normal(1176.55, 80.0, 4000)
    assert format_quantiles(draws[:3], (0.5,)) == ("1190",)
    assert format_quantiles(1e3 * draws[:3], (0.5,)) == ("1190000",)
    assert format_quantiles(np.array([28.01, 31.2, 45.3]), (0.5,)) == ("31",)
    assert format_quantiles(np.array([28.01, 131.2, 1145.3]), (0.5,)) == ("100",)
    assert format_quantiles(np.zeros(0), (0.05, 0.5)) == ("-", "-")
    assert format_quantiles(np.full(3, 31.2345), (0.5,)) == ("31.2",)
