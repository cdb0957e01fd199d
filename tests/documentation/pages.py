"""README.md and docs/: the pages, and the tables between their comments."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

TABLE = re.compile(r"<!-- table: (.+?) -->\n(.*?)<!-- end -->", re.DOTALL)


def tables() -> Iterator[tuple[Path, str, str]]:
    """Page, command and text of every table."""
    for page in PAGES:
        for command, text in TABLE.findall(page.read_text(encoding="utf-8")):
            yield page, command, text
