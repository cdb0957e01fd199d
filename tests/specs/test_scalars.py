import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.specs.fields import angle, resolve


@pytest.mark.parametrize(
    ("word", "meaning"),
    [
        ("1e-3", 1e-3),
        ("1E3", 1e3),
        ("+.5", 0.5),
        ("-2.", -2.0),
        ("12", 12),
        ("-0", 0),
        ("010", 10),
        ("0o17", 15),
        ("0x1F", 31),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("true", True),
        ("FALSE", False),
        ("", None),
        ("~", None),
        ("Null", None),
    ],
)
def test_words_of_yaml_1_2(word: str, meaning: object) -> None:
    assert resolve(word) == meaning
    assert type(resolve(word)) is type(meaning)


@pytest.mark.parametrize(
    "word", ["no", "yes", "on", "off", "y", "N", "tRUE", "1_000", "12:30", "0b11", "1e", "e3", "."]
)
def test_words_of_yaml_1_1_only_are_texts(word: str) -> None:
    assert resolve(word) == word


def test_not_a_number() -> None:
    assert isinstance(resolve(".nan"), float)
    assert math.isnan(float(str(resolve(".NaN"))))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_means_itself(number: float) -> None:
    assert resolve(repr(number)) == number


@given(st.integers(min_value=309, max_value=10_000))
def test_integers_beyond_the_range_of_floats_are_infinite(digits: int) -> None:
    assert resolve("9" * digits) == math.inf
    assert resolve("-" + "9" * digits) == -math.inf


@given(st.floats(-1e6, 1e6))
def test_angles_have_units(number: float) -> None:
    assert angle(f"{number!r} deg") == math.radians(number)
    assert angle(f"{number!r}°") == math.radians(number)
    assert angle(f"{number!r} rad") == number


@pytest.mark.parametrize("word", ["30", "deg", "30 degrees", "pi/6", "30 deg ", "thirty deg", "1,5 deg", "1_0 deg"])
def test_other_words_are_no_angles(word: str) -> None:
    assert angle(word) is None
