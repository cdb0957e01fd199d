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


def format_number(value: float, resolution: float = 0.0, sign: str = "") -> str:
    """Write a number with as many digits as mean something, given how accurately it is known.

    Args:
        value: The number; an integer is written as it is, NaN as a dash.
        resolution: Differences smaller than this mean nothing; 0 if that is not known, which leaves `DIGITS` digits.
        sign: "+" writes the sign of positive numbers too.

    Returns:
        The number in fixed notation, or with an exponent if one of its digits is more than `FIXED` places from the
        point.
    """
    if isinstance(value, int):
        return f"{value:{sign}d}"
    if not math.isfinite(value):
        return "-" if math.isnan(value) else f"{value:{sign}}"
    last_power = last_place(value, resolution)  # of ten, of the last digit
    first_power = max(_first_place(value), last_power)
    if -last_power > FIXED or first_power > FIXED:
        return f"{value:{sign}.{first_power - last_power}e}"
    rounded = round(value, -last_power) + 0.0  # adding 0 makes -0.0 to 0.0
    return f"{rounded:{sign}.{max(-last_power, 0)}f}"


def last_place(value: float, resolution: float = 0.0) -> int:
    """Return the power of ten of the last digit of a number that `format_number` writes."""
    if resolution > 0:
        return math.floor(math.log10(resolution) + 1e-9)  # 0.001 and its like are not exactly powers of ten
    return _first_place(value) - DIGITS + 1


def _first_place(value: float) -> int:
    """Return the power of ten of the first digit of a number that is rounded to `DIGITS` digits; 0 of 0."""
    return int(f"{value:.{DIGITS - 1}e}".partition("e")[2])


def with_unit(text: str, unit: str) -> str:
    """Write a unit behind a number, none where the number has none."""
    return text if unit in ("", "1") or text in EMPTY else f"{text} {unit}"


def format_quantiles(values: np.ndarray, probabilities: tuple[float, ...]) -> tuple[str, ...]:
    """Write quantiles of random draws, with no more digits than so few draws justify.

    The number of draws below a quantile is binomial, with the standard deviation sqrt(p (1 - p) / K) as a fraction of
    K. Half the difference of the quantiles that much to both sides is taken as the resolution. (Distribution-free;
    David and Nagaraja, Order Statistics, 2003, section 7.1.)

    Args:
        values: The draws (K,).
        probabilities: Which quantiles, each in [0, 1].

    Returns:
        The quantiles as texts, one for each probability; dashes if there are no draws.
    """
    if not len(values):
        return ("-",) * len(probabilities)
    texts = []
    for probability in probabilities:
        deviation = math.sqrt(probability * (1 - probability) / len(values))
        around = np.clip([probability - deviation, probability, probability + deviation], 0, 1)
        low, quantile, high = np.quantile(values, around)
        resolution = float(high - low) / 2
        resolution_of_digits = 10.0 ** last_place(float(quantile))  # not finer, even if all draws are the same
        texts.append(format_number(float(quantile), max(resolution, resolution_of_digits)))
    return tuple(texts)
