"""Writes the tables of README.md and docs/, each of which stands between two comments; the first names its command.

    python benchmarks/pages.py                     all tables anew, `make docs-tables`; some hours, on a quiet machine
    python benchmarks/pages.py performance.md      those of a page, or those whose command contains the word
    python benchmarks/pages.py --quick             those of tables.py alone, some seconds
    python benchmarks/pages.py --check --quick     prints how they differ from the pages, and writes nothing

Between `<!-- table: COMMAND -->` and `<!-- end -->` stands what the command prints. It is a script of this folder with
its arguments, or commands of psmpc joined by `&&`, which run in a folder of their own and stand above what they print.
A command that fails and has printed nothing leaves its table as it is; the exit code is 1 if one has failed.
"""

import csv
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import unified_diff
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # for all processes that are started here

HERE = Path(__file__).parent
ROOT = HERE.parent

LONG_TABLES = HERE / "results"
"""Where tables too long for a page are, as CSV files."""

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

BLOCK = re.compile(r"<!-- table: (.+?) -->\n(.*?)<!-- end -->", re.DOTALL)

QUICK = "tables.py"
"""The script whose tables take seconds; a test compares them with the pages."""

PSMPC = [sys.executable, "-c", "from psmpc_cli.cli.main import main; main()"]


PIPE = "\\|"
"""A vertical bar inside a cell."""


def markdown(rows: Iterable[Iterable[object]], *headings: str) -> Iterator[str]:
    """Yield the lines of a table in Markdown as its rows come: each is cells, or cells by heading."""
    for number, row in enumerate(rows):
        cells = row if isinstance(row, Mapping) else dict(zip(headings, row, strict=True))
        if number == 0:
            headings = tuple(cells)
            yield f"| {' | '.join(headings)} |"
            yield "|" + "---|" * len(headings)
        yield f"| {' | '.join(str(cells.get(heading, '')).replace('|', PIPE) for heading in headings)} |"


def as_csv(rows: Iterable[Mapping[str, object]]) -> str:
    """Return rows, each with its cells by heading, as CSV; a row may lack cells."""
    rows = list(rows)
    columns = dict.fromkeys(name for row in rows for name in row)
    file = StringIO()
    writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue()


def write_long_tables(texts: Mapping[str, str]) -> Iterator[str]:
    """Write CSV files below `LONG_TABLES` and yield the table that names them."""
    LONG_TABLES.mkdir(exist_ok=True)
    rows = []
    for name, text in texts.items():
        (LONG_TABLES / name).write_text(text, encoding="utf-8")
        rows.append({"file": f"`{LONG_TABLES.relative_to(ROOT)}/{name}`", "rows": text.count("\n") - 1})
    yield from markdown(rows)


def command_line(*functions: Callable[..., Iterable[str]]) -> None:
    """Print the lines of the function that a script's command line names, perhaps with arguments, as they come."""
    name, *words = sys.argv[1:]
    for line in {each.__name__: each for each in functions}[name](*words):
        print(line, flush=True)


def run_psmpc(line: str, folder: Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a line such as `psmpc check transport` in a folder and return how it ended, with what it printed."""
    arguments = [*PSMPC, *shlex.split(line)[1:]]
    return subprocess.run(arguments, cwd=folder, text=True, stdout=subprocess.PIPE, **options)


def blocks() -> Iterator[tuple[Path, str, str]]:
    """Yield page, command and text of every table."""
    for page in PAGES:
        for command, text in BLOCK.findall(page.read_text(encoding="utf-8")):
            yield page, command, text


def write(page: Path, command: str, text: str) -> None:
    """Replace the text of a command's tables on a page."""

    def replaced(match: re.Match[str]) -> str:
        return f"<!-- table: {command} -->\n{text}<!-- end -->" if match[1] == command else match[0]

    page.write_text(BLOCK.sub(replaced, page.read_text(encoding="utf-8")), encoding="utf-8")


def output(command: str) -> tuple[str, bool]:
    """Run a command; return what stands on the page, and whether it succeeded."""
    script, *words = command.split()
    if script == QUICK:  # in this process, since there are many
        from tables import table

        return table(*words), True
    if script != "psmpc":
        ran = subprocess.run([sys.executable, HERE / script, *words], stdout=subprocess.PIPE, text=True, check=False)
        return ran.stdout, ran.returncode == 0
    text, succeeded = "", True
    with TemporaryDirectory() as folder:
        for line in command.split(" && "):
            ran = run_psmpc(line, Path(folder))
            text += shown(line, ran.stdout)
            succeeded &= ran.returncode == 0
    return text.removeprefix("\n") if succeeded else "", succeeded


def shown(line: str, printed: str) -> str:
    """Return the blocks of a page that show a command, which can be pasted, and what it printed."""
    return f"\n```sh\n{line}\n```\n" + (f"\n```text\n{printed}```\n" if printed else "")


def differs(page: Path, command: str, text: str) -> bool:
    """Print how the text of a table differs from what its command prints now; return whether it does."""
    now, _ = output(command)
    lines = [each.splitlines(keepends=True) for each in (text, now)]
    sys.stdout.writelines(unified_diff(*lines, f"{page.name}: {command}", "now"))
    return text != now


def main(words: Sequence[str]) -> int:
    """Write the tables chosen by the words; return how many commands failed.

    With `--check` print what would change instead; return how many tables would.
    """
    check = "--check" in words
    chosen = [QUICK if word == "--quick" else word for word in words if word != "--check"] or [""]
    if check:
        return sum(differs(*block) for block in blocks() if any(word in block[1] for word in chosen))
    pages: dict[str, list[Path]] = {}
    for page, command, _ in blocks():
        if any(word in command or word == page.name for word in chosen):
            pages.setdefault(command, []).append(page)
    failed = 0
    for command, each in pages.items():
        sys.stderr.write(f"{', '.join(page.name for page in each)}: {command}\n")
        text, succeeded = output(command)
        failed += not succeeded
        for page in each if text else ():
            write(page, command, text)
    return failed


if __name__ == "__main__":
    raise SystemExit(min(main(sys.argv[1:]), 1))
