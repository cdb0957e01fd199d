"""What a controller takes as a measurement."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control import Controller, State
from psmpc_cli.errors import RunError
from psmpc_cli.specs.load import load_task

from .short_transports import SHORT


def test_a_state_that_is_not_measured_is_that_of_the_plan() -> None:
    controller = Controller(load_task("transport", SHORT))
    before = controller.step(0.0, State(np.zeros(9), np.zeros(9)))
    x = before.plan.states_at(np.array([0.1]))[0]
    Q = np.where(np.arange(9) == 2, np.nan, x[:9])
    command = controller.step(0.1, State(Q, x[9:]))
    assert "unmeasured" in command.events
    np.testing.assert_array_equal(command.state, x)


def test_without_a_measurement_nothing_begins() -> None:
    controller = Controller(load_task("transport", SHORT))
    with pytest.raises(RunError, match="nothing is measured at 0 s"):
        controller.step(0.0, State(np.full(9, np.nan), np.zeros(9)))


def test_the_force_of_the_base_is_along_the_axes_of_the_inertial_frame() -> None:
    """Turned by a quarter turn, it still takes a force along x alone to accelerate along x; its own axes differ."""
    controller = Controller(load_task("transport", {"controller.nodes": 5}))
    model = controller.problem.model
    turned = State(np.r_[0.0, 0.0, np.pi / 2, np.zeros(model.n - 3)], np.zeros(model.n))
    command = controller.step(0.0, turned)
    along_x = replace(command, u=np.tile(np.eye(model.n)[0], (len(command.u), 1)))
    F = along_x.force(0.0, turned)
    total = float(model.mass_matrix(turned.Q)[0, 0])
    np.testing.assert_allclose(F[:2], [total, 0.0], atol=1e-9 * total)
    np.testing.assert_allclose(
        np.array(model.space.along_base_axes(turned.Q, F), dtype=float)[:2], [0.0, -total], atol=1e-9 * total
    )
