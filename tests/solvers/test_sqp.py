from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control import Command, State
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.simulation.run import build_experiment
from psmpc_cli.solvers import FEASIBLE, NlpSolver, Outcome, Solution, build_solver
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.task import SolverSpec

from .windows import CONVERGED, FATROP, ONE, again, changed, chosen, far_away

FEW = SolverSpec(kind="sqp", iterations=40, max_iterations=40)
TASK = """\
robot: planar_dual_arm
initial: {base: [-0.1782, -0.5503, -0.0252], arm_1: [0.7556, -0.8237, 0.1881], arm_2: [0.3979, 0.2407, -0.2723]}
controller: {nodes: 20}
solver: sqp
plant: ideal
skills:
  move:  {space: joint, weights: {base: [100, 100, 10], arms: [100, 100, 10], control: 0.03}}
  reach: {space: task, weights: {base: [100, 100, 100], arms: [10, 10, 1], control: 0.03}}
stages:
  - name: reach
    skill: reach
    priority: 2.93
    target: {base: [0.0274, 0.0256, -0.445], arm_1: [1.0229, -0.6876, -1.6485], arm_2: [-1.2303, 0.8117, -0.9274]}
    ends_when: {coordinates: [arms], tolerance: 4e-3}
  - name: leave
    skill: move
    priority: 66.7
    target: {base: [-0.3603, -0.4868, -0.6498], arm_1: [-0.0964, -1.3829, -0.6488], arm_2: [0.2388, 0.6594, -1.1601]}
    ends_when: {coordinates: [base], tolerance: 1e-2}
"""
"""Arms are at their poses long before a base that is free to be anywhere, and what waits is urgent."""


@pytest.fixture(scope="module")
def problem(transport: Task) -> Problem:
    return build_problem(transport)


@pytest.fixture(scope="module")
def two_stages(decisions: list[Command]) -> Solution:
    return chosen(decisions, 2)


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_one_iteration_on_the_shifted_plan_comes_near_the_optimum(
    problem: Problem, decisions: list[Command], stages: int
) -> None:
    solved, judge = chosen(decisions, stages), NlpSolver(problem, FATROP)
    found, optimum = (again(build_solver(problem, spec), solved) for spec in (ONE, FATROP))
    assert found.iterations == 1
    assert found.outcome.usable
    assert judge.violation(found.window, found.plan) <= FEASIBLE
    started = solved.window.omega / solved.window.omega.max() @ judge.costs(solved.window, solved.guess)
    started += float((solved.guess.instants - solved.window.start).sum())
    infeasible = judge.violation(solved.window, solved.guess) > FEASIBLE
    assert infeasible or abs(found.objective - optimum.objective) <= abs(started - optimum.objective) + 1e-9


def test_a_cold_start_is_iterated_until_the_step_is_small(problem: Problem, two_stages: Solution) -> None:
    """What is not marked as the shifted plan is none, however good it is."""
    guess = replace(two_stages.guess, instants=two_stages.guess.instants + 0.2)
    cold = build_solver(problem, ONE).solve(two_stages.window, guess)
    assert not cold.warm
    assert cold.iterations > 1
    assert cold.objective == pytest.approx(again(build_solver(problem, CONVERGED), two_stages).objective, rel=1e-5)


@pytest.fixture
def too_short(decisions: list[Command]) -> Callable[[bool, float], Solution]:
    """A solve of Capture and Transport, its limits soft or hard, whose guess has a share of the time that is needed."""
    capture = [d.solution for d in decisions if len(d.instants) == 1 and d.stage.index == 1]
    chosen = next(each for each in capture if each.plan.instants[0] - each.window.start < 2.7)

    def of(soft: bool, share: float) -> Solution:
        early = chosen.window.start + share * (chosen.plan.instants - chosen.window.start)
        window = replace(chosen.window, soft=soft)
        return replace(chosen, window=window, guess=replace(chosen.plan, instants=early))

    return of


@pytest.mark.parametrize("soft", [False, True], ids=["hard", "soft"])
def test_a_stage_too_short_for_its_end_condition_starts_again_from_a_late_switch(
    problem: Problem, too_short: Callable[[bool, float], Solution], soft: bool
) -> None:
    """No step of the first program lengthens the stage and speeds it up at once; a later guess replaces it."""
    short = too_short(soft, 0.1)
    optimum = build_solver(problem, CONVERGED).solve(short.window, short.plan)
    found = build_solver(problem, CONVERGED).solve(short.window, short.guess)
    assert found.outcome is Outcome.OPTIMAL
    assert found.plan.instants == pytest.approx(optimum.plan.instants, abs=1e-4)


def test_a_first_program_that_only_soft_limits_give_a_solution_is_replaced_by_that_of_a_late_switch(
    problem: Problem, too_short: Callable[[bool, float], Solution]
) -> None:
    """From the short guess the program's step passes the velocity limits by up to 3 m/s."""
    short = too_short(True, 0.02)
    once = CONVERGED.model_copy(update={"max_iterations": 1})
    stepped = build_solver(problem, once).solve(short.window, short.guess)
    assert stepped.violations.max() < FEASIBLE


def test_a_program_without_a_solution_is_named_in_the_report(problem: Problem, two_stages: Solution) -> None:
    lines: list[str] = []
    again(build_solver(problem, CONVERGED, lines.append), changed(two_stages, far_away, 0), False)
    assert lines[-1].endswith("no step meets the linearized constraints")


def test_each_line_of_the_report_leads_from_the_guess_to_the_solution(problem: Problem, two_stages: Solution) -> None:
    lines: list[str] = []
    found = again(build_solver(problem, CONVERGED, lines.append), two_stages)
    rows = [line.split(maxsplit=6) for line in lines[1:]]
    assert rows[0][3:] == ["-", "-", "-"]
    assert float(rows[-1][1]) == pytest.approx(found.objective, rel=1e-8)
    assert float(rows[-1][3]) <= np.sqrt(CONVERGED.tolerance)
    assert all(0 < float(row[4]) <= 1 and int(row[5]) > 0 for row in rows[1:])


@pytest.mark.parametrize("soft", [False, True], ids=["hard", "soft"])
def test_without_compiled_code_piqp_solves_the_programs(problem: Problem, two_stages: Solution, soft: bool) -> None:
    solved = replace(two_stages, window=replace(two_stages.window, soft=soft))
    specs = (CONVERGED, CONVERGED.model_copy(update={"compiled": False}))
    found, other = (again(build_solver(problem, spec), solved) for spec in specs)
    assert found.outcome is other.outcome is Outcome.OPTIMAL
    assert found.objective == pytest.approx(other.objective, rel=1e-6)


@pytest.fixture(scope="module")
def curved(transport: Task) -> dict[bool, Solution]:
    """Windows of a closed loop whose first stage ends at poses: the first one, cold, and a warm one after it."""

    def solved() -> Iterator[Solution]:
        experiment = build_experiment(parse_task(TASK, transport.robot_yaml, "reach"))
        x = experiment.x0
        for time in 0.1 * np.arange(15):
            command = experiment.controller.step(time, State.of(x))
            x = command.plan.states_at(np.array([time + 0.1]))[0]
            yield command.solution

    found = [solution for solution in solved() if len(solution.window.stages) == 2]
    return {warm: next(solution for solution in found if solution.warm == warm) for warm in (False, True)}


@pytest.fixture(scope="module")
def reaching(transport: Task) -> Problem:
    return build_problem(parse_task(TASK, transport.robot_yaml, "reach"))


def test_windows_with_a_curved_end_converge_in_a_few_iterations(
    reaching: Problem, curved: dict[bool, Solution]
) -> None:
    optimum = again(build_solver(reaching, FATROP), curved[True])
    warm, cold = (again(build_solver(reaching, FEW), curved[each], each) for each in (True, False))
    assert warm.outcome is cold.outcome is optimum.outcome is Outcome.OPTIMAL
    assert warm.iterations <= 5
    assert cold.iterations <= 15
    assert warm.objective == pytest.approx(optimum.objective, rel=1e-6)


def test_multipliers_of_a_curved_end_are_carried_to_the_next_solve_and_spare_iterations(
    reaching: Problem, curved: dict[bool, Solution]
) -> None:
    solved, solver = curved[True], build_solver(reaching, FEW)
    assert np.abs(solved.guess_duals).max() > 1.0
    with_them = again(solver, solved)
    np.testing.assert_array_equal(with_them.guess_duals, solved.guess_duals)
    without = again(solver, replace(solved, guess_duals=np.zeros(0)))
    assert with_them.iterations < without.iterations
    assert with_them.duals == pytest.approx(without.duals, abs=1e-2)


def test_multipliers_of_another_back_end_are_ignored(reaching: Problem, curved: dict[bool, Solution]) -> None:
    foreign = replace(curved[True], guess_duals=np.ones(7))
    for kind in ("sqp", "fatrop", "ipopt"):
        found = again(build_solver(reaching, SolverSpec.model_validate({"kind": kind, "iterations": 40})), foreign)
        assert found.outcome is Outcome.OPTIMAL
        assert len(found.guess_duals) == 0
