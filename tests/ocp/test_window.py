from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.reference import Constant, Trajectory
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import (
    COUNTS,
    durations,
    first_counts,
    node_counts,
    normalization,
    on_mesh,
    reference,
    shortest_durations,
    window_numbers,
)
from psmpc_cli.solvers import build_solver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import Task

from ..solvers.recorded import RecordedSolve, recorded, windows_over
from .transport_windows import coasting, ending, moving, window_over

STEP, TOLERANCE = 0.1, 5e-3


def moving_plan(nodes: int) -> Plan:
    """A plan that moves the base at 0.2 m/s; the same motion on any mesh."""
    times = np.linspace(0, 4, nodes + 1)
    X = np.zeros((nodes + 1, 18))
    X[:, 0], X[:, 9] = -0.2 * times, -0.2
    return Plan(times, X, np.zeros((nodes, 9)), np.zeros(0))


def test_costs_are_normalized_by_what_they_are_along_the_prediction(
    stages: tuple[Stage, ...], costs: StageCosts
) -> None:
    plan, none = moving_plan(40), np.zeros((41, 9))
    along = [costs.at(stage, plan.X, none) for stage in stages[:2]]
    smallest, largest = (np.array([extreme(values) for values in along]) for extreme in (np.min, np.max))
    expected = {
        "nadir": (np.zeros(2), largest + 1e-3),
        "range": (smallest, largest - smallest + 1e-3),
        "none": (np.zeros(2), np.ones(2)),
    }
    for kind, numbers in expected.items():
        found = normalization(kind, 1e-3, stages[:2], np.zeros(2), costs, plan, STEP)
        np.testing.assert_allclose(found, numbers, rtol=1e-9, err_msg=kind)


@pytest.mark.parametrize("begins", [0.0, 2.0, 9.0])
def test_nadir_of_a_trajectory_counts_from_where_its_stage_begins(
    stages: tuple[Stage, ...], costs: StageCosts, begins: float
) -> None:
    stage, plan, times = moving(stages[1]), moving_plan(40), np.linspace(0, 4, 41)
    _, scale = normalization("nadir", 0.0, [stage], np.array([begins]), costs, plan, STEP)
    wanted = np.array([np.interp(times - begins, [0, 30], column) for column in stage.reference.points.T]).T
    errors = costs.errors(replace(stage, reference=Constant(stage.target)), plan.X) + stage.target - wanted
    assert scale[0] == pytest.approx(np.max(errors**2 @ stage.weights))


@pytest.mark.parametrize("width", [1e-2, 1e-4])
def test_a_short_tall_control_counts_by_what_it_does_to_the_velocity(
    stages: tuple[Stage, ...], costs: StageCosts, width: float
) -> None:
    """Intervals shrink to nothing before a switch; the scale must not follow the height of one control there."""
    times, u, X = np.array([0.0, 1.02, 1.02 + width, 4.0]), np.zeros((3, 9)), np.zeros((4, 18))
    u[1, 3], X[2:, 12], X[3, 3] = 0.1 / width, 0.1, 0.1 * (4 - 1.02 - width)
    _, scale = normalization("nadir", 1e-3, stages[:1], np.zeros(1), costs, Plan(times, X, u, np.zeros(0)), STEP)
    assert scale[0] < costs.at(stages[0], X[:1], u[:1])[0] + 100 * 0.3**2 + 1.0 + 1.0


def test_without_a_step_costs_are_read_at_the_nodes(stages: tuple[Stage, ...], costs: StageCosts) -> None:
    """As printed: where one control in a short interval is tall, the scale is."""
    times, u, X = np.array([0.0, 1.02, 1.03, 4.0]), np.zeros((3, 9)), np.zeros((4, 18))
    u[1, 3] = 10.0
    plan = Plan(times, X, u, np.zeros(0))
    along = costs.at(stages[0], X, np.vstack([u, u[-1:]]))
    offset, scale = normalization("range", 1e-3, stages[:1], np.zeros(1), costs, plan, None)
    assert along.max() > along.min() + 100
    np.testing.assert_allclose((offset[0], scale[0]), (along.min(), along.max() - along.min() + 1e-3), rtol=1e-12)


def test_a_plan_is_rebuilt_from_its_vector(stages: tuple[Stage, ...]) -> None:
    window = window_over(stages[:3], nodes=(2, 5, 3))
    plan = coasting(window, 1.7, 3.1)
    again = window.plan_of(plan.flat)
    for name in ("times", "X", "u", "switch_times"):
        np.testing.assert_array_equal(getattr(again, name), getattr(plan, name))
    np.testing.assert_array_equal(on_mesh(again, window).X, plan.X)
    with pytest.raises(ValueError, match="reshape"):
        window.plan_of(plan.flat[:-1])


@given(elapsed=st.floats(0, 5), hold=st.floats(0, 2))
def test_a_stage_lasts_what_is_left_of_its_dwell_and_hold(
    stages: tuple[Stage, ...], elapsed: float, hold: float
) -> None:
    dwelling = tuple(ending(stage, dwell=3.0) for stage in stages[:3])
    shortest = shortest_durations(window_over(dwelling, elapsed=elapsed, hold=hold))
    np.testing.assert_allclose(shortest, [max(3.0 - elapsed, hold, 1e-3), 3.0, 1e-3])


def test_a_path_bends_where_its_trajectory_does(stages: tuple[Stage, ...]) -> None:
    bent = Trajectory(np.array([0.0, 1.0, 2.0]), np.outer([0.0, 1.0, 5.0], np.ones(9)))
    window = window_over((stages[0], replace(stages[1], reference=bent)))
    wanted, slopes = reference(window_numbers(window, np.array([3.0])), 1, 2.0)
    np.testing.assert_allclose(wanted[:, 0], [0, 0.5, 1, 3, 5])
    np.testing.assert_allclose(slopes[:, 0], [0, 0.25, 2, 3, 0])


@given(guess=st.floats(0.5, 3.5), tau=st.floats(0.1, 3.9), elapsed=st.floats(0, 20))
def test_a_straight_trajectory_is_followed_wherever_the_optimizer_moves_its_end(
    stages: tuple[Stage, ...], guess: float, tau: float, elapsed: float
) -> None:
    window = window_over((moving(stages[1]), moving(stages[2])), elapsed=elapsed)
    for s, (since, duration) in enumerate([(elapsed, tau), (0.0, 4.0 - tau)]):
        found, _ = reference(window_numbers(window, np.array([1.0 + guess])), s, duration)
        wanted = window.stages[s].wanted(since + duration * np.arange(5) / 4)
        np.testing.assert_allclose(found, wanted, atol=1e-12)


@pytest.fixture(scope="module")
def mission() -> Sequence[RecordedSolve]:
    """Windows with one, two and three stages: before, at and after appends, before and after switches."""
    return [recorded("transport")[appended + later] for appended in (62, 93, 193) for later in (-1, 0, 1, 12)]


def counts_of(
    solve: RecordedSolve, costs: StageCosts, before: Sequence[int] = (), tolerance: float = TOLERANCE
) -> list[int]:
    had = before or [None] * len(solve.window.stages)
    return list(node_counts(solve.window, solve.guess, costs, STEP, tolerance, had))


@pytest.fixture(scope="module")
def problem(transport: Task) -> Problem:
    return build_problem(transport)


@pytest.mark.slow
def test_windows_of_a_mission_agree_with_two_hundred_nodes(problem: Problem, mission: Sequence[RecordedSolve]) -> None:
    """Switch times to 20 ms, J to 1 %, with a fraction of the nodes."""
    solver = build_solver(problem, SolverSpec(kind="sqp", iterations=50))
    saved = list[float]()
    for solve in mission:
        solved = replace(solve, guess=solver.solve(solve.window, solve.guess).plan)
        counts = counts_of(solved, problem.costs)
        fine = [200] * len(solved.window.stages)
        one, other = (solver.solve(replace(solved.window, nodes=tuple(n)), solved.guess) for n in (counts, fine))
        assert one.outcome.usable
        assert other.outcome.usable
        assert one.objective == pytest.approx(other.objective, rel=1e-2)
        assert np.abs(one.plan.switch_times - other.plan.switch_times).max(initial=0.0) < 0.02
        saved.append(sum(counts) / sum(fine))
    assert np.median(saved) < 0.5


def test_no_interval_is_longer_than_a_sample(mission: Sequence[RecordedSolve], costs: StageCosts) -> None:
    for solve in mission:
        counts = counts_of(solve, costs)
        tau = durations(solve.guess.switch_times, solve.window.start, solve.window.horizon)
        assert np.all(tau / counts <= STEP + 1e-9)
        assert set(counts) <= set(COUNTS)


def test_a_stage_keeps_its_count_while_that_is_enough(costs: StageCosts) -> None:
    solve = windows_over(2)[0]
    counts = counts_of(solve, costs)
    for before in (counts, [3, 3], [200, 200]):
        assert counts_of(solve, costs, before) == counts


def test_a_tighter_tolerance_takes_more_nodes(costs: StageCosts) -> None:
    few, many = (counts_of(recorded("transport")[20], costs, tolerance=part) for part in (2e-2, 2e-3))
    assert sum(few) < sum(many)


def test_the_first_window_is_ready_for_costs_that_fall_to_nothing() -> None:
    assert first_counts(recorded("transport")[0].window, np.zeros(0), TOLERANCE, STEP) == (128,)
