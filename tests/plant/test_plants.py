from functools import partial

import casadi as ca
import numpy as np
import pytest

from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.rk4 import Rk4Plant, held_force
from psmpc_cli.robot.model import RobotModel


@pytest.fixture
def x() -> np.ndarray:
    random = np.random.default_rng(3)
    return np.r_[0.3, -0.2, 0.5, 0.4 * random.standard_normal(6), 0.1 * random.standard_normal(9)]


def test_momentum_is_conserved_for_a_minute_without_base_force(model: RobotModel, x: np.ndarray) -> None:
    """Joint torques only, rich in frequencies; linear and angular momentum about the inertial origin."""
    h, ticks, n = 1e-3, 60_000, model.n
    time = h * np.arange(ticks)
    F = np.zeros((n, ticks))
    F[3:] = 0.05 * np.sin(np.outer(np.arange(1, 7), time) + np.arange(6)[:, None])
    tick = held_force(model, h, 1)
    Z = np.asarray(tick.mapaccum(ticks)(np.r_[x, np.zeros(4)], F))[:, 999::1000]
    momentum = np.asarray(model.momentum(Z[:n], Z[n : 2 * n]))
    start = np.asarray(model.momentum(x[:n], x[n:]))
    assert np.abs(Z[3:n] - x[3:n, None]).max() > 0.1
    assert np.abs(momentum - start).max() < 1e-9


def test_energy_changes_by_the_work_and_momentum_by_the_impulse(model: RobotModel, x: np.ndarray) -> None:
    u = np.tile(np.linspace(-0.5, 0.5, 9), (200, 1))
    ticks = Rk4Plant(model, 1e-3).advance(0.0, x, u)
    n, end = model.n, ticks.X[-1]
    energy = float(model.kinetic_energy(end[:n], end[n:])) - float(model.kinetic_energy(x[:n], x[n:]))
    momentum = np.asarray(model.momentum(end[:n], end[n:]) - model.momentum(x[:n], x[n:])).ravel()
    assert energy == pytest.approx(ticks.work, abs=1e-10)
    np.testing.assert_allclose(momentum, ticks.impulse, atol=1e-10)


def test_computed_torque_makes_the_robot_follow_the_ideal_plant(model: RobotModel, x: np.ndarray) -> None:
    """The force is held over a tick, so the error shrinks with the tick."""
    errors = []
    for rate in (250, 1000):
        u = np.tile(np.linspace(-0.5, 0.5, 9), (rate // 5, 1))
        plants = (plant(model, 1 / rate) for plant in (IdealPlant, Rk4Plant))
        ideal, full = (plant.advance(0.0, x, u).X[-1] for plant in plants)
        errors.append(np.abs(ideal - full).max())
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_finer_steps_do_not_change_the_motion(model: RobotModel, x: np.ndarray) -> None:
    u = np.tile(np.linspace(-0.5, 0.5, 9), (100, 1))
    coarse, fine = (Rk4Plant(model, 1e-3, substeps).advance(0.0, x, u).X[-1] for substeps in (1, 4))
    np.testing.assert_allclose(coarse, fine, atol=1e-10)


@pytest.mark.parametrize("build", [IdealPlant, partial(Rk4Plant, substeps=2)])
def test_ticks_tell_times_states_and_forces(model: RobotModel, x: np.ndarray, build) -> None:
    ticks = build(model, 1e-3).advance(2.0, x, np.zeros((10, 9)))
    np.testing.assert_allclose(ticks.time, 2 + 1e-3 * np.arange(11))
    np.testing.assert_array_equal(ticks.X[0], x)
    np.testing.assert_allclose(ticks.F[0], np.asarray(ca.DM(model.low_level(x[:9], x[9:], 0))).ravel())
