import re

from psmpc_cli.specs.document import read
from psmpc_cli.specs.problem import Place, Problem
from psmpc_cli.specs.report import MOST_PROBLEMS, refusal, render, report


def test_caret_stands_under_the_value_behind_tabs_and_in_long_lines() -> None:
    document = read("f", "a: ['\t', 2]\n" + "b: [" + "1, " * 100 + "x]\n")
    assert render(document, Problem(("a", 1), "found 2")) == (
        "f:1:10: a[1]: found 2\n   1 | a: ['\t', 2]\n     |      \t   ^"
    )
    line, caret = render(document, Problem(("b", 100), "found x")).splitlines()[1:]
    assert line[caret.index("^")] == "x"
    assert len(line) <= 127


def test_problems_come_in_the_order_of_lines_and_once() -> None:
    document = read("f", "a: 1\nb: 2\n")
    problems = [Problem(("b",), "second"), Problem(("a",), "first"), Problem(("b",), "second")]
    assert re.findall("first|second", report(document, problems)) == ["first", "second"]


def test_many_problems_are_cut_short_and_counted() -> None:
    document = read("f", "\n".join(f"k{i}: {i}" for i in range(80)))
    text = report(document, [Problem((f"k{i}",), "found it") for i in range(80)])
    assert text.count("found it") == MOST_PROBLEMS
    assert text.endswith("f: 30 more problems")


def test_line_that_cannot_be_shown_is_left_out() -> None:
    document = read("f", "a: 1\n\n")
    assert render(document, Problem((), "here", Place(2, 1))) == "f:2:1: here"
    assert render(document, Problem((), "there", Place(9, 1))) == "f:9:1: there"


def test_refusal_joins_what_is_said() -> None:
    assert str(refusal("", "one", "", "two")) == "one\ntwo"
