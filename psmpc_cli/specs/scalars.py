"""What a plain word of YAML 1.2 means, and angles with a unit."""

import math
import re

Scalar = None | bool | int | float | str

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_TRUE = frozenset({"true", "True", "TRUE"})
_FALSE = frozenset({"false", "False", "FALSE"})
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NOT_A_NUMBER = frozenset({".nan", ".NaN", ".NAN"})
_ANGLE = re.compile(r"([-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?) *(deg|rad|°)")

ANGLE_PATTERN = r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)? *(deg|rad|°)$"
"""`_ANGLE` as JSON Schema writes it."""

MOST_DIGITS = 300
"""Digits of an integer that is surely within the range of a float."""


def resolve(word: str) -> Scalar:
    """Return what an unquoted word means by the core schema of YAML 1.2; a number beyond a float's range is inf."""
    if word in _NULL:
        return None
    if word in _TRUE or word in _FALSE:
        return word in _TRUE
    if _INTEGER.fullmatch(word):
        return _integer(word)
    if _FLOAT.fullmatch(word):
        return float(word)
    if _INFINITE.fullmatch(word):
        return -math.inf if word.startswith("-") else math.inf
    return math.nan if word in _NOT_A_NUMBER else word


def _integer(word: str) -> int | float:
    """Return an integer, or +-inf if it has more digits than a float's range."""
    base = {"0o": 8, "0x": 16}.get(word[:2], 10)
    if len(word) > MOST_DIGITS:
        return -math.inf if word.startswith("-") else math.inf
    return int(word, base)


def angle(word: str) -> float | None:
    """Return the angle [rad] that a word such as `30 deg` means, or None if it is no angle."""
    match = _ANGLE.fullmatch(word)
    if match is None:
        return None
    number, unit = float(match[1]), match[2]
    return number if unit == "rad" else math.radians(number)
