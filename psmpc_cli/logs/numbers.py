"""How numbers are written in tables and sentences: with the digits that mean something, and their unit."""

import math

import numpy as np

DIGITS = 3
"""Significant digits of a number whose resolution is not known."""

TIME = 0.01
"""Resolution of the times of stages and missions [s]."""

EMPTY = ("", "-")
"""Cells of tables without content."""

FIXED = 6
"""Largest power of ten, and smallest when negative, of digits that are written without an exponent."""


def number(value: float, resolution: float = 0.0, sign: str = "") -> str:
    """Write a number with the digits that mean something.

    Args:
        value: The number; an integer is written as it is, NaN as a dash.
        resolution: Differences smaller than this mean nothing; 0 if that is not known, which leaves `DIGITS` digits.
        sign: "+" writes the sign of positive numbers too.
    """
    if isinstance(value, int):
        return f"{value:{sign}d}"
    if not math.isfinite(value):
        return "-" if math.isnan(value) else f"{value:{sign}}"
    place = last_place(value, resolution)
    first = max(_first_place(value), place)
    if -place > FIXED or first > FIXED:
        return f"{value:{sign}.{first - place}e}"
    return f"{round(value, -place) + 0.0:{sign}.{max(-place, 0)}f}"


def last_place(value: float, resolution: float = 0.0) -> int:
    """Return the power of ten of the last digit of a number that `number` writes."""
    if resolution > 0:
        return math.floor(math.log10(resolution) + 1e-9)  # 0.001 and its like are not exactly powers of ten
    return _first_place(value) - DIGITS + 1


def _first_place(value: float) -> int:
    """Return the power of ten of the first digit of a number that is rounded to `DIGITS` digits; 0 of 0."""
    return int(f"{value:.{DIGITS - 1}e}".partition("e")[2])


def with_unit(text: str, unit: str) -> str:
    """Write a unit behind a number, none where the number has none."""
    return text if unit in ("", "1") or text in EMPTY else f"{text} {unit}"


def quantiles(values: np.ndarray, probabilities: tuple[float, ...]) -> tuple[str, ...]:
    """Write quantiles of draws (K,), with no more digits than so many draws give them; dashes without any.

    The number of draws below a quantile is binomial, with the standard deviation sqrt(p (1 - p) / K) as a share of K.
    Half of what the quantiles that much to both sides are apart is taken as the resolution. (Distribution-free; David
    and Nagaraja, Order Statistics, 2003, section 7.1.)
    """
    if not len(values):
        return ("-",) * len(probabilities)
    texts = []
    for p in probabilities:
        deviation = math.sqrt(p * (1 - p) / len(values))
        low, found, high = np.quantile(values, np.clip([p - deviation, p, p + deviation], 0, 1))
        finest = 10.0 ** last_place(float(found))
        texts.append(number(float(found), max(float(high - low) / 2, finest)))
    return tuple(texts)
