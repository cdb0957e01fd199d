from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.ocp.constraints.boxes import initial_violations
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import FEASIBLE, NlpSolver, Outcome, Solution, Solver, build_solver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import Task

from ..ocp.transport_windows import ending, moving
from .recorded import RecordedSolve, windows_over
from .solving import (
    ADJOINT,
    CONVERGED,
    FATROP,
    IPOPT,
    ONE,
    again,
    changed,
    far_away,
    middle_window_over,
    solver_for,
)

pytestmark = pytest.mark.slow

Change = Callable[[Stage], Stage]


@pytest.fixture(scope="module")
def problem(transport: Task) -> Problem:
    return build_problem(transport)


@pytest.fixture(scope="module")
def judge(problem: Problem) -> NlpSolver:
    """Evaluates the NLP of a window at a plan."""
    return NlpSolver(problem, FATROP)


@pytest.fixture(scope="module")
def two_stages() -> RecordedSolve:
    return middle_window_over(2)


def assert_same_optimum(one: Solution, other: Solution) -> None:
    assert one.outcome is other.outcome is Outcome.OPTIMAL
    assert one.objective == pytest.approx(other.objective, rel=1e-5)
    np.testing.assert_allclose(one.costs, other.costs, rtol=1e-3, atol=1e-6)
    assert np.abs(one.plan.switch_times - other.plan.switch_times).max(initial=0.0) < 1e-3


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_all_back_ends_reach_the_same_optimum(problem: Problem, judge: NlpSolver, stages: int) -> None:
    solved = middle_window_over(stages)
    optimum = again(solver_for(problem, FATROP), solved)
    for spec in (CONVERGED, IPOPT, ADJOINT):
        for warm in (False, True):
            found = again(solver_for(problem, spec), solved, warm)
            assert_same_optimum(found, optimum)
            assert judge.violation(found.window, found.plan) < 1e-7


def slow(stage: Stage) -> Stage:
    limits = stage.limits
    return replace(
        stage, limits=replace(limits, velocity_low=limits.velocity_low / 2, velocity_high=limits.velocity_high / 2)
    )


def weak(stage: Stage) -> Stage:
    bound = np.where(np.arange(9) < 5, 0.03, np.inf)
    return replace(stage, limits=replace(stage.limits, acceleration_low=np.full(9, -0.03), acceleration_high=bound))


def at_rest(stage: Stage) -> Stage:
    return ending(stage, rate_tolerance=1e-2)


@pytest.mark.parametrize(
    ("change", "of"), [(slow, 1), (weak, 1), (at_rest, 0), (moving, 1)], ids=["slow", "weak", "at rest", "moving"]
)
def test_windows_of_other_stages_have_the_same_optimum_too(
    problem: Problem, two_stages: RecordedSolve, change: Change, of: int
) -> None:
    solved = changed(two_stages, change, of)
    solver = solver_for(problem, CONVERGED)
    found, other = again(solver, solved, False), again(solver_for(problem, FATROP), solved, False)
    assert_same_optimum(found, other)
    assert_same_optimum(again(solver_for(problem, ADJOINT), solved, False), other)
    assert abs(found.objective - again(solver, two_stages).objective) > 1e-6


@pytest.mark.parametrize("spec", [CONVERGED, FATROP, ADJOINT], ids=["sqp", "fatrop", "adjoint"])
def test_terminal_cost_offset_and_euler_are_solved_too(
    problem: Problem, two_stages: RecordedSolve, spec: SolverSpec
) -> None:
    changes = {"terminal_cost": 0.5, "offset": np.full(2, 0.1), "discretization": "euler"}
    solved = replace(two_stages, window=replace(two_stages.window, **changes))
    found, other = (again(solver_for(problem, each), solved, False) for each in (spec, IPOPT))
    assert_same_optimum(found, other)
    assert found.terminal == pytest.approx(other.terminal, rel=1e-4)
    omega, waited = found.window.omega / found.window.omega.max(), found.plan.switch_times.sum() - found.window.start
    assert found.objective == pytest.approx(omega @ found.costs + omega[-1] * found.terminal + waited, rel=1e-9)


@pytest.mark.slow
def test_task_input_reaches_one_optimum_by_both_nlp_back_ends(problem: Problem) -> None:
    def by_poses(stage: Stage) -> Stage:
        return replace(stage, input="task")

    solved = changed(middle_window_over(1), by_poses, 0)
    one, other = (again(solver_for(problem, spec), solved, False) for spec in (FATROP, IPOPT))
    assert_same_optimum(one, other)


@pytest.mark.parametrize("spec", [CONVERGED, FATROP, IPOPT, ADJOINT], ids=["sqp", "fatrop", "ipopt", "adjoint"])
def test_durations_are_kept_near_the_guess(problem: Problem, two_stages: RecordedSolve, spec: SolverSpec) -> None:
    guess = replace(two_stages.guess, switch_times=two_stages.guess.switch_times + 0.3)
    for within in (0.0, 0.05):
        found = solver_for(problem, spec).solve(two_stages.window, guess, None, within)
        assert found.outcome.usable
        assert found.plan.switch_times == pytest.approx(guess.switch_times - within, abs=1e-6)  # the optimum is earlier


@pytest.mark.parametrize(
    "spec",
    [ONE, SolverSpec(kind="fatrop", max_iterations=80), IPOPT, ADJOINT],
    ids=["sqp", "fatrop", "ipopt", "adjoint"],
)
def test_a_window_that_cannot_be_solved_says_so_with_advice(
    problem: Problem, two_stages: RecordedSolve, spec: SolverSpec
) -> None:
    found = again(solver_for(problem, spec), changed(two_stages, far_away, 0), False)
    assert not found.outcome.usable
    assert ":" in found.outcome.value
    if spec.kind == "sqp":
        assert (found.outcome, found.iterations) == (Outcome.INFEASIBLE, 1)


@pytest.mark.parametrize("kind", ["sqp", "fatrop", "ipopt", "adjoint"])
def test_too_few_iterations_are_reported_as_such(problem: Problem, two_stages: RecordedSolve, kind: str) -> None:
    guess = replace(two_stages.guess, X=two_stages.guess.X + 0.05, switch_times=two_stages.guess.switch_times + 0.3)
    spec = SolverSpec.model_validate({"kind": kind, "max_iterations": 1})
    found = solver_for(problem, spec).solve(two_stages.window, guess)
    assert found.outcome is Outcome.ITERATION_LIMIT
    assert "max_iterations" in found.outcome.value


def test_sqp_stops_at_a_deadline_after_the_iteration_that_passes_it(
    problem: Problem, judge: NlpSolver, two_stages: RecordedSolve
) -> None:
    stopped = again(solver_for(problem, SolverSpec(kind="sqp", iterations=50, deadline=1e-9)), two_stages)
    assert (stopped.iterations, stopped.outcome) == (1, Outcome.FEASIBLE)
    X = two_stages.guess.X + np.r_[np.zeros((1, 18)), np.full((len(two_stages.guess.X) - 1, 18), 0.05)]
    guess = replace(two_stages.guess, X=X, switch_times=two_stages.guess.switch_times + 0.3)
    late = solver_for(problem, SolverSpec(kind="sqp", deadline=1e-9)).solve(two_stages.window, guess)
    assert late.outcome is Outcome.DEADLINE
    assert judge.violation(late.window, late.plan) > FEASIBLE


@pytest.mark.parametrize("optimum", [IPOPT, ADJOINT], ids=["ipopt", "adjoint"])
def test_ipopt_stops_at_a_deadline_too(
    problem: Problem, judge: NlpSolver, two_stages: RecordedSolve, optimum: SolverSpec
) -> None:
    hurried = optimum.model_copy(update={"deadline": 1e-6})
    stopped, free = (again(solver_for(problem, spec), two_stages, False) for spec in (hurried, optimum))
    assert stopped.iterations < free.iterations
    within = judge.violation(stopped.window, stopped.plan) <= FEASIBLE
    assert stopped.outcome is (Outcome.FEASIBLE if within else Outcome.DEADLINE)


def test_a_solution_of_other_stages_or_a_failed_one_starts_nothing(problem: Problem) -> None:
    one = middle_window_over(1)
    two = middle_window_over(2)
    solver = solver_for(problem, ONE)
    same = again(solver, two)
    assert solver.solve(two.window, two.guess, same).warm
    for previous in (again(solver, one), replace(same, outcome=Outcome.INFEASIBLE)):
        assert not solver.solve(two.window, two.guess, previous).warm


def test_ipopt_bounds_the_cost_of_the_last_stage(problem: Problem) -> None:
    """At the cost that priorities lead to, the multiplier of the bound is the ratio of the priorities.

    The bound raises the other cost by 1e-8, which only a tolerance of 1e-10 resolves.
    """
    solved = windows_over(2)[0]
    optimum = again(solver_for(problem, CONVERGED), solved)
    held = replace(solved.guess, switch_times=optimum.plan.switch_times)
    solver = solver_for(problem, SolverSpec(kind="ipopt", tolerance=1e-10, max_iterations=500))
    window = replace(solved.window, omega=np.array([1.0, 1e-2]))
    free = solver.solve(window, held, None, 0.0)
    window = replace(window, omega=np.array([1.0, 0.0]), cost_bound=0.9999 * float(free.costs[-1]))
    bounded = solver.solve(window, free.plan, None, 0.0)
    assert bounded.outcome is Outcome.OPTIMAL
    assert bounded.costs[-1] == pytest.approx(window.cost_bound, rel=1e-5)
    assert bounded.costs[0] >= free.costs[0]
    assert bounded.bound_multiplier == pytest.approx(1e-2, rel=0.1)
    with pytest.raises(InputError, match="fatrop, expected ipopt"):
        solver_for(problem, FATROP).solve(window, held)


@pytest.mark.parametrize("kind", ["sqp", "fatrop", "ipopt", "adjoint"])
def test_a_report_has_a_line_an_iteration_and_changes_nothing(
    problem: Problem, two_stages: RecordedSolve, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    lines: list[str] = []
    spec = SolverSpec.model_validate({"kind": kind, "iterations": 50})
    found = again(build_solver(problem, spec, lines.append), two_stages)
    assert "iter" in lines[0]
    numbers = [int(line.split()[0].rstrip("rRsS")) for line in lines if not line.lstrip().startswith("iter")]
    assert numbers[0] == 0
    assert numbers[-1] == found.iterations
    assert not capfd.readouterr().out
    np.testing.assert_array_equal(found.plan.X, again(solver_for(problem, spec), two_stages).plan.X)


class Made(Solver):
    """A solver that returns what it was made with, or raises it."""

    def __init__(self, result: Solution | Exception) -> None:
        self.result = result

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


@pytest.mark.parametrize("error", [RuntimeError("a\nb"), ZeroDivisionError("a"), np.linalg.LinAlgError("a")])
def test_a_solver_that_raises_has_failed_where_it_started(
    two_stages: RecordedSolve, error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    failed = Made(error).solve(two_stages.window, two_stages.guess)
    assert failed.outcome is Outcome.FAILED
    np.testing.assert_array_equal(failed.plan.X, two_stages.guess.X)
    assert caplog.messages == [f"the solver raised {type(error).__name__}: a"]


def test_a_plan_that_is_not_finite_is_no_solution_and_a_mistake_is_raised(
    problem: Problem, two_stages: RecordedSolve
) -> None:
    window = two_stages.window
    guess = two_stages.guess
    solution = again(solver_for(problem, ONE), two_stages)
    assert Made(solution).solve(window, guess) is solution
    spoilt = replace(solution, plan=replace(solution.plan, u=np.full_like(solution.plan.u, np.nan)))
    assert Made(spoilt).solve(window, guess).outcome is Outcome.FAILED
    with pytest.raises(TypeError):
        Made(TypeError("a")).solve(window, guess)


@pytest.fixture(scope="module", params=[(1, 9), (2, 9), (2, 1)], ids=["fast", "two stages", "beyond a position"])
def beyond(request: pytest.FixtureRequest) -> RecordedSolve:
    """A soft window that begins beyond a limit of a velocity, or of a position."""
    count, row = request.param
    solved = middle_window_over(count)
    stage, x0 = solved.window.stages[0], solved.window.x0.copy()
    limits = stage.limits
    if row < 9:
        low = limits.position_low.copy()
        low[row] = x0[row] + 0.02
        every = tuple(replace(s, limits=replace(s.limits, position_low=low)) for s in solved.window.stages)
    else:
        x0[row] = limits.velocity_high[row - 9] + 0.03
        every = solved.window.stages
    return replace(solved, window=replace(solved.window, x0=x0, stages=every, soft=True))


def test_soft_limits_give_way_to_the_measured_state_alike_in_all_back_ends(
    problem: Problem, judge: NlpSolver, beyond: RecordedSolve
) -> None:
    optimum = again(solver_for(problem, FATROP), beyond, False)
    hard = replace(beyond, window=replace(beyond.window, soft=False))
    for spec in (CONVERGED, IPOPT, ADJOINT):
        found = again(solver_for(problem, spec), beyond, False)
        assert found.outcome is optimum.outcome is Outcome.OPTIMAL
        assert found.objective == pytest.approx(optimum.objective, rel=1e-4)
        assert found.violations == pytest.approx(optimum.violations, abs=1e-5)
        assert (found.violations <= initial_violations(beyond.window.x0, beyond.window.stages) + 1e-6).all()
        assert judge.violation(found.window, found.plan) < 1e-6
    stopped = again(solver_for(problem, CONVERGED), hard, False)
    assert len(stopped.violations) == 0
