"""The disturbed plants: each by the laws of physics, and by each other."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.plant import Disturbance, ForceLimits, JointFriction, Plant, Setpoints, Ticks
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.model import RobotModel

TICK, M = 1e-3, 60
FREE = JointFriction.none(9)
ROUGH = JointFriction(np.r_[np.zeros(3), np.full(6, 0.2)], np.r_[np.zeros(3), np.full(6, 0.05)], 0.02)
PLANTS = (Rk4Plant, MujocoPlant)


def build(plant: type, model: RobotModel, friction: JointFriction, substeps: int = 1) -> Plant:
    built: Plant = plant(model, TICK, substeps, friction=friction)
    return built


@pytest.fixture
def u() -> np.ndarray:
    return np.tile(np.linspace(-0.3, 0.3, 9), (M, 1))


@pytest.fixture
def nothing(model: RobotModel) -> Disturbance:
    return Disturbance(model.nominal, model.nominal, np.zeros((M, 18)), np.zeros((M, 9)))


@pytest.fixture
def everything(model: RobotModel, nothing: Disturbance) -> Disturbance:
    """Other bodies, a payload, noise, and a push."""
    random, known = np.random.default_rng(9), nothing.robot
    robot = InertialParameters(
        known.mass * random.uniform(0.8, 1.2, 7),
        known.inertia * random.uniform(0.8, 1.2, (7, 1)),
        random.uniform(-0.02, 0.02, (7, 2)),
        np.array([2.5, 2.0]),
        np.array([0.3, 0.2]),
    )
    external_force = np.zeros((M, 9))
    external_force[20, :3] = [500.0, -300.0, 40.0]
    return replace(nothing, robot=robot, noise=1e-3 * random.standard_normal((M, 18)), external_force=external_force)


def imbalance(model: RobotModel, robot: InertialParameters, ticks: Ticks) -> np.ndarray:
    """Momentum and energy gained over a sample, less impulse and work (4,)."""
    before, after = (
        np.r_[model.momentum(*np.split(x, 2), robot), model.kinetic_energy(*np.split(x, 2), robot)]
        for x in ticks.states[[0, -1]]
    )
    return after - before - ticks.impulse_and_work


@pytest.mark.parametrize("plant", PLANTS)
def test_without_a_disturbance_it_is_the_robot_the_controller_knows(
    model: RobotModel, x: np.ndarray, u: np.ndarray, nothing: Disturbance, plant: type
) -> None:
    ticks, known = (
        build(plant, model, FREE).advance(2.0, x, Setpoints(u), nothing),
        Rk4Plant(model, TICK).advance(2.0, x, Setpoints(u)),
    )
    np.testing.assert_allclose(ticks.states, known.states, atol=1e-12)
    np.testing.assert_allclose(ticks.F, known.F, atol=1e-9)
    np.testing.assert_array_equal(ticks.time, known.time)


def test_compiled_is_interpreted_to_the_bit(
    model: RobotModel, x: np.ndarray, u: np.ndarray, everything: Disturbance
) -> None:
    one, other = (
        Rk4Plant(model, TICK, 1, native, ROUGH).advance(0.0, x, Setpoints(u), everything) for native in (False, True)
    )
    np.testing.assert_array_equal(one.states, other.states)
    np.testing.assert_array_equal(one.F, other.F)


def test_the_engines_agree_on_other_bodies_with_a_payload(
    model: RobotModel, x: np.ndarray, u: np.ndarray, everything: Disturbance
) -> None:
    one, other = (build(plant, model, FREE).advance(0.0, x, Setpoints(u), everything) for plant in PLANTS)
    np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-11)
    assert np.abs(one.states - Rk4Plant(model, TICK).advance(0.0, x, Setpoints(u)).states).max() > 1e-3


def test_the_engines_differ_under_friction_by_the_step_it_is_held_for(
    model: RobotModel, x: np.ndarray, u: np.ndarray, everything: Disturbance
) -> None:
    apart = []
    for substeps in (1, 4):
        one, other = (
            build(plant, model, ROUGH, substeps).advance(0.0, x, Setpoints(u), everything) for plant in PLANTS
        )
        apart.append(np.abs(one.states - other.states).max())
    assert apart[1] < 0.5 * apart[0]
    assert apart[0] < 2e-3


@pytest.mark.parametrize("friction", [FREE, ROUGH], ids=["free", "rough"])
@pytest.mark.parametrize("plant", PLANTS)
def test_momentum_changes_by_the_impulse_and_energy_by_the_work(
    model: RobotModel, x: np.ndarray, u: np.ndarray, everything: Disturbance, plant: type, friction: JointFriction
) -> None:
    ticks = build(plant, model, friction, 2).advance(0.0, x, Setpoints(u), everything)
    np.testing.assert_allclose(imbalance(model, everything.robot, ticks), 0, atol=1e-8)


@pytest.mark.parametrize("plant", PLANTS)
def test_friction_takes_energy_and_no_momentum(
    model: RobotModel, x: np.ndarray, nothing: Disturbance, plant: type
) -> None:
    """No force acts: the limits leave nothing of it."""
    still = ForceLimits(np.full(9, -1e-12), np.full(9, 1e-12))
    without_force = plant(model, TICK, 1, friction=ROUGH, force_limits=still)
    ticks = without_force.advance(0.0, x, Setpoints(np.zeros((M, 9))), nothing)
    assert ticks.impulse_and_work[-1] < -1e-4
    np.testing.assert_allclose(ticks.impulse_and_work[:-1], 0, atol=1e-10)
    np.testing.assert_allclose(imbalance(model, nothing.robot, ticks), 0, atol=1e-9)


@pytest.mark.parametrize("plant", PLANTS)
def test_the_law_reads_the_noise_and_the_bodies_do_not(
    model: RobotModel, x: np.ndarray, u: np.ndarray, nothing: Disturbance, plant: type
) -> None:
    noisy = replace(nothing, noise=1e-2 * np.random.default_rng(0).standard_normal((M, 18)))
    ticks, quiet = (build(plant, model, FREE).advance(0.0, x, Setpoints(u), given) for given in (noisy, nothing))
    seen = x + noisy.noise[0]
    np.testing.assert_allclose(ticks.F[0], model.inverse_dynamics(seen[:9], seen[9:], u[0]), atol=1e-12)
    np.testing.assert_array_equal(ticks.states[0], quiet.states[0])
    assert np.abs(ticks.states - quiet.states).max() > 1e-7
