import json
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.specs.document import MOST_FAULTS, Data, Fault, Place, read, resolve, write
from psmpc_cli.specs.fields import number_or_angle

texts = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc", "Co", "Cn")), max_size=12)
scalars = st.none() | st.booleans() | st.integers(-(10**18), 10**18) | st.floats(allow_nan=False, allow_infinity=False)
words = st.sampled_from(["1e-3", "no", "yes", "0o17", ".inf", "~", "null", "30 deg", "a: b", "# a", "- a", "*a", "'"])
data = st.recursive(
    scalars | texts | words,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts | words, inner, max_size=4),
    max_leaves=12,
)


@given(data)
def test_written_data_is_read_as_the_same_and_every_number_is_at_its_position(value: Data) -> None:
    document = read("written", write(value))
    assert document.faults == ()
    assert json.dumps(document.data) == json.dumps(value)
    lines = document.text.splitlines()
    for path, entry in document.origins.items():
        assert 1 <= entry.place.line <= len(lines) + 1
        if isinstance(document.value(path), int | float) and not isinstance(document.value(path), bool):
            assert lines[entry.place.line - 1][entry.place.column - 1 :].startswith(str(entry.written))


@given(st.text(alphabet="ab:-[]{}&*!|>'\"%@`#,? \n\t~0\x07\x85\u2028é", max_size=40))
def test_any_text_is_read_or_rejected_with_a_reason(text: str) -> None:
    document = read("any", text)
    assert document.data is None or document.origins[()].place.line >= 1


def test_aliases_are_copied() -> None:
    document = read("aliases", "a: &a {x: [1, 2]}\nb: *a\n")
    assert document.data == {"a": {"x": [1, 2]}, "b": {"x": [1, 2]}}
    assert document.origins[("b", "x", 1)] == document.origins[("a", "x", 1)]
    assert document.origins[("b",)].key == Place(2, 1)


def test_the_first_of_equal_keys_counts_and_odd_keys_are_passed_over() -> None:
    document = read("twice", "a: 1\nb: 2\na: {c: [3]}\n[x, y]: {z: 4}\nd: 5\n")
    assert document.data == {"a": 1, "b": 2, "d": 5}
    assert [(fault.path, fault.place) for fault in document.faults] == [(("a",), Place(3, 1)), ((), Place(4, 1))]


@pytest.mark.parametrize(
    ("word", "meaning"),
    [
        *(("1e-3", 1e-3), ("1E3", 1e3), ("+.5", 0.5), ("-2.", -2.0), ("12", 12), ("-0", 0), ("010", 10)),
        *(("0o17", 15), ("0x1F", 31), (".inf", math.inf), ("-.INF", -math.inf), ("true", True), ("FALSE", False)),
        *(("", None), ("~", None), ("Null", None)),
    ],
)
def test_words_of_yaml_1_2(word: str, meaning: object) -> None:
    assert resolve(word) == meaning
    assert type(resolve(word)) is type(meaning)


@pytest.mark.parametrize("word", ["no", "yes", "on", "y", "tRUE", "1_000", "12:30", "0b11", "1e", "e3", "."])
def test_words_of_yaml_1_1_only_are_texts(word: str) -> None:
    assert resolve(word) == word


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(309, 10_000))
def test_numbers_mean_themselves_within_the_range_of_floats(number: float, digits: int) -> None:
    assert resolve(repr(number)) == number
    assert resolve("-" + "9" * digits) == -math.inf
    assert str(resolve(".NaN")) == "nan"


@given(st.floats(-1e6, 1e6))
def test_angles_have_units(number: float) -> None:
    assert number_or_angle(f"{number!r} deg") == number_or_angle(f"{number!r}°") == math.radians(number)
    assert number_or_angle(f"{number!r} rad") == number


def test_caret_is_under_the_value_behind_tabs_and_in_long_lines() -> None:
    document = read("f", "a: ['\t', 2]\n" + "b: [" + "1, " * 100 + "x]\n")
    for path, written in ((("a", 1), "2"), (("b", 100), "x")):
        line, caret = document.report([Fault(path, "found it")]).splitlines()[1:]
        assert line[caret.index("^")] == written
        assert len(line) <= 127


def test_faults_are_in_the_order_of_lines_once_and_not_too_many() -> None:
    faults = [Fault(("b",), "second"), Fault(("a",), "first"), Fault(("b",), "second")]
    assert re.findall("first|second", read("f", "a: 1\nb: 2\n").report(faults)) == ["first", "second"]
    document = read("f", "\n".join(f"k{i}: {i}" for i in range(80)))
    text = document.report([Fault((f"k{i}",), "found it") for i in range(80)])
    assert text.count("found it") == MOST_FAULTS
    assert text.endswith("f: 30 more problems")
