import re

from psmpc_cli.specs.document import MOST_FAULTS, read
from psmpc_cli.specs.messages import Fault, Place


def test_caret_is_under_the_value_behind_tabs_and_in_long_lines() -> None:
    document = read("f", "a: ['\t', 2]\n" + "b: [" + "1, " * 100 + "x]\n")
    assert document.report([Fault(("a", 1), "found 2")]) == (
        "f:1:10: a[1]: found 2\n   1 | a: ['\t', 2]\n     |      \t   ^"
    )
    line, caret = document.report([Fault(("b", 100), "found x")]).splitlines()[1:]
    assert line[caret.index("^")] == "x"
    assert len(line) <= 127


def test_faults_are_in_the_order_of_lines_and_once() -> None:
    faults = [Fault(("b",), "second"), Fault(("a",), "first"), Fault(("b",), "second")]
    assert re.findall("first|second", read("f", "a: 1\nb: 2\n").report(faults)) == ["first", "second"]


def test_many_faults_are_cut_short_and_counted() -> None:
    document = read("f", "\n".join(f"k{i}: {i}" for i in range(80)))
    text = document.report([Fault((f"k{i}",), "found it") for i in range(80)])
    assert text.count("found it") == MOST_FAULTS
    assert text.endswith("f: 30 more problems")


def test_line_that_is_empty_or_not_in_the_text_is_left_out() -> None:
    document = read("f", "a: 1\n\n")
    assert document.report([Fault((), "here", place=Place(2, 1))]) == "f:2:1: here"
    assert document.report([Fault((), "there", place=Place(9, 1))]) == "f:9:1: there"
