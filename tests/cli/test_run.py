"""Commands on one run and its log, on a task of two seconds."""

import re
import sys
from pathlib import Path

import h5py
import pytest

from psmpc_cli import __version__
from psmpc_cli.cli import common
from psmpc_cli.figures.registry import figures_of
from psmpc_cli.logs.run import read_run
from psmpc_cli.logs.schema import COMPARISON, MONTE_CARLO, PARETO, RUN, SWEEP

from ..near_captures import UNKNOWN_DRIFT, near_capture
from ..short_runs import TASK, there_and_back
from .command import Psmpc, Ran, on_terminal, plain_text


@pytest.fixture
def simulate(psmpc: Psmpc) -> Psmpc:
    """`psmpc simulate task.yaml --no-figures`, and more."""
    return lambda *arguments: psmpc("simulate", "task.yaml", "--no-figures", *arguments)


def test_a_run_leaves_its_log_and_figures_and_prints_its_summary(psmpc: Psmpc) -> None:
    ran = psmpc("simulate", "task.yaml", "--set", "published.psmpc.switch_time.go=9.1")
    assert ran.code == 0
    log = read_run(Path("runs/task.h5"))
    assert log.attributes["finished"]
    drawn = set(figures_of("run")) - {"grasps", "thrusters", "wheels", "clearance"}  # of which there is nothing
    assert {path.stem for path in Path("runs/task").iterdir()} == drawn
    mission, headings, go, back, *measures, remark, last, figures = ran.stdout.splitlines()
    assert mission == "Mission succeeded in 1.9 s"
    assert headings.split()[0] == "stage"
    assert re.findall(r"published \w+", headings) == ["published end"]  # of the starts nothing was published
    assert (go.split()[0], go.split()[4], back.split()[0]) == ("go", "9.1", "back")
    assert len(measures) <= 4
    assert all(re.search(r": \S.* (ms|m\^2/s\^3, rad\^2/s\^3|N m)$", line) for line in measures)
    assert remark == "limits of forces and accelerations: none declared: nothing bounds the largest values above"
    assert (last, figures) == (
        "log: runs/task.h5 (-v prints all that was measured)",
        f"{len(drawn)} figures in runs/task",
    )
    assert max(map(len, ran.stdout.splitlines())) <= 100
    shown = psmpc("show", "runs/task.h5")
    assert shown.stdout.splitlines() == ran.stdout.splitlines()[:-1]
    verbose = psmpc("show", "runs/task.h5", "--verbose").stdout
    assert len(verbose.splitlines()) >= len(shown.stdout.splitlines()) + 5
    assert {"drift of momentum", "failed solves", "tightest velocity margin, of the limit", "end of the run"} <= {
        line.split("  ")[0] for line in verbose.splitlines()
    }


def test_progress_is_plain_lines_without_a_terminal(simulate: Psmpc) -> None:
    lines = simulate().stderr.splitlines()
    form = r" *\d+\.\d s  (go|back) +planned switch times: ([\d., ]+|none +) +(-|[\d.]+) x real time  failed solves: 0"
    assert len(lines) == 2
    assert all(re.fullmatch(form, line) for line in lines)


def test_a_repeated_run_says_how_long_it_takes_yet(psmpc: Psmpc, ended: Path) -> None:
    lines = psmpc("rerun", "ended.h5").stderr.splitlines()
    assert re.search(r"about \d+ s left$", lines[1])


@pytest.mark.slow
def test_long_work_is_one_line_of_a_terminal_and_few_lines_elsewhere(
    psmpc: Psmpc, part: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(common, "SHORT", 0.0)
    plain = psmpc("verify", "part.h5").stderr.splitlines()
    assert len(plain) == 1  # the next one would come `BETWEEN_LINES` later
    assert re.fullmatch(r"0 of 6 samples", plain[0])
    sent = on_terminal("verify", str(part), stream="stderr")
    assert any(re.match(r"5 of 6 samples, about \d+ s left", line) for line in re.split(r"[\r\n]+", plain_text(sent)))


@pytest.mark.slow
def test_drawing_shows_how_far_it_has_come(part: Path) -> None:
    sent = plain_text(on_terminal("plot", str(part), stream="stderr"))
    assert re.search(r"drawing: 1 of \d figures, about \d+ s left", sent)


def test_quiet_prints_nothing(simulate: Psmpc) -> None:
    assert simulate("--quiet") == Ran(0, "", "")
    assert Path("runs/task.h5").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            "monitors=[{name: closed, quantity: distance, of: [arm_1, arm_2], during: back, at_most: 1.0}]",
            ("Mission failed: back met its end condition; monitor did not hold: closed, after 1.9 s", "BROKEN at"),
        ),
        ("time_limit=1.5", ("Mission failed: time limit of 1.5 s reached, after 1.5 s",)),
    ],
)
def test_a_failed_mission_is_a_result(simulate: Psmpc, change: str, words: tuple[str, ...]) -> None:
    ran = simulate("--set", change)
    assert ran.code == 0
    assert ran.stdout.startswith(words[0])
    assert all(word in ran.stdout for word in words)


def test_a_mission_that_can_no_longer_succeed_ends_and_says_so_first(psmpc: Psmpc) -> None:
    Path("near.yaml").write_text(near_capture(UNKNOWN_DRIFT, {"time_limit": 0.3}).task_yaml)
    ran = psmpc("simulate", "near.yaml", "--no-figures")
    assert ran.code == 0
    assert ran.stdout.startswith("Mission failed: arm_1 and arm_2 missed the object at the end of capture, at 0.0 s")
    flown = psmpc("simulate", "near.yaml", "--no-figures", "--keep-going", "-o", "flown.h5")
    assert flown.code == 0
    assert flown.stdout.startswith("Mission failed: time limit of 0.3 s reached")
    assert psmpc("rerun", "flown.h5", "--strict").code == 0
    refused = psmpc("simulate", "--continue", "flown.h5", "--keep-going")
    assert refused.code == 2 and "--keep-going" in refused.stderr


def test_a_task_file_is_followed_and_its_log_repeated(simulate: Psmpc, psmpc: Psmpc) -> None:
    assert simulate("--follow", "--set", "solver.kind=sqp", "-o", "followed.h5").code == 0
    assert read_run(Path("followed.h5")).new_targets is not None
    assert "equal: all" in psmpc("rerun", "followed.h5", "--strict").stdout
    refused = psmpc("simulate", "--continue", "followed.h5", "--follow")
    assert refused.code == 2 and "--follow" in refused.stderr


def test_a_run_that_cannot_go_on_says_why(simulate: Psmpc) -> None:
    ran = simulate("--set", "solver={kind: fatrop, max_iterations: 1}", "--set", "controller.horizon=1")
    assert ran.code == 3
    last = ran.stderr.splitlines()[-1]
    assert all(word in last for word in ("no window could be solved", "solver.max_iterations", "runs/task.h5"))
    assert ran.stdout.startswith("Mission failed: no window could be solved")
    assert read_run(Path("runs/task.h5"))["events/solve_failed"].all()


def test_controller_and_plant_are_those_chosen(simulate: Psmpc) -> None:
    simulate("--controller", "hard", "--plant", "rk4", "--set", "seed=7", "--set", "stages.back.priority=50")
    log = read_run(Path("runs/task-hard-rk4.h5"))
    assert [log.attributes[name] for name in ("controller", "plant", "seed")] == ["hard", "rk4", 7]
    assert log.stages["priority"].tolist() == [1, 50]


@pytest.mark.slow
def test_a_default_output_is_numbered_and_nothing_is_overwritten(psmpc: Psmpc) -> None:
    short = ("simulate", "task.yaml", "--no-figures", "--set", "time_limit=0.1", "-q")
    for expected in ("task.h5", "task-2.h5"):
        before = {path: path.read_bytes() for path in Path("runs").glob("*")}
        assert psmpc(*short).code == 0
        after = {path: path.read_bytes() for path in Path("runs").glob("*")}
        assert after.keys() - before.keys() == {Path("runs") / expected}
        assert all(after[path] == content for path, content in before.items())
    Path("runs/task-3").mkdir()
    assert psmpc(*short).code == 0
    assert psmpc(*short, "--controller", "smpc").code == 0
    assert {path.name for path in Path("runs").glob("*.h5")} >= {"task-4.h5", "task-smpc.h5"}
    before = Path("runs/task-2.h5").read_bytes()
    assert psmpc(*short, "--force", "--set", "seed=3").code == 0
    assert read_run(Path("runs/task.h5")).attributes["seed"] == 3
    assert Path("runs/task-2.h5").read_bytes() == before
    assert psmpc(*short, "--force", "-o", "runs/task-2.h5", "--set", "seed=4").code == 0
    assert read_run(Path("runs/task-2.h5")).attributes["seed"] == 4


def test_a_missing_package_is_found_before_a_log_is_touched(
    psmpc: Psmpc, part: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "psmpc_cli.plant.mujoco", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert_refused_without(psmpc, part, "pip install 'psmpc[mujoco]'")


@pytest.mark.parametrize("error", ["OSError('libfoo.so: wrong ELF class')", "ImportError('no good')", "AttributeError"])
def test_a_package_that_does_not_work_is_named(
    psmpc: Psmpc, part: Path, error: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("mujoco", "psmpc_cli.plant.mujoco"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    (part.parent / "packages").mkdir()
    (part.parent / "packages" / "mujoco.py").write_text(f"raise {error}")
    monkeypatch.syspath_prepend(part.parent / "packages")
    assert_refused_without(psmpc, part, "found no working package mujoco (")


def assert_refused_without(psmpc: Psmpc, log: Path, words: str) -> None:
    """Make sure that a run and a study with MuJoCo are refused in one line with these words, and keep a log."""
    before = log.read_bytes()
    study = ("monte-carlo", "task.yaml", "--runs", "1", "--set", "uncertainty.mass=0.1", "--set", "plant.kind=mujoco")
    for command in (("simulate", "task.yaml", "--plant", "mujoco"), study):
        ran = psmpc(*command, "-o", log.name, "--force", "--no-figures")
        assert (ran.code, len(ran.stderr.splitlines())) == (2, 1)
        assert words in ran.stderr
        assert log.read_bytes() == before


def test_an_interrupted_run_is_finished(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("simulate", "--continue", "part.h5", "--no-figures")
    assert ran.code == 0
    assert ran.stdout.splitlines()[-1].startswith("log: part.h5")
    assert read_run(part).attributes["finished"]


def test_a_run_that_differs_is_not_continued(psmpc: Psmpc, part: Path) -> None:
    with h5py.File(part, "r+") as file:
        file["force/F"][4, 1] += 1.0
    before = part.read_bytes()
    ran = psmpc("simulate", "--continue", "part.h5", "--no-figures", "-q")
    assert ran.code == 1
    assert "force/F" in ran.stdout
    assert "part.h5 was not continued" in ran.stderr
    assert part.read_bytes() == before
    assert psmpc("simulate", "--continue", "part.h5", "--no-figures", "-o", "whole.h5").code == 0
    assert read_run(Path("whole.h5")).attributes["finished"]


@pytest.mark.slow
def test_a_rerun_says_whether_everything_is_equal(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("rerun", "part.h5", "--quiet", "--strict", "-o", "again.h5")
    assert (ran.code, ran.stderr) == (0, "")
    assert ran.stdout.startswith("equal: all ")
    with h5py.File("again.h5", "r+") as file:
        file["force/F"][4, 1] += 1.0
    ran = psmpc("rerun", "again.h5", "--quiet")
    assert ran.code == 0
    assert any(
        line.split()[0] == "force/F" and line.split()[-2:] == ["1.0e+00", "4"] for line in ran.stdout.splitlines()
    )
    assert "differs: 1 of " in ran.stdout
    assert psmpc("rerun", "again.h5", "--quiet", "--strict").code == 1
    assert sorted(path.name for path in Path().glob("*.h5")) == ["again.h5", "part.h5"]


def test_a_replay_shows_iterations_and_what_is_equal(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("replay", "part.h5", "--step", "3")
    assert (ran.code, ran.stderr) == (0, "")
    lines = ran.stdout.splitlines()
    assert lines[0] == "sample 3 of 6, 0.30 s: window of go, back; solver fatrop"
    assert lines[1].split()[:4] == ["iter", "objective", "inf_pr", "inf_du"]
    rows = {line.rpartition("  ")[0].split("  ")[0]: line.split()[-1] for line in lines}
    assert [rows[name] for name in ("objective J", "go ends [s]", "control of base.x")] == ["0.0e+00"] * 3
    assert lines[-1].startswith("the log is repeated to 1e-06: optimal after")
    other = psmpc("replay", "part.h5", "--step", "3", "--solver", "ipopt").stdout.splitlines()
    assert "solver ipopt" in other[0]
    assert ", by another solver: optimal after " in other[-1]


def test_a_verification_names_what_where_and_when(psmpc: Psmpc, part: Path) -> None:
    ran = psmpc("verify", "part.h5", "--every", "2")
    assert (ran.code, ran.stderr) == (0, "")
    assert "3 horizons, the low-level law acting at every instant" in ran.stdout
    assert "closed loop, 6 samples, each from its logged state, the force held over a tick" in ran.stdout
    for name in ("position off the plan", "beyond a velocity limit", "logged state off the integrated one"):
        assert any(line.startswith(name) for line in ran.stdout.splitlines())


def test_a_closed_loop_that_is_left_out_has_no_table(psmpc: Psmpc, tmp_path: Path) -> None:
    there_and_back(tmp_path, "controller.offset_free=true", samples=3, name="uncertain")
    out = psmpc("verify", "uncertain.h5").stdout
    assert "3 horizons" in out
    assert "note: the closed loop was left out" in out
    assert "closed loop, " not in out


@pytest.mark.slow
def test_figures_are_drawn_where_and_as_asked(psmpc: Psmpc, ended: Path) -> None:
    assert psmpc("plot", "ended.h5", "--only", "states", "--only", "errors").stdout.split() == [
        "ended/states.png",
        "ended/errors.png",
    ]
    again = psmpc("plot", "ended.h5", "--only", "states")
    assert again.code == 2
    assert all(word in again.stderr for word in ("states.png", "-o", "--force"))
    assert psmpc("plot", "ended.h5", "--only", "states", "--force").code == 0
    written = psmpc("plot", "ended.h5", "-o", "out", "--only", "instants", "--format", "svg", "--format", "pdf").stdout
    assert sorted(written.split()) == ["out/instants.pdf", "out/instants.svg"]


@pytest.mark.parametrize("kind", [RUN, COMPARISON, PARETO, SWEEP, MONTE_CARLO])
def test_the_help_of_plot_names_every_figure(psmpc: Psmpc, kind: str) -> None:
    words = re.findall(r"\w+", psmpc("plot", "--help").stdout)
    assert set(figures_of(kind)) <= set(words)


def test_the_version_is_printed(psmpc: Psmpc) -> None:
    assert psmpc("--version") == Ran(0, f"psmpc {__version__}\n", "")


@pytest.mark.slow
def test_a_terminal_shows_one_live_line_and_every_event_above_it(tmp_path: Path) -> None:
    (tmp_path / "task.yaml").write_text(TASK)
    words = (str(tmp_path / "task.yaml"), "--no-figures", "-o", str(tmp_path / "log.h5"), "--verbose")
    lines = plain_text(on_terminal("simulate", *words, stream="stderr")).splitlines()
    assert {"0.10 s: back entered the window", "0.80 s: go ended at 0.74 s"} <= set(lines)
    assert any(re.search(r"\d s  back +planned switch times: none", line) for line in lines)
