from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.ocp.transcription import transcribe
from psmpc_cli.ocp.velocity_form import Point, VelocityForm
from psmpc_cli.solvers.sqp_guess import SHARE, later
from psmpc_cli.solvers.sqp_limits import Limits, limits

from psmpc_cli.control import Command
from psmpc_cli.ocp.window import bounds, window_shape
from psmpc_cli.robot.model import RobotModel


class Case:
    """A solved window of the transport run over that many stages."""

    def __init__(self, model: RobotModel, decisions: list[Command], stages: int) -> None:
        solved = next(d.solution for d in decisions if len(d.solution.window.stages) == stages)
        nlp = transcribe(model, window_shape(solved.window.stages, (20,) * stages, "exact"))
        self.form = VelocityForm(model, nlp.shape, nlp.layout)
        self.horizon = solved.window.horizon
        self.limits: Limits = limits(nlp, bounds(nlp, solved.window), self.horizon)
        self.point = self.form.point(solved.solution.z, self.form.numbers(solved.parameters))


@pytest.fixture(scope="module", params=[2, 3], ids=["two_stages", "three_stages"])
def case(request: pytest.FixtureRequest, model: RobotModel, decisions: list[Command]) -> Case:
    return Case(model, decisions, request.param)


def test_the_last_switch_moves_most_of_the_way_to_the_latest_instant(case: Case) -> None:
    found = later(case.form, case.limits, case.point, case.horizon)
    assert found is not None
    assert found.tau[:-1] == pytest.approx(case.point.tau[:-1])
    left, had = case.limits.together - found.tau.sum(), case.limits.together - case.point.tau.sum()
    assert left == pytest.approx((1 - SHARE) * had)
    assert left > 0


def test_the_motion_stays_the_same(case: Case) -> None:
    found = later(case.form, case.limits, case.point, case.horizon)
    assert found is not None
    n = case.form.layout.n
    assert np.array_equal(found.X[0], case.point.X[0])
    assert found.X[-1] == pytest.approx(case.point.X[-1], abs=1e-9)
    travelled = [np.abs(np.diff(point.X[:, :n], axis=0)).sum(axis=0) for point in (found, case.point)]
    assert travelled[0] == pytest.approx(travelled[1], abs=1e-2)


def test_where_no_switch_can_move_there_is_none(case: Case, model: RobotModel, decisions: list[Command]) -> None:
    alone = Case(model, decisions, 1)
    assert later(alone.form, alone.limits, alone.point, alone.horizon) is None
    last = len(case.point.tau) - 1
    given = replace(case.limits, tau_low=case.point.tau, tau_high=case.point.tau)
    assert given.shape.fixed[-1] == last
    assert later(case.form, given, case.point, case.horizon) is None
    latest = Point(
        case.point.X, case.point.tau + (case.limits.together - case.point.tau.sum()) * np.eye(last + 1)[last]
    )
    assert later(case.form, case.limits, latest, case.horizon) is None
