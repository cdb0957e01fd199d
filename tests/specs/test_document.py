import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.specs.document import Data, Document, read, write

texts = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc", "Co", "Cn")), max_size=12)
scalars = st.none() | st.booleans() | st.integers(-(10**18), 10**18) | st.floats(allow_nan=False, allow_infinity=False)
words = st.sampled_from(["1e-3", "no", "yes", "0o17", ".inf", "~", "null", "30 deg", "a: b", "# a", "- a", "*a", "'"])
data = st.recursive(
    scalars | texts | words,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts | words, inner, max_size=4),
    max_leaves=12,
)


@given(data)
def test_written_data_reads_back_as_the_same(value: Data) -> None:
    document = read("written", write(value))
    assert document.faults == ()
    assert document.data == value
    assert json.dumps(document.data) == json.dumps(value)


@given(data)
def test_every_value_stands_where_its_entry_says(value: Data) -> None:
    document = read("written", write(value))
    lines = document.text.splitlines()
    for path, entry in document.entries.items():
        assert 1 <= entry.place.line <= len(lines) + 1
        if isinstance(document.value(path), int | float) and not isinstance(document.value(path), bool):
            assert lines[entry.place.line - 1][entry.place.column - 1 :].startswith(str(entry.written))


@given(st.text(alphabet="ab:-[]{}&*!|>'\"%@`#,? \n\t~0\x07\x85\u2028é", max_size=40))
def test_any_text_is_read_or_refused_with_a_reason(text: str) -> None:
    document = read("any", text)
    assert document.readable or document.faults


def test_aliases_are_copied() -> None:
    document = read("aliases", "a: &a {x: [1, 2]}\nb: *a\n")
    assert document.data == {"a": {"x": [1, 2]}, "b": {"x": [1, 2]}}
    assert document.entries[("b", "x", 1)] == document.entries[("a", "x", 1)]


def test_of_a_key_that_comes_twice_the_first_counts() -> None:
    document = read("twice", "a: 1\nb: 2\na: 3\n")
    assert document.data == {"a": 1, "b": 2}
    assert [problem.path for problem in document.faults] == [("a",)]


def test_path_that_is_not_there_is_looked_up_around_it() -> None:
    document = read("around", "a:\n  b: {c: 1}\n")
    assert document.entry(("a", "b", "x", 3)) == document.entry(("a", "b"))
    assert Document("empty", "").entry(("a",)).place.line == 1
    with pytest.raises(KeyError):
        document.value(("a", 0))
