from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from psmpc_cli.control.shares import combination
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import Experiment

from .test_controller import SHORT

Build = Callable[..., Experiment]

CONTROLS = st.integers(2, 4).flatmap(lambda S: arrays(float, (S, 9), elements=st.floats(-5, 5)))


@given(CONTROLS, st.data())
def test_weights_are_those_of_a_convex_combination(u: np.ndarray, data: st.DataObject) -> None:
    applied = data.draw(arrays(float, 9, elements=st.floats(-5, 5)))
    weights = combination(u, applied)
    assert weights.min() >= 0
    assert weights.sum() == pytest.approx(1)


@given(CONTROLS, st.data())
def test_a_combination_is_recognized(u: np.ndarray, data: st.DataObject) -> None:
    raw = data.draw(arrays(float, len(u), elements=st.floats(0.05, 1)))
    applied = raw / raw.sum() @ u
    np.testing.assert_allclose(combination(u, applied) @ u, applied, atol=1e-6)


@given(arrays(float, (2, 9), elements=st.floats(-5, 5)), arrays(float, 9, elements=st.floats(-5, 5)))
def test_of_two_controls_no_other_combination_is_nearer(u: np.ndarray, applied: np.ndarray) -> None:
    weights = combination(u, applied)
    others = np.linspace(0, 1, 21)[:, None]
    nearest = np.linalg.norm(others * u[0] + (1 - others) * u[1] - applied, axis=1).min()
    assert np.linalg.norm(weights @ u - applied) <= nearest + 1e-6


def test_the_stage_before_hands_its_share_over(experiment_of: Build) -> None:
    records = list(closed_loop(experiment_of(*SHORT)))
    alone = [record for record in records if len(record.command.instants) == 0]
    shared = [record for record in records if len(record.command.instants) > 0 and record.metrics.shares]
    assert all(record.metrics.shares == {record.command.sequence.first: 1.0} for record in alone)
    assert all(sum(record.metrics.shares.values()) == pytest.approx(1) for record in shared)
    assert any(0.05 < record.metrics.shares[record.command.sequence.first] < 0.95 for record in shared)
    late = [
        r
        for r in records
        if len(r.command.instants)
        and r.command.instants[0] - r.command.time < 0.1
        and r.command.sequence.first == 0
        and r.metrics.shares
    ]
    assert all(record.metrics.shares[1] > 0.5 for record in late)  # capture, with its priority of 100, has taken over


def test_shares_can_be_left_out(experiment_of: Build) -> None:
    record = next(closed_loop(experiment_of(*SHORT, "log.shares=false")))
    assert record.metrics.shares == {}


def test_window_costs_are_those_of_the_objective(experiment_of: Build) -> None:
    """J = sum of omega_s J_s, and the pending cost of the stages that wait."""
    for record in closed_loop(experiment_of(*SHORT, "log.shares=false")):
        if "solve_failed" in record.command.events:
            continue
        omega = np.array([1.0, 100.0, 1.0, 0.01])[record.command.sequence.first :][: len(record.metrics.window_cost)]
        pending = omega.max() * np.sum(record.command.instants - record.command.time)
        assert record.command.objective == pytest.approx(omega @ record.metrics.window_cost + pending, rel=1e-6)
