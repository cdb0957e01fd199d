"""What `--force` replaces, in every command that writes: files of the kind that it writes, never what it reads."""

import os
import shlex
from itertools import product
from pathlib import Path

import pytest

from psmpc_cli.specs.library import built_ins

from .command import Psmpc

NOISY = "task.yaml --set uncertainty.noise.position=1e-3"

WRITERS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("simulate task.yaml --no-figures -o out.h5", "out.h5", ("task.yaml",)),
    ("simulate task.yaml -o new.h5", "new/states.png", ()),
    ("simulate task.yaml --no-figures --view -o new.h5", "new-view.html", ()),
    ("simulate --continue part.h5 --no-figures -o out.h5", "out.h5", ("part.h5",)),
    ("rerun part.h5 -o out.h5", "out.h5", ("part.h5",)),
    ("compare task.yaml --no-figures -o out.h5", "out.h5", ("task.yaml",)),
    ("compare task.yaml -o new.h5", "new/overlay.png", ()),
    ("pareto part.h5 --no-figures -o out.h5", "out.h5", ("part.h5",)),
    ("pareto task.yaml --no-figures --log out.h5", "out.h5", ("task.yaml",)),
    ("sweep-weights 2x2 task.yaml --no-figures -o out.h5", "out.h5", ("task.yaml",)),
    (f"monte-carlo {NOISY} --runs 2 --no-figures -o out.h5", "out.h5", ("task.yaml",)),
    ("check task.yaml --figure out.png", "out.png", ("task.yaml",)),
    ("check task.yaml --figure out.svg", "out.svg", ("task.yaml",)),
    ("plot ended.h5 --only states -o new", "new/states.png", ("ended.h5",)),
    ("plot ended.h5 --only states --format pdf -o new", "new/states.pdf", ("ended.h5",)),
    ("plot ended.h5 --only states --animate -o new", "new/animation.gif", ("ended.h5",)),
    ("view part.h5 ended.h5 -o out.html", "out.html", ("part.h5", "ended.h5")),
    ("report ended.h5 -o out.html", "out.html", ("ended.h5",)),
    ("show ended.h5 --csv new", "new/samples.csv", ("ended.h5",)),
    ("reproduce -o new", "new/runs.h5", ()),
    ("reproduce -o new", "new/fronts.h5", ()),
    ("reproduce -o new", "new/report.html", ()),
    ("reproduce -o new", "new/ablation_normalization.png", ()),
    ("reproduce -o new --json out.json", "out.json", ()),
    ("init new", "new/tasks/transport.yaml", ()),
    ("init new", "new/robots/dual_arm_servicer.urdf", ()),
    ("init new", "new/schema/robot.json", ()),
)
"""Command lines that write, one of the files that each writes, and the files that it reads."""

CASES = pytest.mark.parametrize(("line", "output", "inputs"), WRITERS, ids=[f"{row[0]}: {row[1]}" for row in WRITERS])


@pytest.fixture
def folder(tmp_path: Path, ended: Path, part: Path) -> Path:
    """A folder with a task and logs, in which psmpc runs."""
    return tmp_path


def refused(psmpc: Psmpc, folder: Path, line: str, *words: str) -> None:
    """Make sure that a command is refused with `--force`, in one message with these words, and changes no file."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    ran = psmpc(*shlex.split(line), "--force")
    assert (ran.code, ran.stdout) == (2, "")
    assert [word for word in words if word not in ran.stderr] == [], ran.stderr
    assert len(ran.stderr.splitlines()) == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@CASES
def test_a_file_of_another_kind_an_input_and_a_link_that_leads_nowhere_stay(
    psmpc: Psmpc, folder: Path, line: str, output: str, inputs: tuple[str, ...]
) -> None:
    path = folder / output
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("Chapter 1\n")
    refused(psmpc, folder, line, output, "found a text file, expected", "--force replaces")
    path.unlink()
    path.symlink_to(folder / "elsewhere")
    refused(psmpc, folder, line, output, "symbolic link", "elsewhere")
    assert path.is_symlink()
    for each, link in product(inputs, (os.link, os.symlink)):
        path.unlink()
        link(folder / each, path)
        refused(psmpc, folder, line, output)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"<!doctype html>", "an HTML page of another program"),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        (b"GIF89a", "a GIF image"),
        (b"\0\1", "a file of another kind"),
    ],
)
def test_what_stands_in_the_way_is_named(psmpc: Psmpc, folder: Path, content: bytes, found: str) -> None:
    (folder / "out.html").write_bytes(content)
    refused(psmpc, folder, "report ended.h5 -o out.html", f"found {found}, expected an HTML page of psmpc")


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("rerun part.h5 -o part.h5", "part.h5 is read"),
        ("rerun part.h5 -o ./taken/../part.h5", "part.h5 is read"),
        ("pareto part.h5 -o part.h5 --no-figures", "part.h5 is read"),
        ("pareto task.yaml -o new.h5 --log new.h5", "both -o and --log"),
        ("simulate --continue part.h5 -o part.h5 --no-figures", "part.h5 is read"),
        ("report ended.h5 -o ended.h5", "ended.h5 is read"),
        ("view part.h5 ended.h5 -o ended.h5", "ended.h5 is read"),
    ],
)
def test_a_log_is_not_replaced_by_what_is_made_of_it(psmpc: Psmpc, folder: Path, line: str, named: str) -> None:
    (folder / "taken").mkdir()
    refused(psmpc, folder, line, named)


@pytest.mark.slow
def test_files_of_the_same_kind_are_replaced_and_others_beside_them_stay(psmpc: Psmpc, folder: Path) -> None:
    (folder / "new").mkdir()
    (folder / "new" / "notes.txt").write_text("mine")
    for line in (
        "check task.yaml --figure out.svg",
        "plot ended.h5 --only shares --format png --format svg -o new",
        "view ended.h5 -o out.html",
        "show ended.h5 --csv new",
        "init new",
        "simulate task.yaml --no-figures -o out.h5 --set time_limit=0.1",
    ):
        before = set(folder.rglob("*"))
        assert psmpc(*line.split()).code == 0
        written = [path for path in folder.rglob("*") if path not in before and path.is_file()]
        assert written
        for path in written:
            os.utime(path, (0, 0))
        assert psmpc(*line.split(), "--force").code == 0, line
        assert all(path.stat().st_mtime > 0 for path in written)
    assert (folder / "new" / "notes.txt").read_text() == "mine"


def test_the_built_in_files_are_not_written_over_by_their_copies(psmpc: Psmpc, folder: Path) -> None:
    source = built_ins("task")["transport"]
    before = source.read_bytes()
    (folder / "new").mkdir()
    (folder / "new" / "tasks").symlink_to(source.parent)
    refused(psmpc, folder, "init new", ".yaml is read by this command")
    assert source.read_bytes() == before
