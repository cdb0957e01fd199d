"""A run that was killed or interrupted and continued is, dataset by dataset, the run that was not."""

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.differences import compare_logs
from psmpc_cli.logs.read import read_log
from psmpc_cli.simulation.resume import continue_run
from psmpc_cli.simulation.run import Progress

from .logged import there_and_back

VARIANTS = {
    "psmpc": (("stages[1].priority=3",), 6),
    "after the switch": ((), 9),
    "with ticks, by closeness": (("log.ticks=true", "onset.kind=closeness"), 4),
    "rigid bodies": (("plant.kind=rk4", "log.shares=false"), 5),
    "ipopt starts from multipliers": (("solver.kind=ipopt",), 4),
    "levels": (("controller.kind=htmpc",), 5),
    "failed solves": (("solver.max_iterations=9", "stages[1].priority=3"), 6),
    "the plan used up": (("solver.max_iterations=1",), 13),
    "one sample": ((), 1),
}


@pytest.mark.parametrize(("changes", "samples"), VARIANTS.values(), ids=list(VARIANTS))
def test_an_interrupted_run_goes_on_exactly(tmp_path: Path, changes: tuple[str, ...], samples: int) -> None:
    whole = there_and_back(tmp_path, *changes)
    assert len(whole.time) > samples
    log = there_and_back(tmp_path, *changes, samples=samples, name="part")
    continue_run(log)
    comparison = compare_logs(whole.path, log.path)
    assert comparison.differences == ()
    assert comparison.compared > 50
    continued = read_log(log.path)
    for name in ("finished", "end_reason", "created", "digest"):
        assert name == "created" or continued.attributes[name] == whole.attributes[name]
    np.testing.assert_allclose(continued.attributes["continued"], [log.time[-1]])


def test_failed_solves_are_among_what_was_continued(tmp_path: Path) -> None:
    changes, samples = VARIANTS["failed solves"]
    failed = there_and_back(tmp_path, *changes)["events/fallback"]
    assert failed[: samples - 1].any()
    assert not failed.all()
    changes, samples = VARIANTS["the plan used up"]
    assert there_and_back(tmp_path, *changes, name="used up")["events/braking"][: samples - 1].any()


KILLED = """
import os, signal, sys
from pathlib import Path
from psmpc_cli.simulation.resume import continue_run
from psmpc_cli.simulation.run import run
from psmpc_cli.logs.read import read_log
from psmpc_cli.specs.load import load_task
left = int(sys.argv[3])
def watch(progress):
    global left
    left -= 1
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
path = Path(sys.argv[2])
if path.exists():
    continue_run(read_log(path), watch)
else:
    run(load_task(sys.argv[1]), path, watch=watch)
"""


def test_a_run_killed_twice_goes_on_exactly(tmp_path: Path) -> None:
    whole, path = there_and_back(tmp_path), tmp_path / "killed.h5"
    for samples in (5, 4):
        command = [sys.executable, "-c", KILLED, str(tmp_path / "task.yaml"), str(path), str(samples)]
        assert subprocess.run(command, check=False).returncode == -9
    log = read_log(path)
    assert (log.attributes["end_reason"], len(log.time)) == ("", 8)
    continue_run(log)
    assert compare_logs(whole.path, path).differences == ()
    np.testing.assert_allclose(read_log(path).attributes["continued"], [0.4, 0.7])
    assert sorted(each.name for each in tmp_path.iterdir()) == ["killed.h5", "log.h5", "task.yaml"]


def test_a_run_interrupted_while_it_is_continued_can_go_on(tmp_path: Path) -> None:
    whole, log = there_and_back(tmp_path), there_and_back(tmp_path, samples=5, name="part")

    def stop(progress: Progress) -> None:
        if progress.record.time > 0.65:
            raise KeyboardInterrupt("again")

    assert continue_run(log, stop) is None
    half = read_log(log.path)
    assert (half.attributes["end_reason"], len(half.time)) == ("again", 8)
    continue_run(half)
    assert compare_logs(whole.path, log.path).differences == ()


def test_what_cannot_be_continued_is_refused_and_left_alone(tmp_path: Path) -> None:
    for log, message in (
        (there_and_back(tmp_path, name="whole"), r"this run has ended \(back met its end condition\)"),
        (there_and_back(tmp_path, "log.plans=false", samples=3, name="lean"), "holds no plans"),
    ):
        before = log.path.read_bytes()
        with pytest.raises(LogError, match=message):
            continue_run(log)
        assert log.path.read_bytes() == before


def test_a_log_of_a_version_that_measured_less_is_refused(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, samples=3)
    with h5py.File(log.path, "r+") as file:
        for name in ("Q", "Qdot", "end"):
            del file[f"deviation/{name}"]
    with pytest.raises(LogError, match="it has no deviation/"):
        continue_run(read_log(log.path))
    assert len(read_log(log.path).time) == 3
    assert not list(tmp_path.glob("*.part"))


HOLD = """
import sys, h5py
from psmpc_cli.logs.write import claimed
file = h5py.File(sys.argv[1], "r+", locking=False)
assert claimed(file.id.get_vfd_handle())
print("held", flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(os.name == "nt", reason="a run is not noticed there")
def test_a_run_that_still_goes_on_is_not_continued(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, samples=3)
    command = [sys.executable, "-c", HOLD, str(log.path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="its run still goes on"):
            continue_run(log)
        other.communicate("")
    assert len(read_log(log.path).time) == 3
