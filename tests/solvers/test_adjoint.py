from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.end import NEVER, ByState
from psmpc_cli.ocp.gradient import Rollout
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.stage import PlacedStage, Stage
from psmpc_cli.ocp.window import Window, durations, window_numbers, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.solvers import Outcome, build_solver
from psmpc_cli.solvers.adjoint import ShootingNlp
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.parts import QUANTITIES
from psmpc_cli.specs.robots.robot import Limits

from ..ocp.transport_windows import coasting, moving, window_over
from .recorded import MISSIONS, RecordedSolve, recorded
from .solving import ADJOINT, FATROP, IPOPT, again, middle_window_over

PRINTED = SolverSpec(kind="adjoint", gradient="printed")


@pytest.fixture(scope="module")
def problem(transport: Task) -> Problem:
    return build_problem(transport)


def shooting(model: RobotModel, window: Window, plan: Plan) -> tuple[ShootingNlp, np.ndarray, np.ndarray]:
    """The program of a window, and its variables and parameters at a plan."""
    numbers = window_numbers(window, plan.switch_times)
    nlp = ShootingNlp(model, window_shape(window), numbers, has_all_rows=True, printed=False)
    p = np.concatenate([np.ravel(piece, order="F") for piece in numbers.pieces()])
    tau = np.tile(np.diff(plan.switch_times, prepend=window.start)[:, None], nlp.grid.K + 1)
    inputs = np.split(plan.u.T, nlp.grid.first_node[1:-1], axis=1)
    violations = np.full((18, nlp.grid.K + 1), 1e-3) if window.soft else 0.0
    x = np.asarray(nlp.pack(plan.X.T, tau, 0.0, 0.0, violations, 0.0, *inputs)).ravel()
    return nlp, nlp.arguments(x, p, nlp.bounds(window, plan, np.inf))["x0"], p


@pytest.mark.parametrize("soft", [False, True], ids=["hard", "soft"])
@settings(max_examples=4)
@given(seed=st.integers(0, 2**32 - 1), first=st.floats(1.3, 2.7), second=st.floats(0.3, 1.9))
def test_gradient_jacobian_and_hessian_are_those_of_differences(
    model: RobotModel, stages: tuple[Stage, ...], soft: bool, seed: int, first: float, second: float
) -> None:
    """Three stages, two of them with trajectories, any controls and switch times, in any direction."""
    three = (stages[0], moving(stages[1]), moving(stages[2], 2))
    window = window_over(three, terminal_cost=0.5, offset=np.array([0.0, 0.1, 0.2]), soft=soft)
    random = np.random.default_rng(seed)
    plan = coasting(window, first, first + second)
    nlp, z, p = shooting(model, window, replace(plan, u=random.standard_normal(plan.u.shape)))
    direction = random.standard_normal(len(z))
    y = random.standard_normal(nlp.program["g"].numel())
    gradient, jacobian, hessian = (nlp.derivatives[name] for name in ("grad_f", "jac_g", "hess_lag"))

    def J(z: np.ndarray) -> float:
        return float(gradient(z, p)[0])

    def rows(z: np.ndarray) -> np.ndarray:
        return np.asarray(jacobian(z, p)[0]).ravel()

    def slope_of_lagrangian(z: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * gradient(z, p)[1] + jacobian(z, p)[1].T @ y).ravel()

    upper = hessian(z, p, 2.0, y).full()
    h = 1e-5 * direction
    for found, reached in (
        (gradient(z, p)[1].full().ravel() @ direction, (J(z + h) - J(z - h)) / 2e-5),
        (jacobian(z, p)[1].full() @ direction, (rows(z + h) - rows(z - h)) / 2e-5),
        (
            (upper + np.triu(upper, 1).T) @ direction,
            (slope_of_lagrangian(z + h) - slope_of_lagrangian(z - h)) / 2e-5,
        ),
    ):
        np.testing.assert_allclose(found, reached, atol=1e-6 * (1 + np.abs(reached).max()))


def free_coordinate(stage: PlacedStage, target: float, ends: bool) -> PlacedStage:
    """The stage as one for the first coordinate alone, without limits: |Q_0 - target|^2 * 100 + |u|^2."""
    none = np.full(9, np.inf)
    return replace(
        stage.with_target(np.r_[target, np.zeros(8)]),
        weights=np.r_[100.0, np.zeros(8)],
        control_weights=np.ones(9),
        limits=Limits(*(-none, none) * len(QUANTITIES)),
        end=ByState(rows=(0,), tolerance=np.array([1e-3])) if ends else NEVER,
        constraints={},
    )


def there_and_back(stages: tuple[PlacedStage, ...], N: int) -> Window:
    """A double integrator that goes from rest at 0 to 1, and from there back to 0, which is less important."""
    return window_over(
        (free_coordinate(stages[0], 1.0, True), free_coordinate(stages[2], 0.0, False)),
        x0=np.zeros(18),
        omega=np.array([1.0, 0.01]),
        scale=np.ones(2),
        nodes=(N, N),
    )


@pytest.mark.parametrize(
    ("N", "exact", "corrected"), [(12, 13.32, 2.94), pytest.param(25, 8.90, 3.10, marks=pytest.mark.slow)]
)
def test_the_printed_gradient_is_not_that_of_the_discrete_problem(
    problem: Problem, stages: tuple[PlacedStage, ...], N: int, exact: float, corrected: float
) -> None:
    """At the optimum of a double integrator, where all other derivatives of the Lagrangian are 0."""
    window = there_and_back(stages, N)
    guess = coasting(window, 4.0)
    optimum, found = (build_solver(problem, spec).solve(window, guess) for spec in (IPOPT, ADJOINT))
    assert found.outcome is optimum.outcome is Outcome.OPTIMAL
    assert found.objective == pytest.approx(optimum.objective, rel=1e-6)
    assert found.plan.switch_times == pytest.approx(optimum.plan.switch_times, abs=1e-5)
    rollout = Rollout(problem.model, window, optimum.plan.switch_times)
    tau = durations(optimum.plan.switch_times, window.start, window.horizon)
    U = np.split(optimum.plan.u, 2)
    assert rollout.by_adjoint(tau, U) == pytest.approx([exact], abs=0.01)
    assert rollout.by_differences(tau, U) == pytest.approx([exact], abs=0.01)
    assert rollout.by_costate(tau, U) == pytest.approx([corrected], abs=0.01)
    assert rollout.by_costate(tau, U, printed=True) == pytest.approx([1.0 - 100 + 0.2], abs=0.01)
    printed = build_solver(problem, PRINTED).solve(window, guess)
    assert printed.outcome is Outcome.OPTIMAL
    assert printed.plan.switch_times == pytest.approx([window.start + window.horizon - 1e-3], abs=1e-6)
    assert printed.objective > 1.3 * optimum.objective


def assert_same_optimum(problem: Problem, solve: RecordedSolve) -> None:
    found, optimum = (again(build_solver(problem, spec), solve, False) for spec in (ADJOINT, FATROP))
    assert found.outcome is optimum.outcome is Outcome.OPTIMAL
    assert found.objective == pytest.approx(optimum.objective, rel=1e-6)
    assert np.abs(found.plan.switch_times - optimum.plan.switch_times).max(initial=0.0) < 1e-3


def test_a_window_of_one_stage_has_the_optimum_of_fatrop(problem: Problem) -> None:
    assert_same_optimum(problem, middle_window_over(1))


@pytest.mark.slow
@pytest.mark.parametrize("mission", MISSIONS)
def test_windows_of_one_and_two_stages_have_the_optimum_of_fatrop(mission: str) -> None:
    """Every fifth window of three missions."""
    problem = build_problem(MISSIONS[mission]())
    solves = [solve for solve in recorded(mission).values() if len(solve.window.stages) <= 2]
    for solve in solves[::5]:
        assert_same_optimum(problem, solve)


@pytest.mark.slow
def test_a_mission_is_that_of_fatrop() -> None:
    """`approach_capture` from shortly before Capture is in the windows."""
    changes = ("controller.nodes=8", "plant=ideal", "log.shares=false", "initial.base=[-1.2, 1.2, 15 deg]")
    found, other = (
        simulate(load_task("approach_capture", (*changes, f"solver={kind}"))).summary()
        for kind in ("adjoint", "fatrop")
    )
    assert found.succeeded
    assert other.succeeded
    assert found.failed_solves == 0
    ends, other_ends = ([stage.switch_time for stage in each.stages] for each in (found, other))
    assert ends == pytest.approx(other_ends, abs=1e-3)
