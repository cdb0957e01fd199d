"""Windows in which changes of the acceleration cost and are limited, by all back-ends and by both methods of `sqp`."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.ocp.constraints import interval_rows
from psmpc_cli.ocp.gauss_newton import Unknowns, VelocityForm
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.stage import JERK
from psmpc_cli.ocp.window import on_mesh, window_numbers, window_shape
from psmpc_cli.solvers import Outcome, build_solver
from psmpc_cli.solvers.quadratic import PiqpQp, QpStatus
from psmpc_cli.solvers.sqp_window import SqpWindow, fixed_bounds, window_bounds
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import load_task

from ..free_flyer import KINDS, reaching
from .optimality import objective
from .quadratic_forms import our_method
from .random_programs import Task
from .recorded import RESPONSIVE, RecordedSolve, recorded
from .solving import middle_window_over

SPECS = {
    kind: SolverSpec(kind=kind, tolerance=1e-9, iterations=100, max_iterations=500)
    for kind in ("sqp", "fatrop", "ipopt", "adjoint")
}
PLANAR = (
    "skills.move.weights.rate=0.1",
    "skills.reach.weights.rate=0.1",
    "limits={base: {jerk: [0.3, 0.3, 0.3]}, arms: {jerk: [0.6, 0.6, 0.6]}}",
)
SPATIAL = (
    *(f"skills.{kind}.weights.rate=0.01" for kind in KINDS),
    "limits={base: {jerk: [0.5, 0.5, 0.5, 0.5, 0.5, 0.5]}, arm: {jerk: [1, 1, 1]}}",
)


@pytest.fixture(scope="module")
def planar() -> Problem:
    return build_problem(load_task("transport", (*RESPONSIVE, *PLANAR)))


@pytest.fixture(scope="module")
def spatial() -> Problem:
    return build_problem(reaching(*SPATIAL))


def with_rates(problem: Problem, solve: RecordedSolve) -> RecordedSolve:
    """Return a recorded solve with the weights and limits of a problem, near what its guess begins with."""
    of_problem = [problem.stages[stage.index] for stage in solve.window.stages]
    stages = tuple(
        replace(
            stage,
            rate_weights=other.rate_weights,
            constraints={**stage.constraints, JERK: other.constraints[JERK]},
        )
        for stage, other in zip(solve.window.stages, of_problem, strict=True)
    )
    return replace(solve, window=replace(solve.window, stages=stages, soft=True, applied=0.9 * solve.guess.u[0]))


def assert_sqp_reaches_the_optimum_of_ipopt(problem: Problem, solves: Mapping[int, RecordedSolve]) -> None:
    """From the guess, and from that optimum itself."""
    sqp, ipopt = (build_solver(problem, SPECS[kind]) for kind in ("sqp", "ipopt"))
    for solve in solves.values():
        window = with_rates(problem, solve).window
        optimum = ipopt.solve(window, solve.guess)
        for start in (solve.guess, optimum.plan):
            found = sqp.solve(window, start)
            assert found.outcome is optimum.outcome is Outcome.OPTIMAL
            assert found.objective == pytest.approx(optimum.objective, rel=2e-5)
            assert np.abs(found.plan.switch_times - optimum.plan.switch_times).max(initial=0.0) < 1e-4


@pytest.mark.slow
def test_windows_of_a_planar_mission_have_the_optimum_of_ipopt(planar: Problem) -> None:
    """Every third one: a window differs little from the next."""
    solves = dict(list(recorded("transport").items())[::3])
    assert {len(solve.window.stages) for solve in solves.values()} == {1, 2, 3}
    assert_sqp_reaches_the_optimum_of_ipopt(planar, solves)


@pytest.mark.slow
def test_windows_of_a_spatial_mission_have_the_optimum_of_ipopt(spatial: Problem) -> None:
    assert_sqp_reaches_the_optimum_of_ipopt(spatial, recorded("free flyer"))


@pytest.mark.slow
def test_fatrop_and_adjoint_reach_that_optimum_too(planar: Problem) -> None:
    window = with_rates(planar, middle_window_over(2)).window
    guess = middle_window_over(2).guess
    by_kind = {kind: build_solver(planar, spec).solve(window, guess) for kind, spec in SPECS.items()}
    for found in by_kind.values():
        assert found.outcome is Outcome.OPTIMAL
        assert found.objective == pytest.approx(by_kind["ipopt"].objective, rel=1e-5)
        np.testing.assert_allclose(found.costs, by_kind["ipopt"].costs, rtol=1e-3)


def test_a_plan_keeps_the_limits_of_jerk_from_what_is_applied_on(planar: Problem) -> None:
    solve = with_rates(planar, middle_window_over(1))
    found = build_solver(planar, SPECS["sqp"]).solve(solve.window, solve.guess)
    h = np.concatenate([[solve.window.tick], np.diff(found.plan.times)])[:, None]
    u = np.vstack([solve.window.applied, found.plan.u])
    jerk = np.diff(u, axis=0) / ((h[:-1] + h[1:]) / 2)
    limit = planar.stages[0].limits.jerk_high
    assert (np.abs(jerk) <= 1.001 * limit).all()
    assert np.abs(jerk / limit).max() > 0.999  # some are active


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_programs_are_solved_like_piqp_solves_them(planar: Problem, stages: int) -> None:
    solve = with_rates(planar, middle_window_over(stages))
    window = solve.window
    guess = on_mesh(solve.guess, window)
    form = VelocityForm(planar.model, window_shape(window))
    point = Unknowns(guess.X, np.diff(guess.switch_times, prepend=window.start))
    parameters = window_numbers(window, guess.switch_times)
    bounds = window_bounds(form, fixed_bounds(form, window), window, guess, point.tau, np.inf)
    task = Task(SqpWindow(form, bounds, parameters), form.linearize(point, parameters), point)
    rows = [rows for rows in interval_rows(planar.model, window_shape(window)) if rows.name == JERK]
    assert len(task.model.interval_rows) == 2 * sum(
        rows_of.functions.count * len(rows_of.intervals) for rows_of in rows
    )
    ours = our_method(task).solve(task.window, task.model, task.here)
    other = PiqpQp(1e-9).solve(task.window, task.model, task.here)
    assert ours.status is other.status is QpStatus.SOLVED
    assert np.abs(ours.step.tau - other.step.tau).max(initial=0.0) < 1e-6
    assert change_of_objective(task, ours.step) == pytest.approx(
        change_of_objective(task, other.step), rel=1e-6, abs=1e-8
    )


def change_of_objective(task: Task, step: Unknowns) -> float:
    """What a step changes of the quadratic model, residuals over intervals among it."""
    weights = task.window.interval_weights[task.model.interval_rows]
    return objective(task.model, step) + float(weights @ task.window.form.row_change(task.model, step) ** 2) / 2


@pytest.mark.parametrize("count", [1, 2])
def test_derivatives_of_the_rows_are_those_of_their_values(planar: Problem, count: int) -> None:
    """By states at three nodes and by durations; those of the measured state do not count."""
    solve = with_rates(planar, middle_window_over(count))
    window = solve.window
    guess = on_mesh(solve.guess, window)
    form = VelocityForm(planar.model, window_shape(window))
    parameters = window_numbers(window, guess.switch_times)
    point = Unknowns(guess.X, np.diff(guess.switch_times, prepend=window.start) + 0.05)
    model = form.linearize(point, parameters)
    random = np.random.default_rng(count)
    X = random.normal(size=point.X.shape)
    X[0] = 0.0
    step = Unknowns(X, random.normal(size=len(point.tau)))
    after, before = (form.residuals(point.moved(step, sign * 1e-7), parameters) for sign in (1, -1))
    by_differences = (after.interval_rows - before.interval_rows)[model.interval_rows] / 2e-7
    np.testing.assert_allclose(form.row_change(model, step), by_differences, rtol=1e-5, atol=1e-4)
    slope = (model.gradient * step.X).sum() + model.gradient_tau @ step.tau
    assert slope == pytest.approx((after.objective - before.objective) / 2e-7, rel=1e-5)
