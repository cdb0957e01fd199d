import logging
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.end import AtTime
from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window
from psmpc_cli.solvers import NlpSolver, Outcome
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import Task

from ..ocp.transport_windows import N, coasting, ending, moving, window_over


@pytest.fixture(scope="module")
def problem(transport: Task) -> Problem:
    return build_problem(transport)


@pytest.fixture(scope="module")
def solver(problem: Problem) -> NlpSolver:
    return NlpSolver(problem, SolverSpec(kind="fatrop"))


def by_hand(window: Window, plan: Plan, costs: StageCosts) -> np.ndarray:
    """What each stage adds to the objective along a plan: the sum of (20), each trajectory begun with its stage."""
    begins, found = [window.start - window.elapsed, *plan.switch_times], []
    for s, (stage, begin) in enumerate(zip(window.stages, begins, strict=True)):
        at, since = slice(s * N, (s + 1) * N), plan.times - begin
        L = costs.at(stage, plan.X[at], plan.u[at], since[at])
        found.append(float((L - window.offset[s]) @ np.diff(plan.times)[at]) / window.scale[s])
    last = costs.at(stage, plan.X[-1:], np.zeros((1, 9)), since[-1:])[0]
    found[-1] += window.terminal_cost * (last - window.offset[-1]) / window.scale[-1]
    return np.array(found)


@settings(max_examples=15)
@given(first=st.floats(1.1, 2.9), second=st.floats(0.1, 1.9), elapsed=st.floats(0, 20), seed=st.integers(0, 2**32 - 1))
def test_the_objective_is_the_sum_of_the_stages_costs_at_the_nodes(
    solver: NlpSolver,
    stages: tuple[Stage, ...],
    costs: StageCosts,
    first: float,
    second: float,
    elapsed: float,
    seed: int,
) -> None:
    three = (moving(stages[0]), stages[1], moving(stages[2]))
    window = window_over(three, elapsed=elapsed, terminal_cost=0.5, offset=np.array([0.0, 0.1, 0.2]))
    plan = coasting(window, first, first + second)
    plan = replace(plan, u=np.random.default_rng(seed).standard_normal(plan.u.shape))
    np.testing.assert_allclose(solver.costs(window, plan), by_hand(window, plan, costs), rtol=1e-9)


def test_a_solve_that_does_not_return_has_failed(
    solver: NlpSolver, stages: tuple[Stage, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where an iterate is not a number, fatrop raises its regularization without end."""
    monkeypatch.setattr("psmpc_cli.solvers.nlp.LONGEST_CALL", 0.3)
    window = window_over(stages[:2])
    plan = coasting(window, 2.0)
    nowhere = replace(plan, X=np.full_like(plan.X, np.nan))
    found = solver.solve(window, nowhere)
    assert found.outcome is Outcome.TIMEOUT
    assert found.plan.X.shape == plan.X.shape


def test_a_compilation_is_told_of_and_can_be_ended(
    problem: Problem,
    stages: tuple[Stage, ...],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """That of a long program takes a minute, in which no signal reaches the process that does it."""

    def compile_for_ever(*arguments: object) -> None:
        while True:
            pass

    monkeypatch.setattr("psmpc_cli.solvers.nlp.LONGEST_COMPILATION", 0.3)
    monkeypatch.setattr("psmpc_cli.progress.RETOLD_EVERY", 0.05)
    monkeypatch.setattr("casadi.nlpsol", compile_for_ever)
    solver = NlpSolver(problem, SolverSpec(kind="fatrop")).stopping(math.inf)
    window = window_over(stages[:2])
    with caplog.at_level(logging.INFO):
        assert solver.solve(window, coasting(window, 2.0)).outcome is Outcome.TIMEOUT
    told = [str(record.msg) for record in caplog.records if record.levelno == logging.INFO]
    assert told[0] == "fatrop compiles and solves a large window: 0 of 1 windows"
    assert told[-1] == "fatrop compiles and solves a large window: 1 of 1 windows"


def test_a_plan_violates_what_it_breaks(solver: NlpSolver, stages: tuple[Stage, ...]) -> None:
    x0 = np.zeros(18)
    x0[9] = 0.15
    free = tuple(ending(stage, rows=(), tolerance=np.zeros(0)) for stage in stages[:2])
    window = window_over(free, x0=x0)
    coast = coasting(window, 3.0)
    assert solver.violation(window, coast) == pytest.approx(0.0, abs=1e-12)
    fast = window_over(free, x0=x0 + 0.15 * np.eye(18)[9])
    assert solver.violation(fast, coasting(fast, 3.0)) == pytest.approx(0.1)
    assert solver.violation(replace(fast, soft=True), coasting(fast, 3.0)) == pytest.approx(0.0, abs=1e-12)
    gap = replace(coast, X=coast.X + 0.2 * np.outer(np.arange(9) == 3, np.eye(18)[4]))
    assert solver.violation(window, gap) == pytest.approx(0.2)
    ends = window_over((ending(free[0], rows=(0,), tolerance=np.array([0.1])), free[1]), x0=x0)
    assert solver.violation(ends, coast) == pytest.approx(abs(0.15 * 2.0 - stages[0].target[0]) - 0.1)
    timed = window_over((replace(free[0], end=AtTime(at=3.4)), free[1]), x0=x0)
    assert solver.violation(timed, coast) == pytest.approx(0.4)
    dwelling = window_over((ending(free[0], dwell=3.5), free[1]), x0=x0)
    assert solver.violation(dwelling, coast) == pytest.approx(3.5 - 0.5 - 2.0)
    late = coasting(window, 5.0 - 1e-4)
    assert solver.violation(window, late) == pytest.approx(1e-3 - 1e-4)
