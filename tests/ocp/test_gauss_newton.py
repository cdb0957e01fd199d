from collections.abc import Callable

import numpy as np
import pytest

from psmpc_cli.ocp.gauss_newton import Unknowns, VelocityForm
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.ocp.window import Window, plan_on_mesh, window_numbers, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import NlpSolver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import Task

from ..solvers.optimality import hessian
from .transport_windows import coasting, ending, moving, window_over

H = 1e-6


class Case:
    """A window at a point off its guess, with a terminal cost, an offset and a target that moves."""

    def __init__(self, model: RobotModel, stages: tuple[Stage, ...], discretization: str) -> None:
        slow = [ending(stage, rate_tolerance=0.1) for stage in stages]
        stages = (*slow[:-1], moving(slow[-1])) if len(slow) > 1 else (moving(slow[0]),)
        changes = {"terminal_cost": 0.3, "offset": np.full(len(stages), 0.2), "discretization": discretization}
        self.window: Window = window_over(stages, **changes)
        switch_times = np.linspace(1.0, 5.0, len(stages) + 1)[1:-1]
        self.form = VelocityForm(model, window_shape(self.window))
        self.p, random = window_numbers(self.window, switch_times), np.random.default_rng(len(stages))
        X = coasting(self.window, *switch_times).X
        X[1:] += random.normal(scale=0.1, size=X[1:].shape)
        self.point = Unknowns(X, np.diff(switch_times, prepend=1.0) + random.uniform(0.0, 0.1, size=len(switch_times)))
        self.direction = Unknowns(random.normal(size=X.shape), random.normal(scale=0.1, size=len(switch_times)))

    def by_differences(self, of: Callable[[Unknowns], np.ndarray]) -> np.ndarray:
        after, before = (of(self.point.moved(self.direction, sign * H)) for sign in (1, -1))
        return (after - before) / (2 * H)


@pytest.fixture(scope="module")
def problem(transport: Task) -> Problem:
    return build_problem(transport)


@pytest.fixture(scope="module", params=[(1, "exact"), (2, "exact"), (2, "euler"), (3, "exact")], ids=str)
def case(request: pytest.FixtureRequest, model: RobotModel, stages: tuple[Stage, ...]) -> Case:
    count, discretization = request.param
    return Case(model, stages[1 : 1 + count], discretization)


def test_costs_and_constraints_are_those_of_the_nlp(case: Case, problem: Problem) -> None:
    """Both are derived from the residual of the skill, once over nodes in C and once unrolled."""
    nlp = NlpSolver(problem, SolverSpec(kind="ipopt"))
    point, window = case.point, case.window
    plan = plan_on_mesh(window, point.X, case.form.inputs(point, window.horizon), point.tau)
    at = case.form.residuals(point, window_numbers(window, plan.switch_times))
    np.testing.assert_allclose(nlp.costs(window, plan)[:-1], at.costs[:-1], rtol=1e-12)
    assert nlp.costs(window, plan)[-1] == pytest.approx(at.costs[-1] + at.terminal, rel=1e-12)
    at = case.form.residuals(point, case.p)
    linear = case.form.linearize(case.point, case.p).residuals
    assert linear.objective == pytest.approx(at.objective, rel=1e-12)
    np.testing.assert_allclose(linear.costs, at.costs, rtol=1e-12)


def test_derivatives_agree_with_central_differences(case: Case) -> None:
    model, d, n = case.form.linearize(case.point, case.p), case.direction, case.form.grid.n
    J = case.by_differences(lambda point: np.array(case.form.residuals(point, case.p).objective))
    assert float(J) == pytest.approx((model.gradient * d.X).sum() + model.gradient_tau @ d.tau, rel=1e-6)
    gaps = np.diff(d.X[:, :n], axis=0) + model.gap_tau @ d.tau
    gaps += model.gap_velocity[:, :1] * d.X[:-1, n:] + model.gap_velocity[:, 1:] * d.X[1:, n:]
    found = case.by_differences(lambda point: case.form.residuals(point, case.p).gaps)
    np.testing.assert_allclose(found, gaps, atol=1e-8)
    found = case.by_differences(lambda point: case.form.residuals(point, case.p).rows)
    change = (model.rows_by_x * d.X[case.form.row_node]).sum(axis=1)
    np.testing.assert_allclose(found, change, atol=1e-7)


def test_the_hessian_is_positive_semidefinite(case: Case) -> None:
    eigenvalues = np.linalg.eigvalsh(hessian(case.form.linearize(case.point, case.p)))
    assert eigenvalues[0] >= -1e-10 * eigenvalues[-1]
    assert eigenvalues[-1] > 0


def test_the_curvature_of_end_conditions_is_the_change_of_their_derivatives(
    model: RobotModel, stages: tuple[Stage, ...]
) -> None:
    """Conditions on coordinates have none, those on poses have; nothing else of the model changes."""
    assert not VelocityForm(model, window_shape(window_over(stages[:2]))).curved
    window = window_over(stages[1:3])
    form, p = VelocityForm(model, window_shape(window)), window_numbers(window, np.array([3.0]))
    point, multipliers = Unknowns(coasting(window, 3.0).X, np.array([2.0])), np.random.default_rng(0).normal(size=9)
    node, n = form.grid.first_node[1], form.grid.n

    def gradient(Q: np.ndarray) -> np.ndarray:
        """Of multipliers times rows, by Q."""
        X = point.X.copy()
        X[node, :n] = Q
        return np.asarray(multipliers @ form.rows(Unknowns(X, point.tau), p)[1])[:n]

    plain = form.linearize(point, p)
    curved = form.with_curvature(plain, point, p, multipliers)
    added, Q, step = curved.H_QQ - plain.H_QQ, point.X[node, :n], 1e-5
    numeric = np.array([(gradient(Q + step * e) - gradient(Q - step * e)) / (2 * step) for e in np.eye(n)])
    assert form.curved
    assert np.abs(added[node]).max() > 0.1
    assert added[node] == pytest.approx(np.triu(numeric), abs=1e-8)
    assert not np.delete(added, node, axis=0).any()
    for name in ("gradient", "gradient_tau", "H_vv", "H_x_tau", "H_tau_tau"):
        assert getattr(curved, name) is getattr(plain, name)
