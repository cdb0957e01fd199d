import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli import __version__
from psmpc_cli.cli import progress
from psmpc_cli.cli import simulate as module
from psmpc_cli.figures import animation
from psmpc_cli.figures.animation import offscreen_driver
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.logs.run import read_run
from psmpc_cli.logs.schema import Sample

from ..there_and_back import TASK
from .command import Psmpc, Ran

OPEN = "monitors=[{name: closed, quantity: distance, of: [arm_1, arm_2], during: back, at_most: 1.0}]"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path) -> Path:
    """A folder with a small task, and the one to work in."""
    (tmp_path / "task.yaml").write_text(TASK)
    return tmp_path


@pytest.fixture
def simulate(psmpc: Psmpc) -> Psmpc:
    """`psmpc simulate task.yaml --no-figures`, and more."""
    return lambda *arguments: psmpc("simulate", "task.yaml", "--no-figures", *arguments)


def test_a_run_leaves_its_log_and_prints_its_summary(simulate: Psmpc) -> None:
    ran = simulate()
    assert ran.code == 0
    log = read_run(Path("runs/task.h5"))
    assert log.attributes["finished"] is np.True_
    lines = ran.stdout.splitlines()
    assert lines[0].split("  ")[0] == "stage"
    assert [line.split()[0] for line in lines[1:3]] == ["go", "back"]
    assert lines[-2:] == ["mission succeeded: back met its end condition, after 1.9 s", "log: runs/task.h5"]
    for text in (
        "solve time, all windows",
        "median / p95 / p99 / max",
        "fall-backs to the shifted plan",
        "tightest velocity",
    ):
        assert text in ran.stdout
    assert max(map(len, lines)) < 160


def test_progress_is_plain_lines_where_there_is_no_terminal(simulate: Psmpc) -> None:
    lines = simulate().stderr.splitlines()
    form = r" *\d+\.\d s  (go|back) +switches at: ([\d., ]+|none +) +(-|[\d.]+) x real time  fall-backs: 0"
    assert len(lines) == 2
    assert all(re.fullmatch(form, line) for line in lines)
    assert [line.split()[2] for line in lines] == ["go", "back"]


def test_quiet_prints_nothing(simulate: Psmpc) -> None:
    assert simulate("--quiet") == Ran(0, "", "")
    assert Path("runs/task.h5").exists()


def test_a_failed_mission_is_a_result(simulate: Psmpc) -> None:
    ran = simulate("--set", OPEN)
    assert ran.code == 0
    assert "monitor: closed                     BROKEN at 0.8 s, by up to 2.000" in ran.stdout
    said = "mission failed: back met its end condition; monitor did not hold: closed, after 1.9 s"
    assert ran.stdout.splitlines()[-2] == said


def test_a_mission_that_runs_out_of_time_is_a_result(simulate: Psmpc) -> None:
    ran = simulate("--set", "time_limit=1.5")
    assert ran.code == 0
    assert ran.stdout.splitlines()[-2] == "mission failed: time limit of 1.5 s reached, after 1.5 s"


def test_published_values_stand_beside_ours(simulate: Psmpc) -> None:
    ran = simulate("--set", "published={psmpc: {switch_time: {go: 9.1}, actual_start: {back: 8.2}}}")
    assert "9.1" in ran.stdout.splitlines()[1]
    assert "8.2" in ran.stdout.splitlines()[2]


def test_a_run_that_cannot_go_on_says_why(simulate: Psmpc) -> None:
    ran = simulate("--set", "solver={kind: fatrop, max_iterations: 1}", "--set", "controller.horizon=1")
    assert ran.code == 3
    assert ran.stderr.splitlines()[-1] == (
        "psmpc: no window could be solved and the plan was used up; the robot braked to rest (not converged: raise "
        "solver.max_iterations, loosen solver.tolerance, or look for conflicting limits); runs/task.h5 holds the run "
        "up to then"
    )
    assert ran.stdout.splitlines()[-2].startswith("mission failed: no window could be solved")
    assert read_run(Path("runs/task.h5"))["events/solve_failed"].all()


@pytest.mark.parametrize(
    ("arguments", "path"),
    [
        ((), "runs/task.h5"),
        (("--controller", "smpc"), "runs/task-smpc.h5"),
        (("--controller", "hard", "--plant", "rk4"), "runs/task-hard-rk4.h5"),
        (("--set", "controller.kind=smpc"), "runs/task.h5"),
        (("-o", "deep/er/log.hdf5", "--controller", "smpc"), "deep/er/log.hdf5"),
    ],
)
def test_the_log_goes_where_it_is_told(simulate: Psmpc, arguments: tuple[str, ...], path: str) -> None:
    assert simulate(*arguments, "--set", "time_limit=1.4").code == 0
    assert list(Path().rglob("*.h*5")) == [Path(path)]


def test_controller_and_plant_are_those_asked_for(simulate: Psmpc) -> None:
    simulate("--controller", "hard", "--plant", "rk4", "--set", "seed=7", "--set", "stages.back.priority=50")
    log = read_run(Path("runs/task-hard-rk4.h5"))
    assert [log.attributes[name] for name in ("controller", "plant", "seed")] == ["hard", "rk4", 7]
    assert log.stages["priority"].tolist() == [1, 50]
    assert set(log["window/count"]) == {1}


REFUSED = [
    (
        ("--set", "controller.nodes=many"),
        '--set controller.nodes=many: controller.nodes: found the text "many", '
        "expected a whole number from 2 to 1000, or auto",
    ),
    (("--set", "controller.nodes"), '--set controller.nodes: found no "=", expected path=value, such as'),
    (("--set", "controler.nodes=5"), 'found an unknown key (did you mean "controller"?)'),
    (
        ("--controller", "mpc"),
        '--controller mpc: controller.kind: found the text "mpc" (did you mean "smpc"?)',
    ),
    (("--plant", "mars"), '--plant mars: plant.kind: found the text "mars", expected one of ideal'),
    (("--quiet", "--verbose"), "psmpc: found both --quiet and --verbose, expected at most one of them"),
    (("-o", "task.yaml"), "psmpc: task.yaml exists already: choose another file with -o, or overwrite it with --force"),
    (("-o", "task.yaml", "--force"), "psmpc: task.yaml is no log: --force overwrites logs only; choose another file"),
    (("-o", "."), "psmpc: . is a directory: name a file in it with -o, such as run.h5"),
    (("-o", "task.yaml/log.h5"), "psmpc: task.yaml/log.h5 cannot be written: task.yaml is no directory"),
    (("--speed",), "No such option: --speed"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=[" ".join(arguments) for arguments, _ in REFUSED])
def test_bad_input_is_refused_in_one_message(simulate: Psmpc, arguments: tuple[str, ...], message: str) -> None:
    ran = simulate(*arguments)
    assert (ran.code, ran.stdout) == (2, "")
    assert message in ran.stderr
    assert "Traceback" not in ran.stderr
    assert sorted(Path().iterdir()) == [Path("task.yaml")]
    assert Path("task.yaml").read_text() == TASK


def test_a_task_that_is_not_there_is_refused(psmpc: Psmpc) -> None:
    ran = psmpc("simulate", "nowhere")
    assert ran.code == 2
    assert 'nowhere: found no file "nowhere", expected a path or a built-in task' in ran.stderr


def test_an_earlier_log_is_kept_without_force(simulate: Psmpc) -> None:
    simulate("--quiet")
    before = Path("runs/task.h5").read_bytes()
    ran = simulate()
    assert (ran.code, ran.stdout) == (2, "")
    assert ran.stderr == (
        "psmpc: runs/task.h5 exists already: choose another file with -o, or overwrite it with --force\n"
    )
    assert Path("runs/task.h5").read_bytes() == before
    assert simulate("--force", "--set", "time_limit=1.4").code == 0
    assert read_run(Path("runs/task.h5")).final["time"] == pytest.approx(1.4)


def test_a_bad_task_costs_no_earlier_log(simulate: Psmpc) -> None:
    simulate("--quiet")
    before = Path("runs/task.h5").read_bytes()
    assert simulate("--force", "--set", "controller.nodes=0").code == 2
    assert Path("runs/task.h5").read_bytes() == before


@pytest.fixture
def no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where a run starts."""

    def fail(*arguments: object) -> None:
        raise AssertionError("the run has started")

    monkeypatch.setattr(module, "_watched", fail)


@pytest.mark.usefixtures("no_run")
def test_earlier_figures_are_kept_without_force(psmpc: Psmpc) -> None:
    figure = Path("runs/task/states.png")
    figure.parent.mkdir(parents=True)
    figure.write_text("mine")
    ran = psmpc("simulate", "task.yaml")
    assert ran.code == 2
    assert ran.stderr == (
        "psmpc: runs/task holds files already: choose another log with -o, overwrite with --force, or use "
        "--no-figures\n"
    )
    assert figure.read_text() == "mine"


@pytest.mark.usefixtures("no_run")
def test_a_file_in_the_place_of_the_figures_is_found_before_the_run(psmpc: Psmpc) -> None:
    Path("runs").mkdir()
    Path("runs/task").touch()
    ran = psmpc("simulate", "task.yaml", "--force")
    assert ran.code == 2
    assert ran.stderr == (
        "psmpc: runs/task is no directory, but the figures would go there: choose another log with -o, or "
        "--no-figures\n"
    )


def test_a_plant_without_its_package_is_found_before_a_log_is_touched(
    simulate: Psmpc, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulate("--quiet")
    before = Path("runs/task.h5").read_bytes()
    monkeypatch.delitem(sys.modules, "psmpc_cli.plant.mujoco_plant", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    ran = simulate("--plant", "mujoco", "-o", "runs/task.h5", "--force")
    assert (ran.code, ran.stdout) == (2, "")
    assert "pip install 'psmpc[mujoco]'" in ran.stderr.splitlines()[-1]
    assert Path("runs/task.h5").read_bytes() == before


@pytest.mark.usefixtures("no_run")
def test_a_film_nobody_can_draw_is_found_before_the_run(simulate: Psmpc, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "crayons")
    offscreen_driver.cache_clear()
    ran = simulate("--render")
    assert (ran.code, ran.stdout, len(ran.stderr.splitlines())) == (2, "", 1)
    assert ran.stderr.startswith("psmpc: --render: found no driver with which MuJoCo draws off screen (crayons: ")
    assert sorted(Path().iterdir()) == [Path("task.yaml")]


def test_a_film_is_written_beside_the_log(simulate: Psmpc, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []
    monkeypatch.setattr(module, "_draw", lambda log, directory, *flags: drawn.append((directory, *flags)))
    monkeypatch.setattr(animation, "offscreen_driver", lambda: "a driver")
    assert simulate("--render").code == 0
    assert drawn == [(Path("runs/task"), False, False, False, True)]


def test_an_unwritable_folder_is_named(simulate: Psmpc, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, *arguments: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "mkdir", refuse)
    ran = simulate()
    assert (ran.code, ran.stderr) == (2, "psmpc: runs/task.h5 cannot be written: Permission denied\n")


def test_the_version_is_printed(psmpc: Psmpc) -> None:
    assert psmpc("--version") == Ran(0, f"psmpc {__version__}\n", "")


SIGNALS = [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]


@pytest.mark.parametrize(("number", "code", "reason"), SIGNALS)
def test_signals_end_the_run_after_the_sample_in_hand(
    simulate: Psmpc, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, code: int, reason: str
) -> None:
    class Raising(progress.Line):
        def of(self, told: Sample) -> str:
            if told.command.time > 0.25:
                signal.raise_signal(number)
            return super().of(told)

    monkeypatch.setattr(progress, "Line", Raising)
    before = [signal.getsignal(each) for each, _, _ in SIGNALS]
    ran = simulate()
    assert ran.code == code
    assert ran.stdout.splitlines()[-2] == f"mission not finished: {reason}, after 0.3 s"
    log = read_run(Path("runs/task.h5"))
    assert log.time == pytest.approx([0, 0.1, 0.2, 0.3])
    assert (log.attributes["finished"], log.attributes["end_reason"]) == (False, reason)
    assert [signal.getsignal(each) for each, _, _ in SIGNALS] == before


PSMPC = "from psmpc_cli.cli.main import main; main()"


@pytest.mark.parametrize(("number", "code", "reason"), SIGNALS)
def test_an_interrupted_process_leaves_log_summary_and_figures(
    tmp_path: Path, number: signal.Signals, code: int, reason: str
) -> None:
    arguments = ["simulate", "transport", "-o", str(tmp_path / "log.h5"), "--verbose", "--set", "controller.nodes=5"]
    arguments += ["--no-figures"] if number == signal.SIGTERM else []
    command = [sys.executable, "-c", PSMPC, *arguments]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stderr is not None
        first = child.stderr.readline()
        child.send_signal(number)
        stdout, stderr = child.communicate(timeout=60)
    assert child.returncode == code
    assert first.split()[:3] == ["0.0", "s", "approach"]
    assert "Traceback" not in stderr
    log = read_run(tmp_path / "log.h5")
    assert len(log.time) >= 1
    assert (log.attributes["finished"], log.attributes["end_reason"]) == (False, reason)
    assert f"\nmission not finished: {reason}, after {log.time[-1]:.1f} s\n" in stdout
    drawn = sorted(path.stem for path in (tmp_path / "log").glob("*.png"))
    assert drawn == (sorted(figures_of("run")) if number == signal.SIGINT else [])
    with h5py.File(tmp_path / "log.h5") as file:
        assert len(file["time"]) == len(log.time)


def test_a_terminal_shows_one_live_line_and_every_event_above_it(tmp_path: Path) -> None:
    task, terminal = tmp_path / "task.yaml", os.openpty()
    task.write_text(TASK)
    arguments = ["simulate", str(task), "--no-figures", "-o", str(tmp_path / "log.h5"), "--verbose"]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    command = [sys.executable, "-c", PSMPC, *arguments]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=terminal[1]) as child:
        os.close(terminal[1])
        shown = b""
        with suppress(OSError):  # the end of a terminal
            while part := os.read(terminal[0], 4096):
                shown += part
    os.close(terminal[0])
    assert child.returncode == 0
    lines = [re.sub(r"\x1b\[[?\d]*[a-zA-Z]", "", line) for line in shown.decode().splitlines()]
    assert {"info: 0.10 s: back entered the window", "info: 0.80 s: go ended at 0.74 s"} <= set(lines)
    assert any(re.search(r"\d s  back +switches at: none +[\d.]+ x real time  fall-backs: 0$", line) for line in lines)


def test_warnings_of_a_process_are_lines_of_their_own(tmp_path: Path) -> None:
    task = tmp_path / "task.yaml"
    task.write_text(TASK)
    arguments = ["simulate", str(task), "--no-figures", "-o", str(tmp_path / "log.h5")]
    arguments += ["--set", "solver={kind: fatrop, max_iterations: 1}", "--set", "time_limit=1.4"]
    ran = subprocess.run([sys.executable, "-c", PSMPC, *arguments], capture_output=True, text=True, check=False)
    lines = ran.stderr.splitlines()
    assert (ran.returncode, lines[0]) == (
        0,
        "warning: 0.00 s: solve failed (iteration_limit); the shifted plan goes on",
    )
    assert lines[1].endswith("fall-backs: 1")
