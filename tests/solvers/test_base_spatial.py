"""Windows of a spatial robot: all back-ends have the same optimum."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.reference import Trajectory
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.controller import SolverSpec

from ..free_flyer import reaching
from ..ocp.transport_windows import ending
from .recorded import RecordedSolve, recorded
from .solving import changed, solver_for

SQP, FATROP, IPOPT, ADJOINT = (
    SolverSpec(kind=kind, tolerance=1e-9, iterations=100) for kind in ("sqp", "fatrop", "ipopt", "adjoint")
)
"""At 1e-10 fatrop stalls in some windows with soft limits, by rounding."""


@pytest.fixture(scope="module")
def problem() -> Problem:
    return build_problem(reaching())


def assert_same_optimum(problem: Problem, one: RecordedSolve, stages: int) -> None:
    assert len(one.window.stages) == stages
    ipopt = solver_for(problem, IPOPT).solve(one.window, one.guess)
    for spec in (SQP, FATROP, ADJOINT):
        found = solver_for(problem, spec).solve(one.window, one.guess)
        assert found.outcome is ipopt.outcome is Outcome.OPTIMAL
        assert found.objective == pytest.approx(ipopt.objective, rel=1e-6)
        assert np.abs(found.plan.switch_times - ipopt.plan.switch_times).max(initial=0.0) < 1e-5
        assert found.violations == pytest.approx(ipopt.violations, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("sample", "stages"), [(0, 1), (5, 2), (20, 2), (45, 1)])
def test_windows_of_a_mission(problem: Problem, sample: int, stages: int) -> None:
    assert_same_optimum(problem, recorded("free flyer")[sample], stages)


def at_rest(one: RecordedSolve) -> RecordedSolve:
    return changed(one, lambda stage: ending(stage, rate_tolerance=1e-2), 0)


def weak(stage: Stage) -> Stage:
    return replace(
        stage, limits=replace(stage.limits, acceleration_low=np.full(9, -0.2), acceleration_high=np.full(9, 0.2))
    )


def on_a_path(one: RecordedSolve) -> RecordedSolve:
    def moving(stage: Stage) -> Stage:
        later = stage.target + np.r_[0.3, -0.2, np.zeros(len(stage.target) - 2)]
        return replace(stage, reference=Trajectory(np.array([0.0, 5.0]), np.array([stage.target, later])))

    return changed(one, moving, 1)


def turning_too_fast(one: RecordedSolve) -> RecordedSolve:
    """Soft limits; the measured angular velocity is beyond them by 10 %."""
    x0 = one.window.x0.copy()
    x0[12:15] = [0.33, 0.33, -0.33]
    return replace(one, window=replace(one.window, x0=x0, soft=True))


CHANGES: dict[str, Callable[[RecordedSolve], RecordedSolve]] = {
    "at rest": at_rest,
    "weak": lambda one: changed(one, weak, 0, 1),
    "on a path": on_a_path,
    "soft limits": turning_too_fast,
    "terminal cost": lambda one: replace(one, window=replace(one.window, terminal_cost=0.5)),
    "Euler": lambda one: replace(one, window=replace(one.window, discretization="euler")),
}


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_windows_with_other_demands(problem: Problem, change: Callable[[RecordedSolve], RecordedSolve]) -> None:
    assert_same_optimum(problem, change(recorded("free flyer")[12]), 2)
