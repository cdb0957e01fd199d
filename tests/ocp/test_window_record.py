"""Windows are read as they were recorded."""

from dataclasses import fields, replace

import numpy as np
import pytest

from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.ocp.window import Window
from psmpc_cli.ocp.window_record import WindowFrame, read_window, record_of
from psmpc_cli.robot.configuration import IDENTITY, Chart
from psmpc_cli.robot.free_body import body_of
from psmpc_cli.specs.load import load_task

from ..free_flyer import reaching


def assert_same(found: Window | PlacedStage, expected: Window | PlacedStage) -> None:
    """Compare dataclasses field by field, arrays to 1e-12: states pass through the chart and back."""
    for each in fields(expected):
        one = getattr(found, each.name)
        other = getattr(expected, each.name)
        if isinstance(other, np.ndarray | float):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12, err_msg=each.name)
        elif isinstance(other, int | str | tuple) and each.name != "stages":
            assert one == other, each.name


def window_over(stages: tuple[PlacedStage, ...], x0: np.ndarray, chart: Chart) -> Window:
    """A window with numbers unlike each other, of a task whose controller has 12 nodes a stage."""
    count = len(stages)
    return Window(
        stages=stages,
        start=2.5,
        elapsed=0.7,
        hold=0.2,
        x0=x0,
        omega=np.linspace(1.0, 3.0, count),
        offset=np.linspace(0.1, 0.2, count),
        scale=np.linspace(10.0, 20.0, count),
        horizon=4.0,
        pending_cost=1.0,
        terminal_cost=0.0,
        nodes=(12,) * count,
        chart=chart,
    )


def test_a_window_in_space_has_its_chart_and_the_signs_of_its_targets_again() -> None:
    problem = build_problem(reaching())
    space = problem.model.space
    rng = np.random.default_rng(1)
    attitude = rng.normal(size=4)
    Q = np.concatenate([[0.1, -0.2, 0.3], attitude / np.linalg.norm(attitude), [0.2, 0.1, -0.3]])
    v = rng.normal(scale=0.1, size=problem.model.n)
    chart = space.chart_at(Q)
    posture = space.posture(Q[space.joint_coordinates])
    stages = tuple(
        stage.unplaced_copy().in_chart(chart.anchor, posture, dict.fromkeys(stage.attitudes, -1.0))
        for stage in problem.stages[:2]
    )
    window = window_over(stages, np.asarray(chart.to_chart(Q[None], v[None])[0]), chart)
    window = replace(window, soft=problem.limits_are_soft)
    read = read_window(problem, WindowFrame(window.indices, window.nodes, window.start, Q, v), record_of(window))
    assert_same(read, window)
    for found, expected in zip(read.stages, window.stages, strict=True):
        assert_same(found, expected)


def test_what_was_applied_before_is_recorded_where_changes_of_acceleration_count() -> None:
    task = load_task("transport", ["skills.move.weights.rate=0.1", "controller.nodes=12", "plant.low_level_rate=500"])
    problem = build_problem(task)
    x0 = np.linspace(-0.1, 0.1, 18)
    stages = tuple(stage.unplaced_copy() for stage in problem.stages[:2])
    applied = np.linspace(-0.3, 0.2, 9)
    window = replace(window_over(stages, x0, IDENTITY), applied=applied, tick=0.002)
    frame = WindowFrame(window.indices, window.nodes, window.start, x0[:9], x0[9:])
    assert_same(read_window(problem, frame, record_of(window)), window)


def test_a_reserve_of_speed_is_recorded_as_the_stages_of_the_window_had_it() -> None:
    problem = build_problem(load_task("transport", {"controller.nodes": 12, "controller.speed_reserve": 3}))
    x0 = np.linspace(-0.1, 0.1, 18)
    reserve = np.linspace(0.0, 0.02, 18).reshape(2, 9)
    stages = tuple(stage.unplaced_copy().with_speed_reserve(reserve) for stage in problem.stages[:2])
    window = window_over(stages, x0, IDENTITY)
    read = read_window(
        problem, WindowFrame(window.indices, window.nodes, window.start, x0[:9], x0[9:]), record_of(window)
    )
    assert_same(read, window)
    for found, expected in zip(read.stages, window.stages, strict=True):
        np.testing.assert_array_equal(found.limits.velocity_low, expected.limits.velocity_low)
        np.testing.assert_array_equal(found.limits.velocity_high, expected.limits.velocity_high)


@pytest.mark.parametrize("planned", [True, False])
def test_targets_on_an_object_are_where_its_recorded_state_has_them(planned: bool) -> None:
    task = load_task("catch_drifting", {"controller.nodes": 12, "controller.kind": "psmpc" if planned else "hard"})
    problem = build_problem(task)
    capture = problem.body
    state = np.array([-2.4, 2.8, 0.5, 0.02, 0.01, 0.03])
    first = problem.stages[1].unplaced_copy()
    assert first.on_object
    following = first.following(body_of(capture), state, 0.7, 4.0)
    first = first.at_object(state[:3], state[3:]) if planned else following
    Q = np.linspace(-0.4, 0.4, 9)
    v = np.linspace(0.1, -0.1, 9)
    chart = problem.model.space.chart_at(Q)
    window = replace(window_over((first,), np.concatenate([Q, v]), chart), soft=problem.limits_are_soft)
    read = read_window(problem, WindowFrame((1,), (12,), 2.5, Q, v), record_of(window))
    assert_same(read, window)
    assert_same(read.stages[0], first)
    assert read.stages[0].reference.moves != planned
    since = np.array([0.7, 2.0])
    np.testing.assert_allclose(read.stages[0].wanted(since), first.wanted(since), atol=1e-12)


def test_a_stage_stands_in_the_window_before_and_after_its_planned_end() -> None:
    problem = build_problem(load_task("tracking", {"controller.nodes": 12}))
    stage = next(each for each in problem.stages if each.reference.moves)
    Q = np.linspace(-0.4, 0.4, 9)
    v = np.linspace(0.1, -0.1, 9)
    placed = stage.unplaced_copy()
    chart = problem.model.space.chart_at(Q)
    window = window_over((placed, placed.continued), np.concatenate([Q, v]), chart)
    window = replace(window, nodes=(5, 7), soft=problem.limits_are_soft, horizon=problem.spec.controller.horizon)
    frame = WindowFrame(window.indices, window.nodes, window.start, Q, v)
    read = read_window(problem, frame, record_of(window))
    assert read.count == 1
    for found, expected in zip(read.stages, window.stages, strict=True):
        assert (found.index, found.reference.moves) == (expected.index, expected.reference.moves)
        assert_same(found, expected)
