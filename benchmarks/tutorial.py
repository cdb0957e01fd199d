"""Follows pages, such as the tutorial, to the letter, each in an empty folder; writes what their commands print.

    python benchmarks/tutorial.py                  some minutes; writes the figures of the tutorial too
    python benchmarks/tutorial.py --check          prints how the pages would change, and writes nothing

A block with a title is a file, or the text of a line of one. A block of `sh` with one of `text` below it is a command
and what it prints: standard error where the command ends with an error. `...` stands for the rest of an output; the
lines above it are kept. Other blocks of `sh` are not run. How many solves came late depends on the machine, and is
left out.
"""

import re
import subprocess
import sys
from difflib import unified_diff
from pathlib import Path
from tempfile import TemporaryDirectory

from gallery import FIGURES, shrink
from pages import ROOT, run_psmpc

PAGES = (ROOT / "docs" / "tutorial.md", ROOT / "docs" / "own_task.md", ROOT / "README.md")

BLOCK = re.compile(
    r'^```(?:yaml title="(?P<file>[\w.]+)(?:, line (?P<line>\d+))?"\n|sh\n(?P<command>[^\n]+)\n```\n+```text\n)'
    r"(?P<text>.*?)^```",
    re.M | re.S,
)

LATE = "solves came late"
"""Part of the warning that depends on what else the machine does."""

FIGURE = re.compile(r'\(figures/(tutorial/\w+\.png) "([\w/.-]+)"\)')


def follow(page: str, folder: Path) -> str:
    """Follow a page in a folder; return it with what its commands print now."""
    return BLOCK.sub(lambda block: step(block, folder), page)


def step(block: re.Match[str], folder: Path) -> str:
    """Write the file or run the command of a block; return the block with what was printed."""
    if block["file"] is not None:
        path, text = folder / block["file"], block["text"]
        if block["line"]:
            lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
            lines[int(block["line"]) - 1] = text
            text = "".join(lines)
        path.write_text(text, encoding="utf-8")
        return block[0]
    shown = block["text"].splitlines()
    ran = run_psmpc(block["command"], folder, stderr=subprocess.PIPE)
    printed = [line for line in (ran.stderr if ran.returncode else ran.stdout).splitlines() if LATE not in line]
    if "..." in shown:
        printed[shown.index("...") :] = ["..."]
    return "\n".join(["```sh", block["command"], "```", "", "```text", *printed, "```"])


def check() -> int:
    """Print how the pages differ from what following them shows now; return 1 where one does, or lacks a figure.

    The widths of columns do not count: they follow from solve times below the lines that are shown.
    """
    faults = []
    for page in PAGES:
        before = page.read_text(encoding="utf-8")
        with TemporaryDirectory() as name:
            after = follow(before, Path(name))
            missing = [source for _, source in FIGURE.findall(after) if not (Path(name) / source).is_file()]
        lines = [re.sub(" +", " ", text).splitlines(keepends=True) for text in (before, after)]
        faults += [*unified_diff(*lines, page.name, "now"), *(f"no figure {source}\n" for source in missing)]
    sys.stdout.writelines(faults)
    return int(bool(faults))


def main() -> None:
    """Write the pages and their figures anew."""
    for page in PAGES:
        with TemporaryDirectory() as name:
            folder = Path(name)
            text = follow(page.read_text(encoding="utf-8"), folder)
            for target, source in FIGURE.findall(text):
                shrink(folder / source, FIGURES / target)
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(check() if "--check" in sys.argv else main())
