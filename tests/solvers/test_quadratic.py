"""The quadratic programs of windows: our own method, PIQP's, and the conditions of an optimum."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.gauss_newton import Unknowns, VelocityForm
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.ocp.window import window_numbers, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers.quadratic import EQUALITY_WIDTH, PiqpQp, QpSolution, QpStatus
from psmpc_cli.solvers.sqp_window import SqpWindow, fixed_bounds, widened, window_bounds

from .optimality import curvatures, energy, objective, optimality, rows_after
from .quadratic_forms import our_method, ours
from .random_programs import Task, random_task, soft_rows, unattainable
from .recorded import RecordedSolve, windows_over
from .solving import middle_window_over

SEEDS = st.integers(0, 2**32 - 1)
FEATURES = st.sets(st.sampled_from(("equal", "fixed", "free", "history", "inputs", "intervals", "tied")))
NODES = st.sampled_from([(1,), (4,), (3, 2), (5, 5), (2, 3, 2)])


def piqp(task: Task, tolerance: float = 1e-9) -> QpSolution:
    """Solve a program by PIQP."""
    return PiqpQp(tolerance).solve(task.window, task.model, task.here)


def first_program(model: RobotModel, solve: RecordedSolve) -> Task:
    """The program at the guess of a recorded window, without rows that are rarely active, of which it has none."""
    stages = tuple(replace(stage, constraints=without(stage.constraints, "turns")) for stage in solve.window.stages)
    window = replace(solve.window, stages=stages)
    guess = solve.guess
    form = VelocityForm(model, window_shape(window))
    tau = np.diff(guess.switch_times, prepend=window.start)
    point = Unknowns(guess.X, tau)
    parameters = window_numbers(window, guess.switch_times)
    bounds = window_bounds(form, fixed_bounds(form, window), window, guess, tau, np.inf)
    return Task(SqpWindow(form, bounds, parameters), form.linearize(point, parameters), point)


def without(constraints: Mapping[str, ConstraintNumbers], name: str) -> dict[str, ConstraintNumbers]:
    """The constraints of a stage but for one."""
    return {key: each for key, each in constraints.items() if key != name}


@pytest.fixture(params=[1, 2, 3], ids=["one_stage", "two_stages", "three_stages"])
def tasks(request: pytest.FixtureRequest, model: RobotModel) -> list[Task]:
    """Programs of a mission: after an append, and warm."""
    found = windows_over(request.param)
    return [first_program(model, solve) for solve in (found[0], middle_window_over(request.param), found[-1])]


def assert_optimal(task: Task, found: QpSolution) -> None:
    assert found.status is QpStatus.SOLVED
    missed = optimality(task, found)
    scale = 1 + max(np.abs(found.gaps).max(), np.abs(found.rows).max())
    assert missed.gaps < 1e-9
    assert missed.limits < 1e-8
    assert missed.gradient < 1e-8 * scale
    assert missed.complementarity < 1e-8 * scale


def test_programs_of_a_mission_are_solved_like_piqp_solves_them(tasks: Sequence[Task]) -> None:
    for task in tasks:
        found = ours(task)
        other = piqp(task)
        assert_optimal(task, found)
        assert other.status is QpStatus.SOLVED
        assert objective(task.model, found.step) == pytest.approx(objective(task.model, other.step), rel=1e-6, abs=1e-8)
        assert np.abs(found.step.tau - other.step.tau).max(initial=0.0) < 1e-6
        assert energy(task.model, found.step, other.step) < 1e-8


@pytest.mark.slow
@settings(max_examples=60)
@given(seed=SEEDS, nodes=NODES, what=FEATURES)
def test_random_programs_end_where_their_conditions_hold(seed: int, nodes: tuple[int, ...], what: set[str]) -> None:
    task = random_task(np.random.default_rng(seed), nodes, what)
    found = ours(task)
    assert_optimal(task, found)


@settings(max_examples=30)
@given(seed=SEEDS, what=FEATURES)
def test_a_program_without_a_solution_is_proved_to_have_none(seed: int, what: set[str]) -> None:
    task = unattainable(random_task(np.random.default_rng(seed), (3, 2), what))
    found = ours(task)
    assert found.status is QpStatus.INFEASIBLE
    assert found.iterations < 30


def less_convex(rng: np.random.Generator, task: Task) -> Task:
    """The same program with less curvature by durations or positions, none of it or far too little."""
    model = task.model
    of_durations, of_positions = 10 ** rng.uniform(-3, 4, 2) * (rng.random(2) < 1 / 2)
    durations = model.H_tau_tau - of_durations * np.eye(len(model.H_tau_tau))
    positions = model.H_QQ - of_positions * np.eye(model.H_QQ.shape[1])
    return replace(task, model=replace(model, H_tau_tau=durations, H_QQ=positions))


def is_equation(task: Task) -> np.ndarray:
    """Which rows of a program are equations."""
    bounds = task.window.bounds
    return np.asarray(bounds.high - bounds.low <= EQUALITY_WIDTH)


ROUNDING = 1e-7
"""Eigenvalue, by the largest one, below which rounding decides its sign: a row that is an equation has a weight of 1e9
in the Hessian, and a double has 16 digits."""


@settings(max_examples=80)
@given(seed=SEEDS, nodes=NODES, what=st.sets(st.sampled_from(("equal", "fixed", "inputs", "tied"))))
def test_a_program_of_equations_is_solved_exactly_where_it_is_convex(
    seed: int, nodes: tuple[int, ...], what: set[str]
) -> None:
    rng = np.random.default_rng(seed)
    task = less_convex(rng, random_task(rng, nodes, what))
    equation = is_equation(task)
    bounds = task.window.bounds
    task = task.with_bounds(low=np.where(equation, bounds.low, -np.inf), high=np.where(equation, bounds.high, np.inf))
    curvature = curvatures(task, equation)
    assume(abs(curvature[0]) > ROUNDING * abs(curvature).max())
    found = ours(task)
    assert found.status is (QpStatus.SOLVED if curvature[0] > 0 else QpStatus.NOT_CONVEX)


@settings(max_examples=80)
@given(seed=SEEDS, nodes=NODES, what=FEATURES)
def test_only_minima_are_solutions_and_no_convex_program_is_called_another(
    seed: int, nodes: tuple[int, ...], what: set[str]
) -> None:
    rng = np.random.default_rng(seed)
    task = less_convex(rng, random_task(rng, nodes, what))
    found = ours(task)
    if found.status is QpStatus.SOLVED:
        active = np.abs(found.rows) > 1e-6
        curvature = curvatures(task, is_equation(task) | active)
        assert curvature[0] >= -ROUNDING * abs(curvature).max()
    if found.status is QpStatus.NOT_CONVEX:
        assert curvatures(task, is_equation(task))[0] < 0


def test_a_saddle_at_the_first_iterate_is_no_solution() -> None:
    """Every residual is 0 there, and nothing says which way is down."""
    task = random_task(np.random.default_rng(3), (3, 2), set())
    nothing = np.zeros_like
    model = task.model
    flat = replace(
        model,
        residuals=replace(model.residuals, gaps=nothing(model.residuals.gaps)),
        gradient=nothing(model.gradient),
        gradient_tau=nothing(model.gradient_tau),
        H_tau_tau=model.H_tau_tau - 1e4,
    )
    rows = np.full(len(task.window.bounds.low), np.inf)
    saddle = replace(task, model=flat).with_bounds(low=-rows, high=rows)
    assert ours(saddle).status is QpStatus.NOT_CONVEX


def test_durations_that_cost_nothing_are_no_negative_curvature() -> None:
    """What eliminations leave of them is rounding, of either sign."""
    for seed in range(40):
        task = random_task(np.random.default_rng(seed), (2, 3, 2), {"inputs"})
        model = task.model
        linear = replace(model, H_x_tau=np.zeros_like(model.H_x_tau), H_tau_tau=np.zeros_like(model.H_tau_tau))
        without_motion = replace(linear, gap_tau=np.zeros_like(model.gap_tau))
        assert ours(replace(task, model=without_motion)).status in (QpStatus.SOLVED, QpStatus.INFEASIBLE)


def test_a_program_with_numbers_that_are_none_fails(tasks: Sequence[Task]) -> None:
    gradient = tasks[0].model.gradient.copy()
    gradient[3, 0] = np.nan
    assert ours(replace(tasks[0], model=replace(tasks[0].model, gradient=gradient))).status is QpStatus.FAILED


def test_solving_again_gives_the_same(tasks: Sequence[Task]) -> None:
    """No memory is left over from the program before."""
    task = tasks[-1]
    qp = our_method(task)
    first = qp.solve(task.window, task.model, task.here)
    qp.solve(task.window, replace(task.model, gradient=-task.model.gradient), task.here)
    again = qp.solve(task.window, task.model, task.here)
    assert np.array_equal(first.step.X, again.step.X)
    assert np.array_equal(first.rows, again.rows)


def softened(task: Task, away: np.ndarray | float = 0.0, node_rows: bool = False) -> Task:
    """The same program with soft bounds of states, some of them moved, and perhaps soft rows at nodes."""
    bounds = task.window.bounds
    soft = soft_rows(task, states=True, node_rows=node_rows)
    low = bounds.low.copy()
    high = bounds.high.copy()
    low[soft], high[soft] = widened(low[soft], high[soft])
    at = slice(task.window.states)
    return task.with_bounds(low=low + _padded(away, len(low), at), high=high + _padded(away, len(low), at), soft=soft)


def _padded(away: np.ndarray | float, size: int, at: slice) -> np.ndarray:
    padded = np.zeros(size)
    padded[at] = away
    return padded


def penalties(task: Task) -> np.ndarray:
    """What a violation of each row by 1 costs; 0 of hard ones."""
    return task.window.row_penalties(task.here, slice(None))


def costs_of_violations(task: Task, step: Unknowns) -> float:
    bounds = task.window.bounds
    rows = rows_after(task, step)
    violations = np.maximum(np.maximum(bounds.low - rows, rows - bounds.high), 0.0)
    return float(penalties(task) @ violations)


def total_cost(task: Task, found: QpSolution) -> float:
    return objective(task.model, found.step) + costs_of_violations(task, found.step)


@settings(max_examples=40)
@given(seed=SEEDS, nodes=NODES, what=FEATURES, node_rows=st.booleans())
def test_both_methods_violate_what_cannot_be_met_at_the_same_cost(
    seed: int, nodes: tuple[int, ...], what: set[str], node_rows: bool
) -> None:
    rng = np.random.default_rng(seed)
    task = random_task(rng, nodes, what)
    size = task.window.states
    task = softened(task, away=np.where(rng.random(size) < 1 / 3, rng.normal(size=size), 0.0), node_rows=node_rows)
    found = ours(task)
    other = piqp(task)
    soft = task.window.bounds.soft
    assert found.status is QpStatus.SOLVED
    assert (np.abs(found.rows[soft]) <= penalties(task)[soft] * (1 + 1e-9)).all()
    if other.status is QpStatus.SOLVED:
        assert total_cost(task, found) == pytest.approx(total_cost(task, other), rel=1e-6, abs=1e-6)


@settings(max_examples=40)
@given(seed=SEEDS, nodes=NODES, what=FEATURES, node_rows=st.booleans())
def test_a_program_that_hard_bounds_allow_has_the_same_solution_with_soft_ones(
    seed: int, nodes: tuple[int, ...], what: set[str], node_rows: bool
) -> None:
    task = softened(random_task(np.random.default_rng(seed), nodes, what), node_rows=node_rows)
    is_soft = task.window.bounds.soft
    hard = ours(task.with_bounds(soft=np.zeros_like(is_soft)))
    soft = ours(task)
    assert soft.status is QpStatus.SOLVED
    if hard.status is QpStatus.SOLVED and (np.abs(hard.rows[is_soft]) < penalties(task)[is_soft]).all():
        assert costs_of_violations(task, soft.step) < 1e-6
        assert objective(task.model, soft.step) == pytest.approx(objective(task.model, hard.step), rel=1e-6, abs=1e-6)


@settings(max_examples=20)
@given(seed=SEEDS, what=FEATURES)
def test_soft_bounds_do_not_help_where_an_end_condition_cannot_be_met(seed: int, what: set[str]) -> None:
    task = softened(unattainable(random_task(np.random.default_rng(seed), (3, 2), what)))
    assert ours(task).status is QpStatus.INFEASIBLE
