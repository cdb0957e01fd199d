from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.figures.run import Run, load_run
from psmpc_cli.logs.read import Log, read_log

Load = Callable[..., Run]
Write = Callable[..., Path]


def test_stages_of_a_finished_run_follow_each_other(run: Run) -> None:
    assert [span.name for span in run.spans] == ["approach", "capture", "transport", "release"]
    assert [span.end for span in run.spans] == [10.0, 13.0, 23.0, 29.6]
    assert [span.start for span in run.spans[1:]] == [span.end for span in run.spans[:-1]]


def test_only_a_premature_stage_is_early(run: Run) -> None:
    assert [span.early for span in run.spans] == [None, 6.4, None, None]


def test_the_end_of_a_finished_run_follows_the_last_sample(run: Run, log: Log) -> None:
    assert run.end == 29.6 > log.time[-1]
    np.testing.assert_array_equal(run.Q[-1], log.final["Q"])
    assert len(run.time) == len(run.Q) == len(run.Qdot) == len(run.xi) == len(log.time) + 1


def test_a_killed_run_ends_with_its_last_sample(load: Load) -> None:
    run = load(last=11.0)
    assert run.end == run.log.time[-1]
    assert [(span.name, span.end) for span in run.spans] == [("approach", 10.0), ("capture", run.end)]


def test_a_stage_that_acted_early_but_was_not_reached_is_shown(load: Load) -> None:
    run = load(last=8.0)
    assert [(span.name, span.start, span.early) for span in run.spans] == [
        ("approach", 0.0, None),
        ("capture", run.end, 6.4),
    ]


def test_states_between_samples_are_interpolated(run: Run) -> None:
    between = run.coordinates_at((run.time[10] + run.time[11]) / 2)
    np.testing.assert_allclose(between, (run.Q[10] + run.Q[11]) / 2)
    np.testing.assert_array_equal(run.coordinates_at(run.end), run.Q[-1])


def test_the_state_is_the_true_one_beside_what_the_controller_saw(load: Load, run: Run) -> None:
    blurred = load(blur=0.1)
    for name in ("time", "Q", "Qdot", "xi"):
        np.testing.assert_array_equal(getattr(blurred, name), getattr(run, name))
    np.testing.assert_allclose(np.abs(blurred.Q_seen - run.Q), 0.1)
    np.testing.assert_allclose(np.abs(blurred.Qdot_seen - run.Qdot), 0.1)
    np.testing.assert_array_equal(blurred.coordinates_at(blurred.end), run.Q[-1])
    np.testing.assert_array_equal((run.Q_seen, run.Qdot_seen), (run.Q, run.Qdot))


def test_a_log_without_a_sample_is_refused(load: Load) -> None:
    with pytest.raises(LogError, match="holds no sample"):
        load(last=-1.0)


def test_a_log_of_one_sample_is_a_run(load: Load) -> None:
    run = load(last=0.2)
    assert [(span.name, span.start, span.end) for span in run.spans] == [("approach", 0.0, 0.0)]


def test_texts_that_do_not_hold_are_named(tmp_path: Path, write_log: Write) -> None:
    path = write_log(tmp_path / "run.h5", last=1.0, attributes={"task_yaml": "nonsense: 1"})
    with pytest.raises(LogError, match=r"(?s)do not hold in this version.*nonsense"):
        load_run(read_log(path))


def test_texts_of_another_robot_are_refused(tmp_path: Path, write_log: Write, one_arm: dict[str, object]) -> None:
    texts = {"task_yaml": one_arm["task"], "robot_yaml": one_arm["robot"]}
    path = write_log(tmp_path / "run.h5", last=1.0, attributes=texts)
    with pytest.raises(LogError, match="do not describe the run"):
        load_run(read_log(path))
