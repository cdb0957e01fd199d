"""How-to pages are short, begin with whom they are for, and have no long tables."""

import re

import pytest
import yaml

from .pages import ROOT

LINES = 200
"""What a how-to page has at most."""

ROWS = 12
"""What a table in the reading path has at most."""

NAVIGATION = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
SECTIONS = {name: pages for section in NAVIGATION for name, pages in section.items()}
HOW_TO = [path for page in SECTIONS["How to"] for path in page.values()]


@pytest.mark.parametrize("page", HOW_TO)
def test_a_how_to_page_has_one_job(page: str) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    introduction, *_ = text.split("\n## ")
    assert re.search(r"^For ", introduction, re.MULTILINE), "it says first whom it is for"
    assert text.count("\n") <= LINES, "its model belongs to Concepts, its measurements to Results"
    longest = max((table.count("\n") for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)), default=0)
    assert longest - len(("head", "rule")) <= ROWS, "long tables belong to Reference, or into a CSV file"
