"""The schema of a log, and docs/log.md, whose tables come from it.

python tests/logs/test_schema.py          writes the tables of docs/log.md anew between their markers
"""

import re
from pathlib import Path

from psmpc_cli.logs.schema import SCHEMA, table

PAGE = Path(__file__).parents[2] / "docs" / "log.md"
TABLE = re.compile(r"<!-- (time|ticks/tick|fixed)(?:, ([a-z ]+))? -->\n(.*?)\n<!-- end of ", re.DOTALL)


def filled(page: str) -> str:
    """Return the page with every table between its markers."""
    for along, only, text in TABLE.findall(page):
        page = page.replace(text, table("" if along == "fixed" else along, only))
    return page


def test_the_page_on_the_log_has_every_dataset_as_the_schema_has_it() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert filled(page) == page
    listed = re.findall(r"^\| `([\w/]+)` \|", page, re.MULTILINE)
    assert sorted(listed) == sorted(column.path for column in SCHEMA if not column.is_scale)


def test_every_dimension_has_its_scale() -> None:
    scales = {column.path for column in SCHEMA if column.is_scale} | {f"{c.path}_element" for c in SCHEMA if c.ragged}
    assert {dim for column in SCHEMA for dim in column.dims} == scales
    assert len({column.path for column in SCHEMA}) == len(SCHEMA)


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
