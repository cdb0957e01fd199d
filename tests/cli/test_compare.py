import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from psmpc_cli.cli import parallel
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.logs.run import read_comparison

from ..there_and_back import TASK
from .command import Psmpc, Ran

ROW = re.compile(r"(?P<label>.+?) {2,}(?P<cells>.+)")


def rows(ran: Ran) -> dict[str, list[str]]:
    """The cells of the table that was printed, by the label of their row."""
    found = (ROW.fullmatch(line) for line in ran.stdout.splitlines()[1:])
    return {match["label"]: re.split(" {2,}", match["cells"].strip()) for match in found if match}


@pytest.fixture
def compare(psmpc: Psmpc, tmp_path: Path) -> Psmpc:
    """`psmpc compare` of a small task, `--jobs 1`, and more."""
    (tmp_path / "task.yaml").write_text(TASK)
    return lambda *arguments: psmpc("compare", "task.yaml", "--jobs", "1", *arguments)


def test_one_table_one_file_and_the_figures(compare: Psmpc, psmpc: Psmpc) -> None:
    ran = compare("--set", "log.plans=false")
    assert ran.code == 0
    assert ran.stdout.splitlines()[0].split() == ["psmpc", "smpc", "htmpc", "hard"]
    table = rows(ran)
    assert all(len(cells) == 4 for cells in table.values())
    for label in (
        "go ends [s]",
        "back actually starts [s]",
        "back lasts [s]",
        "end of the run [s]",
        "control effort, integral of |u|^2",
        "base thrusters, force [N s]",
        "base thrusters, torque [N m s]",
        "variation of u, joints [rad/s^2]",
        "tightest position margin, of the limit",
        "tightest velocity margin, of the limit",
        "solve time, median [ms]",
        "solve time, p95 [ms]",
        "solve time, p99 [ms]",
        "solve time, maximum [ms]",
        "monitor: far apart",
    ):
        assert label in table
    assert table["mission"] == ["succeeded"] * 4
    assert table["levels not solved"][:2] == ["-", "-"]
    assert list(read_comparison(Path("runs/task-comparison.h5"))) == ["psmpc", "smpc", "htmpc", "hard"]
    assert {path.stem for path in Path("runs/task-comparison").iterdir()} == set(figures_of("comparison"))
    assert max(map(len, ran.stdout.splitlines())) < 160
    again = psmpc("show", "runs/task-comparison.h5")
    assert again.stdout.splitlines() == ran.stdout.splitlines()[:-1]


def test_the_table_says_what_the_logs_say(compare: Psmpc) -> None:
    table = rows(compare("--controllers", "smpc,hard", "--no-figures"))
    logs = read_comparison(Path("runs/task-comparison.h5"))
    for cell, log in zip(table["back ends [s]"], logs.values(), strict=True):
        assert cell == f"{log.stages['switch_time'][1]:.2f}"
    assert table["go ends [s]"][0].endswith("[0.9]")
    assert "[" not in table["go ends [s]"][1]
    assert table["back actually starts [s]"][0].startswith("early ")


def test_a_failed_mission_is_a_result(compare: Psmpc) -> None:
    far = "monitors=[{name: far apart, quantity: distance, of: [arm_1, arm_2], during: back, at_least: 9}]"
    ran = compare("--controllers", "hard", "--no-figures", "--set", far)
    assert ran.code == 0
    assert rows(ran)["mission"] == ["failed"]
    assert rows(ran)["monitor: far apart"][0].startswith("BROKEN at")
    assert "hard: mission failed: back met its end condition; monitor did not hold: far apart" in ran.stdout


def test_progress_says_who_is_done(compare: Psmpc) -> None:
    ran = compare("--controllers", "hard,smpc", "--no-figures")
    assert ran.stderr.splitlines() == ["hard done, 1 of 2", "smpc done, 2 of 2"]


def test_a_line_shows_how_far_each_run_has_come(tmp_path: Path) -> None:
    paths = {name: tmp_path / f"{name}.h5" for name in ("psmpc", "smpc", "hard")}
    (tmp_path / "psmpc.time").write_text("12.300")
    with parallel.watching_runs(True) as runs:
        runs.began(paths)
        runs.done("hard")
        assert runs.line() == "psmpc 12.3 s   smpc waits   hard done"


def test_quiet_prints_nothing(compare: Psmpc) -> None:
    assert compare("--controllers", "hard", "--no-figures", "--quiet", "-o", "a.h5") == Ran(0, "", "")
    assert list(read_comparison(Path("a.h5"))) == ["hard"]


def test_nothing_is_overwritten_without_force(compare: Psmpc) -> None:
    fast = ("--controllers", "hard", "-o", "a.h5")
    Path("a").mkdir()
    Path("a/mine.txt").touch()
    ran = compare(*fast)
    assert (ran.code, ran.stdout) == (2, "")
    assert "a holds files already" in ran.stderr
    assert not Path("a.h5").exists()
    assert compare(*fast, "--no-figures").code == 0
    before = Path("a.h5").read_bytes()
    ran = compare(*fast, "--no-figures")
    assert (ran.code, ran.stdout) == (2, "")
    assert "a.h5 exists already" in ran.stderr
    assert Path("a.h5").read_bytes() == before
    assert compare(*fast, "--force").code == 0
    assert {path.name for path in Path("a").iterdir()} == {
        "mine.txt",
        *(f"{name}.png" for name in figures_of("comparison")),
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controllers", "psmpc,spmc"], "found no controller 'spmc', expected one or more of"),
        (["--set", "controller.kind=smpc"], "choose with --controllers"),
        (["--set", "controller.nods=3"], 'did you mean "nodes"?'),
        (["--jobs", "0"], "Invalid value for '--jobs'"),
        (["-o", "."], "is a directory"),
        (["-o", "task.yaml/a.h5"], "task.yaml/a.h5"),
    ],
)
def test_bad_input_is_one_clear_message(compare: Psmpc, arguments: list[str], message: str) -> None:
    ran = compare(*arguments)
    assert (ran.code, ran.stdout) == (2, "")
    assert message in ran.stderr
    assert "Traceback" not in ran.stderr
    assert {path.name for path in Path().iterdir()} <= {"task.yaml"}


def test_figures_and_tables_of_a_comparison_and_of_its_runs(compare: Psmpc, psmpc: Psmpc) -> None:
    compare("--controllers", "smpc,hard", "--no-figures", "--quiet", "-o", "a.h5")
    assert psmpc("plot", "a.h5", "--only", "instants").stdout == "a/instants.png\n"
    assert psmpc("plot", "a.h5", "--run", "hard", "--only", "shares").stdout == "a/hard/shares.png\n"
    csv = psmpc("show", "a.h5", "--csv", "csv").stdout.splitlines()
    assert csv == [f"csv/{name}/{table}.csv" for name in ("smpc", "hard") for table in ("samples", "stages")]
    for arguments, message in (
        (["plot", "a.h5", "--run", "psmpc"], "expected one of smpc, hard"),
        (["plot", "a.h5", "--animate"], "choose one with --run"),
        (["plot", "a.h5", "--only", "forces"], "expected one of states, instants, shares, snapshots"),
    ):
        ran = psmpc(*arguments)
        assert (ran.code, ran.stdout) == (2, "")
        assert message in ran.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (15, 143, "terminated")])
def test_signals_end_the_comparison_and_leave_nothing(tmp_path: Path, number: int, code: int, word: str) -> None:
    command = [sys.executable, "-c", "from psmpc_cli.cli.main import main; main()", "compare", "transport"]
    command += ["--set", "controller.nodes=20", "-o", str(tmp_path / "a.h5")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as child:
        try:
            for _ in range(600):
                if list(tmp_path.glob(".a-*/*.time")):
                    break
                time.sleep(0.1)
            child.send_signal(number)
            _, said = child.communicate(timeout=60)
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
    assert child.returncode == code
    assert said.splitlines()[-1] == f"psmpc: {word}; no comparison was written"
    assert list(tmp_path.iterdir()) == []
