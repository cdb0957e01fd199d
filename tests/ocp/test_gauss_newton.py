from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from psmpc_cli.ocp.transcription import Nlp, transcribe
from psmpc_cli.ocp.velocity_form import Point, VelocityForm

from psmpc_cli.control import Command
from psmpc_cli.ocp.gauss_newton import Linearization, linearize
from psmpc_cli.ocp.window import Parameters, window_shape
from psmpc_cli.robot.model import RobotModel

H = 1e-6


class Case:
    """A window of a run at a point off its guess, with a terminal cost, an offset and a reference that moves."""

    def __init__(self, model: RobotModel, decision: Command, discretization: str, seed: int) -> None:
        window, random = decision.solution.window, np.random.default_rng(seed)
        shape = window_shape(window.stages, (20,) * len(window.stages), discretization)
        moving = tuple(replace(stage, moving=True, end_velocity=bool(stage.end_rows)) for stage in shape.stages)
        self.nlp: Nlp = transcribe(model, replace(shape, stages=moving))
        self.form = VelocityForm(model, self.nlp.shape, self.nlp.layout)
        plain = VelocityForm(model, shape, self.nlp.layout).numbers(decision.solution.parameters)
        self.p: Parameters[np.ndarray] = replace(
            plain,
            terminal=np.array(0.3),
            offset=np.full(len(shape.nodes), 0.2),
            paths=tuple(
                np.hstack([np.tile(target[:, None], 21), random.normal(scale=0.1, size=(len(target), 21))])
                for target in plain.targets
            ),
        )
        guess = self.form.point(decision.solution.guess.z, self.p)
        X = guess.X + random.normal(scale=0.1, size=guess.X.shape)
        X[0] = guess.X[0]
        self.point = Point(X, guess.tau + random.uniform(0.0, 0.1, size=guess.tau.shape))
        self.direction = Point(random.normal(size=X.shape), random.normal(scale=0.1, size=guess.tau.shape))

    def by_differences(self, of: Callable[[Point], np.ndarray]) -> np.ndarray:
        after, before = (of(self.point.moved(self.direction, sign * H)) for sign in (1, -1))
        return (after - before) / (2 * H)

    @property
    def parameters(self) -> np.ndarray:
        return np.concatenate([np.ravel(piece, order="F") for piece in self.p.pieces()])


@pytest.fixture(params=[(1, "exact"), (2, "exact"), (2, "euler"), (3, "exact")], ids=str)
def case(request: pytest.FixtureRequest, model: RobotModel, decisions: list[Command]) -> Case:
    stages, discretization = request.param
    chosen = [d for d in decisions if len(d.solution.window.stages) == stages]
    return Case(model, chosen[len(chosen) // 2], discretization, seed=stages)


def dense_hessian(case: Case, model: Linearization) -> np.ndarray:
    n, K, S = case.form.layout.n, case.form.layout.K, case.form.layout.switches
    hessian = np.zeros((2 * n * (K + 1) + S, 2 * n * (K + 1) + S))
    for k in range(K + 1):
        at = 2 * n * k
        hessian[at : at + n, at : at + n] = model.positions[k]
        hessian[at + n : at + 2 * n, at + n : at + 2 * n] = np.diag(model.velocities[k])
        hessian[at : at + 2 * n, 2 * n * (K + 1) :] = model.arrow[k]
        if k < K:
            hessian[at + n : at + 2 * n, at + 3 * n : at + 4 * n] = np.diag(model.coupling[k])
    hessian[2 * n * (K + 1) :, 2 * n * (K + 1) :] = np.triu(model.durations)
    return np.triu(hessian) + np.triu(hessian, 1).T


def test_a_parameter_vector_is_split_into_what_it_was_made_of(case: Case) -> None:
    found = case.form.numbers(case.parameters)
    for piece, original in zip(found.pieces(), case.p.pieces(), strict=True):
        np.testing.assert_array_equal(piece, original)


def test_objective_and_constraints_are_those_of_the_nlp(case: Case) -> None:
    z = case.form.decision(case.point, case.p)
    f, g = ca.Function("nlp", [case.nlp.x, case.nlp.p], [case.nlp.f, case.nlp.g])(z, case.parameters)
    at, n = case.form.residuals(case.point, case.p), case.form.layout.n
    assert at.objective == pytest.approx(float(f), rel=1e-12)
    rows = np.asarray(g).ravel()
    np.testing.assert_allclose(rows[case.nlp.gap_rows[:, :n]], at.gaps, atol=1e-12)
    np.testing.assert_allclose(rows[case.nlp.gap_rows[:, n:]], 0.0, atol=1e-12)
    for s, end in at.ends.items():
        np.testing.assert_allclose(rows[case.nlp.end_rows[s]], end, atol=1e-12)


def test_a_point_survives_the_way_through_the_nlp(case: Case) -> None:
    again = case.form.point(case.form.decision(case.point, case.p), case.p)
    np.testing.assert_array_equal(again.X, case.point.X)
    np.testing.assert_array_equal(again.tau, case.point.tau)


def test_derivatives_agree_with_central_differences(case: Case) -> None:
    model, d, n = linearize(case.form, case.point, case.p), case.direction, case.form.layout.n
    J = case.by_differences(lambda point: np.array(case.form.residuals(point, case.p).objective))
    assert float(J) == pytest.approx((model.gradient * d.X).sum() + model.gradient_tau @ d.tau, rel=1e-6)
    gaps = np.diff(d.X[:, :n], axis=0) + model.gap_tau @ d.tau
    gaps += model.gap_velocity[:, :1] * d.X[:-1, n:] + model.gap_velocity[:, 1:] * d.X[1:, n:]
    np.testing.assert_allclose(
        case.by_differences(lambda point: case.form.residuals(point, case.p).gaps), gaps, atol=1e-8
    )
    for s, values in model.end_derivatives.items():
        row, column = case.form.terms[s].end_derivatives
        change = np.zeros(case.form.terms[s].end_rows)
        np.add.at(change, row, values * d.X[case.form.layout.first_node[s + 1]][column])
        found = case.by_differences(lambda point, s=s: case.form.residuals(point, case.p).ends[s])
        np.testing.assert_allclose(found, change, atol=1e-7)


def test_the_hessian_is_positive_semidefinite(case: Case) -> None:
    eigenvalues = np.linalg.eigvalsh(dense_hessian(case, linearize(case.form, case.point, case.p)))
    assert eigenvalues[0] >= -1e-10 * eigenvalues[-1]
    assert eigenvalues[-1] > 0
