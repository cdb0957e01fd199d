"""The adaptive integrator agrees with known motions, and with the plant in the limit of short steps."""

import numpy as np
import pytest

from psmpc_cli.plant.adaptive import AdaptiveDynamics
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel


@pytest.fixture(scope="module")
def physics(model: RobotModel) -> AdaptiveDynamics:
    return AdaptiveDynamics(model)


@pytest.fixture(scope="module")
def motion(model: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    """A state in motion, and accelerations for eight pieces."""
    random = np.random.default_rng(3)
    return random.normal(0, 0.2, 2 * model.n), random.normal(0, 0.3, (8, model.n))


def test_under_the_law_the_motion_is_the_double_integrators(
    model: RobotModel, physics: AdaptiveDynamics, motion: tuple[np.ndarray, np.ndarray]
) -> None:
    """Paper eqs. (7), (8)."""
    x, u = motion
    flow = physics.integrate("law", x, 3.0 + 0.05 * np.arange(9), u)
    np.testing.assert_allclose(
        flow.between_pieces, IdealPlant(model, 0.05).advance(3.0, x, Setpoints(u)).states, atol=1e-10
    )


def test_a_force_held_over_a_tick_is_the_plants(
    model: RobotModel, physics: AdaptiveDynamics, motion: tuple[np.ndarray, np.ndarray]
) -> None:
    x, u = motion
    ticks = Rk4Plant(model, 0.01, substeps=10).advance(3.0, x, Setpoints(u))
    np.testing.assert_allclose(physics.integrate("ticks", x, ticks.time, u).between_pieces, ticks.states, atol=1e-9)
    np.testing.assert_allclose(
        physics.integrate("force", x, ticks.time, ticks.F).between_pieces, ticks.states, atol=1e-9
    )


def test_momentum_changes_by_the_impulse_of_the_held_force(
    model: RobotModel, physics: AdaptiveDynamics, motion: tuple[np.ndarray, np.ndarray]
) -> None:
    x, _ = motion
    F = np.zeros((1, model.n))
    F[0, :2] = 3.0, -2.0
    after = physics.integrate("force", x, np.array([0.0, 0.2]), F).states[-1]
    before, later = (model.momentum(*np.split(z, 2)) for z in (x, after))
    np.testing.assert_allclose(later[:2] - before[:2], 0.2 * F[0, :2], atol=1e-9)
