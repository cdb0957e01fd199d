"""Writes the tables of docs/log.md from the layout; the test beside it keeps the page in step.

python tests/logs/layout_tables.py          writes docs/log.md anew between its markers
"""

from pathlib import Path

from psmpc_cli.logs.layout import (
    COLUMNS,
    DISTURBANCE,
    DRAWN,
    FINAL_TRUE,
    LEVELS,
    PAYLOAD,
    PLANS,
    TABLES,
    TICKS,
    TRUE_STATE,
    Column,
    Table,
)

PAGE = Path(__file__).parents[2] / "docs" / "log.md"
SIZES = {"": "", "coordinate": ", n", "pose_coordinate": ", m", "stage": ", S", "momentum": ", 3"}


def table(rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table of datasets."""
    head = ["| dataset | shape | units | what |", "|---|---|---|---|"]
    return "\n".join([*head, *(f"| {' | '.join(row)} |" for row in rows)])


def columns(chosen: tuple[Column, ...], length: str) -> str:
    """Return the table of datasets with a row a sample or a tick."""
    return table([(f"`{c.path}`", f"({length}{SIZES[c.scale] or ','})", c.units, c.long_name) for c in chosen])


def fixed(chosen: tuple[Table, ...]) -> str:
    """Return the table of datasets that do not grow."""
    return table([(f"`{t.path}`", f"({', '.join(t.scales)})", t.units, t.long_name) for t in chosen])


def tables() -> dict[str, str]:
    """Return every table of the page by its marker."""
    plans = [(f"`{path}`", "(K, its longest)", "1", long_name) for path, long_name in PLANS]
    return {
        "samples": columns(COLUMNS, "K"),
        "levels": columns(LEVELS, "K"),
        "true state": columns(TRUE_STATE, "K"),
        "payload": columns(PAYLOAD, "K"),
        "disturbance": columns(DISTURBANCE, "K"),
        "ticks": columns(TICKS, "M"),
        "tables": fixed(TABLES),
        "final true": fixed(FINAL_TRUE),
        "drawn": fixed(DRAWN),
        "plans": table(plans),
    }


def filled(page: str) -> str:
    """Return the page with every table between its markers."""
    for name, text in tables().items():
        begin, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
        before, _, rest = page.partition(begin)
        _, _, after = rest.partition(end)
        page = f"{before}{begin}{text}{end}{after}"
    return page


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
