"""Follows pages, such as the tutorial, to the letter, each in an empty folder; writes what their commands print.

    python benchmarks/tutorial.py                  some minutes; writes the figures of the tutorial too
    python benchmarks/tutorial.py --check          prints how the pages would change, and writes nothing

A block with a title is a file, or the text of a line of one. A block of `sh` with one of `text` below it is a command
and what it prints: standard error where the command ends with an error. `...` stands for the rest of an output; the
lines above it are kept. Other blocks of `sh` are not run. How many solves came late depends on the machine, and is
left out.
"""

import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from difflib import unified_diff
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

from gallery import FIGURES, shrink
from pages import ROOT, run_psmpc

from psmpc_cli.cli.main import main as psmpc
from psmpc_cli.figures import style

PAGES = (ROOT / "docs" / "tutorial.md", ROOT / "docs" / "own_task.md", ROOT / "README.md")

BLOCK = re.compile(
    r'^```(?:yaml title="(?P<file>[\w.]+)(?:, line (?P<line>\d+))?"\n|sh\n(?P<command>[^\n]+)\n```\n+```text\n)'
    r"(?P<text>.*?)^```",
    re.M | re.S,
)

LATE = "solves came late"
"""Part of the warning that depends on what else the machine does."""

FIGURE = re.compile(r'\(figures/(tutorial/\w+\.png) "([\w/.-]+)"\)')


Ran = subprocess.CompletedProcess[str]
Run = Callable[[str, Path], Ran]
"""Runs a command line in a folder."""


def run_alone(line: str, folder: Path) -> Ran:
    """Run a command line in a process of its own."""
    return run_psmpc(line, folder, stderr=subprocess.PIPE)


def run_here(line: str, folder: Path) -> Ran:
    """Run a command line in this process, which has imported everything, with figures of few dots."""
    out, err = StringIO(), StringIO()
    style.STYLE["savefig.dpi"] = 20
    sys.argv = shlex.split(line)
    try:
        with chdir(folder), redirect_stdout(out), redirect_stderr(err):
            psmpc()
    except SystemExit as left:
        return subprocess.CompletedProcess(line, int(left.code or 0), out.getvalue(), err.getvalue())
    raise AssertionError("the command line leaves by SystemExit")


def follow(page: str, folder: Path, run: Run) -> str:
    """Follow a page in a folder; return it with what its commands print now."""
    return BLOCK.sub(lambda block: step(block, folder, run), page)


def step(block: re.Match[str], folder: Path, run: Run) -> str:
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
    ran = run(block["command"], folder)
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
            after = follow(before, Path(name), run_here)
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
            text = follow(page.read_text(encoding="utf-8"), folder, run_alone)
            for target, source in FIGURE.findall(text):
                shrink(folder / source, FIGURES / target)
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(check() if "--check" in sys.argv else main())
