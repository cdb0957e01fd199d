from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.control import Controller, State
from psmpc_cli.ocp.gauss_newton import Unknowns, VelocityForm
from psmpc_cli.ocp.plan import Plan, resting_plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.window import Window, on_mesh, window_numbers, window_shape
from psmpc_cli.solvers import FEASIBLE, NlpSolver, Outcome, Solution, build_solver
from psmpc_cli.solvers.quadratic import PiqpQp
from psmpc_cli.solvers.sqp_window import SqpWindow, fixed_bounds, window_bounds
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.robot import stack

from ..ocp.constraints.floating_windows import drawn, fast_arms_in, problem_of
from .recorded import RecordedSolve, curved_end, recorded
from .solving import CONVERGED, FATROP, ONE, again, changed, far_away, middle_window_over

CAPTURE = 106
"""The sample of the transport mission in which Capture needs less than 2.7 s."""

FEW = SolverSpec(kind="sqp", iterations=40, max_iterations=40)


@pytest.fixture(scope="module")
def problem(transport: Task) -> Problem:
    return build_problem(transport)


@pytest.fixture(scope="module")
def two_stages() -> RecordedSolve:
    return middle_window_over(2)


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_one_iteration_on_the_shifted_plan_comes_near_the_optimum(problem: Problem, stages: int) -> None:
    solved = middle_window_over(stages)
    judge = NlpSolver(problem, FATROP)
    found, optimum = (again(build_solver(problem, spec), solved) for spec in (ONE, FATROP))
    assert found.iterations == 1
    assert found.outcome.usable
    assert judge.violation(found.window, found.plan) <= FEASIBLE
    started = solved.window.omega / solved.window.omega.max() @ judge.costs(solved.window, solved.guess)
    started += float((solved.guess.switch_times - solved.window.start).sum())
    infeasible = judge.violation(solved.window, solved.guess) > FEASIBLE
    assert infeasible or abs(found.objective - optimum.objective) <= abs(started - optimum.objective) + 1e-9


def test_a_cold_start_is_iterated_until_the_step_is_small(problem: Problem, two_stages: RecordedSolve) -> None:
    """What is not marked as the shifted plan is none, however good it is."""
    guess = replace(two_stages.guess, switch_times=two_stages.guess.switch_times + 0.2)
    cold = build_solver(problem, ONE).solve(two_stages.window, guess)
    assert not cold.warm
    assert cold.iterations > 1
    assert cold.objective == pytest.approx(again(build_solver(problem, CONVERGED), two_stages).objective, rel=1e-5)


@pytest.fixture(scope="module")
def capture(problem: Problem) -> Solution:
    """The optimum of a window of Capture and Transport, in which Capture needs less than 2.7 s."""
    optimum = again(build_solver(problem, CONVERGED), recorded("transport")[CAPTURE])
    assert [stage.name for stage in optimum.window.stages] == ["capture", "transport"]
    assert optimum.plan.switch_times[0] - optimum.window.start < 2.7
    return optimum


def too_short(capture: Solution, soft: bool, share: float) -> RecordedSolve:
    """Return a solve of Capture, its limits soft or hard, whose guess has a share of the time that is needed."""
    start = capture.window.start
    guess = replace(capture.plan, switch_times=start + share * (capture.plan.switch_times - start))
    window = replace(capture.window, soft=soft)
    return replace(recorded("transport")[CAPTURE], window=window, guess=guess)


@pytest.mark.parametrize("soft", [False, True], ids=["hard", "soft"])
def test_a_stage_too_short_for_its_end_condition_starts_again_from_a_late_switch(
    problem: Problem, capture: Solution, soft: bool
) -> None:
    """No step of the first program lengthens the stage and speeds it up at once; a later guess replaces it."""
    short = too_short(capture, soft, 0.1)
    optimum = build_solver(problem, CONVERGED).solve(short.window, capture.plan)
    found = build_solver(problem, CONVERGED).solve(short.window, short.guess)
    assert found.outcome is Outcome.OPTIMAL
    assert found.plan.switch_times == pytest.approx(optimum.plan.switch_times, abs=1e-4)


def test_a_first_program_that_only_soft_limits_give_a_solution_is_replaced_by_that_of_a_late_switch(
    problem: Problem, capture: Solution
) -> None:
    """From the short guess the program's step passes the velocity limits by up to 3 m/s."""
    short = too_short(capture, True, 0.02)
    once = CONVERGED.model_copy(update={"max_iterations": 1})
    stepped = build_solver(problem, once).solve(short.window, short.guess)
    assert stepped.violations.max() < FEASIBLE


def test_a_program_without_a_solution_is_named_in_the_report(problem: Problem, two_stages: RecordedSolve) -> None:
    lines: list[str] = []
    again(build_solver(problem, CONVERGED, lines.append), changed(two_stages, far_away, 0), False)
    assert lines[-1].endswith("no step meets the linearized constraints")


def test_each_line_of_the_report_leads_from_the_guess_to_the_solution(
    problem: Problem, two_stages: RecordedSolve
) -> None:
    lines: list[str] = []
    found = again(build_solver(problem, CONVERGED, lines.append), two_stages)
    rows = [line.split(maxsplit=6) for line in lines[1:]]
    assert rows[0][3:] == ["-", "-", "-"]
    assert float(rows[-1][1]) == pytest.approx(found.objective, rel=1e-8)
    assert float(rows[-1][3]) <= np.sqrt(CONVERGED.tolerance)
    assert all(0 < float(row[4]) <= 1 and int(row[5]) > 0 for row in rows[1:])


@pytest.mark.parametrize("soft", [False, True], ids=["hard", "soft"])
def test_without_compiled_code_piqp_solves_the_programs(
    problem: Problem, two_stages: RecordedSolve, soft: bool
) -> None:
    solved = replace(two_stages, window=replace(two_stages.window, soft=soft))
    specs = (CONVERGED, CONVERGED.model_copy(update={"compiled": False}))
    found, other = (again(build_solver(problem, spec), solved) for spec in specs)
    assert found.outcome is other.outcome is Outcome.OPTIMAL
    assert found.objective == pytest.approx(other.objective, rel=1e-6)


@pytest.fixture(scope="module")
def curved() -> Mapping[bool, RecordedSolve]:
    """Windows whose first stage ends at poses: the mission's first one, cold, and a warm one after it."""
    return {solve.warm: solve for solve in recorded("curved end").values()}


@pytest.fixture(scope="module")
def reaching() -> Problem:
    return build_problem(curved_end())


def test_windows_with_a_curved_end_converge_in_a_few_iterations(
    reaching: Problem, curved: Mapping[bool, RecordedSolve]
) -> None:
    optimum = again(build_solver(reaching, FATROP), curved[True])
    warm, cold = (again(build_solver(reaching, FEW), curved[each], each) for each in (True, False))
    assert warm.outcome is cold.outcome is optimum.outcome is Outcome.OPTIMAL
    assert warm.iterations <= 5
    assert cold.iterations <= 15
    assert warm.objective == pytest.approx(optimum.objective, rel=1e-6)


def test_multipliers_of_a_curved_end_are_carried_to_the_next_solve_and_spare_iterations(
    reaching: Problem, curved: Mapping[bool, RecordedSolve]
) -> None:
    solve = curved[True]
    solver = build_solver(reaching, FEW)
    assert np.abs(solve.duals).max() > 1.0
    with_them = again(solver, solve)
    np.testing.assert_array_equal(with_them.guess_duals, solve.duals)
    without = again(solver, replace(solve, duals=np.zeros(0)))
    assert with_them.iterations < without.iterations
    assert with_them.duals == pytest.approx(without.duals, abs=1e-2)


def test_multipliers_of_another_back_end_are_ignored(reaching: Problem, curved: Mapping[bool, RecordedSolve]) -> None:
    foreign = replace(curved[True], duals=np.ones(7))
    for kind in ("sqp", "fatrop", "ipopt"):
        found = again(build_solver(reaching, SolverSpec.model_validate({"kind": kind, "iterations": 40})), foreign)
        assert found.outcome is Outcome.OPTIMAL
        assert len(found.guess_duals) == 0


HAND_X = 7
"""Place of the hand's x among the numbers of a target in space, behind the base's pose."""

FLOATING = 18
"""Seed of a window of a free-floating robot in space whose second program from rest has no solution."""


@pytest.fixture(scope="module")
def floating() -> Problem:
    return problem_of("free-floating", None)


def from_rest(problem: Problem, window: Window) -> Plan:
    """Return the guess at rest with the switch in the middle of the window."""
    rest = resting_plan(0.0, window.horizon, problem.spec.controller.uniform_nodes, window.x0, window.chart)
    return on_mesh(replace(rest, switch_times=np.array([window.horizon / 2])), window)


def out_of_reach(window: Window) -> Window:
    """Return the window with the place of its first stage 10 m away."""
    reach, home = window.stages
    target = reach.target.copy()
    target[HAND_X] += 10.0
    return replace(window, stages=(reach.with_target(target), home))


def test_a_cold_window_of_a_robot_without_thrusters_goes_on_by_elastic_programs(floating: Problem) -> None:
    window = drawn(floating, FLOATING)
    lines: list[str] = []
    found = build_solver(floating, CONVERGED, lines.append).solve(window, from_rest(floating, window))
    assert found.outcome is Outcome.OPTIMAL
    assert any(line.endswith("elastic") for line in lines)
    assert not lines[-1].endswith("elastic")


def test_elastic_programs_end_where_they_bring_the_violation_no_further_down(floating: Problem) -> None:
    window = out_of_reach(drawn(floating, FLOATING))
    lines: list[str] = []
    found = build_solver(floating, CONVERGED, lines.append).solve(window, from_rest(floating, window))
    assert found.outcome is Outcome.INFEASIBLE
    assert lines[-1].endswith("elastic")
    violations = [float(line.split()[2]) for line in lines[1:]]
    assert all(after <= before for before, after in pairwise(violations))
    assert found.iterations <= 10


def test_warm_windows_have_no_elastic_programs(floating: Problem) -> None:
    window = drawn(floating, FLOATING)
    solver = build_solver(floating, CONVERGED)
    before = solver.solve(window, from_rest(floating, window))
    lines: list[str] = []
    far = out_of_reach(window)
    found = build_solver(floating, CONVERGED, lines.append).solve(far, from_rest(floating, far), before)
    assert found.warm
    assert found.outcome is Outcome.INFEASIBLE
    assert found.iterations == 1
    assert not any(line.endswith("elastic") for line in lines)


OVERSHOT = 8
"""Seed of a window of a free-floating robot in the plane about whose optimum full steps go to and fro, each longer."""


def test_steps_that_undo_each_other_are_shortened(tmp_path: Path) -> None:
    problem = problem_of("free-floating", fast_arms_in(tmp_path))
    window = drawn(problem, OVERSHOT)
    lines: list[str] = []
    spec = SolverSpec(kind="sqp", iterations=60, max_iterations=60)
    found = build_solver(problem, spec, lines.append).solve(window, from_rest(problem, window))
    assert found.outcome is Outcome.OPTIMAL
    shares = [float(line.split()[4]) for line in lines[2:]]
    assert any(0.26 < share < 0.49 for share in shares)  # neither a half nor a quarter


TIGHT_FORCES = (
    "controller.nodes=12",
    "limits={base: {force: [4, 4, 1]}, arms: {force: [4, 2, 1]}}",
    "skills.move.weights.control=0.003",
    "skills.reach.weights.control=0.003",
)
"""Rows of forces are curved in the velocities, and so small a control weight leaves the objective nearly flat."""


def first_solution(name: str, *changes: str) -> Solution:
    """The solution of the first window of a task."""
    task = load_task(name, changes)
    Q = stack(task.spec.initial, task.robot, "joint")
    return Controller(task).step(0.0, State(Q, np.zeros(9))).solution


def test_a_step_that_leaves_curved_rows_is_corrected() -> None:
    """Steps of the objective alone leave the limits of forces by 2e-4 and more, whatever share of them is taken."""
    solution = first_solution("transport", *TIGHT_FORCES)
    assert solution.outcome is Outcome.FEASIBLE
    assert solution.window.stages[0].name == "approach"


def first_window(solution: Solution, *changes: str) -> tuple[SqpWindow, Unknowns]:
    """The window of a solution of `transport`, and its guess."""
    window = solution.window
    guess = solution.plan
    form = VelocityForm(build_problem(load_task("transport", changes)).model, window_shape(window))
    tau = np.zeros(0)
    bounds = window_bounds(form, fixed_bounds(form, window), window, guess, tau, np.inf)
    return SqpWindow(form, bounds, window_numbers(window, guess.switch_times)), Unknowns(guess.X, tau)


def test_a_later_iterate_keeps_the_rows_of_the_program_before() -> None:
    of_window, point = first_window(first_solution("transport", *TIGHT_FORCES), *TIGHT_FORCES)
    here, near = of_window.linearize(point)
    _, full = of_window.linearize(point, of_window.with_rows(near, point, np.zeros(0, int), np.arange(30)))
    np.testing.assert_array_equal(full.interval_rows, np.union1d(near.interval_rows, np.arange(30)))
    assert len(near.interval_rows) < len(full.interval_rows) < len(here.residuals.interval_rows)


def test_a_program_that_misses_rows_gets_those_that_are_near_their_bounds_too() -> None:
    of_window, point = first_window(first_solution("transport", *TIGHT_FORCES), *TIGHT_FORCES)
    here, model = of_window.linearize(point)
    without = replace(model, interval_rows=model.interval_rows[:0], interval_rows_by=model.interval_rows_by[:0])
    reached = of_window.evaluation(point.moved(PiqpQp(1e-9).solve(of_window, without, here).step, 1.0))
    assert reached.violation > FEASIBLE
    half, tenth = (of_window.missed_rows(without, reached, share)[1] for share in (0.5, 0.1))
    assert 0 < len(half) < len(tenth)
    assert set(half) < set(tenth)


def test_the_correction_of_a_step_takes_most_of_what_it_leaves_of_curved_rows() -> None:
    of_window, point = first_window(first_solution("transport", *TIGHT_FORCES), *TIGHT_FORCES)
    here, linear = of_window.linearize(point)
    every = np.arange(len(of_window.form.row_interval))
    linear = of_window.with_rows(linear, here.point, np.zeros(0, int), every)
    step = PiqpQp(1e-9).solve(of_window, linear, here).step
    reached = of_window.evaluation(here.point.moved(step, 1.0))
    about, nearest = of_window.corrected(here, linear, step, reached)
    correction = PiqpQp(1e-9).solve(of_window, nearest, about).step
    left = of_window.evaluation(here.point.moved(correction, 1.0)).violation
    assert reached.violation > FEASIBLE
    assert left < reached.violation / 10


def test_a_solve_that_ends_without_convergence_returns_the_last_point_that_meets_all_constraints() -> None:
    """Iterated on, this one breaks down where no share of a step is accepted."""
    solution = first_solution("transport", *TIGHT_FORCES, "solver={kind: sqp, iterations: 200}")
    assert solution.outcome is Outcome.FEASIBLE
