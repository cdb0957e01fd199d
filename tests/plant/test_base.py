"""The undisturbed plants: each by the laws of physics, and by each other."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.plant.base import Setpoints
from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel

from ..robot.strategies import State, laws, moving_robots

TICK = 1e-3


@pytest.fixture
def u() -> np.ndarray:
    """Two seconds of accelerations, rich in frequencies."""
    return 0.5 * np.sin(np.outer(TICK * np.arange(2000), np.arange(1, 10)) + np.arange(9))


def change(model: RobotModel, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the change of the robot model's momentum and energy between two states (4,)."""
    first, last = (
        np.r_[model.momentum(*np.split(x, 2)), model.kinetic_energy(*np.split(x, 2))] for x in (before, after)
    )
    return last - first


@given(moving_robots(most=3), st.integers(1, 3))
@laws
def test_momentum_changes_by_the_impulse_and_energy_by_the_work(state: State, substeps: int) -> None:
    """For MuJoCo these are the robot model's momentum and energy at the states of an engine that knows neither."""
    model, Q, v, u = state
    x = np.r_[Q, 0.2 * v]
    for build in (Rk4Plant, MujocoPlant):
        ticks = build(model, TICK, substeps).advance(0.0, x, Setpoints(np.tile(0.2 * u, (50, 1))))
        np.testing.assert_allclose(change(model, x, ticks.states[-1]), ticks.impulse_and_work, atol=1e-9)


def test_computed_torque_makes_the_robot_follow_the_ideal_plant(model: RobotModel, x: np.ndarray) -> None:
    """The force is held over a tick, so the error shrinks with the tick."""
    errors = []
    for rate in (250, 1000):
        u = np.tile(np.linspace(-0.5, 0.5, 9), (rate // 5, 1))
        ideal, full = (
            plant(model, 1 / rate).advance(0.0, x, Setpoints(u)).states[-1] for plant in (IdealPlant, Rk4Plant)
        )
        errors.append(np.abs(ideal - full).max())
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize("build", [IdealPlant, partial(Rk4Plant, substeps=2), MujocoPlant])
def test_ticks_contain_times_states_and_forces(model: RobotModel, x: np.ndarray, build: type) -> None:
    plant = build(model, TICK)
    ticks = plant.advance(2.0, x, Setpoints(np.zeros((10, 9))))
    np.testing.assert_allclose(ticks.time, 2 + TICK * np.arange(11))
    np.testing.assert_array_equal(ticks.states[0], x)
    np.testing.assert_allclose(ticks.F[0], model.bias(x[:9], x[9:]))
    plant.advance(0.0, -x, Setpoints(np.ones((10, 9))))
    np.testing.assert_array_equal(
        plant.advance(2.0, x, Setpoints(np.zeros((10, 9)))).states, ticks.states
    )  # a sample has no memory


def test_forces_of_rk4_give_the_same_motion_in_mujoco(model: RobotModel, x: np.ndarray, u: np.ndarray) -> None:
    """Open loop over two seconds: nothing pulls the two together."""
    ticks, fine = (
        Rk4Plant(model, TICK).advance(0.0, x, Setpoints(u)),
        Rk4Plant(model, TICK, 4).advance(0.0, x, Setpoints(u)),
    )
    assert np.abs(ticks.states - x).max() > 0.3
    np.testing.assert_allclose(fine.states, ticks.states, rtol=0, atol=1e-9)
    for substeps in (1, 4):
        np.testing.assert_allclose(
            MujocoPlant(model, TICK, substeps).replay(x, ticks.F), ticks.states, rtol=0, atol=1e-10
        )
