"""`psmpc show`: tables of runs and studies, from files with made-up numbers, and their export."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.run import build_experiment
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.runner import WAITING

from ..short_runs import TASK, there_and_back
from ..synthetic_fronts import synthetic_fronts
from ..synthetic_logs import Story, write_story
from ..synthetic_monte_carlo import synthetic_monte_carlo
from ..synthetic_sweep import T_S, numbers, synthetic_sweep
from .command import Psmpc, on_terminal


@pytest.fixture
def shown(psmpc: Psmpc) -> Psmpc:
    """The lines of `psmpc show FILE`."""
    return lambda *arguments: psmpc("show", *map(str, arguments)).stdout.splitlines()


def table_rows(lines: Sequence[str]) -> list[str]:
    """Return the rows of a sweep's table: lines of several columns that begin with a number."""
    return [line for line in lines if re.match(r" *[\d.]+(e[+-]\d+)?  +\S+  ", line)]


def test_a_run_that_was_killed_at_once_has_a_summary(tmp_path: Path, shown: Psmpc) -> None:
    LogWriter(tmp_path / "log.h5", header(build_experiment(load_task("transport", ["plant.kind=ideal"])))).close()
    lines = shown(tmp_path / "log.h5", "--verbose")
    assert lines[0] == "Mission not finished: the run was killed, or goes on, after 0.0 s"
    assert lines[3].split() == ["capture", "100", "6.3", "13.8"]
    assert "monitor: object held not judged" in [" ".join(line.split()) for line in lines]
    assert not any(line.startswith("drift") for line in lines)


def test_a_touch_is_in_the_first_line(tmp_path: Path, shown: Psmpc) -> None:
    """The post stands in the base at the start."""
    keeps_clear = ("obstacles=[{name: post, shape: {sphere: 0.1}, pose: [0, 0, 0]}]", "clearance={}")
    there_and_back(tmp_path, *keeps_clear, "log.shares=false", "time_limit=0.3")
    first, *lines = shown(tmp_path / "log.h5", "-v")
    assert first.startswith("Mission failed: base - post touched, ") and " mm deep at 0.0 s" in first
    rows = [" ".join(line.split()) for line in lines]
    assert any(row.startswith("smallest distance of parts, any tick base - post: -") for row in rows)
    assert any(row.startswith("monitor: nothing touched BROKEN: base - post touched, ") for row in rows)


@pytest.mark.slow
def test_a_stage_shorter_than_a_sample_is_named(tmp_path: Path, shown: Psmpc, psmpc: Psmpc) -> None:
    log = write_story(tmp_path / "log.h5", Story(ends=(10.0, 10.001, 23.0, 29.6), early={}))
    brief = "stage capture lasted 1.00 ms, less than a sample of 100 ms"
    assert f"warning: {brief}" in shown(log)
    assert psmpc("report", str(log), "-o", "report.html").code == 0
    assert f"<p>{brief.capitalize()}.</p>" in Path("report.html").read_text()
    assert not any(
        "lasted" in line for line in shown(write_story(tmp_path / "other.h5", Story(ends=(10, 10.1, 23, 30))))
    )


def test_a_short_summary_has_the_first_stages_and_says_how_many_more_there_are(tmp_path: Path, shown: Psmpc) -> None:
    head, _, tail = TASK.partition("stages:\n")
    back, _, tail = tail.partition("object:")
    back = back[back.index("  - name: back") :]
    stages = "".join(back.replace("name: back", f"name: s{k}") for k in range(15))
    limit = tail[tail.index("time_limit") :]
    (tmp_path / "many.yaml").write_text(f"{head}stages:\n{stages}{limit}")
    LogWriter(tmp_path / "log.h5", header(build_experiment(load_task(str(tmp_path / "many.yaml"))))).close()
    lines = shown(tmp_path / "log.h5")
    assert [line.split()[0] for line in lines[1:13]] == ["stage", *(f"s{k}" for k in range(11))]
    assert lines[13] == "4 more stages: -v shows all"
    assert {f"s{k}" for k in range(15)} <= {line.split()[0] for line in shown(tmp_path / "log.h5", "-v")}


@pytest.mark.slow
@pytest.mark.parametrize(("no_colour", "begins"), [("", "\x1b[33mwarning: "), ("1", "warning: ")])
def test_warnings_have_a_colour_on_a_terminal(tmp_path: Path, no_colour: str, begins: str) -> None:
    log = write_story(tmp_path / "log.h5", Story(ends=(10.0, 10.001, 23.0, 29.6), early={}))
    sent = on_terminal("show", str(log), stream="stdout", NO_COLOR=no_colour)
    assert any(line.startswith(begins) for line in sent.splitlines())


def test_tables_of_a_log_are_exported(psmpc: Psmpc, part: Path) -> None:
    assert psmpc("show", "part.h5", "--csv", "csv").stdout.split() == ["csv/samples.csv", "csv/stages.csv"]
    with Path("csv/samples.csv").open(newline="") as file:
        assert [float(row["time [s]"]) for row in csv.DictReader(file)] == pytest.approx([0.1 * k for k in range(6)])
    assert psmpc("show", "part.h5", "--csv", "csv").code == 2
    assert psmpc("show", "part.h5", "--csv", "csv", "--force").code == 0


def test_a_log_that_is_cut_off_is_named(psmpc: Psmpc, part: Path) -> None:
    part.write_bytes(part.read_bytes()[:5000])
    ran = psmpc("show", "part.h5")
    assert (ran.code, ran.stdout) == (2, "")
    assert "part.h5: found an HDF5 file that is cut off or damaged" in ran.stderr


def test_a_sweep_has_a_row_for_each_ratio_and_a_recommendation(tmp_path: Path, shown: Psmpc, psmpc: Psmpc) -> None:
    path = tmp_path / "sweep.h5"
    synthetic_sweep(path, "3x3")
    headline, reason, heading, *lines = shown(path, "-v")
    assert headline.startswith("recommended omega_2/omega_1: ")
    assert reason.startswith(("it ends at ", "the mission ends at "))
    assert heading == "actual start of capture [s] by threshold epsilon"
    assert any(line.split()[:3] == ["omega_2/omega_1", "0.001", "0.1"] for line in lines)
    rows = table_rows(lines)
    assert [row.split()[0] for row in rows] == ["1e-06", "0.001", "1", "1000", "1e+06"]
    cell = numbers(1.0)
    fine, coarse = cell["actual_start"]
    end = f"{cell['completion_time']:.2f}"
    assert rows[2].split() == ["1", f"{fine}", f"{coarse}", f"{T_S:.2f}", end, end, "1.01", "50.0", "0.90"]
    assert lines[-2].startswith("9 cells: 9 computed; 500 solves")
    assert lines[-1] == f"sweep: {path}"
    short = shown(path)
    assert short[:2] == [headline, reason]
    assert max(map(len, short[2:-1])) <= 100
    assert [len(row.split()) for row in table_rows(short)] == [7] * 5
    assert "holds a sweep, expected logs" in psmpc("show", str(path), "--csv", "tables").stderr


@pytest.mark.parametrize(
    ("sampling", "given", "lines"),
    [
        (
            "3x3",
            {"failed": (0, 1), "waiting": (2, 3, 4)},
            ("9 cells: 3 waiting, 4 computed, 2 failed", "  2 failed: time limit of 30 s reached"),
        ),
        ("3", {"waiting": (0, 1, 2), "own_status": WAITING}, ("3 cells: 3 waiting", "no ratio is recommended")),
        ("101", {}, ("1e-06", "1e+06", "49 of 101 ratios")),
        ("3x3", {"task": "transport"}, ("omega_1  omega_2", "1000", "9 cells")),
    ],
    ids=["failed", "waiting", "many", "runs of one ratio that differ"],
)
def test_a_sweep_that_is_not_complete_or_not_small(
    tmp_path: Path, shown: Psmpc, sampling: str, given: dict[str, object], lines: tuple[str, ...]
) -> None:
    synthetic_sweep(tmp_path / "sweep.h5", sampling, **given)
    found = shown(tmp_path / "sweep.h5", "-v")
    assert len(table_rows(shown(tmp_path / "sweep.h5"))) <= 11
    assert all(any(line.strip().startswith(expected.strip()) for line in found) for expected in lines), found


def test_a_failed_cell_has_a_row_with_its_reason(tmp_path: Path, shown: Psmpc) -> None:
    synthetic_sweep(tmp_path / "sweep.h5", "3", failed=(1,))
    lines = shown(tmp_path / "sweep.h5", "-v")
    assert any(line.endswith(" why") for line in lines)
    rows = table_rows(lines)
    assert [row.split()[0] for row in rows[:3]] == ["1e-06", "1", "1e+06"]
    assert rows[1].split()[5] == "failed" and rows[1].endswith("  time limit of 30 s reached")
    assert "reached" not in rows[0] + rows[2]


def test_a_run_whose_mission_fails_after_the_second_stage_says_so(tmp_path: Path, shown: Psmpc) -> None:
    synthetic_sweep(tmp_path / "sweep.h5", "2", of=lambda ratio: {**numbers(ratio), "succeeded": float(ratio > 1)})
    low, high = table_rows(shown(tmp_path / "sweep.h5", "-v"))
    assert low.split()[5] == "failed"
    assert high.split()[5] == f"{numbers(1e6)['completion_time']:.2f}"


def test_a_monte_carlo_study_has_rate_spread_and_worst_runs(tmp_path: Path, shown: Psmpc) -> None:
    path = tmp_path / "study.h5"
    synthetic_monte_carlo(path, waiting=(11,), crashed=(2,), late=(5,))
    first, *lines = shown(path)
    assert first.startswith("9 of 11 runs succeeded: 81.8 %, 95 % interval 52.3 to 94.9 % (1 waiting, 10 ended, 1 cra")
    assert lines[0] == "warning: 9 of 11 exceeded a velocity limit, by up to 10 %"
    assert lines[1].split()[-7:] == ["runs", "5", "%", "50", "%", "95", "%"]
    assert sum(line in lines for line in shown(path, "-v")) < len(shown(path, "-v"))
    worst = lines.index("worst runs: failed, latest, largest error")
    assert lines[worst + 2].split() == ["12", "failed", "-", "-", *["crashed:", "ZeroDivisionError:", "by", "zero"]]
    assert lines[worst + 3].split()[:4] == ["15", "failed", "60.00", "300"]
    assert lines[-2].startswith("repeat one: psmpc simulate transport --set 'uncertainty.noise={position: 1e-3}'")
    assert lines[-2].endswith("--set seed=12")
    assert lines[-1] == f"study: {path}"


def test_a_monte_carlo_study_counts_the_runs_that_touched(tmp_path: Path, shown: Psmpc) -> None:
    made = synthetic_monte_carlo(tmp_path / "study.h5", runs=4).results
    made["smallest_clearance"][:] = [0.02, -0.001, 0.03, -0.01]
    made["touched"][:] = [0, 1, 0, 1]
    made.create(force=True)
    assert "warning: 2 of 4 touched what they keep clear of" in shown(tmp_path / "study.h5")


def test_a_monte_carlo_study_without_runs_says_so(tmp_path: Path, shown: Psmpc) -> None:
    synthetic_monte_carlo(tmp_path / "study.h5", runs=2, waiting=(0, 1))
    lines = shown(tmp_path / "study.h5")
    assert lines[0] == "no run was made yet: 2 waiting"
    assert not any(line.startswith("worst") for line in lines)


@pytest.mark.parametrize(("limited", "says"), [(0, True), (1, False), (-1, False)])
def test_a_monte_carlo_study_says_that_nothing_limits_forces(
    tmp_path: Path, shown: Psmpc, limited: int, says: bool
) -> None:
    made = synthetic_monte_carlo(tmp_path / "study.h5", runs=2).results
    made["limits_dynamics"][:] = limited
    made.create(force=True)
    text = " ".join(shown(tmp_path / "study.h5"))
    assert ("limits of forces and accelerations: none declared" in text) == says
    assert ("cause of the exceeded velocities: where nothing bounds forces" in text) == says


def test_fronts_have_a_row_for_each_sample_and_how_they_move(tmp_path: Path, shown: Psmpc) -> None:
    path = tmp_path / "pareto.h5"
    synthetic_fronts(path, failed=(1,)).create()
    first, heading, *rows = shown(path)
    assert first.startswith("with growing omega_2/omega_1 the optimum moves to the upper left at 2 of 3 samples")
    assert heading.split()[:4] == ["T0", "[s]", "t_s", "[s]"]
    assert [row.split()[0] for row in rows[:3]] == ["6.50", "7.50", "8.50"]
    assert [row.split()[-1] for row in rows[:3]] == ["0", "7", "0"]
    assert any("least omega_1 J_1 + omega_2 J_2 + pending cost" in row for row in rows)
    assert any("moves to the unknown (2 of 2)" in row for row in rows)
    assert rows[-1] == f"results: {path}"
