import os
from pathlib import Path

import pytest

from psmpc_cli.cli.monte_carlo import print_monte_carlo
from psmpc_cli.studies import runner
from psmpc_cli.studies.monte_carlo import ENDED, WAITING, read_monte_carlo

from ..made_up_monte_carlo import made_up_monte_carlo
from ..there_and_back import TASK
from .command import Psmpc

NOISY = ("task.yaml", "--set", "uncertainty.noise.position=1e-3", "--jobs", "1")


@pytest.fixture(autouse=True)
def task(tmp_path: Path) -> None:
    """A small task in the folder of the test."""
    (tmp_path / "task.yaml").write_text(TASK)


def test_runs_give_tables_a_file_and_figures(psmpc: Psmpc, tmp_path: Path) -> None:
    code, out, err = psmpc("monte-carlo", *NOISY, "--runs", "2")
    assert code == 0
    assert "2 of 2 runs succeeded" in out
    assert "2 of 2 runs" in err
    path, figures = tmp_path / "runs" / "task-monte-carlo.h5", tmp_path / "runs" / "task-monte-carlo"
    assert {figure.name for figure in figures.iterdir()} == {"success.png", "runs.png"}
    before = path.read_bytes()
    code, shown, _ = psmpc("show", str(path))
    assert code == 0
    assert "2 of 2 runs succeeded" in shown
    assert psmpc("plot", str(path), "-o", "again", "--only", "runs")[0] == 0
    assert (tmp_path / "again" / "runs.png").read_bytes() == (figures / "runs.png").read_bytes()
    code, _, err = psmpc("monte-carlo", *NOISY, "--runs", "2")
    assert code == 2
    assert "exists already" in err
    assert path.read_bytes() == before
    code, out, err = psmpc("monte-carlo", *NOISY, "--runs", "3", "--resume")
    assert code == 0
    assert "1 of 1 runs" in err
    assert "3 of 3 runs succeeded" in out


def test_an_interrupted_study_keeps_what_is_done(psmpc: Psmpc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(runner.ResultsWriter):
        def write(self, index: tuple[int, ...], values: object) -> None:
            super().write(index, values)
            if not index:
                os.kill(os.getpid(), 15)

    monkeypatch.setattr(runner, "ResultsWriter", Interrupted)
    code, _, err = psmpc("monte-carlo", *NOISY, "--runs", "2", "-o", "study.h5", "--no-figures")
    assert code == 143
    assert "terminated; study.h5 holds what was done: go on with --resume" in err
    assert sorted(read_monte_carlo(tmp_path / "study.h5")["status"]) == [WAITING, ENDED]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("task.yaml",), "--runs"),
        (("task.yaml", "--runs", "0"), "--runs"),
        (("task.yaml", "--runs", "2"), "task.yaml: found nothing random below uncertainty, all runs would be equal"),
        ((*NOISY, "--runs", "2", "--resume"), "--resume: found no file runs/task-monte-carlo.h5"),
        ((*NOISY, "--runs", "2", "--resume", "--force"), "both --resume and --force"),
        ((*NOISY, "--runs", "2", "--dask", "tcp://127.0.0.1:9"), "both --jobs and --dask"),
        (("nowhere.yaml", "--runs", "2"), "nowhere.yaml"),
        ((*NOISY, "--runs", "2", "--set", "controller.nodes=none"), "controller.nodes"),
        ((*NOISY, "--runs", "2", "-o", "task.yaml"), "task.yaml exists already"),
    ],
)
def test_bad_input_is_named_and_leaves_nothing(
    psmpc: Psmpc, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    code, out, err = psmpc("monte-carlo", *arguments)
    assert code == 2
    assert said in err
    assert "Traceback" not in err
    assert not out
    assert not (tmp_path / "runs").exists()


def printed(capsys: pytest.CaptureFixture[str], path: Path, **given: object) -> list[str]:
    print_monte_carlo(made_up_monte_carlo(path, **given))
    return capsys.readouterr().out.splitlines()


def test_the_rate_the_spread_and_the_worst_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, heading, *lines = printed(capsys, tmp_path / "study.h5", waiting=(11,), crashed=(2,), late=(5,))
    assert first == (
        "9 of 11 runs succeeded: 81.8 %, 95 % interval 52.3 to 94.9 % (1 waiting, 10 ended, 1 crashed); "
        "9 of 11 exceeded a velocity limit, by up to 10 %"
    )
    assert heading.split()[-7:] == ["runs", "5", "%", "50", "%", "95", "%"]
    worst = lines.index("worst runs: failed, latest, largest error")
    assert lines[worst + 2].split() == ["12", "failed", "-", "-", *["crashed:", "ZeroDivisionError:", "by", "zero"]]
    assert lines[worst + 3].split()[:4] == ["15", "failed", "60.00", "300.000"]
    assert lines[worst + 4].split()[:2] == ["20", "succeeded"]
    assert lines[-2].startswith("repeat one: psmpc simulate transport --set 'uncertainty.noise={position: 1e-3}'")
    assert lines[-2].endswith("--set seed=12")
    assert lines[-1] == f"study: {tmp_path / 'study.h5'}"


def test_a_study_that_has_not_begun_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, tmp_path / "study.h5", runs=2, waiting=(0, 1))
    assert lines[0] == "no run was made yet: 2 waiting"
    assert not any(line.startswith("worst") for line in lines)
