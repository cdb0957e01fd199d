"""The rows that keep hands which hold one body from moving against each other."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.ocp.constraints import NodeRows, node_rows, soft_row_violations
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.problem import Problem, build_problem, in_own_chart
from psmpc_cli.ocp.stage import SampleContext
from psmpc_cli.ocp.window import Window, window_numbers, window_shape
from psmpc_cli.ocp.window_record import WindowFrame, read_window, record_of
from psmpc_cli.robot.configuration import space_of_pose
from psmpc_cli.solvers import build_solver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import load_task

from .held_objects import without_forces

NODES = (4, 3)
HELD = 2
"""Stage 2 of both tasks is one in which both hands hold the object; the one after it lets go."""


@pytest.fixture(scope="module", params=["transport_grasp", "servicing"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return build_problem(load_task(request.param))


def some_coordinates(problem: Problem) -> np.ndarray:
    """Bent arms and a turned base (nq,)."""
    return stepped(problem, problem.model.space.neutral, np.random.default_rng(5).uniform(-0.6, 0.6, problem.model.n))


def stepped(problem: Problem, Q: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Coordinates after a step (n,) from others (nq,)."""
    return np.asarray(problem.model.space.path(Q, step[None]))[-1]


def relative_pose(problem: Problem, Q: np.ndarray) -> np.ndarray:
    """Pose of the second hand in the frame of the first one."""
    poses = dict(zip(problem.model.pose_rows, problem.model.poses(Q), strict=True))
    one, other = (poses[gripper] for gripper in problem.body.grasp.at)
    return space_of_pose(len(one)).relative(other, one)


def window_of(problem: Problem, relative: np.ndarray) -> Window:
    """A stage that holds the object and the next one, from rest; the hands closed at a relative pose."""
    Q = some_coordinates(problem)
    placed = [in_own_chart(problem.model, each, Q, np.zeros(problem.model.n)) for each in problem.stages[HELD:][:2]]
    stages, states = zip(*placed, strict=True)
    return Window(
        stages=tuple(stage.with_arguments({"hands": relative}) for stage in stages),
        start=0.0,
        elapsed=0.0,
        x0=states[0],
        omega=np.ones(2),
        offset=np.zeros(2),
        scale=np.ones(2),
        horizon=4.0,
        pending_cost=0.01,
        terminal_cost=0.0,
        nodes=NODES,
        chart=problem.model.space.chart_at(Q),
    )


def rows_of(problem: Problem, window: Window) -> list[NodeRows]:
    return [rows for rows in node_rows(problem.model, window_shape(window)) if rows.name == "hands"]


def test_only_closed_hands_have_rows_and_only_in_stages_that_hold(problem: Problem) -> None:
    relative = relative_pose(problem, some_coordinates(problem))
    assert rows_of(problem, window_of(problem, np.full_like(relative, np.nan))) == []
    (rows,) = rows_of(problem, window_of(problem, relative))
    assert list(rows.nodes) == [1, 2, 3, 4]
    assert rows.soft


def test_rows_are_the_rates_of_the_pose_error(problem: Problem) -> None:
    Q = some_coordinates(problem)
    space = problem.model.space
    v = np.random.default_rng(6).uniform(-0.1, 0.1, problem.model.n)
    window = window_of(problem, relative_pose(problem, Q))
    (rows,) = rows_of(problem, window)
    x = space.chart_at(Q).to_chart(Q[None], v[None])[0]
    found = rows.functions.value(x, rows.argument(window_numbers(window, np.array([1.0]))))[0].ravel()
    step = 1e-4
    later, earlier = (relative_pose(problem, stepped(problem, Q, by * v)) for by in (step, -step))
    expected = space_of_pose(len(later)).pose_error(later, earlier) / (2 * step)
    assert np.linalg.norm(expected) > 1e-2
    np.testing.assert_allclose(np.sort(np.abs(found)), np.sort(np.abs(expected)), atol=1e-7)


def test_over_a_horizon_hands_may_move_by_the_band(problem: Problem) -> None:
    (rows,) = rows_of(problem, window_of(problem, relative_pose(problem, some_coordinates(problem))))
    window = window_of(problem, relative_pose(problem, some_coordinates(problem)))
    low, high = rows.bounds(window)
    band = problem.body.grasp.half_widths
    np.testing.assert_allclose(np.unique(high), np.unique(band) / window.horizon)
    np.testing.assert_array_equal(low, -high)


def test_derivatives_are_those_of_the_rows(problem: Problem) -> None:
    window = window_of(problem, relative_pose(problem, some_coordinates(problem)))
    (rows,) = rows_of(problem, window)
    a = rows.argument(window_numbers(window, np.array([1.0])))
    n = problem.model.n
    x = 0.2 * np.random.default_rng(7).standard_normal(2 * n)
    jacobian = rows.functions.with_jacobian(x, a)[1].reshape(rows.functions.count, 2 * n)
    h = 1e-6
    differences = [
        (rows.functions.value(x + h * each, a)[0] - rows.functions.value(x - h * each, a)[0]).ravel() / (2 * h)
        for each in np.eye(2 * n)
    ]
    np.testing.assert_allclose(jacobian, np.transpose(differences), atol=1e-8)


@pytest.mark.parametrize("before", [None, 0.0])
def test_the_band_is_about_the_pose_that_the_hands_have_at_each_sample(problem: Problem, before: float | None) -> None:
    at_sample = problem.stages[HELD].constraints["hands"].at_sample
    assert at_sample is not None
    Q = some_coordinates(problem)
    chart = problem.model.space.chart_at(Q)
    x = np.asarray(chart.to_chart(Q[None], np.zeros((1, problem.model.n)))[0])
    relative = relative_pose(problem, Q)
    earlier = None if before is None else np.full(len(relative), before)
    view = SampleContext(0.0, x, chart.anchor, argument_before=earlier)
    found = at_sample(problem.model, view)
    np.testing.assert_allclose(found, relative, atol=1e-12)
    assert at_sample(problem.model, replace(view, is_current=False)) is None


def test_a_window_reads_the_relative_poses_from_its_record(problem: Problem) -> None:
    relative = relative_pose(problem, some_coordinates(problem))
    window = window_of(problem, relative)
    frame = WindowFrame(window.indices, NODES, 0.0, some_coordinates(problem), np.zeros(problem.model.n))
    again = read_window(problem, frame, record_of(window))
    np.testing.assert_array_equal(again.stages[0].constraints["hands"].argument, relative)
    assert window_shape(again) == window_shape(window)


@pytest.mark.parametrize("apart", [0.0, 0.05], ids=["together", "apart"])
@pytest.mark.slow
def test_both_kinds_of_back_end_keep_the_hands_together(problem: Problem, apart: float) -> None:
    relative = relative_pose(problem, some_coordinates(problem))
    two_stages = window_of(problem, relative)
    x0 = two_stages.x0.copy()
    x0[problem.model.n + problem.model.space.n_twist :] = apart
    alone = np.ones(1)
    window = replace(
        two_stages,
        stages=(without_forces(two_stages.stages[0]),),
        x0=x0,
        omega=alone,
        offset=0 * alone,
        scale=alone,
        nodes=(2,),
    )
    guess = resting_plan(0.0, window.horizon, 2, window.x0, window.chart)
    window = window.about(guess)
    found = build_solver(problem, SolverSpec(kind="sqp", tolerance=1e-9, iterations=200)).solve(window, guess)
    exact = build_solver(problem, SolverSpec(kind="ipopt", tolerance=1e-9)).solve(window, found.plan)
    assert found.outcome.usable and exact.outcome.usable
    assert found.objective == pytest.approx(exact.objective, rel=1e-5)
    violation, at_first = soft_row_violations(problem.model, window, found.plan)
    assert violation < 1e-8
    assert (at_first > 1e-3) == bool(apart)
