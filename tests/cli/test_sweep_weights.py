import os
from pathlib import Path

import pytest

from psmpc_cli.cli.sweep_weights import MOST_ROWS, print_sweep
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.studies import runner
from psmpc_cli.studies.sweep import COMPUTED, SHARED, WAITING
from psmpc_cli.studies.weights import sweep_cells

from ..made_up_sweep import T_S, made_up_sweep, numbers
from ..there_and_back import TASK
from .command import Psmpc


@pytest.fixture(autouse=True)
def task(tmp_path: Path) -> None:
    """A small task in the folder of the test."""
    (tmp_path / "task.yaml").write_text(TASK)


@pytest.fixture
def sweep(psmpc: Psmpc) -> Psmpc:
    """`psmpc sweep-weights --jobs 1`, and more."""
    return lambda *arguments: psmpc("sweep-weights", *arguments, "--jobs", "1")


def test_a_grid_gives_a_table_a_file_and_figures(sweep: Psmpc, psmpc: Psmpc, tmp_path: Path) -> None:
    code, out, err = sweep("task.yaml", "2x2", "--range", "0.1:10")
    assert code == 0
    assert "4 cells: 3 computed, 1 shared" in out
    assert "3 of 3 runs" in err
    results = read_results(tmp_path / "runs" / "task-sweep.h5", SWEEP)
    assert results["status"].ravel().tolist() == [COMPUTED, COMPUTED, COMPUTED, SHARED]
    assert list((tmp_path / "runs" / "task-sweep").glob("*.png"))
    assert psmpc("plot", "runs/task-sweep.h5", "-o", "again")[0] == 0
    assert {path.name for path in (tmp_path / "again").iterdir()} == {
        path.name for path in (tmp_path / "runs" / "task-sweep").iterdir()
    }
    before = (tmp_path / "runs" / "task-sweep.h5").read_bytes()
    code, _, err = sweep("2x2", "task.yaml", "--range", "0.1:10")
    assert code == 2
    assert "exists already" in err
    code, out, _ = sweep("2x2", "task.yaml", "--range", "0.1:10", "--resume")
    assert code == 0
    assert "3 computed" in out
    code, _, err = sweep("3x3", "task.yaml", "--range", "0.1:10", "--resume")
    assert code == 2
    assert "holds another sweep" in err
    assert (tmp_path / "runs" / "task-sweep.h5").read_bytes() == before


def test_random_draws_need_no_grid(sweep: Psmpc, tmp_path: Path) -> None:
    code, out, _ = sweep("task.yaml", "--sampling", "random:2", "-o", "draws.h5", "--no-figures")
    assert code == 0
    assert "2 cells: 2 computed" in out
    assert read_results(tmp_path / "draws.h5", SWEEP)["omega_1"].shape == (2,)


def test_thresholds_are_those_asked_for(sweep: Psmpc, tmp_path: Path) -> None:
    assert sweep("2", "task.yaml", "--epsilon", "0.5,1e-3", "-o", "two.h5", "--no-figures", "-q")[0] == 0
    results = read_results(tmp_path / "two.h5", SWEEP)
    assert results["epsilon"].tolist() == [1e-3, 0.5]
    assert results["actual_start"].shape == (2, 2)


def test_an_interrupted_sweep_keeps_what_is_done(sweep: Psmpc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(runner.ResultsWriter):
        def write(self, index: tuple[int, ...], values: object) -> None:
            super().write(index, values)
            if not index:
                os.kill(os.getpid(), 15)

    monkeypatch.setattr(runner, "ResultsWriter", Interrupted)
    code, _, err = sweep("2x2", "task.yaml", "-o", "sweep.h5", "--no-figures")
    assert code == 143
    assert "terminated; sweep.h5 holds what was done: go on with --resume" in err
    assert COMPUTED in read_results(tmp_path / "sweep.h5", SWEEP)["status"]
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    assert sweep("2x2", "task.yaml", "-o", "sweep.h5", "--no-figures", "--resume")[0] == 0
    assert WAITING not in read_results(tmp_path / "sweep.h5", SWEEP)["status"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "neither a grid nor --sampling"),
        (("task.yaml",), "neither a grid nor --sampling"),
        (("3x3", "task.yaml", "--sampling", "random:5"), "both a grid and --sampling"),
        (("25y25", "task.yaml"), "found '25y25', expected two sizes of at least 2 such as 25x25"),
        (("1x5", "task.yaml"), "found '1x5'"),
        (("3x3", "task.yaml", "--sampling", "sobol:5"), "both a grid and --sampling"),
        (("task.yaml", "--sampling", "sobol:5"), "--sampling: found 'sobol:5', expected random:N"),
        (("3x3", "task.yaml", "--range", "1:0.1"), "--range: found '1:0.1'"),
        (("3x3", "task.yaml", "--epsilon", "0"), "--epsilon: found '0'"),
        (("3x3", "task.yaml", "--stages", "2,3"), "--stages: found '2,3', expected two in a row"),
        (("3x3", "task.yaml", "--set", "controller.kind=smpc"), "which has no priorities"),
        (("3x3", "task.yaml", "--resume"), "--resume: found no file runs/task-sweep.h5"),
        (("3x3", "task.yaml", "--resume", "--force"), "both --resume and --force"),
        (("3x3", "task.yaml", "--dask", "tcp://127.0.0.1:9"), "both --jobs and --dask"),
        (("3x3", "nowhere.yaml"), "nowhere.yaml"),
        (("3x3", "task.yaml", "--set", "controller.nodes=none"), "controller.nodes"),
    ],
)
def test_bad_input_is_named_and_leaves_nothing(
    sweep: Psmpc, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    code, out, err = sweep(*arguments)
    assert code == 2
    assert said in err
    assert "Traceback" not in err
    assert not out
    assert not (tmp_path / "runs").exists()


def printed(capsys: pytest.CaptureFixture[str], *arguments: object, **given: object) -> list[str]:
    print_sweep(sweep_cells(made_up_sweep(*arguments, **given)))
    return capsys.readouterr().out.splitlines()


def test_a_row_a_ratio_says_what_became_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sweep.h5"
    heading, names, *rows = printed(capsys, path, "3x3")
    assert heading == "actual start of capture [s] by threshold epsilon"
    assert names.split()[:3] == ["omega_2/omega_1", "0.001", "0.1"]
    assert [row.split()[0] for row in rows[:5]] == ["1e-06", "0.001", "1", "1000", "1e+06"]
    cell = numbers(1.0)
    fine, coarse = cell["actual_start"]
    assert rows[2].split() == ["1", f"{fine}", f"{coarse}", f"{T_S}", f"{cell['completion_time']:.2f}", "1.01", "0.90"]
    assert rows[5] == "9 cells: 9 computed; 900 solves, 0 of them failed"
    assert rows[6].startswith("recommended omega_2/omega_1: ")
    assert rows[7] == f"sweep: {path}"


def test_failures_are_told_with_their_reasons(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, tmp_path / "sweep.h5", "3x3", failed=(0, 1), waiting=(2, 3, 4))
    assert "9 cells: 3 waiting, 4 computed, 2 failed; 400 solves, 0 of them failed" in lines
    assert "  2 failed: time limit of 30 s reached" in lines


def test_a_sweep_without_ended_cells_has_no_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, tmp_path / "sweep.h5", "3", waiting=(0, 1, 2))
    assert lines[0] == "3 cells: 3 waiting; 0 solves, 0 of them failed"
    assert lines[1].startswith("no ratio is recommended")


def test_of_many_ratios_some_are_printed_the_first_and_last_among_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, _, *rows = printed(capsys, tmp_path / "sweep.h5", "101")
    assert rows[MOST_ROWS] == f"{MOST_ROWS} of 101 ratios"
    assert (rows[0].split()[0], rows[MOST_ROWS - 1].split()[0]) == ("1e-06", "1e+06")


def test_runs_of_one_ratio_that_differ_have_rows_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, names, *rows = printed(capsys, tmp_path / "sweep.h5", "3x3", task="transport")
    assert names.split()[:2] == ["omega_1", "omega_2"]
    assert [row.split()[:2] for row in rows[:3]] == [["1000", "0.001"], ["1", "0.001"], ["1000", "1"]]
    assert rows[9].startswith("9 cells")
