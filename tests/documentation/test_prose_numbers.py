"""The numbers in the prose of the front pages are those of their sources; the script that checks it notices others."""

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from .pages import ROOT

BENCHMARKS = ROOT / "benchmarks"

Faults = Callable[..., list[str]]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the script defines."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # which pages.py sets
    return runpy.run_path(str(BENCHMARKS / "prose_numbers.py"), run_name="prose_numbers")


@pytest.fixture
def faults(script: dict[str, Any], tmp_path: Path) -> Faults:
    """Checks a page of its own against entries; faults without the page's name."""

    def check(text: str, *entries: dict[str, Any]) -> list[str]:
        page = tmp_path / "page.md"
        page.write_text(text, encoding="utf-8")
        found = script["check"]({str(page): [script["Entry"].model_validate(entry) for entry in entries]})[1]
        return [fault.removeprefix(str(page)) for fault in found]

    return check


def test_every_number_of_the_front_pages_has_its_source(
    script: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert (script["main"](), capsys.readouterr().err) == (0, "")


@pytest.mark.parametrize(
    "text",
    [
        "A robot in 3-D, in HDF5.\n",
        "```\nmake 3\n```\n",
        "![At 8 s](figures/at_8.png)\n",
        "[A page](page.md#section-10)\n",
        "<!-- table: tables.py some -->\n| 1 |\n<!-- end -->\n",
    ],
)
def test_what_is_no_number_of_the_prose_needs_no_source(faults: Faults, text: str) -> None:
    assert faults(text) == []


@pytest.mark.parametrize("number", ["7", "-7.5", "1,000", "1e-11", "2.5e3"])
def test_a_number_without_a_source_is_named_with_its_line(faults: Faults, number: str) -> None:
    assert faults(f"It takes\n[about {number}](page.md).\n") == [f":2: {number} has no source"]


NODES = {"file": "tasks/transport.yaml", "key": "controller.nodes"}
"""100."""

CELL = {"page": "docs/reproduce.md", "table": "tables.py baseline", "row": "htmpc"}
"""A row of the table of the transport task, less its column."""


@pytest.mark.parametrize(
    ("text", "source", "relation"),
    [
        ("100 nodes", NODES, "equal"),
        ("at most 101 nodes", NODES, "bound"),
        ("2e-3 m", {"file": "tasks/transport.yaml", "key": "stages.0.ends_when.tolerance"}, "equal"),
        ("-2 m", {"file": "tasks/transport.yaml", "pattern": r"object: .*pose: \[([-.\d]+),"}, "equal"),
        ("2.5 m less", {"file": "tasks/transport.yaml", "pattern": r"object: .*pose: \[([-.\d]+),"}, "decrease"),
        ("99 % less", {"file": "tasks/transport.yaml", "key": "stages.3.priority"}, "percent saved"),
        ("28 claims", {"function": "published_claims"}, "equal"),
        ("7 dwarfs", {"given": "a tale"}, "equal"),
    ],
)
def test_a_number_agrees_at_the_digits_given(faults: Faults, text: str, source: dict[str, str], relation: str) -> None:
    entry = {"text": text, "from": source, "relation": relation}
    assert faults(text.replace(" ", "\n"), entry) == []


@pytest.mark.parametrize(
    ("text", "source", "relation"),
    [
        ("100.4 nodes", NODES, "equal"),
        ("100 to 200 nodes", NODES, "equal"),
        ("at most 99 nodes", NODES, "bound"),
        ("100 less", NODES, "decrease"),
        ("9 % less", {"file": "tasks/transport.yaml", "key": "stages.3.priority"}, "percent saved"),
    ],
)
def test_a_number_that_differs_is_named_with_its_source(
    faults: Faults, text: str, source: dict[str, str], relation: str
) -> None:
    (fault,) = faults(text, {"text": text, "from": source, "relation": relation})
    assert fault.startswith(f":1: '{text}' differs from '")
    assert "tasks/transport.yaml: " in fault


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (CELL, "0 cells"),
        (CELL | {"row": "psmpc"}, "0 cells"),
        ({"page": "docs/reproduce.md", "row": "no such row"}, "0 cells"),
        ({"file": "tasks/transport.yaml", "key": "controller.no_such_key"}, "no_such_key"),
        ({"file": "tasks/transport.yaml", "pattern": "no such text"}, "0 matches"),
        ({"file": "tasks/transport.yaml", "pattern": "name: ()"}, "5 matches"),
        ({"file": "tasks/no_such_file.yaml", "pattern": ""}, "No such file"),
    ],
)
def test_a_source_that_is_not_there_is_named(faults: Faults, source: dict[str, str], reason: str) -> None:
    column = {"column": "no such column"} if "page" in source else {}
    (fault,) = faults("100 nodes", {"text": "100 nodes", "from": source | column})
    assert fault.startswith(":1: '100 nodes' has no source in ")
    assert reason in fault


TABLE = """9.8 s

<!-- table: gaits.py times -->
| gait | legs | end [s] |
|---|---|---|
| trot | two | 9.80 of 12 |
| trot | four | 3.00 |
<!-- end -->
"""
"""A page with a number and a table."""


@pytest.mark.parametrize(
    ("text", "row", "more", "expected"),
    [
        ("9.8 s", "trot | two", {}, []),
        ("9.8 s", "trot | two", {"table": "gaits.py times"}, []),
        ("12 s", "trot | two", {"after": "of"}, []),
        ("9.8 s", "trot | four", {}, ["differs from '3.00'"]),
        ("9.8 s", "trot", {}, ["(2 cells)"]),
        ("9.8 s", "tro", {}, ["(0 cells)"]),
        ("9.8 s", "trot | two", {"table": "gaits.py"}, ["(0 cells)"]),
    ],
)
def test_a_cell_is_found_by_the_first_cells_of_its_row(
    faults: Faults, tmp_path: Path, text: str, row: str, more: dict[str, str], expected: list[str]
) -> None:
    source = {"page": str(tmp_path / "page.md"), "row": row, "column": "end [s]", **more}
    found = faults(TABLE.replace("9.8 s", text, 1), {"text": text, "from": source})
    assert len(found) == len(expected)
    assert all(reason in fault for reason, fault in zip(expected, found, strict=True))


def test_a_text_that_is_not_on_the_page_is_named(faults: Faults) -> None:
    assert faults("None here.\n", {"text": "100 nodes", "from": NODES}) == [": '100 nodes' is not in the prose"]
    assert faults("No 1100 nodes.\n", {"text": "100 nodes", "from": NODES}) == [
        ":1: '100 nodes' holds no number",
        ":1: 1100 has no source",
    ]
