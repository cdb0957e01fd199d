"""The tables of README.md and docs/ are what their commands print, and so is the tutorial; none is by hand."""

import re
import shlex
import subprocess
import sys
from itertools import chain
from pathlib import Path

import pytest
from typer.main import get_command

from psmpc_cli.cli.app import app
from psmpc_cli.figures import registry
from psmpc_cli.logs.schema import SCHEMA
from psmpc_cli.paper.figures import ABLATIONS
from psmpc_cli.report.texts import MEASURES
from psmpc_cli.specs.robots.robot import PlanarRobot, SpatialRobot, UrdfRobot
from psmpc_cli.specs.task import TaskSpec

from ..cli.command import Psmpc
from .pages import PAGES, ROOT, TABLE, tables

BENCHMARKS = ROOT / "benchmarks"
TABLES = list(tables())
QUICK = "tables.py"
"""The script whose tables take seconds."""


def run_benchmark(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a script of benchmarks/."""
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=BENCHMARKS, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_quick_tables_are_what_their_commands_print() -> None:
    """All but those of `posed`, of which a row is computed below."""
    names = {" ".join(command.split()[:2]) for _, command, _ in TABLES if command.startswith(QUICK)}
    ran = run_benchmark("pages.py", "--check", *(names - {f"{QUICK} posed"}))
    assert (ran.returncode, ran.stdout) == (0, ""), "python benchmarks/pages.py --quick writes them anew"


@pytest.mark.slow
def test_a_row_of_a_table_of_missions_is_what_its_command_prints() -> None:
    (table,) = (text for _, command, text in TABLES if command == f"{QUICK} posed")
    ran = run_benchmark("tables.py", "posed", "hard")
    heading, rule, row = ran.stdout.splitlines()
    assert table.startswith(f"{heading}\n{rule}\n") and f"\n{row}\n" in table, f"python benchmarks/pages.py {QUICK}"


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_no_table_of_numbers_is_by_hand(page: Path) -> None:
    by_hand = TABLE.sub("", page.read_text(encoding="utf-8"))
    assert "<!-- table:" not in by_hand
    rows = [line.strip("| ").split("|") for line in by_hand.splitlines() if line.startswith("|")]
    assert [row for row in rows if sum(bool(re.match(r" *-?\d", cell)) for cell in row) > 1] == []


def test_the_script_of_every_table_is_there() -> None:
    scripts = {command.split()[0] for _, command, _ in TABLES} - {"psmpc"}
    assert [script for script in scripts if not (BENCHMARKS / script).is_file()] == []


def test_every_key_and_every_dataset_is_in_a_table() -> None:
    commands = [command for _, command, _ in TABLES]
    roots = (TaskSpec, PlanarRobot, SpatialRobot, UrdfRobot)
    models = {name for root in roots for name in (root.__name__, *root.model_json_schema()["$defs"])}
    assert sorted(f"{QUICK} keys {model}" for model in models) == sorted(c for c in commands if f"{QUICK} keys" in c)
    datasets = "".join(text for _, command, text in TABLES if f"{QUICK} datasets" in command)
    listed = re.findall(r"^\| `([\w/]+)` \|", datasets, re.MULTILINE)
    assert sorted(listed) == sorted(column.path for column in SCHEMA if not column.is_scale)


def test_every_command_is_in_the_reference_of_the_command_line() -> None:
    commands = [command for page, command, _ in TABLES if page.name == "command_line.md"]
    names = vars(get_command(app))["commands"]
    assert sorted(f"{QUICK} options {name}" for name in names) == sorted(c for c in commands if "options" in c)


def test_every_row_of_a_summary_is_explained_once() -> None:
    page = (ROOT / "docs" / "summary.md").read_text(encoding="utf-8")
    rows_of_measures = page.partition("## End and solves")[2].partition("## Monitors")[0]
    explained = re.findall(r"^\| `(.+?)` \| ", rows_of_measures.replace(r"\|", "/"), re.MULTILINE)
    assert sorted(explained) == sorted(measure.label.replace("|", "/") for measure in MEASURES)


DIGITS = re.compile(r"\d+\.\d+(e[+-]\d+)?|\d+e[+-]\d+|(?<=after )\d+")
"""Numbers that rounding on another machine may change: decimals, and counts of iterations."""


def outline(text: str) -> list[str]:
    """What a command prints without such numbers: of tables the names of the rows, of iterations nothing."""
    lines = [re.split(r" {2,}", DIGITS.sub("#", line).strip())[0] for line in text.splitlines()]
    return [line for line in lines if not line.isdigit()]


def results(text: str) -> dict[str, float]:
    """Objective and switch times of a horizon as they were logged, by name."""
    return {
        name: float(value) for name, value in re.findall(r"^(objective J|\w+ ends \[s\]) +(\S+)", text, re.MULTILINE)
    }


@pytest.mark.slow
def test_the_page_on_repeating_a_run_prints_the_run_there_is(tmp_path: Path, psmpc: Psmpc) -> None:
    """Other builds change the numbers by far less than 1e-3, and another run by more.

    The run of fatrop is not repeated: of its table all but decimals is what the one above it has.
    """
    shown = {command: text for page, command, text in TABLES if page.name == "repeat.md"}
    replayed, verified, by_fatrop = shown
    assert "solver=fatrop" in by_fatrop
    of_sqp, of_fatrop = (
        [line for line in outline(shown[each]) if "psmpc" not in line] for each in (verified, by_fatrop)
    )
    assert of_fatrop == of_sqp
    printed: dict[str, str] = {}
    for command, text in ((command, shown[command]) for command in (replayed, verified)):
        for line in command.split(" && "):
            if line not in printed:
                ran = psmpc(*shlex.split(line)[1:])
                assert ran.code == 0, line
                output = f"\n```text\n{ran.stdout}```\n" if ran.stdout else ""
                printed[line] = f"\n```sh\n{line}\n```\n{output}"
        now = "".join(printed[line] for line in command.split(" && ")).removeprefix("\n")
        assert outline(now) == outline(text), "python benchmarks/pages.py repeat.md writes the page anew"
        assert results(now) == pytest.approx(results(text), rel=1e-3)
    assert results("".join(shown.values())).keys() >= {"objective J", "approach ends [s]"}


@pytest.mark.slow
def test_the_long_tables_are_those_of_the_results() -> None:
    differ = "[name for name, text in long_tables().items() if (LONG_TABLES / name).read_text() != text]"
    ran = run_benchmark("-c", f"from missions import long_tables; from pages import LONG_TABLES; print({differ})")
    assert (ran.returncode, ran.stdout) == (0, "[]\n"), "python benchmarks/missions.py files writes them anew"


@pytest.mark.slow
def test_who_follows_a_page_sees_what_it_shows() -> None:
    ran = run_benchmark("tutorial.py", "--check")
    assert (ran.returncode, ran.stdout) == (0, ""), "python benchmarks/tutorial.py writes the page anew"


def test_the_gallery_has_every_figure() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    of_the_paper = ["presence", "monitors", "schedule", *(f"ablation_{name}" for name in ABLATIONS)]
    names = [*chain.from_iterable(registry.FIGURES.values()), *of_the_paper]
    assert [name for name in names if f"_{name}.png)" not in page] == []


def test_captions_of_the_gallery_are_sentences() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    captions = re.findall("<figcaption>(.*?)</figcaption>", page)
    for figures in registry.FIGURES.values():
        assert {figure.caption for figure in figures.values()} <= set(captions)
    for caption in captions:
        assert re.fullmatch(r"[A-Z][^_]*[^_.]\.", caption), caption
        assert len(caption.split()) > 5, caption
