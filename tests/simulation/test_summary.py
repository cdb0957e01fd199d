from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.read import Log, read_log
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.simulation.run import header, simulate
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.simulation.summary import summarize
from psmpc_cli.specs.load import load_task

CHANGES = ("controller.nodes=5", "plant.kind=ideal", "time_limit=2", "log.plans=false")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """Two seconds of a transport run."""
    path = tmp_path_factory.mktemp("runs") / "log.h5"
    simulate(load_task("transport", CHANGES), path)
    return read_log(path)


@pytest.fixture
def nothing(tmp_path: Path) -> Log:
    """The log of a run that was killed before its first sample."""
    loaded = load_task("transport", CHANGES)
    LogWriter(tmp_path / "log.h5", header(build_experiment(loaded))).close()
    return read_log(tmp_path / "log.h5")


def changed(log: Log, **columns: np.ndarray | float) -> Log:
    """The log with values in some columns, named with _ in place of /, or others among its attributes."""
    by_name = {path.replace("/", "_"): path for path in log.columns}
    new = {by_name[name]: np.broadcast_to(v, log[by_name[name]].shape) for name, v in columns.items()}
    return replace(log, columns={**log.columns, **new})


def test_a_run_up_to_its_time_limit(log: Log) -> None:
    summary = summarize(log)
    assert (summary.ended, summary.completed, summary.succeeded) == (True, False, False)
    assert summary.reason == "time limit of 2 s reached"
    assert summary.duration == pytest.approx(2.0)
    assert [stage.name for stage in summary.stages] == ["approach", "capture", "transport", "release"]
    assert [stage.priority for stage in summary.stages] == [1, 100, 1, 0.01]
    assert summary.solves.count == 20
    assert summary.switching_solves.count == summary.appended == summary.postponed == summary.fallbacks == 0
    assert [(limit.kind, limit.coordinate[:4]) for limit in summary.limits] == [
        ("position", "base"),
        ("velocity", "base"),
    ]
    assert summary.momentum_error < 1e-9
    assert summary.control_effort == pytest.approx(log["effort/control"].sum())
    assert np.isnan(summary.distances).all()


def test_a_run_without_samples_has_a_summary(nothing: Log) -> None:
    summary = summarize(nothing)
    assert (summary.ended, summary.succeeded, summary.duration) == (False, False, 0.0)
    assert summary.reason == "the run was killed, or goes on"
    assert (summary.solves.count, summary.switching_solves.count, summary.limits) == (0, 0, ())
    assert np.isnan([summary.solves.median, summary.momentum_error, *summary.distances]).all()
    assert [(verdict.held, np.isnan(verdict.margin)) for verdict in summary.monitors] == [(False, True)]


def test_published_values_are_those_of_the_same_controller(log: Log) -> None:
    stages = summarize(log).stages
    np.testing.assert_equal([stage.published_switch for stage in stages], [np.nan, 13.8, 24.4, 31.3])
    np.testing.assert_equal([stage.published_start for stage in stages], [np.nan, 6.3, np.nan, np.nan])
    other = replace(log, attributes={**log.attributes, "controller": "hard"})
    assert np.isnan([stage.published_switch for stage in summarize(other).stages]).all()


def test_solve_times_are_told_apart_by_windows_with_a_switch(log: Log) -> None:
    times, count = np.arange(1.0, 21.0), np.r_[np.ones(15), np.full(5, 2)].astype(int)
    summary = summarize(changed(log, solver_wall_time=times, solver_iterations=times, window_count=count))
    assert (summary.solves.median, summary.solves.largest, summary.solves.iterations) == (10.5, 20.0, 10.5)
    assert (summary.switching_solves.count, summary.switching_solves.median) == (5, 18.0)
    assert 19 < summary.solves.p95 < summary.solves.p99 < 20


def test_basins_that_changed_are_counted_where_there_were_several_guesses(log: Log) -> None:
    assert summarize(log).basins is None
    assert summarize(changed(log, window_basin=np.r_[np.full(10, -1), np.zeros(7), 1, 0, 2])).basins == 2
    assert summarize(changed(log, window_basin=np.zeros(20))).basins == 0
    older = {path: values for path, values in log.columns.items() if path != "window/basin"}
    assert summarize(replace(log, columns=older)).basins is None


def test_a_solve_that_outlasts_its_sample_is_missed(log: Log) -> None:
    times = np.full(20, 0.09)
    times[3:5] = 0.11
    assert summarize(changed(log, solver_wall_time=times)).missed == 2


def test_events_are_counted(log: Log) -> None:
    once, often = np.arange(20) == 3, np.arange(20) < 7
    summary = summarize(changed(log, events_appended=once, events_postponed=often, events_fallback=once))
    assert (summary.appended, summary.postponed, summary.fallbacks) == (1, 7, 1)


def test_the_tightest_limit_is_relative_to_its_width(log: Log) -> None:
    margin = np.full((20, 9), np.inf)
    margin[4, 0], margin[7, 5] = 0.5, 0.4  # of 5 m, and of pi
    (position, velocity) = summarize(changed(log, margin_position=margin)).limits
    assert (position.coordinate, position.margin) == ("base.x", 0.5)
    assert position.relative == pytest.approx(0.1)
    margin[7, 5] = -1e-3
    (position, velocity) = summarize(changed(log, margin_position=margin)).limits
    assert (position.coordinate, position.margin) == ("arm_1.3", -1e-3)
    assert position.relative == pytest.approx(-1e-3 / np.pi)
    assert velocity.kind == "velocity"


def test_without_limits_there_is_no_tightest_one(log: Log) -> None:
    assert [limit.kind for limit in summarize(changed(log, margin_position=np.inf)).limits] == ["velocity"]


def test_a_broken_monitor_fails_the_mission(log: Log) -> None:
    opened = log["pose/xi"].copy()
    opened[10:, log.pose_coordinates.index("arm_1.x")] += 1.0
    done = replace(log, attributes={**log.attributes, "finished": True})
    for xi, succeeded in ((log["pose/xi"], True), (opened, False)):
        summary = summarize(changed(done, window_first=2, pose_xi=xi))
        assert (summary.completed, summary.succeeded) == (True, succeeded)
        assert [verdict.held for verdict in summary.monitors] == [succeeded]


def test_grippers_are_measured_when_a_stage_ends(log: Log) -> None:
    xi = np.zeros_like(log["pose/xi"])
    xi[:, log.pose_coordinates.index("arm_1.x")] = log.time
    final = {**log.final, "xi": np.zeros(9)}
    final["xi"][log.pose_coordinates.index("arm_1.x")] = log.final["time"]
    stages = {**log.stages, "switch_time": np.array([0.55, 1.0, 2.0, np.nan])}
    summary = summarize(replace(changed(log, pose_xi=xi), stages=stages, final=final))
    np.testing.assert_allclose(summary.distances, [0.55, 1.0, 2.0, np.nan])


def test_stage_times_are_those_of_the_log(nothing: Log) -> None:
    path = nothing.path
    path.unlink()
    times = {"switch_time": np.arange(4.0) + 1, "actual_start": np.arange(4.0), "early": [0, 1, 0, 0]}
    with LogWriter(path, header(build_experiment(load_task("transport", CHANGES)))) as writer:
        writer.update({f"stages/{name}": values for name, values in times.items()})
    stages = summarize(read_log(path)).stages
    assert [(stage.actual_start, stage.switch_time) for stage in stages] == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert [stage.premature for stage in stages] == [False, True, False, False]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("task_yaml", "not: a task", "the task or robot in it does not hold in this version:\n"),
        ("robot_yaml", "[", "the task or robot in it does not hold in this version:\n"),
    ],
)
def test_texts_of_another_version_are_named(nothing: Log, name: str, text: str, message: str) -> None:
    with h5py.File(nothing.path, "r+") as file:
        file.attrs[name] = text
    with pytest.raises(LogError) as refused:
        summarize(read_log(nothing.path))
    assert str(refused.value).startswith(f"{nothing.path}: {message}")


def test_texts_of_another_run_are_refused(nothing: Log) -> None:
    other = load_task("approach_capture").task_yaml
    with pytest.raises(LogError) as refused:
        summarize(replace(nothing, attributes={**nothing.attributes, "task_yaml": other}))
    assert str(refused.value) == f"{nothing.path}: the task and robot in it do not describe the run it holds"
