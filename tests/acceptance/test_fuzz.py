"""Damaged files, descriptions and command lines, drawn at random, are read, done or rejected in one message."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random
from threading import Timer

import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import LogError
from psmpc_cli.figures import style
from psmpc_cli.logs.comparison import save_comparison
from psmpc_cli.logs.files import kind_of
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.schema import COMPARISON, RUN
from psmpc_cli.report import pages

from ..cli.command import Psmpc, command_line
from ..fuzz_settings import fuzzing
from ..short_runs import TASK, there_and_back
from ..synthetic_fronts import synthetic_fronts
from ..synthetic_monte_carlo import synthetic_monte_carlo
from ..synthetic_sweep import synthetic_sweep
from .hdf5_edits import SECRETS, edit, plant_secrets, shows_secret

pytestmark = pytest.mark.slow

FILES = ("log.h5", "part.h5", "compared.h5", "sweep.h5", "fronts.h5")

WORDS = (
    *("", "-", "--", "-x", "--help", "nan", "-1", "0", "1e999", "9" * 30, ".", "..", "none.h5", "a\nb", "a" * 5000),
    *("task.yaml", "empty.h5", "--force", "--quiet", "--set", "--only", "--format", "--run", "--step", "--every"),
    *("=", "x=[", "stages[9].name=1", "time_limit=.nan", "initial.base=[1e300, 0, 0]", "solver.kind=*a", "1,2", "1:0"),
    *("random:x", "0x0", "png", "exe", "states", "psmpc", "transport", "planar_dual_arm", *FILES),
)
"""Words that are put into command lines."""

LINES = (
    *("show log.h5", "show part.h5 --csv new", "show compared.h5", "show sweep.h5", "show fronts.h5"),
    *("plot part.h5 --only states -o new --format svg", "plot compared.h5 --run one --only controls -o new"),
    *("replay part.h5 --step 2", "verify part.h5 --every 3", "rerun part.h5 -o new.h5 --strict"),
    *("simulate task.yaml -o new.h5 --no-figures --set time_limit=0.3", "check task.yaml --set seed=1"),
    *("compare task.yaml --controllers pid,smpc -o new.h5", "pareto log.h5 --stages 1,9 --points 3 -o new.h5"),
    *("sweep-weights 2x2 task.yaml --stages 2,9 --range 1:10 -o new.h5", "monte-carlo task.yaml --runs 0", "init new"),
)
"""Command lines that end soon; some are wrong already."""

NUMBERS = (
    *("controller.horizon", "controller.sample_time", "controller.nodes", "controller.zeta", "solver.tolerance"),
    *("plant.low_level_rate", "plant.step", "seed", "time_limit", "stages.go.dwell", "stages.go.priority"),
    *("stages.go.target.base[0]", "stages.go.ends_when.tolerance", "skills.move.weights.control", "initial.base[0]"),
    *("uncertainty.mass", "uncertainty.friction.viscous", "uncertainty.noise.velocity", "uncertainty.payload.mass"),
)
"""Numbers of the task that a setting can change."""

READ = """
import json, sys
from pathlib import Path
from psmpc_cli.errors import LogError
from psmpc_cli.logs.files import kind_of
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.run import read_comparison, read_run
readers = {"run": read_run, "comparison": read_comparison}
for line in sys.stdin:
    path = Path(json.loads(line))
    try:
        kind = kind_of(path)
        readers[kind](path) if kind in readers else read_results(path, kind)
        print("read", flush=True)
    except LogError as error:
        print("rejected" if "\\n" not in str(error) else "several lines", flush=True)
    except Exception as error:
        print(repr(error), flush=True)
"""
"""Reads the files named on standard input; HDF5 may crash on a damaged one, and this process with it."""

READERS = {
    "log.h5": (
        *("show bad.h5 -v", "show bad.h5 --csv new", "view bad.h5 -o new/page.html", "report bad.h5 -o new/page.html"),
        *("show bad.h5 -v", "show bad.h5 --csv new", "view bad.h5 -o new/page.html", "verify bad.h5 --every 9"),
        *("plot bad.h5 --only states -o new", "plot bad.h5 --only snapshots -o new", "verify bad.h5 --every 9"),
    ),
    "part.h5": (
        *("show bad.h5", "show bad.h5 --csv new", "replay bad.h5 --step 1", "verify bad.h5 --every 3", "rerun bad.h5"),
        "simulate --continue bad.h5 -o new/run.h5 --no-figures -q",
        "pareto bad.h5 --stages 1,2 --points 3 -o new/fronts.h5 --no-figures",
    ),
    "compared.h5": (
        *("show bad.h5", "show bad.h5 --csv new", "plot bad.h5 --only overlay -o new", "view bad.h5 -o new/page.html"),
        "plot bad.h5 --run one --only controls -o new",
    ),
    "sweep.h5": (
        "show bad.h5",
        "show bad.h5",
        "plot bad.h5 --only starts -o new",
        "plot bad.h5 --only heat_map -o new",
    ),
    "fronts.h5": ("show bad.h5", "show bad.h5", "plot bad.h5 -o new"),
    "trials.h5": ("show bad.h5", "show bad.h5", "plot bad.h5 --only success -o new", "plot bad.h5 --only runs -o new"),
}
"""Every command that reads a file, by file."""

LONGEST_REJECTION, MOST_MEMORY = 2.0, 500_000
"""What docs/faults.md promises of a file that is rejected [s], and of any small one [kB]."""

LONGEST = 5.0
"""After so long a file is one on which HDF5 hangs [s]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    there_and_back(folder)
    there_and_back(folder, "log.plans=true", samples=6, name="part")
    runs = {"one": read_run(folder / "log.h5"), "two": read_run(folder / "part.h5")}
    save_comparison(runs, folder / "compared.h5")
    synthetic_sweep(folder / "sweep.h5", "3x3", waiting=(1,), failed=(2,))
    synthetic_fronts(folder / "fronts.h5", failed=(1,)).create()
    synthetic_monte_carlo(folder / "trials.h5", waiting=(1,), crashed=(2,))
    plant_secrets(folder / "planted")
    (folder / "task.yaml").write_text(TASK)
    (folder / "empty.h5").touch()
    return folder


class Reader:
    """Reads files in a process of its own, which is started again after a crash, or when HDF5 hangs on a file."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None

    def read(self, path: Path) -> str:
        """Return read, rejected, crashed (or hung), or what was raised instead."""
        if self.process is None or self.process.poll() is not None:
            self.stop()
            command = [sys.executable, "-c", READ]
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(str(path)) + "\n")
        self.process.stdin.flush()
        timer = Timer(LONGEST, self.process.kill)
        timer.start()
        answer = self.process.stdout.readline().strip()
        timer.cancel()
        return answer or "crashed"

    def stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.communicate()


@pytest.fixture(scope="module")
def reader() -> Iterator[Reader]:
    reader = Reader()
    yield reader
    reader.stop()


def mutated_bytes(content: bytes, random: Random) -> bytes:
    """Cut a file off, overwrite or remove a part of it, or flip bits."""
    changed, at, length = bytearray(content), random.randrange(len(content)), random.choice([1, 8, 64, 512, 4096])
    kind = random.randrange(5)
    if kind == 0:
        return content[:at]
    if kind == 1:
        changed[at : at + length] = random.choice([b"\x00", b"\xff"]) * length
    elif kind == 2:
        del changed[at : at + length]
    else:
        for _ in range(random.choice([1, 2, 8, 64])):
            changed[random.randrange(len(content))] ^= 1 << random.randrange(8)
    return bytes(changed)


@fuzzing(30)
@given(seed=st.integers(0, 2**32), name=st.sampled_from(FILES))
def test_a_damaged_file_is_read_or_rejected(folder: Path, reader: Reader, seed: int, name: str) -> None:
    random, path = Random(seed), folder / "bad.h5"
    path.write_bytes(mutated_bytes((folder / name).read_bytes(), random))
    assert reader.read(path) in ("read", "rejected", "crashed")


@pytest.mark.parametrize("batch", range(4))
def test_a_file_that_was_edited_is_read_or_rejected(
    folder: Path, command: Psmpc, batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "DPI", 20)
    monkeypatch.setitem(style.STYLE, "savefig.dpi", 20)
    planted = [folder / "planted" / name for name in SECRETS]
    for path in planted:
        os.utime(path, (0, path.stat().st_mtime))
    for seed in range(40 * batch, 40 * (batch + 1)):
        random = Random(seed)
        name = random.choice(list(READERS))
        shutil.copy(folder / name, "bad.h5")
        changes = edit(Path("bad.h5"), random, folder / "planted")
        line = random.choice(READERS[name])
        before, began = resident_memory(), time.process_time()
        try:
            read = is_read(Path("bad.h5")) if seed % 4 == 0 else None
            ran = command(*line.split())
        except Exception as error:
            raise AssertionError(f"{seed}: {changes}: {line}") from error
        spent, grown = time.process_time() - began, resident_memory(peak=True) - before
        about = f"{seed}: {changes}: {line}: exit code {ran.code}, {spent:.2f} s, {grown} kB: {ran.stderr}"
        assert ran.code in ((2,) if read is False else (0, 1, 2, 3)), about
        assert ran.code in (0, 1) or ran.stderr, about
        assert ran.code != 2 or spent < LONGEST_REJECTION, about
        assert grown < MOST_MEMORY, about
        written = [path.read_bytes() for path in Path("new").glob("*") if path.suffix in (".csv", ".html")]
        assert not any(shows_secret(text) for text in (ran.stdout.encode(), ran.stderr.encode(), *written)), about
        shutil.rmtree("new", ignore_errors=True)
    assert [path for path in planted if path.stat().st_atime] == []


def is_read(path: Path) -> bool:
    """Return whether a reader takes a file; what is raised but LogError is an error."""
    readers = {RUN: read_run, COMPARISON: read_comparison}
    try:
        kind = kind_of(path)
        readers[kind](path) if kind in readers else read_results(path, kind)
    except LogError as error:
        assert "\n" not in str(error)
        return False
    return True


def resident_memory(peak: bool = False) -> int:
    """Return the memory of this process [kB]: now, from when on its peak is counted, or the peak since then."""
    if not peak:
        Path("/proc/self/clear_refs").write_text("5")
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields["VmHWM" if peak else "VmRSS"].split()[0])


@fuzzing(60)
@given(
    st.sampled_from(LINES),
    st.lists(st.tuples(st.integers(1, 8), st.sampled_from(WORDS), st.booleans()), min_size=1, max_size=3),
)
def test_a_mutated_command_line_is_done_or_rejected(
    folder: Path, command: Psmpc, line: str, changes: list[tuple[int, str, bool]]
) -> None:
    words = line.split()
    for at, word, instead in changes:
        words[at : at + instead] = [word]
    kept = {name: (folder / name).read_bytes() for name in FILES}
    ran = command(*words)
    assert ran.code in (0, 1, 2, 3), ran.stderr
    assert "Traceback" not in ran.stderr
    assert ran.code in (0, 1) or ran.stderr
    if "--force" not in words:
        assert {name: (folder / name).read_bytes() for name in FILES} == kept


@fuzzing(10)
@given(st.lists(st.tuples(st.sampled_from(NUMBERS), st.floats(-13, 13)), min_size=1, max_size=2))
def test_numbers_of_any_magnitude_are_rejected_or_give_a_readable_log(
    command: Psmpc, settings: list[tuple[str, float]]
) -> None:
    Path("new.h5").unlink(missing_ok=True)
    changes = ["plant.kind=rk4", "solver.compiled=false", "log.shares=false", "time_limit=0.3"]
    changes += [f"{key}={10**magnitude:.3g}" for key, magnitude in settings]
    ran = command(
        "simulate", "task.yaml", "-o", "new.h5", "--no-figures", "-q", *[w for c in changes for w in ("--set", c)]
    )
    assert ran.code in (0, 2, 3), ran.stderr
    assert "Traceback" not in ran.stderr
    assert ran.code == 2 or command("show", "new.h5").code == 0


@pytest.fixture
def command(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Psmpc:
    """The command line in this process, in the folder of the files."""
    monkeypatch.chdir(folder)
    return command_line(monkeypatch, capsys)
