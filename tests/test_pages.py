"""The tables of README.md and docs/ are what their commands print, and so is the tutorial; none is by hand."""

import re
from itertools import chain
from pathlib import Path

import pytest
import tutorial
from pages import BLOCK, HERE, PAGES, QUICK, ROOT, blocks
from tables import models_of, table

from psmpc_cli.figures import registry
from psmpc_cli.logs.schema import SCHEMA
from psmpc_cli.paper.figures import ABLATIONS
from psmpc_cli.specs.robot import PlanarRobot, SpatialRobot, UrdfRobot
from psmpc_cli.specs.task import TaskSpec

BLOCKS = list(blocks())
QUICK_ONES = [block for block in BLOCKS if block[1].startswith(QUICK)]


@pytest.mark.parametrize(("page", "command", "text"), QUICK_ONES, ids=[command for _, command, _ in QUICK_ONES])
def test_a_quick_table_is_what_its_command_prints(page: Path, command: str, text: str) -> None:
    assert text == table(*command.split()[1:]), f"python benchmarks/pages.py --quick writes {page.name} anew"


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_no_table_of_numbers_is_by_hand(page: Path) -> None:
    by_hand = BLOCK.sub("", page.read_text(encoding="utf-8"))
    assert "<!-- table:" not in by_hand
    rows = [line.strip("| ").split("|") for line in by_hand.splitlines() if line.startswith("|")]
    assert [row for row in rows if sum(bool(re.match(r" *-?\d", cell)) for cell in row) > 1] == []


def test_the_script_of_every_table_is_there() -> None:
    scripts = {command.split()[0] for _, command, _ in BLOCKS} - {"psmpc"}
    assert [script for script in scripts if not (HERE / script).is_file()] == []


def test_every_key_and_every_dataset_is_in_a_table() -> None:
    commands = [command for _, command, _ in BLOCKS]
    models = {model for root in (TaskSpec, PlanarRobot, SpatialRobot, UrdfRobot) for model in models_of(root)}
    assert sorted(f"{QUICK} keys {model}" for model in models) == sorted(c for c in commands if f"{QUICK} keys" in c)
    datasets = "".join(text for _, command, text in BLOCKS if f"{QUICK} datasets" in command)
    listed = re.findall(r"^\| `([\w/]+)` \|", datasets, re.MULTILINE)
    assert sorted(listed) == sorted(column.path for column in SCHEMA if not column.is_scale)


@pytest.mark.slow
def test_who_follows_the_tutorial_sees_what_it_shows(tmp_path: Path) -> None:
    page = tutorial.PAGE.read_text(encoding="utf-8")
    # The widths of columns follow from solve times below the lines that are shown.
    assert re.sub(" +", " ", tutorial.follow(page, tmp_path)) == re.sub(" +", " ", page)
    assert [source for _, source in tutorial.FIGURE.findall(page) if not (tmp_path / source).is_file()] == []


def test_the_gallery_has_every_figure() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    of_the_paper = ["presence", "monitors", "schedule", *(f"ablation_{name}" for name in ABLATIONS)]
    names = [*chain.from_iterable(registry.FIGURES.values()), *of_the_paper]
    assert [name for name in names if f"<figcaption>{name}</figcaption>" not in page] == []
