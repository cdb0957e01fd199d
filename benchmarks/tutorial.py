"""Follows docs/tutorial.md to the letter in an empty folder; writes what its commands print, and its figures.

    python benchmarks/tutorial.py                  some minutes
    python benchmarks/tutorial.py --check          prints how the page would change, and writes nothing

A block with a title is a file, or the text of a line of one; a console block is a command and what it prints: standard
error where the command ends with an error. `...` stands for the rest of an output; the lines above it are kept.
"""

import re
import subprocess
import sys
from difflib import unified_diff
from pathlib import Path
from tempfile import TemporaryDirectory

from gallery import FIGURES, shrink
from pages import ROOT, run_psmpc

PAGE = ROOT / "docs" / "tutorial.md"

BLOCK = re.compile(
    r'^```(?:yaml title="(?P<file>[\w.]+)(?:, line (?P<line>\d+))?"|console)\n(?P<text>.*?)^```', re.M | re.S
)

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
    command, *shown = block["text"].splitlines()
    ran = run_psmpc(command.removeprefix("$ "), folder, stderr=subprocess.PIPE)
    printed = (ran.stderr if ran.returncode else ran.stdout).splitlines()
    if "..." in shown:
        printed[shown.index("...") :] = ["..."]
    return "\n".join(["```console", command, *printed, "```"])


def check() -> int:
    """Print how the page differs from what following it shows now; return 1 where it does, or lacks a figure.

    The widths of columns do not count: they follow from solve times below the lines that are shown.
    """
    before = PAGE.read_text(encoding="utf-8")
    with TemporaryDirectory() as name:
        after = follow(before, Path(name))
        missing = [source for _, source in FIGURE.findall(after) if not (Path(name) / source).is_file()]
    lines = [re.sub(" +", " ", page).splitlines(keepends=True) for page in (before, after)]
    differences = list(unified_diff(*lines, PAGE.name, "now"))
    sys.stdout.writelines([*differences, *(f"no figure {source}\n" for source in missing)])
    return int(bool(differences or missing))


def main() -> None:
    """Write the page and its figures anew."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        page = follow(PAGE.read_text(encoding="utf-8"), folder)
        for target, source in FIGURE.findall(page):
            shrink(folder / source, FIGURES / target)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(check() if "--check" in sys.argv else main())
