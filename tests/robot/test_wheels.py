"""Reaction wheels by themselves: shares, limits, and the momentum and energy that they add to those of bodies."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.robot.model import RobotModel, load_robot
from psmpc_cli.robot.wheels import Wheels

from ..wheeled import PYRAMID, TWO_WHEELS, robot_in

TURNED = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)


@pytest.fixture
def model(tmp_path: Path) -> RobotModel:
    return load_robot(robot_in(tmp_path, "free_flyer_arm", PYRAMID))


def test_motors_give_a_moment_with_the_least_torques(model: RobotModel) -> None:
    wheels = Wheels.of(model.spec)
    F = np.r_[0.1, -0.2, 0.3, 0.004, -0.003, 0.002, 0.0, 0.0, 0.0]
    acts, torques = wheels.turned(F, wheels.initial, TURNED, 1e-3, np.zeros(4))
    np.testing.assert_allclose(acts[model.space.rotation], F[model.space.rotation], atol=1e-17)
    np.testing.assert_allclose(wheels.axes @ torques, -F[model.space.rotation], atol=1e-17)
    np.testing.assert_allclose(wheels.unseen @ torques, 0, atol=1e-17)
    np.testing.assert_allclose(np.linalg.norm(wheels.axes, axis=0), 1)


def test_a_full_wheel_gives_nothing_further(model: RobotModel) -> None:
    """It takes what leads to its largest momentum in the tick, and gives back as before."""
    wheels = Wheels.of(model.spec)
    h = wheels.momentum - [1e-6, 0, 0.1, 0.1]
    F = np.zeros(model.n)
    F[model.space.rotation] = -wheels.axes @ np.full(4, 0.01)
    _, torques = wheels.turned(F, h, TURNED, 1e-3, np.zeros(4))
    wanted = wheels.allocation @ wheels.axes @ np.full(4, 0.01)
    np.testing.assert_allclose(torques, [1e-3, 0, wanted[2], wanted[3]], atol=1e-12)
    _, back = wheels.turned(-F, h, TURNED, 1e-3, np.zeros(4))
    np.testing.assert_allclose(back, -wanted, atol=1e-17)


@pytest.mark.parametrize("where", ["plane", "space"])
def test_momentum_is_that_of_the_model_with_what_is_stored(tmp_path: Path, where: str) -> None:
    built_in, of = ("planar_dual_arm", TWO_WHEELS) if where == "plane" else ("free_flyer_arm", PYRAMID)
    model = load_robot(robot_in(tmp_path, built_in, of))
    wheels = Wheels.of(model.spec)
    random = np.random.default_rng(1)
    Q = model.space.path(model.neutral, random.standard_normal((1, model.n)))
    v = random.standard_normal(model.n)
    h = random.standard_normal(wheels.count)
    added = wheels.balance(Q[-1:], h[None])[0]
    stored = model.nominal.storing(wheels.axes @ h)
    np.testing.assert_allclose(model.momentum(Q[-1], v, stored) - model.momentum(Q[-1], v), added[:-1], atol=1e-13)
    assert added[-1] == pytest.approx((h**2 / wheels.inertia).sum() / 2)
    np.testing.assert_allclose(wheels.momenta(wheels.spins(h, v), v), h, atol=1e-14)


def test_the_gyroscopic_moment_is_part_of_the_bias(model: RobotModel) -> None:
    random = np.random.default_rng(5)
    Q = model.space.path(model.neutral, random.standard_normal((1, model.n)))[-1]
    v = random.standard_normal(model.n)
    h = np.array([0.3, -0.2, 0.5])
    moment = model.bias(Q, v, model.nominal.storing(h)) - model.bias(Q, v)
    np.testing.assert_allclose(moment[model.space.rotation], np.cross(v[model.space.rotation], h), atol=1e-13)
    np.testing.assert_allclose(np.delete(moment, np.arange(3, 6)), 0, atol=1e-13)
