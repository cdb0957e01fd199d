"""A sweep that is ended from outside, all its processes at once, and goes on."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.studies.sweep import COMPUTED, SHARED, WAITING

from ..there_and_back import TASK

pytestmark = pytest.mark.slow

COMMAND = [sys.executable, "-c", "from psmpc_cli.cli.main import main; main()"]

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Start a small sweep into a file in a process group of its own."""
    (tmp_path / "task.yaml").write_text(TASK)

    def run(file: str, *arguments: str) -> subprocess.Popen[str]:
        sweep = ["sweep-weights", "3x3", str(tmp_path / "task.yaml"), "--jobs", "2", "--no-figures"]
        return subprocess.Popen(
            [*COMMAND, *sweep, "-o", str(tmp_path / file), *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    return run


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    _, err = process.communicate(timeout=120)
    return process.returncode, err


def kill_after(process: subprocess.Popen[str], runs: int) -> int:
    """Kill a sweep and all its processes after so many runs, and return how many it had told of."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(f"{runs} of "):
            break
    os.killpg(process.pid, signal.SIGKILL)
    ended = [int(found[1]) for found in re.finditer(r"^(\d+) of ", process.stderr.read(), re.MULTILINE)]
    process.stderr.close()
    assert process.wait() == -signal.SIGKILL
    return max([runs, *ended])


def test_a_killed_sweep_loses_no_run_that_has_ended_and_goes_on_to_the_same_file(start: Start, tmp_path: Path) -> None:
    told = kill_after(start("killed.h5"), runs=2)
    stopped = read_results(tmp_path / "killed.h5", SWEEP)["status"]
    computed = np.count_nonzero(stopped == COMPUTED)
    assert told <= computed < 5
    assert WAITING in stopped
    code, err = finish(start("killed.h5", "--resume"))
    assert code == 0
    assert err.startswith(f"0 of {5 - computed} runs")
    assert finish(start("whole.h5"))[0] == 0
    killed, whole = read_results(tmp_path / "killed.h5", SWEEP), read_results(tmp_path / "whole.h5", SWEEP)
    assert np.count_nonzero(whole["status"] == SHARED) == 4
    assert killed.quantities.keys() == whole.quantities.keys()
    for name, quantity in whole.quantities.items():
        if "wall time" not in quantity.long_name:
            np.testing.assert_array_equal(killed[name], quantity.values, err_msg=name)


@pytest.mark.parametrize("delay", [0.5, 1.1])
def test_ctrl_c_ends_a_sweep_whose_processes_only_start(start: Start, tmp_path: Path, delay: float) -> None:
    process = start("sweep.h5")
    assert process.stderr is not None
    assert process.stderr.readline() == "0 of 5 runs\n"
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    code, err = finish(process)
    assert code == 130
    assert err.splitlines()[-1].endswith("sweep.h5 holds what was done: go on with --resume")
    assert "Traceback" not in err


def test_ctrl_c_ends_a_sweep_in_the_midst_of_a_solve(start: Start, tmp_path: Path) -> None:
    process = start("sweep.h5")
    assert process.stderr is not None
    assert process.stderr.readline() == "0 of 5 runs\n"
    assert process.stderr.readline().startswith("1 of 5 runs")  # the processes have started, and solve
    os.killpg(process.pid, signal.SIGINT)
    code, err = finish(process)
    assert code == 130
    assert err.splitlines()[-1].endswith("sweep.h5 holds what was done: go on with --resume")
    assert "Traceback" not in err
    assert WAITING in read_results(tmp_path / "sweep.h5", SWEEP)["status"]
