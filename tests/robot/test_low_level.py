"""The low-level law of controllers and plants: in joint space, in task space, and with a load that it knows."""

import numpy as np
import pytest

from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.low_level import LowLevelLaw, low_level_law
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.object import NO_BODY, ObjectBody

GRASPED = load_task("transport_grasp", {"object.grasp.known": True}).spec.body


@pytest.fixture
def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates with bent arms, velocities and accelerations."""
    return np.r_[0.1, 0.2, 0.3, 0.5, 0.8, 0.4, 0.5, 0.9, 0.3], np.linspace(-0.1, 0.1, 9), np.linspace(0.2, -0.1, 9)


def test_inputs_are_accelerations_or_rates_of_twists(model: RobotModel, motion: tuple[np.ndarray, ...]) -> None:
    law = LowLevelLaw(model)
    np.testing.assert_array_equal(law.force(*motion), model.computed_torque(*motion))
    Q, v, u = motion
    rates = np.linspace(0.1, 0.4, 9)
    np.testing.assert_array_equal(law.force(Q, v, u, rates), model.task_space_force(Q, v, rates))


def test_a_load_counts_while_hands_hold_it(model: RobotModel, motion: tuple[np.ndarray, ...]) -> None:
    law = low_level_law(model, body_of(GRASPED), GRASPED.grasp)
    load = HeldLoad(model, body_of(GRASPED), GRASPED.grasp)
    np.testing.assert_array_equal(law.force(*motion, grasps=law.grasps), load.force(*motion))
    np.testing.assert_array_equal(law.force(*motion), model.computed_torque(*motion))
    Q, v, u = motion
    planned = np.tile(u, (3, 1))
    closed = np.array([False, True, True])
    np.testing.assert_array_equal(law.followed(Q, v, planned, np.zeros(3, bool), 1e-3), planned)
    followed = law.followed(Q, v, planned, closed, 1e-3)
    np.testing.assert_array_equal(followed[0], u)
    assert np.abs(followed[1] - u).max() > 1e-3


@pytest.mark.parametrize("body", [NO_BODY, load_task("transport_grasp", {"object.grasp.known": False}).spec.body])
def test_a_load_that_is_not_known_does_not_count(
    model: RobotModel, motion: tuple[np.ndarray, ...], body: ObjectBody
) -> None:
    law = low_level_law(model, body_of(body), body.grasp)
    assert law.grasps is None
    np.testing.assert_array_equal(law.force(*motion, grasps=np.zeros((2, 5))), model.computed_torque(*motion))
