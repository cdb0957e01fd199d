"""Reaction wheels by themselves: shares, limits, and the momentum and energy that they add to those of bodies."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.robot.model import RobotModel, load_robot

from ...wheeled import PYRAMID, TWO_WHEELS, robot_in

TURNED = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)


@pytest.fixture
def model(tmp_path: Path) -> RobotModel:
    return load_robot(robot_in(tmp_path, "free_flyer_arm", PYRAMID))


def test_motors_give_a_moment_with_the_least_torques(model: RobotModel) -> None:
    wheels = Wheels.of(model.spec)
    F = np.r_[0.1, -0.2, 0.3, 0.004, -0.003, 0.002, 0.0, 0.0, 0.0]
    acts, torques = wheels.with_turning(F, wheels.initial, TURNED, 1e-3, np.zeros(4))
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
    _, torques = wheels.with_turning(F, h, TURNED, 1e-3, np.zeros(4))
    wanted = wheels.allocation @ wheels.axes @ np.full(4, 0.01)
    np.testing.assert_allclose(torques, [1e-3, 0, wanted[2], wanted[3]], atol=1e-12)
    _, back = wheels.with_turning(-F, h, TURNED, 1e-3, np.zeros(4))
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
    added = wheels.momentum_and_energy(Q[-1:], h[None])[0]
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


def test_how_often_a_moment_is_in_what_wheels_give_and_store(model: RobotModel) -> None:
    wheels = Wheels.of(model.spec)
    direction = np.array([0.2, -0.1, 0.3])
    torque, momentum = wheels.along(direction)
    shares = np.abs(wheels.allocation @ direction)
    assert (torque * shares / wheels.torque).max() == pytest.approx(1)
    assert (momentum * shares / wheels.momentum).max() == pytest.approx(1)
    without = Wheels.of(model.spec.model_copy(update={"wheels": model.spec.wheels[:2]}))
    assert without.along(np.array([0.0, 1.0, 0.0])) == (0.0, 0.0)


def test_the_inertia_about_the_centre_is_that_of_momentum(model: RobotModel) -> None:
    """Of a robot that turns about its centre of mass with its joints held."""
    random = np.random.default_rng(3)
    Q = model.space.path(model.neutral, random.standard_normal((1, model.n)))[-1]
    omega = random.standard_normal(3)
    R = model.body_frames(Q)[0, :3, :3]
    v = np.r_[np.cross(R @ omega, Q[:3] - model.centre_of_mass(Q)), omega, np.zeros(3)]
    linear, angular = np.split(model.momentum(Q, v), 2)
    np.testing.assert_allclose(linear, 0, atol=1e-12)
    np.testing.assert_allclose(angular, R @ model.inertia_about_centre(Q) @ omega, atol=1e-12)
