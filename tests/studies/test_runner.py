"""The runner of studies: calls in parallel, and a results file that is filled in and resumed.

What is called is defined inside the tests, so that it is sent to the processes by value: they cannot import tests.
"""

import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Timer

import h5py
import numpy as np
import pytest

import psmpc_cli
from psmpc_cli.errors import InputError, RunError
from psmpc_cli.logs.files import FileLock
from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import SWEEP, Column
from psmpc_cli.progress import Progress
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.runner import (
    COMPUTED,
    FAILED,
    LOST,
    SHARED,
    WAITING,
    Study,
    compute,
    run_study,
    with_changes,
)
from psmpc_cli.studies.sampling import parse_sampling
from psmpc_cli.studies.sweep import load_sweep_task, weight_study

from ..short_runs import TASK

Call = Callable[[int], int]

ITEMS = {item: item for item in range(6)}


def doubling(*fatal: int, once: Path | None = None) -> Call:
    """A call that doubles its item; some items kill their process, every time or until a note exists."""

    def call(item: int) -> int:
        if item in fatal and not (once and once.exists()):
            if once:
                once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return 2 * item

    return call


def doubled(*lost: int) -> dict[int, int | None]:
    return {item: None if item in lost else 2 * item for item in range(6)}


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_gets_its_result(jobs: int) -> None:
    assert dict(compute(doubling(), ITEMS, jobs)) == doubled()
    assert list(compute(doubling(), {}, jobs)) == []


@pytest.mark.slow
def test_a_killed_process_loses_no_result(tmp_path: Path) -> None:
    found = list(compute(doubling(2, once=tmp_path / "note"), ITEMS, 2))
    assert sorted(found) == sorted(doubled().items())


@pytest.mark.slow
@pytest.mark.parametrize("killed_after", [0.0, 0.1])
def test_processes_that_end_while_they_return_much_block_nothing(killed_after: float, tmp_path: Path) -> None:
    """A process that is killed while it writes to a pipe keeps all who read it waiting."""
    note = tmp_path / "note"

    def call(item: int) -> bytes:
        if item == 1 and killed_after and not note.exists():
            note.touch()
            Timer(killed_after, os.kill, (os.getpid(), signal.SIGKILL)).start()
        return bytes(100_000_000)

    with closing(compute(call, {item: item for item in range(4)}, 2)) as results:
        for _, result in results:
            assert len(result) == 100_000_000
            if not killed_after:
                break  # the others are ended while they return theirs


@pytest.mark.slow
def test_what_a_call_raises_is_raised() -> None:
    def call(item: int) -> int:
        raise ArithmeticError("no such luck")

    with pytest.raises(ArithmeticError, match="no such luck"):
        list(compute(call, {0: 0}, 1))


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_calls_are_made_in_other_processes_with_one_thread_and_no_more_than_wanted_at_once(
    jobs: int, tmp_path: Path
) -> None:
    def call(item: int) -> tuple[int, int, str]:
        (mine := tmp_path / str(item)).touch()
        time.sleep(0.05)
        at_once = len(list(tmp_path.iterdir()))
        mine.unlink()
        return os.getpid(), at_once, os.environ["OMP_NUM_THREADS"]

    found = [result for _, result in compute(call, {item: item for item in range(8)}, jobs)]
    assert os.getpid() not in {process for process, _, _ in found}
    assert max(at_once for _, at_once, _ in found) <= jobs
    assert {threads for _, _, threads in found} == {"1"}


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Task:
    path = tmp_path_factory.mktemp("task") / "task.yaml"
    path.write_text(TASK)
    return load_sweep_task(path)


def study_of(task: Task, grid: str = "2x2", every_cell: bool = False) -> Study:
    return weight_study(task, (0, 1), parse_sampling(grid, (0.1, 10.0)), every_cell)


@pytest.fixture(scope="module")
def whole(task: Task, tmp_path_factory: pytest.TempPathFactory) -> Results:
    return run_study(study_of(task), tmp_path_factory.mktemp("study") / "whole.h5", 2)


def assert_same(found: Results, wanted: Results) -> None:
    """Everything but measured times is equal."""
    for name, quantity in wanted.quantities.items():
        if "wall time" not in quantity.long_name:
            np.testing.assert_array_equal(found[name], quantity.values, err_msg=name)


def stop_after(runs: int) -> Callable[[Progress], None]:
    def watch(progress: Progress) -> None:
        if progress.ended == runs:
            raise KeyboardInterrupt

    return watch


@pytest.mark.slow
def test_a_study_that_was_stopped_is_resumed_to_the_same_results(tmp_path: Path, task: Task, whole: Results) -> None:
    path, seen = tmp_path / "study.h5", list[Progress]()
    with pytest.raises(KeyboardInterrupt):
        run_study(study_of(task), path, 1, watch=stop_after(1))
    stopped = read_results(path, SWEEP)
    assert stopped["status"].ravel().tolist() == [COMPUTED, WAITING, WAITING, SHARED]
    resumed = run_study(study_of(task), path, 1, resume=True, watch=seen.append)
    assert (seen[-1].total, seen[-1].ended) == (2, 2)
    assert float(resumed["wall_time"]) > float(stopped["wall_time"])
    assert_same(resumed, whole)


@pytest.mark.slow
def test_a_cell_that_fails_is_marked_and_computed_again_when_resumed(
    tmp_path: Path, task: Task, whole: Results
) -> None:
    study, first = study_of(task), failing(study_of(task), 10.0)
    results = run_study(first, tmp_path / "study.h5", 1)
    assert results["status"].tolist() == [[COMPUTED, FAILED], [COMPUTED, SHARED]]
    assert results["reason"][0, 1] == "ArithmeticError: no such luck"
    assert np.isnan(results["completion_time"][0, 1])
    assert_same(run_study(study, tmp_path / "study.h5", 1, resume=True), whole)


def failing(study: Study, priority: float) -> Study:
    """The study with a quantity that cannot be read for this priority of the first stage."""
    first, *others = study.quantities

    def raising(run: Run) -> object:
        if run.stages["priority"][0] == priority:
            raise ArithmeticError("no such luck")
        return first.value(run)

    return replace(study, quantities=(replace(first, value=raising), *others))


@pytest.mark.slow
def test_a_cell_that_kills_its_process_is_lost_and_the_others_are_computed(tmp_path: Path, task: Task) -> None:
    def killing(run: Run) -> float:
        if run.stages["priority"][0] == 10.0:
            os.kill(os.getpid(), signal.SIGKILL)
        return 0.0

    quantities = [Column("killing", "1", "", killing)]
    results = run_study(replace(study_of(task), quantities=quantities), tmp_path / "study.h5", 2)
    assert results["status"].tolist() == [[COMPUTED, FAILED], [COMPUTED, SHARED]]
    assert results["reason"][0, 1] == LOST


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "grid", "every_cell", "named"),
    [
        ((), "3x3", False, "sampling 2x2, this one has 3x3"),
        ((), "2x2", True, "every cell 0, this one has 1"),
        (("controller.nodes=9",), "2x2", False, "nodes: 9"),
    ],
)
def test_another_study_is_not_resumed(
    whole: Results, task: Task, changes: tuple[str, ...], grid: str, every_cell: bool, named: str
) -> None:
    before = whole.path.read_bytes()
    with pytest.raises(InputError, match="holds another sweep") as error:
        run_study(study_of(with_changes(task, changes), grid, every_cell), whole.path, resume=True)
    assert named in str(error.value)
    assert whole.path.read_bytes() == before


def test_a_study_of_another_version_or_without_a_file_is_not_resumed(tmp_path: Path, task: Task) -> None:
    with pytest.raises(InputError, match="found no file"):
        run_study(study_of(task), tmp_path / "study.h5", resume=True)
    study_of(task).results(tmp_path / "study.h5").create()
    with h5py.File(tmp_path / "study.h5", "r+") as file:
        file.attrs["psmpc_version"] = "0.0.1"
    with pytest.raises(InputError, match=r"found psmpc version 0\.0\.1, this one has "):
        run_study(study_of(task), tmp_path / "study.h5", resume=True)


def test_a_study_whose_file_lacks_quantities_is_not_resumed(tmp_path: Path, task: Task) -> None:
    study_of(task).results(tmp_path / "study.h5").create()
    with h5py.File(tmp_path / "study.h5", "r+") as file:
        del file["reference_status"]
    with pytest.raises(InputError, match="earlier version, whose studies had no reference_status: start anew"):
        run_study(study_of(task), tmp_path / "study.h5", resume=True)


def test_a_file_that_another_process_fills_in_is_not_touched_until_that_ends(tmp_path: Path, task: Task) -> None:
    path = tmp_path / "study.h5"
    study_of(task).results(path).create()
    holding = """
import sys
from pathlib import Path
from psmpc_cli.logs.files import FileLock
with FileLock(Path(sys.argv[1])) as lock:
    lock.replace(Path(sys.argv[1]).read_bytes())
    print("locked", flush=True)
    sys.stdin.read()
"""
    before = path.stat().st_ino
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    environment = {**os.environ, "PYTHONPATH": str(Path(psmpc_cli.__file__).parents[1])}
    with subprocess.Popen([sys.executable, "-c", holding, path], env=environment, text=True, **pipes) as other:
        assert other.stdout is not None and other.stdout.readline() == "locked\n"
        held = path.stat().st_ino
        assert held != before
        read_results(path, SWEEP)
        for resume in (True, False):
            with pytest.raises(InputError, match=r"study\.h5 is being filled in by another process"):
                run_study(study_of(task), path, force=not resume, resume=resume)
        assert path.stat().st_ino == held
        other.kill()
    with FileLock(path) as lock:
        lock.replace(path.read_bytes())
    assert path.stat().st_ino != held


@contextmanager
def dask_cluster(folder: Path, *worker: str) -> Iterator[str]:
    """Start a Dask scheduler and workers on this machine, and give the scheduler's address."""
    local = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")
    settings = {
        "PYTHONPATH": str(Path(psmpc_cli.__file__).parents[1]),
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
        "DASK_TEMPORARY_DIRECTORY": str(folder),
    }
    file, started = folder / "scheduler.json", list[subprocess.Popen[bytes]]()

    def start(*arguments: str) -> None:
        command = [sys.executable, "-m", "dask", *arguments, *local]
        quiet = subprocess.DEVNULL
        started.append(subprocess.Popen(command, env={**os.environ, **settings}, stdout=quiet, stderr=quiet))

    try:
        start("scheduler", "--port", "0", "--scheduler-file", str(file))
        for _ in range(600):
            if file.exists() and file.read_text().endswith("}"):
                break
            time.sleep(0.1)
        address = str(json.loads(file.read_text())["address"])
        start("worker", address, *worker)
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(20)


@pytest.mark.slow
def test_a_cluster_computes_what_this_machine_does_and_survives_killed_workers(
    tmp_path: Path, task: Task, whole: Results, capfd: pytest.CaptureFixture[str]
) -> None:
    with dask_cluster(tmp_path, "--nthreads", "1", "--nworkers", "2") as address:
        assert_same(run_study(study_of(task), tmp_path / "study.h5", dask=address), whole)
        assert dict(compute(doubling(1), ITEMS, dask=address)) == doubled(1)
        with pytest.raises(ArithmeticError, match="no such luck"):
            list(compute(lambda item: (_ for _ in ()).throw(ArithmeticError("no such luck")), {1: 1}, dask=address))
    assert tuple(capfd.readouterr()) == ("", "")


@pytest.mark.slow
def test_a_scheduler_that_dies_is_one_error_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("psmpc_cli.studies.runner.CONNECTING", 3)
    with dask_cluster(tmp_path, "--nthreads", "1", "--no-nanny") as address:
        with pytest.importorskip("distributed").Client(address, set_as_default=False) as client:
            scheduler = client.run_on_scheduler(os.getpid)
        caplog.clear()

        def call(item: int) -> int:
            if item:
                os.kill(scheduler, signal.SIGKILL)
                time.sleep(6)
            return item

        with pytest.raises(RunError, match=r"connection to the Dask scheduler at .* was lost"):
            list(compute(call, ITEMS, dask=address))
    assert tuple(capfd.readouterr()) == ("", "")
    assert [each for each in caplog.records if each.levelno >= logging.WARNING] == []


@pytest.mark.slow
def test_workers_with_several_threads_are_rejected(tmp_path: Path) -> None:
    several = dask_cluster(tmp_path, "--nthreads", "2", "--no-nanny")
    with several as address, pytest.raises(InputError, match="has 2 threads"):
        list(compute(doubling(), ITEMS, dask=address))


@pytest.mark.parametrize("address", ["localhost", "", "http://127.0.0.1:1", "tcp://127.0.0.1:1"])
def test_an_address_without_a_scheduler_is_told(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("psmpc_cli.studies.runner.CONNECTING", 1)
    with pytest.raises(InputError, match="dask scheduler --host") as error:
        list(compute(doubling(), ITEMS, dask=address))
    assert f"'{address}'" in str(error.value)
    assert "\n" not in str(error.value)


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'psmpc\[dask\]'"):
        list(compute(doubling(), ITEMS, dask="tcp://127.0.0.1:8786"))


IN_A_WORKER = """
import multiprocessing
import psmpc_cli as psmpc

def study(jobs):
    task = psmpc.load_task("transport", {"controller.nodes": 5, "time_limit": 0.2, "uncertainty.mass": 0.1})
    try:
        return psmpc.monte_carlo(task, 2, path=f"{jobs}.h5", jobs=jobs)["status"].tolist()
    except psmpc.InputError as error:
        return str(error)

if __name__ == "__main__":
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        for result in pool.map(study, [1, 2, None]):
            print(result)
"""


@pytest.mark.slow
def test_a_worker_that_may_start_no_process_computes_itself_or_says_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(IN_A_WORKER)
    ran = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=True)
    alone, two, default = ran.stdout.splitlines()
    assert alone == f"{[COMPUTED] * 2}"
    assert two.startswith("jobs: found 2 in a process that may start no other")
    assert default.startswith("jobs: found one for each core in a process that may start no other")
    assert two.endswith("expected jobs=1, which computes in this process")
    assert [path.name for path in tmp_path.glob("*.h5")] == ["1.h5"]
