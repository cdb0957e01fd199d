from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from psmpc_cli.ocp.transcription import transcribe
from psmpc_cli.ocp.velocity_form import VelocityForm
from psmpc_cli.solvers.qp_solution import QpSolution, QpStatus
from psmpc_cli.solvers.sqp_limits import limits

from psmpc_cli.control import Command
from psmpc_cli.ocp.gauss_newton import linearize
from psmpc_cli.ocp.window import bounds, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Outcome, build_solver, sqp
from psmpc_cli.specs.task import SolverSpec

from ..optimality import energy, objective, optimality
from ..random_programs import Task, random_task, unattainable
from .both_methods import our_method, ours, piqp

FEATURES = ("equal", "fixed", "inputs", "tied")


def recorded(model: RobotModel, decision: Command) -> Task:
    """The program at the guess of a window of a run."""
    solved = decision.solution
    nlp = transcribe(model, window_shape(solved.window.stages, solved.window.nodes, "exact"))
    form = VelocityForm(nlp.model, nlp.shape, nlp.layout)
    numbers = form.numbers(solved.parameters)
    horizon, point = float(numbers.horizon), form.point(solved.guess.z, numbers)
    held = limits(nlp, bounds(nlp, solved.window), horizon)
    return Task(form, linearize(form, point, numbers), held, point, horizon)


@pytest.fixture(params=[1, 2, 3], ids=["one_stage", "two_stages", "three_stages"])
def tasks(request: pytest.FixtureRequest, model: RobotModel, decisions: list[Command]) -> list[Task]:
    """Programs of a run: after an append, and warm."""
    of_size = [d for d in decisions if len(d.solution.window.stages) == request.param]
    return [recorded(model, d) for d in (of_size[0], of_size[len(of_size) // 2], of_size[-1])]


def assert_optimal(task: Task, found: QpSolution) -> None:
    assert found.status is QpStatus.SOLVED
    missed, scale = optimality(task, found), 1 + found.largest
    assert missed.gaps < 1e-9
    assert missed.limits < 1e-8
    assert missed.gradient < 1e-8 * scale
    assert missed.complementarity < 1e-8 * scale


def test_programs_of_a_run_are_solved_like_piqp_solves_them(tasks: Sequence[Task]) -> None:
    for task in tasks:
        found, other = ours(task), piqp(task)
        assert_optimal(task, found)
        assert other.status is QpStatus.SOLVED
        assert objective(task.model, found.step) == pytest.approx(objective(task.model, other.step), rel=1e-6, abs=1e-8)
        assert np.abs(found.step.tau - other.step.tau).max(initial=0.0) < 1e-6
        assert energy(task.model, found.step, other.step) < 1e-8


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    nodes=st.sampled_from([(1,), (4,), (3, 2), (5, 5), (2, 3, 2)]),
    what=st.sets(st.sampled_from(FEATURES)),
)
def test_random_programs_end_where_their_conditions_hold(seed: int, nodes: tuple[int, ...], what: set[str]) -> None:
    task = random_task(np.random.default_rng(seed), nodes, what)
    found = ours(task)
    assert_optimal(task, found)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), what=st.sets(st.sampled_from(FEATURES)))
def test_random_programs_reach_the_objective_of_piqp(seed: int, what: set[str]) -> None:
    task = random_task(np.random.default_rng(seed), (3, 3), what)
    other = piqp(task)
    if other.status is QpStatus.SOLVED:
        best = objective(task.model, other.step)
        assert objective(task.model, ours(task).step) == pytest.approx(best, rel=1e-6, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), what=st.sets(st.sampled_from(FEATURES)))
def test_a_program_without_a_solution_is_proved_to_have_none(seed: int, what: set[str]) -> None:
    task = unattainable(random_task(np.random.default_rng(seed), (3, 2), what))
    found = ours(task)
    assert found.status is QpStatus.INFEASIBLE
    assert found.iterations < 30


def test_a_program_with_numbers_that_are_none_fails(tasks: Sequence[Task]) -> None:
    gradient = tasks[0].model.gradient.copy()
    gradient[3, 0] = np.nan
    assert ours(replace(tasks[0], model=replace(tasks[0].model, gradient=gradient))).status is QpStatus.FAILED


def test_solving_again_gives_the_same(tasks: Sequence[Task]) -> None:
    """No memory is left over from the program before."""
    task, other = tasks[-1], tasks[0]
    qp = our_method(task)
    first = qp.solve(task.model, task.limits, task.point, task.horizon)
    qp.solve(other.model, other.limits, other.point, other.horizon)
    again = qp.solve(task.model, task.limits, task.point, task.horizon)
    assert np.array_equal(first.step.X, again.step.X)
    assert np.array_equal(first.X, again.X)


def test_without_a_compiler_piqp_solves_the_programs(
    model: RobotModel, decisions: list[Command], monkeypatch: pytest.MonkeyPatch
) -> None:
    solved = next(d.solution for d in decisions if len(d.solution.window.stages) == 2)
    nlp = transcribe(model, window_shape(solved.window.stages, solved.window.nodes, "exact"))
    held, spec = bounds(nlp, solved.window), SolverSpec(kind="sqp", iterations=50)
    compiled = build_solver(nlp, spec).solve(solved.guess, solved.parameters, held)
    monkeypatch.setattr(sqp, "load_kernel", lambda coordinates, durations: None)
    packaged = build_solver(nlp, spec).solve(solved.guess, solved.parameters, held)
    assert compiled.outcome is packaged.outcome is Outcome.OPTIMAL
    assert compiled.objective == pytest.approx(packaged.objective, rel=1e-6)
