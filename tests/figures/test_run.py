from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import Run, read_run

Load = Callable[..., Run]
Write = Callable[..., Path]


def test_stages_of_a_finished_run_follow_each_other(run: Run) -> None:
    assert [span.name for span in run.spans] == ["approach", "capture", "transport", "release"]
    assert [span.end for span in run.spans] == [10.0, 13.0, 23.0, 29.6]
    assert [span.start for span in run.spans[1:]] == [span.end for span in run.spans[:-1]]


def test_the_end_of_a_finished_run_follows_the_last_sample(run: Run, log: Run) -> None:
    assert run.motion.end == 29.6 > log.time[-1]
    np.testing.assert_array_equal(run.motion.Q[-1], log.final["Q"])
    assert len(run.motion.time) == len(run.motion.Q) == len(run.motion.v) == len(run.motion.xi) == len(log.time) + 1


def test_a_killed_run_ends_with_its_last_sample(load: Load) -> None:
    run = load(last=11.0)
    assert run.motion.end == run.time[-1]
    assert [(span.name, span.end) for span in run.spans] == [("approach", 10.0), ("capture", run.motion.end)]


def test_a_stage_that_acted_early_but_was_not_reached_is_shown(load: Load) -> None:
    run = load(last=8.0)
    assert [(span.name, span.start, span.early) for span in run.spans] == [
        ("approach", 0.0, None),
        ("capture", run.motion.end, 6.4),
    ]


def test_states_between_samples_are_interpolated(run: Run) -> None:
    between = run.motion.coordinates_at((run.motion.time[10] + run.motion.time[11]) / 2)
    np.testing.assert_allclose(between, (run.motion.Q[10] + run.motion.Q[11]) / 2)
    np.testing.assert_array_equal(run.motion.coordinates_at(run.motion.end), run.motion.Q[-1])


def test_the_state_is_the_true_one_beside_what_the_controller_saw(load: Load, run: Run) -> None:
    blurred = load(blur=0.1)
    for name in ("time", "Q", "v", "xi"):
        np.testing.assert_array_equal(getattr(blurred.motion, name), getattr(run.motion, name))
    np.testing.assert_allclose(np.abs(blurred.motion.Q_seen - run.motion.Q), 0.1)
    np.testing.assert_allclose(np.abs(blurred.motion.v_seen - run.motion.v), 0.1)
    np.testing.assert_array_equal(blurred.motion.coordinates_at(blurred.motion.end), run.motion.Q[-1])
    np.testing.assert_array_equal((run.motion.Q_seen, run.motion.v_seen), (run.motion.Q, run.motion.v))


def test_a_log_without_a_sample_is_refused(load: Load) -> None:
    with pytest.raises(LogError, match="found no samples"):
        assert load(last=-1.0).motion


def test_texts_that_do_not_hold_are_named(tmp_path: Path, write_log: Write) -> None:
    path = write_log(tmp_path / "run.h5", last=1.0, attributes={"task_yaml": "nonsense: 1"})
    with pytest.raises(LogError, match=r"(?s)not valid in this version.*nonsense"):
        assert read_run(path).task


def test_texts_of_another_robot_are_refused(tmp_path: Path, write_log: Write, one_arm: dict[str, object]) -> None:
    texts = {"task_yaml": one_arm["task"], "robot_yaml": one_arm["robot"]}
    path = write_log(tmp_path / "run.h5", last=1.0, attributes=texts)
    with pytest.raises(LogError, match="do not describe the run"):
        assert read_run(path).problem
