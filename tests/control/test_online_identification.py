"""What a controller finds out besides the state, and the low-level law that counts with it."""

from typing import Any

import numpy as np
import pytest

from psmpc_cli.control import Command, Controller, State
from psmpc_cli.control.identification.inertia import NO_INERTIA
from psmpc_cli.control.identification.load import NO_LOAD
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.specs.load import load_task


def first_command(task: str, changes: dict[str, Any], wheels: np.ndarray | None = None) -> Command:
    """Return the command of a robot that starts at rest, with wheels that store so much."""
    controller = Controller(load_task(task, {"controller.nodes": 8, **changes}))
    model = controller.problem.model
    return controller.step(0.0, State(model.neutral, np.zeros(model.n), wheels))


@pytest.mark.parametrize(("task", "changes"), [("transport", {}), ("catch_drifting", {"object.grasp.known": True})])
def test_a_controller_that_finds_nothing_out_counts_with_what_is_described(task: str, changes: dict[str, Any]) -> None:
    command = first_command(task, changes)
    assert command.load is NO_LOAD and command.inertia is NO_INERTIA
    assert repr(command.load) == "<LoadEstimate: none, the load is not to be found out>"
    assert repr(command.inertia) == "<InertiaEstimate: none, masses and inertias are not to be found out>"
    assert command.law.parameters is command.law.model.nominal
    np.testing.assert_array_equal(command.law.load, command.problem.law.load)


def test_the_law_counts_with_the_prior_of_a_load_before_it_is_held() -> None:
    prior = {"mass": 12.0, "inertia": 3.0}
    command = first_command("catch_drifting", {"object.grasp.known": "estimated", "controller.load_prior": prior})
    np.testing.assert_array_equal(command.law.load, [12.0, 3.0])
    assert command.problem.law.load[0] != 12.0
    assert command.inertia is NO_INERTIA


def test_masses_and_wheels_are_found_out_together() -> None:
    """What wheels store counts besides the estimated masses, neither in place of the other."""
    momentum = np.full(len(load_task("turn_and_look").robot.wheels), 0.02)
    command = first_command("turn_and_look", {"controller.masses": "estimated"}, momentum)
    stored = Wheels.of(command.law.model.spec).along_base(momentum.tolist())
    np.testing.assert_array_equal(command.law.parameters.stored, stored)
    assert command.inertia.bodies == len(command.law.model.nominal.mass)
    np.testing.assert_array_equal(command.law.parameters.mass, command.law.model.nominal.mass)
    assert command.load is NO_LOAD
