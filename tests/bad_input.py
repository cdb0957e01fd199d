"""A folder of files good and bad, command lines on them, and the verdict on how psmpc took one."""

import contextlib
import io
import os
import shutil
import sys
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from random import Random
from unittest import mock

from psmpc_cli.cli.main import main
from psmpc_cli.logs.comparison import merge_logs
from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

from .made_up_fronts import made_up_fronts
from .made_up_monte_carlo import made_up_monte_carlo
from .made_up_sweep import made_up_sweep
from .there_and_back import TASK

NOISE, SHORT = "uncertainty.noise.position=1e-3", "time_limit=0.3"

RESULTS = ("ended.h5", "part.h5", "compared.h5", "sweep.h5", "fronts.h5", "runs.h5")
"""Logs and results of every kind."""

LINES: tuple[tuple[str, ...], ...] = (
    ("show", "ended.h5"),
    ("show", "part.h5", "--csv", "new"),
    ("show", "compared.h5"),
    ("show", "sweep.h5"),
    ("show", "fronts.h5"),
    ("plot", "part.h5", "--only", "states", "-o", "new", "--format", "svg"),
    ("plot", "compared.h5", "--run", "one", "--only", "controls", "-o", "new"),
    ("plot", "sweep.h5", "--only", "nothing"),
    ("replay", "part.h5", "--step", "2"),
    ("replay", "part.h5", "--step", "99", "--solver", "ipopt", "--export", "new.npz"),
    ("verify", "part.h5", "--every", "3"),
    ("rerun", "part.h5", "-o", "new.h5", "--strict"),
    ("simulate", "task.yaml", "-o", "new.h5", "--no-figures", "--set", "time_limit=0.5"),
    ("simulate", "--continue", "ended.h5", "--no-figures"),
    ("simulate", "task.yaml", "--controller", "pid", "--plant", "rk4"),
    ("check", "task.yaml", "robot.yaml", "--set", "seed=1"),
    ("check", "task.yaml", "--figure", "new.png"),
    ("compare", "task.yaml", "--controllers", "pid,smpc", "-o", "new.h5"),
    ("pareto", "ended.h5", "--stages", "1,9", "--at", "0.5", "--points", "3", "-o", "new.h5"),
    ("sweep-weights", "2x2", "task.yaml", "--stages", "2,9", "--range", "1:10", "--epsilon", "1e-3", "-o", "new.h5"),
    ("sweep-weights", "task.yaml", "--sampling", "random:0", "--jobs", "1"),
    ("monte-carlo", "task.yaml", "--runs", "2", "--jobs", "1", "-o", "new.h5", "--set", NOISE, "--set", SHORT),
    ("monte-carlo", "task.yaml", "--runs", "0", "--jobs", "0", "-o", "new.h5"),
    ("monte-carlo", "task.yaml", "--runs", "9", "--resume", "-o", "runs.h5", "--no-figures"),
    ("show", "runs.h5"),
    ("plot", "runs.h5", "--only", "success", "-o", "new"),
    ("reproduce", "--weights", "0x0", "--fronts", "1", "--jobs", "0", "-o", "new"),
    ("bench", "--nodes", "0", "--solvers", "pid", "--repeat", "0", "--json", "new.json"),
    ("init", "new"),
    ("schema", "task"),
    ("compile", "nothing.yaml"),
)
"""Command lines that end soon; some of them are wrong already."""

LONGEST = 30_000
"""Characters of a message that is still clear; fifty problems of a file with their lines are below it."""


@dataclass(frozen=True)
class Verdict:
    """How psmpc took a command line: a word for it, and a note where it should not have taken it so."""

    word: str
    note: str = ""

    @property
    def is_finding(self) -> bool:
        """Whether that must not happen."""
        return bool(self.note)


def prepare(folder: Path) -> None:
    """Make the files that command lines name: logs and results of every kind, and what only looks like a file."""
    (folder / "task.yaml").write_text(TASK)
    loaded = load_task(folder / "task.yaml", ["time_limit=1.5"])
    (folder / "robot.yaml").write_text(loaded.robot_yaml)
    samples: list[Sample] = []

    def watch(progress: Sample) -> None:
        samples.append(progress)
        if len(samples) == 6:
            raise KeyboardInterrupt

    simulate(loaded, folder / "part.h5", watch=watch)
    simulate(loaded, folder / "ended.h5")
    merge_logs({"one": folder / "ended.h5", "two": folder / "part.h5"}, folder / "compared.h5")
    made_up_sweep(folder / "sweep.h5", "3x3", waiting=(1,), failed=(2,))
    made_up_fronts(folder / "fronts.h5", failed=(1,))
    made_up_monte_carlo(folder / "runs.h5", 5, waiting=(1,), crashed=(2,), task=str(folder / "task.yaml"))
    (folder / "empty.h5").touch()
    (folder / "text.h5").write_text(TASK)
    (folder / "noise.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + Random(0).randbytes(4000))
    (folder / "folder").mkdir()
    (folder / "folder" / "kept").write_text("kept")
    os.mkfifo(folder / "pipe")
    (folder / "zero").symlink_to("/dev/zero")
    (folder / "loop").symlink_to("loop")
    (folder / "nowhere").symlink_to("not there")


def judged(arguments: list[str]) -> Verdict:
    """Run a command line in this process and return how it was taken."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", errors) for errors in ("surrogateescape", "backslashreplace"))
    code: object = 0
    with (
        mock.patch.object(sys, "argv", ["psmpc", *arguments]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(record=True) as warned,
    ):
        warnings.simplefilter("always")
        try:
            main()
        except SystemExit as left:
            code = left.code or 0
        except BaseException as error:
            return Verdict("traceback", "".join(traceback.format_exception(error)[-4:]))
    err.flush()
    said = err.buffer.getvalue().decode() if isinstance(err.buffer, io.BytesIO) else ""
    if warned:
        return Verdict("warned", f"{warned[0].filename}:{warned[0].lineno}: {warned[0].message}")
    return _of_code(code, said)


def simulated(settings: list[str]) -> Verdict:
    """Run the small task for three samples with settings, and return how that was taken; a log must be readable."""
    brief = ["plant.kind=rk4", "solver.compiled=false", "log.shares=false", "time_limit=0.3", *settings]
    words = [word for setting in brief for word in ("--set", setting)]
    verdict = judged(["simulate", "task.yaml", "-o", "new.h5", "--no-figures", "--quiet", *words])
    if verdict.word in ("accepted", "could not go on"):
        shown = judged(["show", "new.h5"])
        return verdict if shown.word == "accepted" else Verdict("unreadable", f"{shown.word}: {shown.note}")
    return verdict


def _of_code(code: object, said: str) -> Verdict:
    """Return the verdict on an exit code and what was written to standard error."""
    if "Traceback" in said:
        return Verdict("traceback", said)
    if code not in (0, 1, 2, 3):
        return Verdict("exit code", f"{code}: {said[:500]}")
    if code and not said.strip() and code != 1:
        return Verdict("silent", f"exit code {code}")
    if len(said) > LONGEST:
        return Verdict("long", f"{len(said)} characters: {said[:300]}")
    if any(not (character.isprintable() or character in "\n\t\u00b0") for character in said):
        return Verdict("unprintable", ascii(said[:500]))
    return Verdict({0: "accepted", 1: "check failed", 2: "refused", 3: "could not go on"}[int(str(code))])


def states(folder: Path) -> Mapping[str, tuple[int, int, int]]:
    """Return what shows that a file of a folder has changed, by its path."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        found[str(path)] = (status.st_ino, status.st_size, 0 if path.is_dir() else status.st_mtime_ns)
    return found


def tidy(folder: Path, kept: Mapping[str, tuple[int, int, int]]) -> list[str]:
    """Remove what is new in a folder, and return what was there before and is not as it was."""
    for path in sorted(folder.rglob("*"), reverse=True):
        if str(path) not in kept:
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    now = states(folder)
    return [path for path, state in kept.items() if now.get(path) != state]
