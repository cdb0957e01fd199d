"""Tables of the documentation that programs write."""

from collections.abc import Iterable
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def write_between(page: str, marker: str, lines: Iterable[str]) -> None:
    """Put lines between `<!-- marker -->` and `<!-- end of marker -->` of a page of docs/, instead of those there.

    Raises:
        SystemExit: The page has no such place.
    """
    path, begin, end = DOCS / page, f"<!-- {marker} -->\n", f"<!-- end of {marker} -->"
    text = path.read_text(encoding="utf-8")
    before, found, rest = text.partition(begin)
    _, ended, after = rest.partition(end)
    if not (found and ended):
        raise SystemExit(f"{path}: found no place for the table of {marker}")
    path.write_text(before + begin + "".join(f"{line}\n" for line in lines) + end + after, encoding="utf-8")
