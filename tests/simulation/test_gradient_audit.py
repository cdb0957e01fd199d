from collections.abc import Callable

import pytest

from psmpc_cli.simulation.gradient_audit import audit_gradients
from psmpc_cli.simulation.run import Experiment, build_experiment, converging

from .. import free_flyer

pytestmark = pytest.mark.slow


def test_costate_formula_meets_the_adjoint_at_unconstrained_optima_with_first_order(
    experiment_of: Callable[..., Experiment],
) -> None:
    audits = audit_gradients(experiment_of("controller.nodes=50", "solver.kind=fatrop"))
    assert [audit.switch for audit in audits] == [
        ("approach", "capture"),
        ("capture", "transport"),
        ("transport", "release"),
    ]
    for audit in audits:
        assert audit.holds
        assert audit.costate_gaps[0] / audit.costate_gaps[1] == pytest.approx(2, rel=0.1)


def test_trajectories_that_begin_with_their_stage_are_in_all_gradients(
    experiment_of: Callable[..., Experiment],
) -> None:
    audits = audit_gradients(experiment_of("controller.nodes=25", "solver.kind=fatrop", task="tracking"))
    assert [audit.switch for audit in audits] == [("unfold", "trace"), ("trace", "stow")]
    assert all(audit.holds for audit in audits)
    assert [audit.costate_gaps[0] / audit.costate_gaps[1] for audit in audits] == pytest.approx([2, 2], rel=0.1)


def test_gradients_agree_in_the_chart_of_a_robot_in_space() -> None:
    audits = audit_gradients(build_experiment(converging(free_flyer.reaching("controller.nodes=15"))))
    assert [audit.switch for audit in audits] == [("fly", "reach"), ("reach", "look")]
    for audit in audits:
        assert audit.holds
        assert audit.costate_gaps[0] / audit.costate_gaps[1] == pytest.approx(2, rel=0.15)
