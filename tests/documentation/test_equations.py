"""docs/formulation.md says of every numbered equation where it is and what tests it, by names that exist."""

import ast
import re

import pytest

from .pages import ROOT

ROW = re.compile(
    r"^\| \((\d+)\) \| [^|]+ \| `([\w/.]+)` \| `(\w+)` \| ([^|]+) \| `([\w/.]+)::(test_\w+)` \|$", re.MULTILINE
)
PAGE = (ROOT / "docs" / "formulation.md").read_text(encoding="utf-8").partition("## 10. Equation by equation")[2]
EQUATIONS = [tuple(row) for row in ROW.findall(PAGE)]

VERDICTS = ("same", "departs")


def names_in(path: str) -> set[str]:
    """The classes and functions of a file, also those inside classes."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef | ast.FunctionDef)}


def test_all_equations_of_the_paper_are_there_in_their_order() -> None:
    assert [int(number) for number, *_ in EQUATIONS] == list(range(1, 33))


@pytest.mark.parametrize(("number", "path", "name", "verdict", "file_of_test", "test"), EQUATIONS)
def test_the_place_of_an_equation_and_its_test_exist(
    number: str, path: str, name: str, verdict: str, file_of_test: str, test: str
) -> None:
    assert name in names_in(f"psmpc_cli/{path}"), number
    assert verdict.startswith(VERDICTS), number
    assert test in names_in(f"tests/{file_of_test}"), number
