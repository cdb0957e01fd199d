from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.ocp.end_curvature import EndCurvature
from psmpc_cli.ocp.transcription import Nlp, transcribe
from psmpc_cli.ocp.velocity_form import Point, VelocityForm

from psmpc_cli.control import Command
from psmpc_cli.ocp.gauss_newton import linearize
from psmpc_cli.ocp.window import window_shape
from psmpc_cli.robot.model import RobotModel


class Case:
    """A window of the transport run with two stages, the first one of this index."""

    def __init__(self, model: RobotModel, decisions: list[Command], first: int) -> None:
        windows = (decision.solution for decision in decisions)
        solved = next(s for s in windows if len(s.window.stages) == 2 and s.window.stages[0].index == first)
        self.nlp: Nlp = transcribe(model, window_shape(solved.window.stages, (20, 20), "exact"))
        self.form = VelocityForm(model, self.nlp.shape, self.nlp.layout)
        self.numbers = self.form.numbers(solved.parameters)
        self.point = self.form.point(solved.guess.z, self.numbers)
        self.curvature = EndCurvature(self.form)


@pytest.fixture(scope="module")
def capture(model: RobotModel, decisions: list[Command]) -> Case:
    """Ends when poses are reached."""
    return Case(model, decisions, 1)


def test_an_end_condition_on_coordinates_is_not_curved(model: RobotModel, decisions: list[Command]) -> None:
    assert Case(model, decisions, 0).curvature.stages == ()


def test_it_is_the_change_of_the_end_rows_derivatives(capture: Case) -> None:
    multipliers = np.random.default_rng(0).normal(size=9)
    node, n = capture.nlp.layout.first_node[1], capture.nlp.layout.n

    def gradient(Q: np.ndarray) -> np.ndarray:
        """Of multipliers times rows, by Q."""
        X = capture.point.X.copy()
        X[node, :n] = Q
        _, derivatives = capture.form.ends(Point(X, capture.point.tau), capture.numbers)[0]
        found, (row, column) = np.zeros(2 * n), capture.form.terms[0].end_derivatives
        np.add.at(found, column, derivatives * multipliers[row])
        return found[:n]

    model = linearize(capture.form, capture.point, capture.numbers)
    curved = capture.curvature.added_to(model, capture.point, capture.numbers, {0: multipliers})
    added = curved.positions - model.positions
    Q, step = capture.point.X[node, :n], 1e-5
    numeric = np.array([(gradient(Q + step * e) - gradient(Q - step * e)) / (2 * step) for e in np.eye(n)])
    assert np.abs(added[node]).max() > 0.1
    assert added[node] == pytest.approx(np.triu(numeric), abs=1e-8)
    assert not np.delete(added, node, axis=0).any()


def test_the_rest_of_the_model_stays_as_it_is(capture: Case) -> None:
    model = linearize(capture.form, capture.point, capture.numbers)
    curved = capture.curvature.added_to(model, capture.point, capture.numbers, {0: np.ones(9)})
    assert replace(curved, positions=model.positions) is not model
    for name in ("gradient", "gradient_tau", "velocities", "coupling", "arrow", "durations"):
        assert getattr(curved, name) is getattr(model, name)
