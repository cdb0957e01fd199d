"""Runs that cannot go on, or whose log cannot be written: the message, and the exit code."""

from pathlib import Path

import pytest
from faults import Fault, during, psmpc, simulate, unmeasured

from ..there_and_back import TASK

QUICK = ("log.shares=false", "solver.compiled=false", "time_limit=60")
FAR = "stages.go.target.base=[3, 0, 0]"


@pytest.fixture
def task(tmp_path: Path) -> str:
    path = tmp_path / "task.yaml"
    path.write_text(TASK)
    return str(path)


@pytest.mark.slow
def test_a_run_that_cannot_measure_any_more_says_so(tmp_path: Path, task: str) -> None:
    log = tmp_path / "log.h5"
    ran = simulate(unmeasured(during(0.3, 1000)), log, task, *QUICK, FAR)
    assert ran.code == 3
    assert ran.err.splitlines()[-1] == (
        "psmpc: the state was not measured and the plan was used up; the robot braked to rest; "
        f"{log} holds the run up to then"
    )
    assert "samples not measured" in ran.out


@pytest.mark.parametrize(("force", "said"), [((), "exists already"), (("--force",), "is no log")])
def test_a_device_is_no_log(task: str, force: tuple[str, ...], said: str) -> None:
    ran = psmpc(Fault(), "simulate", task, "--no-figures", "-o", "/dev/full", *force)
    assert ran.code == 2
    assert said in ran.err


def test_a_directory_that_takes_no_files_is_refused(tmp_path: Path, task: str) -> None:
    (tmp_path / "file").write_text("")
    ran = psmpc(Fault(), "simulate", task, "--no-figures", "-o", str(tmp_path / "file" / "log.h5"))
    assert ran.code == 2
    assert "cannot be written" in ran.err
