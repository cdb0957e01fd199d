"""Bad input to any command: exit code 2, one message that names what is wrong, and no file is left or changed."""

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import h5py
import pytest

from psmpc_cli.figures.animation import offscreen_driver
from psmpc_cli.logs.run import read_run

from ..short_runs import TASK
from .command import PROGRAM, Psmpc

ANYWHERE = "task.yaml --set uncertainty.noise.position=1e-3"
NOISY = f"{ANYWHERE} --jobs 1"
"""A task of which a study can be made."""

BAD: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("simulate", ("no task", "transport", "--continue LOG")),
    ("simulate nowhere", ('"nowhere"', "built-in task", "transport")),
    ("simulate task.yaml --set controller.nodes=many", ("controller.nodes", '"many"', "auto")),
    ("simulate task.yaml --set controller.nodes", ('no "="', "path=value")),
    ("simulate task.yaml --set controler.nodes=5", ("unknown key", '"controller"')),
    (
        "simulate task.yaml --controller mpc",
        ("--controller mpc", "controller.kind", '"smpc"', "psmpc, smpc, hard, htmpc"),
    ),
    ("simulate task.yaml --plant mars", ("--plant mars", "plant.kind", "ideal, rk4, mujoco")),
    ("simulate task.yaml --quiet --verbose", ("--quiet", "--verbose")),
    ("simulate task.yaml --speed", ("--speed",)),
    ("simulate task.yaml -o part.h5", ("part.h5 exists", "-o", "--force")),
    ("simulate task.yaml -o task.yaml --force", ("task.yaml is read by this command",)),
    ("simulate task.yaml -o .", ("is a directory",)),
    ("simulate task.yaml --no-figures -o /dev/full", ("/dev/full exists",)),
    ("simulate task.yaml --no-figures -o /dev/full --force", ("/dev/full: found no regular file",)),
    ("simulate task.yaml -o taken.h5", ("taken holds files", "-o", "--force", "--no-figures")),
    ("simulate task.yaml -o blocked.h5", ("blocked is no directory", "-o")),
    ("simulate task.yaml -o task.yaml/log.h5 --no-figures", ("task.yaml", "directory")),
    ("simulate task.yaml --continue part.h5", ("--continue", "expected no task")),
    ("simulate --continue part.h5 --plant rk4", ("--continue", "--plant")),
    ("simulate --continue none.h5", ("none.h5", "no such file")),
    ("simulate --continue ended.h5", ("ended.h5", "has ended", "nothing to continue")),
    ("rerun part.h5 -o ended.h5", ("ended.h5 exists",)),
    *((f"{line} compared.h5", ("compared.h5: found a comparison",)) for line in ("rerun", "verify", "replay --step 0")),
    ("simulate --continue compared.h5", ("compared.h5: found a comparison",)),
    ("rerun task.yaml", ("task.yaml", "HDF5")),
    ("verify part.h5 --every 0", ("--every",)),
    ("replay part.h5 --step 6", ("no sample 6", "0 to 5")),
    ("replay part.h5 --step 2 --solver nlp", ('"nlp"', "sqp, fatrop, ipopt")),
    ("show none.h5", ("none.h5", "no such file")),
    ("show task.yaml", ("task.yaml", "HDF5")),
    ("plot ended.h5 --only stats", ("'stats'", "states, velocities, controls")),
    ("plot ended.h5 --format jpg", ("'jpg'", "png, pdf, svg")),
    ("plot ended.h5 --run psmpc", ("--run", "comparison")),
    ("plot part.h5 -o task.yaml", ("task.yaml", "-o")),
    ("compare task.yaml --controllers psmpc,spmc", ("'spmc'", "psmpc, smpc, hard, htmpc")),
    ("compare task.yaml --set controller.kind=smpc", ("controller.kind", "--controllers")),
    ("compare task.yaml -o taken.h5", ("taken holds files",)),
    ("sweep-weights", ("neither a grid nor --sampling", "25x25")),
    ("sweep-weights 3x3 task.yaml --sampling random:5", ("both a grid and --sampling",)),
    ("sweep-weights 25y25 task.yaml", ("'25y25'", "25x25")),
    ("sweep-weights 3x3x3 task.yaml", ("'3x3x3'", "25x25")),
    ("sweep-weights task.yaml 1x5", ("'1x5'",)),
    ("sweep-weights task.yaml --sampling sobol:5", ("'sobol:5'", "random:N")),
    ("sweep-weights 3x3 task.yaml --range 0:1", ("--range", "'0:1'")),
    ("sweep-weights 3x3 task.yaml --epsilon 0", ("--epsilon", "'0'")),
    ("sweep-weights 3x3 task.yaml --stages 2,3", ("--stages", "'2,3'", "1 go, 2 back")),
    ("sweep-weights 3x3 task.yaml --set controller.kind=smpc", ("smpc", "no priorities")),
    ("sweep-weights 3x3 task.yaml --resume", ("--resume", "runs/task-sweep.h5")),
    ("sweep-weights 3x3 task.yaml --resume --force", ("--resume and --force",)),
    ("sweep-weights 3x3 task.yaml --jobs 1 --dask tcp://127.0.0.1:9", ("--jobs and --dask",)),
    ("monte-carlo task.yaml", ("--runs",)),
    ("monte-carlo task.yaml --runs 2", ("task.yaml", "nothing random")),
    (f"monte-carlo {NOISY} --runs 2 --resume", ("--resume", "runs/task-monte-carlo.h5")),
    (f"monte-carlo {NOISY} --runs 2 -o task.yaml", ("task.yaml is read by this command",)),
    (f"monte-carlo {ANYWHERE} --runs 2 --dask garbage -o part.h5 --force --no-figures", ("--dask", "'garbage'")),
    (f"monte-carlo {ANYWHERE} --runs 2 --dask garbage -o new.h5", ("--dask", "'garbage'")),
    ("sweep-weights 2x2 task.yaml --dask garbage -o part.h5 --force --no-figures", ("--dask", "'garbage'")),
    ("pareto task.yaml --at soon", ("--at", "'soon'")),
    ("pareto task.yaml --method guess", ("--method", "'guess'", "weighted-sum")),
    ("pareto task.yaml --stages 2,1", ("--stages", "'2,1'", "1 go, 2 back")),
    ("pareto task.yaml --points 1", ("--points",)),
    ("pareto task.yaml --log part.h5", ("part.h5 exists",)),
    ("pareto ended.h5 --set controller.nodes=3", ("ended.h5", "--set")),
    ("reproduce --fronts 2", ("--fronts",)),
    ("reproduce --weights many", ("'many'", "25x25")),
    ("reproduce --set controller.kind=hard", ("controller.kind",)),
    ("reproduce --set controller=smpc", ("controller.kind",)),
    ("reproduce -o taken", ("taken holds files", "--force")),
    ("reproduce -o task.yaml/out", ("no directory", "-o")),
    ("reproduce --json task.yaml", ("task.yaml exists", "--json", "--force")),
    ("bench task.yaml --nodes many", ("--nodes many", "controller.nodes", '"many"')),
    ("bench task.yaml --solvers snopt", ("--solvers", "'snopt'")),
    ("bench task.yaml --set solver.kind=ipopt", ("--solvers",)),
    ("check nowhere", ("nowhere",)),
    ("check task.yaml --figure scenario.jpg", ("'jpg'", "png, pdf, svg")),
    ("init taken", ("taken",)),
    ("init task.yaml", ("task.yaml",)),
    ("schema plant", ("robot", "task")),
    ("fly", ("fly",)),
)
"""Command lines, and words that the message must have."""


@pytest.fixture
def folder(tmp_path: Path, ended: Path, part: Path) -> Path:
    """A folder with logs, a folder in which files stand where outputs would go, and a file in place of a folder."""
    (tmp_path / "taken" / "tasks").mkdir(parents=True)
    (tmp_path / "taken" / "tasks" / "transport.yaml").write_text("mine")
    (tmp_path / "blocked").touch()
    with h5py.File(shutil.copy(ended, tmp_path / "compared.h5"), "r+") as file:
        file.attrs["kind"] = "comparison"
    return tmp_path


@pytest.mark.parametrize(("line", "words"), BAD, ids=[line for line, _ in BAD])
def test_bad_input_is_named_and_leaves_nothing(psmpc: Psmpc, folder: Path, line: str, words: tuple[str, ...]) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    ran = psmpc(*shlex.split(line))
    assert ran.code == 2
    assert not ran.stdout or line.startswith("check")
    assert [word for word in words if word not in ran.stderr] == [], ran.stderr
    assert "Traceback" not in ran.stderr
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert not (folder / "runs").exists()


def test_problems_of_all_files_come_together_after_the_tables(psmpc: Psmpc, tmp_path: Path) -> None:
    text = (tmp_path / "task.yaml").read_text()
    (tmp_path / "bad.yaml").write_text(text.replace("tolerance: 0.005", "tolerance: -3", 1))
    (tmp_path / "far.yaml").write_text(text.replace("base: [0.1, 0, 0]", "base: [9, 0, 0]", 1))
    ran = psmpc("check", "bad.yaml", "task.yaml", "far.yaml", "nowhere")
    assert ran.code == 2
    assert ran.stdout.startswith("OK: task task\ntask\n")
    count, *lines = ran.stderr.splitlines()
    assert count == "3 problems:"
    heads = [line.split(": found")[0] for line in lines if line[0] != " "]
    assert [head.rpartition(": ")[2] for head in heads] == [
        "stages[0].ends_when.tolerance",
        "stages[0].target.base[0]",
        "nowhere",
    ]


@pytest.mark.parametrize("line", ["simulate task.yaml", "simulate task.yaml --no-figures", "compare task.yaml"])
def test_a_folder_that_takes_no_files_is_named_before_anything_is_compiled(psmpc: Psmpc, line: str) -> None:
    ran = psmpc(*line.split(), "-o", "/proc/log.h5")
    assert (ran.code, len(ran.stderr.splitlines())) == (2, 1)
    assert "/proc cannot be written" in ran.stderr
    assert "-o" in ran.stderr


@pytest.mark.parametrize("line", ["show ended.h5", "schema robot", "--help"])
def test_a_standard_output_that_is_full_is_named(folder: Path, line: str) -> None:
    with Path("/dev/full").open("w") as full:
        ran = subprocess.run([*PROGRAM, *line.split()], stdout=full, stderr=subprocess.PIPE, text=True, cwd=folder)
    assert (ran.returncode, len(ran.stderr.splitlines())) == (3, 1)
    assert "standard output cannot be written" in ran.stderr


@pytest.mark.slow
def test_progress_that_cannot_be_shown_stops_nothing(folder: Path) -> None:
    (folder / "task.yaml").write_text(TASK)
    line = "simulate task.yaml --no-figures -o log.h5"
    with Path("/dev/full").open("w") as full:
        ran = subprocess.run([*PROGRAM, *line.split()], stdout=subprocess.PIPE, stderr=full, text=True, cwd=folder)
    assert (ran.returncode, ran.stdout.splitlines()[-1]) == (0, "log: log.h5 (-v prints all that was measured)")


@pytest.mark.slow
def test_a_standard_output_that_is_closed_is_named_and_the_log_is_whole(folder: Path) -> None:
    (folder / "task.yaml").write_text(TASK)
    closing = "import os, sys; os.close(1); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    line = [PROGRAM[0], "-c", closing, *PROGRAM[1:], "simulate", "task.yaml", "--no-figures", "-o"]
    ran = subprocess.run([*line, "log.h5"], stderr=subprocess.PIPE, text=True, cwd=folder)
    assert ran.returncode == 3
    assert ran.stderr.splitlines()[-1] == "psmpc: standard output cannot be written: it is closed"
    assert "Traceback" not in ran.stderr
    assert read_run(folder / "log.h5").attributes["finished"]
    quiet = subprocess.run([*line, "other.h5", "-q"], stderr=subprocess.PIPE, text=True, cwd=folder)
    assert (quiet.returncode, quiet.stderr) == (0, "")


def test_no_name_controls_the_terminal(psmpc: Psmpc, folder: Path, part: Path) -> None:
    """Texts of a log, of tables and of messages have no directional or control characters."""
    evil = "\u202egnp\x1b[2J\x9b\r\x07"
    with h5py.File(part, "r+") as file:
        file.attrs["end_reason"] = f"ended{evil}"
        file.attrs["compiler"] = evil
    (folder / f"{evil}.h5").write_bytes(part.read_bytes())
    for line in (
        ("show", "part.h5"),
        ("show", "part.h5", "-v"),
        ("show", f"{evil}.h5"),
        ("show", evil),
        ("check", evil),
    ):
        ran = psmpc(*line)
        shown = ran.stdout + ran.stderr
        assert shown
        assert [c for c in shown if not c.isprintable() and c not in "\n\t"] == [], line


def test_warnings_of_libraries_do_not_reach_the_terminal(folder: Path) -> None:
    script = """
import logging, warnings
from psmpc_cli.cli.main import main
from psmpc_cli.cli import tables
def noisy(*arguments):
    warnings.warn("raw")
    logging.getLogger("matplotlib").warning("raw")
    logging.getLogger("psmpc_cli.cli").warning("ours")
tables.print_summary = noisy
main()
"""
    command = [*PROGRAM[:1], "-c", script, "show", "ended.h5"]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "warning: ours\n")


@pytest.mark.slow
def test_a_file_whose_name_is_no_text_is_shown_with_escapes(folder: Path, ended: Path) -> None:
    strict = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}  # as in most locales
    show = [*PROGRAM, "show", b"\xff.h5"]
    missing = subprocess.run(show, capture_output=True, text=True, cwd=folder, env=strict)
    assert (missing.returncode, missing.stdout) == (2, "")
    assert missing.stderr.startswith("psmpc: \\udcff.h5: found no such file")
    ended.rename(os.fsdecode(bytes(folder) + b"/\xff.h5"))
    shown = subprocess.run(show, capture_output=True, text=True, cwd=folder, env=strict)
    assert (shown.returncode, shown.stderr) == (0, "")
    assert shown.stdout.endswith("log: \\udcff.h5 (-v prints all that was measured)\n")


def test_values_of_another_file_are_not_exported(psmpc: Psmpc, part: Path) -> None:
    (part.parent / "secret").write_bytes(b"MARKED7!" * 6)
    with h5py.File(part, "r+") as file:
        del file["solver/status"]
        file.create_dataset("solver/status", (6,), "S8", external=[("secret", 0, 48)])
    ran = psmpc("show", "part.h5", "--csv", "tables")
    assert (ran.code, ran.stdout, len(ran.stderr.splitlines())) == (2, "", 1)
    assert "part.h5: /solver/status: found external storage" in ran.stderr
    assert not Path("tables").exists()


@pytest.mark.slow
def test_a_film_that_cannot_be_drawn_is_found_before_the_run(psmpc: Psmpc, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "crayons")
    offscreen_driver.cache_clear()
    ran = psmpc("simulate", "task.yaml", "--render")
    assert (ran.code, ran.stdout, len(ran.stderr.splitlines())) == (2, "", 1)
    assert "--render" in ran.stderr
    assert not Path("runs").exists()
