import gc
import logging
import os
import pickle
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from random import Random
from types import FrameType

import numpy as np
import pytest

import psmpc_cli
from psmpc_cli import __version__
from psmpc_cli.errors import InputError, RunError
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.run import build_experiment, closed_loop, simulate
from psmpc_cli.specs.load import Task, load_task

from ..limited_disk import files_of_at_most

COARSE = ("controller.nodes=5", "plant.kind=ideal")


def coarse(*changes: str) -> Task:
    return load_task("transport", (*COARSE, *changes))


def stopping_after(samples: int, *words: str) -> Callable[[Sample], None]:
    """A watcher that interrupts the run once it has seen so many samples."""
    seen: list[Sample] = []

    def watch(sample: Sample) -> None:
        seen.append(sample)
        if len(seen) == samples:
            raise KeyboardInterrupt(*words)

    return watch


class Kept(logging.Handler):
    """Keeps what is reported."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(f"{record.levelname}: {record.getMessage()}")


@pytest.fixture(scope="module")
def told() -> Kept:
    """What the finished run reported."""
    return Kept()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, told: Kept) -> Run:
    path, logger = tmp_path_factory.mktemp("runs") / "log.h5", logging.getLogger("psmpc_cli")
    level = logger.level
    logger.addHandler(told)
    logger.setLevel(logging.INFO)
    simulate(coarse(), path)
    logger.removeHandler(told)
    logger.setLevel(level)
    return read_run(path)


def test_the_log_of_a_finished_run_says_how_it_ended(finished: Run) -> None:
    assert finished.attributes["finished"] is np.True_
    assert finished.attributes["end_reason"] == "release met its end condition"
    assert finished.final["time"] == pytest.approx(finished.stages["switch_time"][-1])
    assert finished.final["time"] > finished.time[-1]
    assert np.isfinite(finished.stages["switch_time"]).all()
    assert np.all(np.diff(finished.stages["switch_time"]) > 0)
    assert (finished.stages["actual_start"][1:] <= finished.stages["switch_time"][:-1]).all()


def test_the_log_says_what_ran(finished: Run) -> None:
    loaded, attributes = coarse(), finished.attributes
    assert finished.task.digest == attributes["digest"] == loaded.digest
    expected = {"psmpc_version": __version__, "casadi_version": version("casadi"), "numpy_version": np.__version__}
    expected |= {"controller": "psmpc", "plant": "ideal", "solver": "sqp", "task_name": "transport"}
    assert {name: attributes[name] for name in expected} == expected
    assert (attributes["nodes"], attributes["sample_time"], attributes["horizon"], attributes["seed"]) == (5, 0.1, 4, 0)
    assert str(attributes["created"]).endswith("+00:00")
    assert finished.coordinates[2:4] == ("base.theta", "arm_1.1")


def test_the_verdicts_of_the_monitors_are_in_the_log(finished: Run) -> None:
    assert finished.monitors["name"].tolist() == ["object held"]
    assert finished.monitors["held"].tolist() == [1]
    assert finished.monitors["margin"][0] == pytest.approx(finished.summary().monitors[0].margin)


def test_the_watcher_sees_every_sample(tmp_path: Path) -> None:
    seen: list[Sample] = []
    simulate(coarse("time_limit=1"), tmp_path / "log.h5", watch=seen.append)
    assert [sample.command.time for sample in seen] == pytest.approx(0.1 * np.arange(10))
    assert {sample.command.stage.name for sample in seen} == {"approach"}


def test_a_run_in_memory_is_the_one_in_its_log(tmp_path: Path) -> None:
    logged, run = simulate(coarse("time_limit=1"), tmp_path / "log.h5"), simulate(coarse("time_limit=1"))
    for path, values in logged.arrays.items():
        if path != "solver/wall_time":
            np.testing.assert_array_equal(run[path], values)
    for mine, others in ((logged.final, run.final), (logged.stages, run.stages), (logged.monitors, run.monitors)):
        np.testing.assert_equal(dict(mine), dict(others))
    assert run.task.digest == logged.task.digest
    sent = pickle.loads(pickle.dumps(run))  # to another process, which builds the problem anew
    assert sent.task.digest == run.task.digest
    assert sent.summary().beyond_limits == run.summary().beyond_limits == logged.summary().beyond_limits


def test_the_time_limit_ends_a_run_that_is_not_finished(tmp_path: Path) -> None:
    log = simulate(coarse("time_limit=1"), tmp_path / "log.h5")
    assert (log.attributes["stuck"], log.attributes["end_reason"]) == (False, "time limit of 1 s reached")
    assert log.attributes["finished"] is np.False_
    assert log.final["time"] == pytest.approx(1.0)
    assert np.isfinite(log.final["Q"]).all()
    assert log.monitors["held"].tolist() == [0]


@pytest.mark.parametrize(("words", "reason"), [((), "interrupted"), (("terminated",), "terminated")])
def test_an_interruption_leaves_a_whole_log(tmp_path: Path, words: tuple[str, ...], reason: str) -> None:
    log = simulate(coarse(), tmp_path / "log.h5", watch=stopping_after(7, *words))
    assert log.time == pytest.approx(0.1 * np.arange(7))
    assert (log.attributes["finished"], log.attributes["end_reason"]) == (False, reason)
    assert np.isnan(log.final["time"])
    assert log.stages["actual_start"][0] == 0.0


def test_an_existing_log_is_refused_before_the_first_sample(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    path.write_text("mine")
    seen: list[Sample] = []
    with pytest.raises(InputError, match="exists already"):
        simulate(coarse(), path, watch=seen.append)
    assert not seen
    assert path.read_text() == "mine"


def test_a_run_without_solutions_brakes_and_says_why(caplog: pytest.LogCaptureFixture) -> None:
    log = simulate(coarse("solver.kind=fatrop", "solver.max_iterations=1", "controller.horizon=1"))
    assert log.attributes["stuck"]
    reason = "no window could be solved and the plan was used up; the robot braked to rest"
    assert log.attributes["end_reason"] == reason
    assert log["events/solve_failed"].all()
    assert log["events/braking"][-1]
    assert set(log["solver/status"]) == {"iteration_limit"}
    messages = [entry.getMessage() for entry in caplog.records]
    assert messages[0] == "0.00 s: solve failed (iteration_limit); the shifted plan goes on"
    assert messages[-1] == "1.40 s: solve failed (iteration_limit); the robot brakes to rest"


def test_events_are_reported_to_who_asks(finished: Run, told: Kept) -> None:
    happened = [text.partition(" s: ")[2].partition(" at ")[0] for text in told.messages if text.startswith("INFO: ")]
    assert [text for text in happened if text.endswith("ended")] == [
        f"{stage} ended" for stage in finished.stage_names[:-1]
    ]
    assert [text for text in happened if "entered" in text] == [
        f"{stage} entered the window" for stage in finished.stage_names[1:]
    ]


@pytest.mark.slow
def test_a_run_whose_log_finds_no_room_ends_with_what_it_has(tmp_path: Path) -> None:
    path, seen = tmp_path / "log.h5", list[Sample]()

    def watch(sample: Sample) -> None:
        seen.append(sample)
        time.sleep(0.1)

    with files_of_at_most(500_000), pytest.raises(RunError, match="cannot be written any further"):
        simulate(coarse("log.ticks=true"), path, watch)
    log = read_run(path)
    assert 0 < len(log.time) < len(seen)
    assert log.interrupted


RUN = """
import sys, time
from pathlib import Path
from psmpc_cli.logs import write
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task
write.LARGEST_SHARE = 1.0  # on a busy machine, too, the log is written twice a second
def watch(sample):
    print("sample", flush=True)
    time.sleep(0.05)
simulate(load_task("transport", sys.argv[2:]), Path(sys.argv[1]), watch)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kill", range(4))
def test_a_killed_run_leaves_all_but_the_last_half_second(tmp_path: Path, kill: int) -> None:
    random, plans = Random(kill), kill % 2 == 0
    samples, delay = random.randrange(30), random.uniform(0.0, 0.1)
    path = tmp_path / "log.h5"
    command = [sys.executable, "-c", RUN, str(path), *COARSE, f"log.plans={str(plans).lower()}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        told = "".join(child.stdout.readline() for _ in range(samples))
        while not path.exists() and child.poll() is None:
            time.sleep(0.001)
        time.sleep(delay)
        child.kill()
        told += child.stdout.read()
    log = read_run(path)
    assert told.count("\n") - 0.5 / 0.05 <= len(log.time) <= told.count("\n") + 1
    assert log.time == pytest.approx(0.1 * np.arange(len(log.time)))
    assert (log.attributes["finished"], log.attributes["end_reason"]) == (False, "")
    summary = log.summary()
    assert (summary.ended, summary.succeeded) == (False, False)
    for k in range(len(log.time) if plans else 0):
        assert np.isfinite(log.plan("solution", k)).all()


@pytest.mark.slow
def test_metrics_are_the_same_whenever_they_are_read() -> None:
    task = load_task("transport", ("controller.nodes=5", "time_limit=12", "log.shares=false"))
    at_once = [dict(sample.metrics) for sample in closed_loop(build_experiment(task))]
    later = [dict(sample.metrics) for sample in list(closed_loop(build_experiment(task)))]
    assert len(at_once) == 120
    np.testing.assert_equal(at_once, later)


@pytest.fixture
def nothing_frozen() -> Iterator[None]:
    """Have nothing left out of garbage collections before a test, and all of it after, as the tests have it."""
    gc.unfreeze()
    yield
    gc.freeze()


def test_garbage_collections_leave_out_what_a_loop_is_made_of_until_it_ends(nothing_frozen: None) -> None:
    samples = closed_loop(build_experiment(coarse()))
    assert gc.get_freeze_count() == 0
    next(samples)
    assert gc.get_freeze_count() > 10_000
    samples.close()
    assert gc.get_freeze_count() == 0


def test_a_loop_leaves_frozen_what_a_caller_has_frozen(nothing_frozen: None) -> None:
    gc.freeze()
    samples = closed_loop(build_experiment(coarse()))
    next(samples)
    samples.close()
    assert gc.get_freeze_count() > 0


def test_one_sample_passes_the_files_that_the_page_on_the_architecture_lists() -> None:
    root, passed = Path(psmpc_cli.__file__).parent, set[str]()

    def note(frame: FrameType, event: str, argument: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(root):
            passed.add(str(path.relative_to(root)))

    experiment = build_experiment(load_task("transport", ["controller.nodes=12", "log.shares=false"]))
    samples = closed_loop(experiment)
    with LogWriter(None, header(experiment)) as log:
        for _ in range(5):
            log.write(next(samples))
        sys.setprofile(note)
        log.write(next(samples))
        assert len(log.file["time"]) == 6
        sys.setprofile(None)
    page = (root.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    steps = page.partition("## One sample")[2].partition("What a task does not ask for")[0]
    assert set(re.findall(r"`([\w/]+\.py)`", steps)) == passed
    assert len(passed) <= 39


def failing(error: Exception) -> Callable[[Sample], None]:
    """A watcher that fails at the third sample."""

    def watch(sample: Sample) -> None:
        if sample.number == 2:
            raise error

    return watch


@pytest.mark.parametrize("error", [StopIteration("enough"), ValueError("found 3"), LookupError("no key")])
def test_an_error_of_the_watcher_is_raised_and_the_log_names_it(error: Exception, tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with pytest.raises(type(error)) as raised:
        simulate(coarse("time_limit=0.5"), path, failing(error))
    assert raised.value is error
    log = read_run(path)
    assert len(log.time) == 3
    assert (bool(log.attributes["finished"]), log.attributes["end_reason"]) == (
        False,
        f"{type(error).__name__}: {error}",
    )


def test_a_watcher_may_change_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "other"
    other.mkdir()
    monkeypatch.chdir(tmp_path)
    run = simulate(coarse("time_limit=0.5"), "log.h5", lambda sample: os.chdir(other))
    assert run.attributes["end_reason"] == "time limit of 0.5 s reached"
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["log.h5"]
    assert list(other.iterdir()) == []


def test_a_watcher_cannot_write_into_what_is_recorded() -> None:
    def scribble(sample: Sample) -> None:
        command = sample.command
        ticks = sample.ticks
        metrics = [each for each in sample.metrics.values() if isinstance(each, np.ndarray) and each.ndim]
        for array in (
            command.state,
            command.u,
            command.plan.X,
            command.plan.u,
            ticks.states,
            ticks.F,
            ticks.time,
            *metrics,
        ):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0

    task = coarse("time_limit=0.5", "plant.kind=rk4", "log.ticks=true")
    scribbled = simulate(task, watch=scribble)
    alone = simulate(task)
    for path in ("state/Q", "control/u", "force/F", "final/Q"):
        np.testing.assert_array_equal(scribbled[path], alone[path])
