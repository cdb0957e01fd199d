"""What a controller takes as a measurement."""

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
    np.testing.assert_array_equal(command.x, x)


def test_without_a_measurement_nothing_begins() -> None:
    controller = Controller(load_task("transport", SHORT))
    with pytest.raises(RunError, match="nothing is measured at 0 s"):
        controller.step(0.0, State(np.full(9, np.nan), np.zeros(9)))
