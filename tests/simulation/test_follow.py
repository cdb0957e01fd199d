"""Targets that change while a task runs: by hand, by a function, and in the task's file."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.follow import FollowedTask
from psmpc_cli.simulation.replay import continue_run, replay, rerun
from psmpc_cli.simulation.run import simulate
from psmpc_cli.simulation.verify import Verification
from psmpc_cli.specs.load import load_task

from ..short_runs import TASK

FARTHER = {"base": [0.15, 0.05, 0], "arms": [0, 0, 0]}


def farther(time: float) -> dict[str, object]:
    """The first target is another one from 0.5 s on."""
    return {"go": FARTHER} if time == 0.5 else {}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("task") / "task.yaml"
    path.write_text(TASK.replace("{kind: fatrop}", "{kind: sqp}"))
    return path


@pytest.fixture(scope="module")
def retargeted(file: Path) -> Run:
    return simulate(load_task(file), file.with_name("run.h5"), new_targets=farther)


def test_a_stage_ends_at_its_new_target(file: Path, retargeted: Run) -> None:
    assert retargeted.summary().completed
    (sample,) = np.flatnonzero(retargeted["events/retargeted"])
    assert retargeted.time[sample] == 0.5
    (at_end,) = np.flatnonzero(retargeted["window/first"] == 1)[:1]
    assert retargeted.Q[at_end, :2] == pytest.approx([0.15, 0.05], abs=0.03)
    assert np.nanmax(retargeted["deviation/end"][:, 0]) < 1.5
    before = simulate(load_task(file))
    assert "events/retargeted" not in before
    np.testing.assert_array_equal(before["control/u"][:sample], retargeted["control/u"][:sample])
    assert retargeted.stages["switch_time"][0] > before.stages["switch_time"][0]


def test_a_log_repeats_its_run_with_the_new_targets(retargeted: Run) -> None:
    log = read_run(retargeted.path)
    assert [(each.time, each.stage) for each in log.changes_of_targets] == [(0.5, "go")]
    comparison = rerun(log)
    assert comparison is not None and not comparison.differences
    for sample in (4, 5, 6, len(log.time) - 1):
        assert replay(log, sample).largest == 0.0
    assert Verification(log).horizons["position"].value < 1e-3


def test_an_unfinished_log_is_completed_with_them(file: Path) -> None:
    def interrupt(sample: Sample) -> None:
        if sample.number == 7:
            raise KeyboardInterrupt

    part = simulate(load_task(file), file.with_name("part.h5"), interrupt, new_targets=farther)
    continued = continue_run(part)
    assert continued is not None and not continued.differences


def test_a_controller_takes_arrays_and_rejects_what_a_task_file_may_not_have(file: Path) -> None:
    controller = psmpc.Controller(load_task(file))
    state = psmpc.State(np.zeros(9), np.zeros(9))
    controller.step(0.0, state)
    for stage, target, error, words in (
        ("go", {"base": [0.1, 0]}, psmpc.SpecError, "expected 3 entries for base"),
        ("go", {"base": [0.1, 0, 0], "arms": ["1 m", 0, 0]}, psmpc.SpecError, "target.arms"),
        ("nowhere", FARTHER, psmpc.InputError, 'expected one that is not over: "go", "back"'),
    ):
        with pytest.raises(error, match=words):
            controller.retarget(stage, target)
    assert "retargeted" not in controller.step(0.1, state).events
    controller.retarget("back", {"base": np.array([0.05, 0.0, 0.0]), "arms": np.zeros(3)})
    command = controller.step(0.2, state)
    assert "retargeted" in command.events
    assert command.problem.stages[1].target[:3].tolist() == [0.05, 0, 0]
    assert "retargeted" not in controller.step(0.3, state).events


def test_a_stage_that_is_over_has_no_new_target(file: Path) -> None:
    def late(time: float) -> dict[str, object]:
        return {"go": FARTHER} if time > 1.5 else {}

    with pytest.raises(psmpc.InputError, match='found the text "go", expected one that is not over: "back"'):
        simulate(load_task(file), new_targets=late)


def editing(path: Path, texts: dict[int, Callable[[str], str]]) -> Callable[[Sample], None]:
    """A watcher that edits a file after some samples."""

    def watch(sample: Sample) -> None:
        if sample.number in texts:
            path.write_text(texts[sample.number](path.read_text()))
            os.utime(path, (sample.number + 1, sample.number + 1))

    return watch


def test_the_file_of_a_task_is_followed(tmp_path: Path, file: Path) -> None:
    path = tmp_path / "task.yaml"
    path.write_text(file.read_text())
    messages = list[str]()
    followed = FollowedTask(load_task(path), path, report=messages.append)
    edits = {
        0: lambda text: text.replace("horizon: 1", "horizon: 2"),
        1: lambda text: text.replace("horizon: 2", "horizon: [1"),
        2: lambda text: text.replace("horizon: [1", "horizon: 1"),
        4: lambda text: text.replace("{base: [0.1, 0, 0], arm_1: [0.02, 0, 0], arm_2", "{base: [0.15, 0.05, 0], arm_1"),
        5: lambda text: text.replace("arm_1: [0, 0, 0]}\n    ends", "arm_1: [0, 0, 0], arm_2: [0, 0, 0]}\n    ends", 1),
    }
    run = simulate(load_task(path), watch=editing(path, edits), new_targets=followed)
    other, unread, no_arm = messages
    assert "found other values of controller, expected other targets alone" in other
    assert "task.yaml:3" in unread
    assert "stages[0].target" in no_arm
    assert [(each.time, each.stage) for each in run.changes_of_targets] == [(pytest.approx(0.6), "go")]
    assert run.summary().completed
    again = rerun(run)
    assert again is not None
    assert again.differences == ()
