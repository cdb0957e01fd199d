"""The summary of a run from the datasets of its log: stages, solves, limits, monitors, deviations and smoothness."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.summary import variation_by_group
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.report.pages import report_run
from psmpc_cli.report.texts import describe_forces, describe_mission, describe_verdict, measure_rows, warnings_of
from psmpc_cli.simulation.recorder import header
from psmpc_cli.simulation.run import build_experiment, simulate
from psmpc_cli.solvers.base import FEASIBLE
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.measures import WHOLE_RUN

from ..short_runs import CUT, there_and_back

CHANGES = ("controller.nodes=5", "plant.kind=ideal", "time_limit=2", "log.plans=false")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Two seconds of a transport run."""
    path = tmp_path_factory.mktemp("runs") / "log.h5"
    simulate(load_task("transport", CHANGES), path)
    return read_run(path)


@pytest.fixture
def nothing(tmp_path: Path) -> Run:
    """The log of a run that was killed before its first sample."""
    loaded = load_task("transport", CHANGES)
    LogWriter(tmp_path / "log.h5", header(build_experiment(loaded))).close()
    return read_run(tmp_path / "log.h5")


def changed(log: Run, **columns: np.ndarray | float) -> Run:
    """The log with values in some columns, named with _ in place of /."""
    by_name = {path.replace("/", "_"): path for path in log.arrays}
    new = {by_name[name]: np.broadcast_to(v, log[by_name[name]].shape) for name, v in columns.items()}
    return replace(log, arrays={**log.arrays, **new})


def test_a_run_up_to_its_time_limit(log: Run) -> None:
    summary = log.summary()
    assert (summary.ended, summary.completed, summary.succeeded) == (True, False, False)
    assert summary.reason == "time limit of 2 s reached"
    assert summary.duration == pytest.approx(2.0)
    assert [stage.name for stage in summary.stages] == ["approach", "capture", "transport", "release"]
    assert [stage.priority for stage in summary.stages] == [1, 100, 1, 0.01]
    assert summary.solves.count == 20
    assert summary.switching_solves.count == summary.appended == summary.postponed == summary.failed_solves == 0
    assert [(limit.kind, limit.coordinate[:4]) for limit in summary.limits] == [
        ("position", "base"),
        ("velocity", "base"),
    ]
    assert summary.momentum_error < 1e-9
    assert summary.control_effort == pytest.approx(log["effort/control"].sum())
    assert np.isnan(summary.distances).all()


def test_a_run_without_samples_has_a_summary(nothing: Run) -> None:
    summary = nothing.summary()
    assert (summary.ended, summary.succeeded, summary.duration) == (False, False, 0.0)
    assert summary.reason == "the run was killed, or goes on"
    assert (summary.solves.count, summary.switching_solves.count, summary.limits) == (0, 0, ())
    assert np.isnan([summary.solves.median, summary.momentum_error, *summary.distances]).all()
    assert [(verdict.held, np.isnan(verdict.margin)) for verdict in summary.monitors] == [(False, True)]


def test_published_values_are_those_of_the_same_controller(log: Run) -> None:
    stages = log.summary().stages
    np.testing.assert_equal([stage.published_switch for stage in stages], [np.nan, 13.8, 24.4, 31.3])
    np.testing.assert_equal([stage.published_start for stage in stages], [np.nan, 6.3, np.nan, np.nan])
    other = replace(log, attributes={**log.attributes, "controller": "hard"})
    assert np.isnan([stage.published_switch for stage in other.summary().stages]).all()


def test_solve_times_are_told_apart_by_windows_with_a_switch(log: Run) -> None:
    times = np.arange(1.0, 21.0)
    switch_times = np.full((20, 4), np.nan)
    switch_times[15:, 1] = 30.0
    summary = changed(log, solver_wall_time=times, solver_iterations=times, window_instants=switch_times).summary()
    assert (summary.solves.median, summary.solves.largest, summary.solves.iterations) == (10.5, 20.0, 10.5)
    assert (summary.switching_solves.count, summary.switching_solves.median) == (5, 18.0)
    assert 19 < summary.solves.p95 < summary.solves.p99 < 20


def test_basins_that_changed_are_counted_if_there_were_several_guesses(log: Run) -> None:
    assert log.summary().basins is None
    assert changed(log, window_basin=np.r_[np.full(10, -1), np.zeros(7), 1, 0, 2]).summary().basins == 2
    assert changed(log, window_basin=np.zeros(20)).summary().basins == 0


def test_events_are_counted(log: Run) -> None:
    once, often = np.arange(20) == 3, np.arange(20) < 7
    summary = changed(log, events_appended=once, events_postponed=often, events_solve_failed=once).summary()
    assert (summary.appended, summary.postponed, summary.failed_solves) == (1, 7, 1)


def test_the_tightest_limit_is_relative_to_its_width(log: Run) -> None:
    margin = np.full((20, 9), np.inf)
    margin[4, 0], margin[7, 5] = 0.5, 0.4  # of 5 m, and of pi
    (position, velocity) = changed(log, margin_position=margin).summary().limits
    assert (position.coordinate, position.margin) == ("base.x", 0.5)
    assert position.relative == pytest.approx(0.1)
    margin[7, 5] = -1e-3
    (position, velocity) = changed(log, margin_position=margin).summary().limits
    assert (position.coordinate, position.margin) == ("arm_1.3", -1e-3)
    assert position.relative == pytest.approx(-1e-3 / np.pi)
    assert velocity.kind == "velocity"


def test_without_limits_there_is_no_tightest_one(log: Run) -> None:
    assert [limit.kind for limit in changed(log, margin_position=np.inf).summary().limits] == ["velocity"]


def test_a_broken_monitor_fails_the_mission(log: Run) -> None:
    opened = log["pose/xi"].copy()
    opened[10:, log["pose_coordinate"].tolist().index("arm_1.x")] += 1.0
    done = replace(log, attributes={**log.attributes, "finished": True})
    for xi, succeeded in ((log["pose/xi"], True), (opened, False)):
        summary = changed(done, window_first=2, pose_xi=xi).summary()
        assert (summary.completed, summary.succeeded) == (True, succeeded)
        assert [verdict.held for verdict in summary.monitors] == [succeeded]


@pytest.mark.slow
def test_a_mission_whose_monitor_is_not_judged_neither_succeeded_nor_failed(log: Run, tmp_path: Path) -> None:
    short = there_and_back(tmp_path, samples=2, name="short")  # the monitor's stage has no sample
    done = replace(short, attributes={**short.attributes, "finished": True})
    run = changed(done, final_end_time=0.2)
    summary = run.summary()
    assert [verdict.is_judged for verdict in summary.monitors] == [False]
    assert summary.succeeded is None
    assert describe_mission(summary).startswith("Mission not judged")
    assert "not judged" in repr(summary)
    (column,) = (column for column in WHOLE_RUN if column.path == "succeeded")
    assert column.value is not None and column.value(run) == -1
    assert report_run(run).html.count('class="count "') == 1
    assert column.value(log) == 0


def test_grippers_are_measured_when_a_stage_ends(log: Run) -> None:
    xi = np.zeros_like(log["pose/xi"])
    xi[:, log["pose_coordinate"].tolist().index("arm_1.x")] = log.time
    final = np.zeros(9)
    final[log["pose_coordinate"].tolist().index("arm_1.x")] = log.final["time"]
    ends = np.array([0.55, 1.0, 2.0, np.nan])
    summary = changed(log, pose_xi=xi, stages_switch_time=ends, final_xi=final).summary()
    np.testing.assert_allclose(summary.distances, [0.55, 1.0, 2.0, np.nan])


@pytest.mark.parametrize(("name", "text"), [("task_yaml", "not: a task"), ("robot_yaml", "[")])
def test_texts_of_another_version_are_named(nothing: Run, name: str, text: str) -> None:
    with pytest.raises(LogError, match=r"log\.h5: the task or robot in it is not valid in this version:\n"):
        replace(nothing, attributes={**nothing.attributes, name: text}).summary()


def test_texts_of_another_run_are_rejected(nothing: Run) -> None:
    other = load_task("approach_capture").task_yaml
    with pytest.raises(LogError, match="the task and robot in it do not describe the run it holds"):
        replace(nothing, attributes={**nothing.attributes, "task_yaml": other}).summary()


@pytest.fixture(scope="module")
def drifting() -> Run:
    """Half a second of a run that is to catch an object."""
    return simulate(load_task("catch_drifting", ("controller.nodes=5", "time_limit=0.5", "log.plans=false")))


NEAR = np.array([1e-3, 1e-3, 1e-3, 1e-3])
FAR = np.array([[1e-3, 1e-3, 1e-3, 1e-3], [0.02, 1e-3, 1e-3, 1e-3]])
TAKEN = {"grasp_closed_at": 9.0, "grasp_missed_by": NEAR}
THERE = np.array([0.0, 0.978, 0.0])


@pytest.mark.parametrize(("sample", "explained"), [(2, True), (3, False)])
def test_a_limit_exceeded_where_grippers_close_is_explained_by_their_speed(
    drifting: Run, sample: int, explained: bool
) -> None:
    """They close between the samples 2 and 3; the other samples stay within the limits, or go beyond them by less."""
    margin = np.full(drifting["margin/velocity"].shape, 0.1)
    margin[sample, 1] = -0.125
    margin[1, 0] = -0.02
    closed_at = drifting.time[2] + 0.05
    run = changed(drifting, margin_velocity=margin, grasp_closed_at=closed_at, grasp_missed_by=NEAR)
    row = dict(measure_rows(run.summary()))["farthest beyond a limit, any tick"]
    where = drifting.coordinates[1]
    assert row.startswith(f"{where} velocity: 0.125 m/s at {drifting.time[sample]:.1f} s")
    assert ("as the grippers close" in row) == explained
    if explained:
        assert "that move by 1.00 mm/s, " in row
        assert f"in other samples: {drifting.coordinates[0]} velocity: 0.0200 m/s at" in row


OBJECT_OUTCOMES = {
    "never near": (
        {},
        "BROKEN: the run ended at 0.4 s, before arm_1, arm_2 had to close",
        "not judged",
        "BROKEN: it was not",
    ),
    "too far": (
        {"grasp_closed_at": np.array([9.0, np.nan]), "grasp_missed_by": FAR},
        "BROKEN: arm_2 outside the envelope when the grippers were to close, margin -1.000",
        "not judged",
        "BROKEN: it was not taken",
    ),
    "still held": (
        TAKEN,
        "held, margin 0.9",
        "held, margin 1.000 (pull 0 of 12 N, ",
        "BROKEN: still held at 0.4 s, when the run ended",
    ),
    "pulled open": (
        {**TAKEN, "grasp_lost": np.array([1, -1]), "grasp_opened_at": np.array([9.5, np.nan]), "object_left_at": 9.5},
        "held",
        "BROKEN: arm_1 pulled open at 9.5 s, margin 1.000 (pull 0 of 12 N, ",
        "BROKEN: arm_1 pulled open at 9.5 s",
    ),
    "let go elsewhere": (
        {**TAKEN, "grasp_lost": 0, "object_left_at": 9.5, "object_left_pose": THERE + 0.2, "object_left_velocity": 0.0},
        "held",
        "held",
        "BROKEN: let go at 9.5 s, too far from its destination or too fast, margin -39.000",
    ),
    "delivered": (
        {**TAKEN, "grasp_lost": 0, "object_left_at": 9.5, "object_left_pose": THERE, "object_left_velocity": 0.0},
        "held",
        "held",
        "held, margin 1.000",
    ),
}


@pytest.mark.parametrize(("columns", "taken", "kept", "delivered"), OBJECT_OUTCOMES.values(), ids=list(OBJECT_OUTCOMES))
def test_what_became_of_an_object_is_said_without_numbers_that_are_not_known(
    drifting: Run, columns: dict[str, np.ndarray | float], taken: str, kept: str, delivered: str
) -> None:
    summary = changed(drifting, **columns).summary()
    told = [describe_verdict(verdict) for verdict in summary.monitors]
    for text, expected in zip(told, (taken, kept, delivered), strict=True):
        assert text.startswith(expected)
        assert "nan" not in text


def test_the_last_end_error_is_against_the_object_where_it_is_at_the_end() -> None:
    """Robot and object that are both moved by the same way have the same errors."""
    on_object = {"base": {"object": [0, -0.978, "0 deg"]}, "arm_1": {"object": "arm_1"}, "arm_2": {"object": "arm_2"}}
    changes = {"controller.nodes": 5, "time_limit": 0.3, "uncertainty.noise.position": 1e-4}
    run = simulate(load_task("catch_drifting", {**changes, "stages.release.target": on_object}))
    by = np.array([0.3, -0.2, 0.0])
    robot = {f"final_Q{which}": run[f"final/Q{which}"] + np.r_[by, np.zeros(6)] for which in ("", "_true")}
    target_object = {"final_object_pose": run["final/object_pose"] + by}
    errors = run.summary().end_errors
    assert errors is not None
    assert changed(run, **robot, **target_object).summary().end_errors == pytest.approx(errors)
    assert changed(run, **robot).summary().end_errors != pytest.approx(errors)
    assert changed(run, **target_object).summary().end_errors != pytest.approx(errors)


def test_deviations_are_the_largest_of_the_run(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "plant.kind=rk4", "log.shares=false")
    found = log.summary()
    position, velocity = found.off_plan
    assert position.value == np.abs(log["deviation/Q"]).max()
    assert velocity.value == np.abs(log["deviation/Qdot"]).max() < 1e-3
    assert velocity.where.endswith(" velocity")
    assert found.beyond_limits == ()
    assert found.end_condition is not None
    assert (found.end_condition.where, found.end_condition.value) == ("go", pytest.approx(1.0, abs=1e-3))
    margin = log["margin/velocity"].copy()
    margin[2, 1] = -0.125
    (beyond,) = changed(log, margin_velocity=margin).summary().beyond_limits
    assert (beyond.value, beyond.where, beyond.time) == (0.125, f"{log.coordinates[1]} velocity", log.time[2])


@pytest.mark.parametrize(
    ("planned", "text"), [(0.02, "off the plan"), (-0.0245, "0.0245 m of it planned"), (-0.125, "as planned")]
)
def test_a_violated_limit_is_the_plans_or_that_of_the_motion_that_left_it(
    tmp_path: Path, planned: float, text: str
) -> None:
    log = there_and_back(tmp_path, "log.shares=false")
    margin = log["margin/position"].copy()
    margin_of_plan = log["margin/planned_position"].copy()
    margin[2, 1] = -0.125
    margin_of_plan[2, 1] = planned
    summary = changed(log, margin_position=margin, margin_planned_position=margin_of_plan).summary()
    row = dict(measure_rows(summary))["farthest beyond a limit, any tick"]
    assert row == f"{log.coordinates[1]}: 0.125 m at {log.time[2]:.1f} s, {text}"
    assert f"a limit was exceeded: {row}" in warnings_of(summary)


def test_solves_that_came_late_or_failed_and_samples_without_measurement_are_warned_of(log: Run) -> None:
    assert [warning for warning in warnings_of(log.summary()) if "solves" in warning or "samples" in warning] == []
    wall_time = np.zeros(len(log.time))
    wall_time[[1, 4]] = 0.15
    flags = np.zeros(len(log.time), bool)
    flags[1] = True
    summary = changed(log, solver_wall_time=wall_time, events_solve_failed=flags, events_unmeasured=flags).summary()
    count = len(log.time)
    assert {
        f"2 of {count} solves came late: they took longer than a sample of 100 ms",
        f"1 of {count} solves failed",
        f"1 of {count} samples came without a measurement",
    } <= set(warnings_of(summary))


def test_rounding_beyond_a_limit_is_no_warning(log: Run) -> None:
    margin = log["margin/position"].copy()
    margin[2, 1] = -1e-12
    summary = changed(log, margin_position=margin).summary()
    assert summary.beyond_limits
    assert not any("limit" in warning for warning in warnings_of(summary))


def test_margins_of_plans_are_those_of_the_motion_where_it_follows_them(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "log.shares=false", "plant.kind=ideal")
    for kind in ("position", "velocity"):
        np.testing.assert_allclose(log[f"margin/planned_{kind}"], log[f"margin/{kind}"], atol=FEASIBLE)


LARGEST_FORCE = "largest commanded force, of its limit"
TIME_CUT = "forces cut at their limits"


@pytest.mark.slow
def test_the_force_nearest_to_its_limit_is_named_with_when_and_how_long_forces_are_cut(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, *CUT, name="cut")
    utilization = log["force/utilization"].copy()
    utilization[3, 2] = 1.5
    run = changed(log, force_utilization=utilization)
    summary = run.summary()
    assert summary.tightest_force is not None
    assert (summary.tightest_force.where, summary.tightest_force.value) == ("base.theta", 1.5)
    assert summary.saturated == log["force/saturated"].mean()
    rows = dict(measure_rows(summary))
    assert rows[LARGEST_FORCE] == "base.theta: 150.0 % at 0.3 s"
    assert rows[TIME_CUT] == f"{100 * log['force/saturated'].mean():.1f} % of the time"
    far = (utilization > 1.05).any(axis=1).mean()
    assert 0 < far == summary.far_beyond < 1
    assert rows["forces beyond 105 % of a limit"] == f"{100 * far:.1f} % of the time"
    assert f"forces beyond 105 % of a limit were commanded, {100 * far:.1f} % of the time" in warnings_of(summary)
    assert describe_forces(summary).endswith(f"beyond 105 % of a limit {100 * far:.1f} % of the time")
    assert summary.limits_dynamics

    in_study = {column.path: column.value(run) for column in WHOLE_RUN if column.value and "force" in column.path}
    assert (in_study["force_utilization"], in_study["force_saturated"]) == (1.5, summary.saturated)
    assert (in_study["tightest_force"], in_study["tightest_force_time"]) == ("base.theta", log.time[3])


def test_a_task_that_limits_neither_forces_nor_accelerations_is_named(log: Run, tmp_path: Path) -> None:
    assert not log.summary().limits_dynamics
    assert not {LARGEST_FORCE, TIME_CUT} & set(dict(measure_rows(log.summary())))
    bounded = there_and_back(tmp_path, "limits.arms.acceleration=[9, 9, 9]", samples=2, name="bounded")
    assert bounded.summary().limits_dynamics
    values = {column.path: column.value(bounded) for column in WHOLE_RUN if column.value and "force" in column.path}
    assert values["tightest_force"] == "" and np.isnan([values["force_utilization"], values["force_saturated"]]).all()


KEEPS_CLEAR = (
    "obstacles=[{name: post, shape: {sphere: 0.1}, pose: [0, -1, 0]}]",
    "clearance.margin=0.02",
    "log.shares=false",
    "time_limit=1",
)
"""Changes with which the task there and back keeps clear of a post below the robot."""

CLEARANCE = "smallest distance of parts, any tick"


@pytest.fixture
def clear(tmp_path: Path) -> Run:
    """A second of a run that keeps clear of a post, and touches nothing."""
    return there_and_back(tmp_path, *KEEPS_CLEAR, name="clear")


def with_distances(run: Run, distances: Mapping[tuple[int, int], float], kept: float = 0.02) -> Run:
    """The run with distances [m] of pairs at samples, by both numbers; 1 m at others."""
    found = np.ones(run["clearance/distance"].shape)
    for at, distance in distances.items():
        found[at] = distance
    return changed(run, clearance_distance=found, clearance_margin=found - kept)


def test_the_nearest_parts_are_named_with_distance_margin_and_time(clear: Run) -> None:
    distances = clear["clearance/distance"]
    summary = clear.summary()
    assert summary.clearance is not None
    assert summary.clearance.nearest.distance == distances.min() == summary.clearance.nearest.margin + 0.02
    assert (summary.clearance.touched, np.isnan(summary.clearance.touched_at)) == ((), True)
    near = with_distances(clear, {(3, 1): 0.0123, (5, 0): 0.05})
    text = f"{clear['clearance/pair'][1]}: 12.3 mm at {clear.time[3]:.1f} s, margin -7.7 mm"
    rows = dict(measure_rows(near.summary()))
    assert rows[CLEARANCE] == text
    assert rows["monitor: nothing touched"] == "held, margin 0.012 m"
    assert "smallest margin of clearance, any tick" not in rows
    assert f"a margin of clearance was not kept: {text}" in warnings_of(near.summary())
    assert not any("clearance" in warning for warning in warnings_of(clear.summary()))


def test_parts_nearer_to_their_margin_than_the_nearest_are_named_too(clear: Run) -> None:
    near = with_distances(clear, {(3, 1): 0.03, (5, 0): 0.05})
    margin = near["clearance/margin"].copy()
    margin[5, 0] = -0.01
    rows = dict(measure_rows(changed(near, clearance_margin=margin).summary()))
    assert rows[CLEARANCE].startswith(f"{clear['clearance/pair'][1]}: 30.0 mm")
    assert rows["smallest margin of clearance, any tick"] == (
        f"{clear['clearance/pair'][0]}: 50.0 mm at {clear.time[5]:.1f} s, margin -10.0 mm"
    )


def test_a_touch_fails_the_mission_and_is_said_first(clear: Run) -> None:
    done = replace(clear, attributes={**clear.attributes, "finished": True, "end_reason": "back met its end"})
    done = changed(done, window_first=np.r_[np.zeros(5, int), np.ones(5, int)])
    first, second = clear["clearance/pair"][:2]
    free = with_distances(done, {(3, 0): 0.0}).summary()
    assert (free.succeeded, describe_mission(free)) == (True, "Mission succeeded in 1.0 s")
    one = with_distances(done, {(3, 0): -0.0123}).summary()
    assert not one.succeeded
    assert describe_mission(one) == (
        f"Mission failed: {first} touched, 12.3 mm deep at 0.3 s; back met its end, after 1.0 s"
    )
    several = with_distances(done, {(3, 1): -0.001, (5, 0): -0.02}).summary()
    assert several.clearance is not None and several.clearance.touched == (first, second)
    assert describe_mission(several).startswith(
        f"Mission failed: {first} touched, 20.0 mm deep at 0.5 s (first touch at 0.3 s; 1 more pair touched); back"
    )
    verdict = several.monitors[0]
    assert (verdict.name, verdict.held, verdict.margin, verdict.broken_at) == (
        "nothing touched",
        False,
        -0.02,
        clear.time[3],
    )


@pytest.mark.slow
def test_a_run_that_pushes_through_a_post_says_so(tmp_path: Path) -> None:
    """The post stands in the base at the start; nothing can be done but leave it."""
    inside = there_and_back(tmp_path, *KEEPS_CLEAR, "obstacles.post.pose=[0, 0, 0]", name="inside")
    assert inside["monitors/name"].tolist()[0] == "nothing touched"
    assert (inside["monitors/held"][0], inside["monitors/unit"].tolist()[0]) == (0, "m")
    assert inside["monitors/margin"][0] == np.nanmin(inside["clearance/distance"]) < -0.05
    assert describe_mission(inside.summary()).startswith("Mission failed: base - post touched, ")


def test_a_run_without_clearance_has_no_word_of_it(log: Run) -> None:
    summary = log.summary()
    assert summary.clearance is None
    assert [verdict.name for verdict in summary.monitors] == ["object held"]
    assert CLEARANCE not in dict(measure_rows(summary))
    assert log["monitors/name"].tolist() == ["object held"]
    found = {column.path: column.value(log) for column in WHOLE_RUN if column.value is not None}
    assert np.isnan([found["smallest_clearance"], found["nearest_parts_time"], found["touched"]]).all()
    assert found["nearest_parts"] == ""


@pytest.mark.parametrize(("distance", "touched"), [(0.05, 0.0), (-0.05, 1.0)])
def test_clearance_is_in_studies(clear: Run, distance: float, touched: float) -> None:
    run = with_distances(clear, {(3, 1): distance})
    found = {column.path: column.value(run) for column in WHOLE_RUN if column.value is not None}
    assert (found["smallest_clearance"], found["touched"]) == (distance, touched)
    assert (found["nearest_parts"], found["nearest_parts_time"]) == (clear["clearance/pair"][1], clear.time[3])


def test_nothing_can_touch_where_every_pair_is_excepted(tmp_path: Path) -> None:
    parts = ("base", "arm_1", "arm_2", "post")
    every = "clearance.except=[" + ", ".join(f"[{a}, {b}]" for a in parts for b in parts) + "]"
    run = there_and_back(tmp_path, *KEEPS_CLEAR, every, name="excepted")
    assert run["clearance/distance"].shape == (len(run.time), 0)
    check = run.summary().monitors[0]
    assert (check.name, check.held, check.margin) == ("nothing touched", True, np.inf)
    assert describe_verdict(check) == "held"


COORDINATES = ("base.x", "base.y", "base.theta", "arm_1.1", "arm_1.2")
CONTROLS = arrays(float, (6, 5), elements=st.floats(-9, 9))


def by_group(u: np.ndarray) -> np.ndarray:
    return np.array(variation_by_group(np.abs(np.diff(u, axis=0)).sum(axis=0), COORDINATES))


def test_the_variation_is_summed_by_group() -> None:
    u = np.zeros((4, 5))
    u[1] = [1, -2, 3, 4, -5]
    np.testing.assert_array_equal(by_group(u), [6, 6, 18, 0])
    changes = np.abs(np.diff(u, axis=0)).sum(axis=0)
    assert variation_by_group(changes, COORDINATES, sliding=["arm_1.2"]) == (6, 6, 8, 10)


@given(CONTROLS, st.floats(0.1, 10))
def test_the_variation_scales_with_the_control_and_a_monotone_control_has_the_least(u: np.ndarray, by: float) -> None:
    np.testing.assert_allclose(by_group(by * u + 1), by * by_group(u), atol=1e-9)
    assert np.all(by_group(np.linspace(u[0], u[-1], len(u))) <= by_group(u) + 1e-9)
