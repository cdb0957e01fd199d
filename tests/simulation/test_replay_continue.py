"""A run that was killed or interrupted is repeated, and what its log holds is checked."""

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.comparison import compare_runs
from psmpc_cli.logs.run import read_run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.replay import continue_run, rerun, unequal_conditions
from psmpc_cli.simulation.run import build_experiment, simulate
from psmpc_cli.specs.load import load_task

from ..short_runs import there_and_back

VARIANTS = {
    "psmpc": (("stages[1].priority=3",), 6),
    "with ticks, by closeness": (("log.ticks=true", "onset.kind=closeness"), 4),
    "levels": (("controller.kind=htmpc", "log.plans=false"), 5),
    "the plan used up": (("solver.max_iterations=1",), 13),
}


@pytest.mark.slow
@pytest.mark.parametrize(("changes", "samples"), VARIANTS.values(), ids=list(VARIANTS))
def test_an_interrupted_run_is_completed(tmp_path: Path, changes: tuple[str, ...], samples: int) -> None:
    whole = there_and_back(tmp_path, *changes)
    log = there_and_back(tmp_path, *changes, samples=samples, name="part")
    comparison = continue_run(log)
    assert comparison is not None
    assert comparison.differences == ()
    assert compare_runs(whole, read_run(log.path)).differences == ()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["log.h5", "part.h5", "task.yaml"]


@pytest.mark.slow
def test_a_capture_that_was_interrupted_before_its_grippers_closed_is_completed(tmp_path: Path) -> None:
    def stop(sample: Sample) -> None:
        if sample.number == 5:
            raise KeyboardInterrupt

    near = "initial={base: [-1.9, 1.9, 28 deg], arm_1: [45 deg, 30 deg, 60 deg], arm_2: [-45 deg, -30 deg, -60 deg]}"
    task = load_task("transport_grasp", ["controller.nodes=8", "log.shares=false", "time_limit=4", near])
    comparison = continue_run(simulate(task, tmp_path / "part.h5", stop))
    assert comparison is not None and comparison.differences == ()
    assert np.isfinite(read_run(tmp_path / "part.h5")["grasp/closed_at"]).all()


KILLED = """
import os, signal, sys, time
from pathlib import Path
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task
def watch(sample):
    time.sleep(0.2)
    if sample.number == 4:
        os.kill(os.getpid(), signal.SIGKILL)
simulate(load_task(sys.argv[1]), Path(sys.argv[2]), watch=watch)
"""


@pytest.mark.slow
def test_a_killed_run_is_completed(tmp_path: Path) -> None:
    whole, path = there_and_back(tmp_path), tmp_path / "killed.h5"
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "task.yaml"), str(path)]).returncode == -9
    log = read_run(path)
    assert log.attributes["end_reason"] == ""
    assert 0 < len(log.time) <= 5
    assert continue_run(log) is not None
    assert compare_runs(whole, read_run(path)).differences == ()


@pytest.mark.slow
def test_where_rows_differ_the_log_stays_as_it_was(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, samples=5)
    with h5py.File(log.path, "r+") as file:
        file["state/Q"][2, 0] += 1e-9
    before = log.path.read_bytes()
    comparison = continue_run(read_run(log.path))
    assert comparison is not None
    assert [(each.path, each.row) for each in comparison.differences] == [("state/Q", 2)]
    assert log.path.read_bytes() == before
    elsewhere = tmp_path / "whole.h5"
    assert continue_run(read_run(log.path), elsewhere) is not None
    assert log.path.read_bytes() == before
    assert read_run(elsewhere).attributes["finished"]


def test_a_run_interrupted_while_it_is_continued_stays_as_it_was(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, samples=5, name="part")
    before = log.path.read_bytes()

    def stop(sample: Sample) -> None:
        if sample.command.time > 0.65:
            raise KeyboardInterrupt("again")

    assert continue_run(log, watch=stop) is None
    assert log.path.read_bytes() == before
    assert sorted(each.name for each in tmp_path.iterdir()) == ["part.h5", "task.yaml"]


def test_a_run_that_has_ended_is_not_continued(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"this run has ended \(back met its end condition\)"):
        continue_run(there_and_back(tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize(("controller", "samples"), [("psmpc", None), ("htmpc", 5)])
def test_a_run_repeated_is_equal_in_every_dataset(tmp_path: Path, controller: str, samples: int | None) -> None:
    log = there_and_back(tmp_path, f"controller.kind={controller}", samples=samples)
    comparison = rerun(log, tmp_path / "again.h5")
    assert comparison is not None
    assert comparison.differences == ()
    assert comparison.compared > 40


def test_an_interruption_leaves_nothing_to_compare(tmp_path: Path) -> None:
    def stop(sample: Sample) -> None:
        raise KeyboardInterrupt

    assert rerun(there_and_back(tmp_path, samples=3), tmp_path / "again.h5", watch=stop) is None


def test_conditions_under_which_runs_may_differ_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    log = there_and_back(tmp_path, samples=1)
    assert unequal_conditions(log) == ()
    with h5py.File(log.path, "r+") as file:
        file.attrs["casadi_version"] = "1.0"
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    versions, threads = unequal_conditions(read_run(log.path))
    assert versions.startswith("casadi 1.0 wrote the log, this is ")
    assert threads.startswith("OMP_NUM_THREADS is not 1")


def test_processor_and_compiler_are_named_where_they_are_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    log = there_and_back(tmp_path, "solver.kind=sqp", samples=1)
    assert log.summary().compiled
    assert unequal_conditions(log) == ()
    monkeypatch.setenv("CC", "/no/such/compiler")
    (compiler,) = unequal_conditions(log)
    assert compiler == f"the compiler was {log.attributes['compiler']}, this is none"
    with h5py.File(log.path, "r+") as file:
        file.attrs.update({"processor": "an abacus", "compiled": False, "compiler": ""})
    (processor,) = unequal_conditions(read_run(log.path))
    assert processor == f"the processor was an abacus, this is {log.attributes['processor']}"


def test_a_log_without_samples_cannot_be_repeated(tmp_path: Path) -> None:
    about = header(build_experiment(there_and_back(tmp_path, samples=1).task))
    LogWriter(tmp_path / "empty.h5", about).close()
    with pytest.raises(LogError, match="holds no samples"):
        rerun(read_run(tmp_path / "empty.h5"), tmp_path / "again.h5")
