"""Checks the numbers in the prose of the front pages against the files they come from, and prints them as a table.

    python benchmarks/prose_numbers.py

prose_numbers.yaml has, by page, fragments of its sentences, each with the source of its numbers. Prose is what stands
outside tables that a command writes (pages.py), code blocks, images and link targets. The exit code is 1, and each
fault one line, if a number has no source, a fragment is not on its page, or a number differs from its source.
"""

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, Literal

import yaml
from pages import BLOCK, ROOT, markdown
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

ENTRIES = Path(__file__).with_suffix(".yaml")

NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:,\d{3})*(?:\.\d+)?(?:e[-+]?\d+)?(?!-?[A-Za-z_]|\d|\.\d)")
"""A number by itself: the digits of `3-D` or `HDF5` are parts of words."""

NOT_PROSE = (
    BLOCK,
    re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE),
    re.compile(r"!\[[^\]]*\]\([^)]*\)"),
    re.compile(r"\]\([^)]*\)"),
)
"""Tables, code blocks, images, link targets."""


# ------------------------------------------------------------------------------------------------- sources


class Source(BaseModel):
    """Where the numbers of a fragment come from. `str` names it; paths are relative to the project."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def read(self, fragment: str) -> str:
        """Return the text whose numbers, from the first on, are those of the fragment; LookupError without one."""
        raise NotImplementedError


class Cell(Source):
    """The only cell of a page's tables in a row that begins with these cells and in a column of this name."""

    page: str
    table: str = ""
    """Command of the table; without it all tables of the page count."""
    row: str
    column: str
    after: str = ""
    """What the number follows in the cell."""

    def read(self, fragment: str) -> str:
        """Return the cell, or what follows `after` in it."""
        beginning = f"{self.row} | "
        rows = (row for row in table_rows(self.page, self.table) if " | ".join(row.values()).startswith(beginning))
        found = [row[self.column] for row in rows if self.column in row]
        if len(found) != 1:
            raise LookupError(f"{len(found)} cells")
        return found[0][found[0].index(self.after) :]

    def __str__(self) -> str:
        return f"{self.page}: {', '.join(filter(None, (self.table, self.row, self.column)))}"


class Key(Source):
    """The value of a key of a YAML file, its path joined by dots, with indices of lists."""

    file: str
    key: str

    def read(self, fragment: str) -> str:
        """Return the value as text."""
        value: Any = yaml.safe_load((ROOT / self.file).read_text(encoding="utf-8"))
        for part in self.key.split("."):
            value = value[int(part) if isinstance(value, list) else part]
        return str(value)

    def __str__(self) -> str:
        return f"{self.file}: {self.key}"


class Matched(Source):
    """The only match of a regular expression in a file; its groups are the numbers."""

    file: str
    pattern: str

    def read(self, fragment: str) -> str:
        """Return the groups of the match."""
        found = list(re.finditer(self.pattern, (ROOT / self.file).read_text(encoding="utf-8")))
        if len(found) != 1:
            raise LookupError(f"{len(found)} matches")
        return " ".join(found[0].groups())

    def __str__(self) -> str:
        return f"{self.file}: {self.pattern}".replace("|", "\\|")


class Computed(Source):
    """What a function of this script computes."""

    function: str

    def read(self, fragment: str) -> str:
        """Return the result as text."""
        return str(FUNCTIONS[self.function]())

    def __str__(self) -> str:
        return f"{self.function}: {(FUNCTIONS[self.function].__doc__ or '').splitlines()[0]}"


class Given(Source):
    """A definition or a quotation, with the reason why it has no file."""

    given: str

    def read(self, fragment: str) -> str:
        """Return the fragment."""
        return fragment

    def __str__(self) -> str:
        return f"given: {self.given}"


def table_rows(page: str, command: str = "") -> Iterator[dict[str, str]]:
    """Yield the rows of a page's tables, or of those that a command writes, as cells by column."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if command:
        text = "".join(match[2] for match in BLOCK.finditer(text) if match[1] == command)
    columns: list[str] = []
    for line in text.splitlines():
        if not line.startswith("|"):
            columns = []
            continue
        cells = [cell.strip() for cell in line.strip()[1:-1].split("|")]
        if not columns:
            columns = cells
        elif not line.startswith(("|---", "| ---")):
            yield dict(zip(columns, cells, strict=False))


def published_claims() -> int:
    """Count the published claims of psmpc_cli/paper/claims.yaml, without those that stand apart."""
    claims = yaml.safe_load((ROOT / "psmpc_cli" / "paper" / "claims.yaml").read_text(encoding="utf-8"))
    return sum("apart" not in claim for claim in claims)


def detumble_costs() -> list[Decimal]:
    """Return the costs J of docs/detumble.md, of the independent optimum first."""
    return [Decimal(row["J"]) for row in table_rows("docs/detumble.md", "detumble.py table")]


def detumble_difference() -> Decimal:
    """Return the largest difference of a cost J of docs/detumble.md from the independent optimum's [%]."""
    optimum, *costs = detumble_costs()
    largest = max(abs(cost - optimum) for cost in costs)
    return round(100 * largest / optimum, 3)


def detumble_limit() -> Decimal:
    """Return the mean of both costs J of docs/detumble.md on the finest mesh."""
    return sum(detumble_costs()[-2:]) / Decimal(2)


def shares_of_late_decisions() -> list[Decimal]:
    """Return the share of late decisions in each built-in task of docs/performance.md [%], ascending."""
    rows = table_rows("docs/performance.md", "performance_table.py tasks")
    return sorted(100 * Decimal(row["late"]) / Decimal(row["samples"]) for row in rows)


def tasks_in_time() -> str:
    """Count the built-in tasks of docs/performance.md in which no decision is late, of all."""
    shares = shares_of_late_decisions()
    return f"{shares.count(Decimal(0))} of {len(shares)}"


def late_share() -> Decimal:
    """Return the second largest share of late decisions in a built-in task of docs/performance.md [%]."""
    return shares_of_late_decisions()[-2]


FUNCTIONS: Mapping[str, Callable[[], object]] = {
    function.__name__: function
    for function in (published_claims, detumble_difference, detumble_limit, tasks_in_time, late_share)
}


# ------------------------------------------------------------------------------------------------- entries


class Entry(BaseModel):
    """A fragment of a page's prose, at all its places, with the source of its numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    text: str
    source: Cell | Key | Matched | Computed | Given = Field(alias="from")
    relation: Literal["equal", "decrease", "percent saved", "bound"] = "equal"


RELATIONS: Mapping[str, Callable[[Decimal, Decimal, Decimal], bool]] = {
    "equal": lambda stated, value, half: abs(stated - value) <= half,
    "decrease": lambda stated, value, half: abs(stated + value) <= half,
    "percent saved": lambda stated, value, half: abs(stated - 100 * (1 - value)) <= half,
    "bound": lambda stated, value, half: value <= stated,
}
"""Whether a number of the prose agrees with its source's, given half of the unit of the number's last digit."""


def decimal(number: str) -> Decimal:
    """Return a number as it is written; its exponent is that of its last digit."""
    return Decimal(number.replace(",", ""))


def prose(text: str) -> str:
    """Return the text of a page with blanks for what is not prose, so that places stay the same."""
    for pattern in NOT_PROSE:
        text = pattern.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    return text


def agrees(entry: Entry, stated: Sequence[str], source: str) -> bool:
    """Return whether the numbers of a fragment are the first ones of its source, at the digits given."""
    values = NUMBER.findall(source)
    if len(values) < len(stated):
        return False
    for number, value in zip(stated, values, strict=False):
        unit = Decimal(1).scaleb(int(decimal(number).as_tuple().exponent))
        if not RELATIONS[entry.relation](decimal(number), decimal(value), unit / 2):
            return False
    return True


def check(entries: Mapping[str, Iterable[Entry]]) -> tuple[list[dict[str, str]], list[str]]:
    """Check entries by page; return the rows of the table and the faults, a line each."""
    rows = []
    faults = []
    for page, of_page in entries.items():
        text = prose((ROOT / page).read_text(encoding="utf-8"))
        numbers = list(NUMBER.finditer(text))
        covered: set[int] = set()
        for entry in of_page:
            words = r"\s+".join(map(re.escape, entry.text.split()))
            places = list(re.finditer(words, text))
            if not places:
                faults.append(f"{page}: '{entry.text}' is not in the prose")
            for place in places:
                where = f"{page}:{line_of(text, place.start())}"
                inside = [each for each in numbers if place.start() <= each.start() and each.end() <= place.end()]
                covered.update(each.start() for each in inside)
                try:
                    source = entry.source.read(entry.text)
                except (LookupError, TypeError, ValueError, OSError) as error:
                    faults.append(f"{where}: '{entry.text}' has no source in {entry.source} ({error})")
                    continue
                if not inside:
                    faults.append(f"{where}: '{entry.text}' holds no number")
                elif not agrees(entry, [each[0] for each in inside], source):
                    faults.append(f"{where}: '{entry.text}' differs from '{source}' in {entry.source}")
                value = source if entry.relation == "equal" else f"{source} ({entry.relation})"
                rows.append({"page": where, "text": entry.text, "from": str(entry.source), "value": value})
        for number in numbers:
            if number.start() not in covered:
                faults.append(f"{page}:{line_of(text, number.start())}: {number[0]} has no source")
    return rows, faults


def line_of(text: str, place: int) -> int:
    """Return the number of the line at a place of a text, from 1."""
    return text.count("\n", 0, place) + 1


def main() -> int:
    """Print the table and the faults; return how many faults there are."""
    entries = TypeAdapter(dict[str, list[Entry]]).validate_python(yaml.safe_load(ENTRIES.read_text(encoding="utf-8")))
    rows, faults = check(entries)
    for line in markdown(rows):
        print(line)
    for fault in faults:
        print(fault, file=sys.stderr)
    return len(faults)


if __name__ == "__main__":
    raise SystemExit(min(main(), 1))
