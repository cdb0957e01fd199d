"""Plants under the law in task space, F = J' F_m: twists of base and end-effectors are what it commands."""

import numpy as np
import pytest

from psmpc_cli.plant.base import Disturbance, JointFriction, Plant, Setpoints
from psmpc_cli.plant.ideal import IdealPlant
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel

from ..robot.robots_in_task_space import planar_robot, spatial_robot

TICK = 1e-3
M = 100
PLANTS = IdealPlant, Rk4Plant, MujocoPlant


@pytest.fixture(scope="module", params=["plane", "plane, redundant", "space", "space, redundant"])
def robot(request: pytest.FixtureRequest) -> RobotModel:
    build = planar_robot if request.param.startswith("plane") else spatial_robot
    joints = (4 if build is planar_robot else 7) - (not request.param.endswith("redundant"))
    return build(joints, 0)


@pytest.fixture
def x(robot: RobotModel) -> np.ndarray:
    """Bent arms in motion."""
    random = np.random.default_rng(5)
    Q = robot.neutral.copy()
    Q[robot.space.joint_coordinates] = random.uniform(0.4, 1.0, robot.nq - robot.space.n_pose)
    return np.r_[Q, 0.1 * random.standard_normal(robot.n)]


@pytest.mark.parametrize("build", PLANTS)
def test_twists_follow_what_the_law_in_task_space_commands(robot: RobotModel, x: np.ndarray, build: type) -> None:
    """The force is held over a tick, so the error shrinks with the tick."""
    Q, v = np.split(x, [robot.nq])
    start = robot.twists(Q, v)
    rates = np.linspace(-0.3, 0.3, len(start))
    errors = []
    for tick in (4 * TICK, TICK):
        count = round(0.1 / tick)
        plant: Plant = build(robot, tick)
        ticks = plant.advance(
            0.0, x, Setpoints(np.full((count, robot.n), np.nan), twist_rates=np.tile(rates, (count, 1)))
        )
        end = robot.twists(*np.split(ticks.states[-1], [robot.nq]))
        errors.append(np.abs(end - start - 0.1 * rates).max())
        expected = robot.task_space_force(Q, v, rates)
        np.testing.assert_allclose(ticks.F[0], expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.2)


@pytest.mark.parametrize("build", PLANTS)
def test_both_laws_lead_to_the_same_motion(robot: RobotModel, x: np.ndarray, build: type) -> None:
    """The accelerations at the first tick are those of the rates, redundant arms damped alike; held for a tick."""
    Q, v = np.split(x, [robot.nq])
    rates = np.linspace(-0.3, 0.3, len(robot.twists(Q, v)))
    u = robot.task_space_acceleration(Q, v, rates)
    plant: Plant = build(robot, TICK)
    one = plant.advance(0.0, x, Setpoints(u[None], twist_rates=rates[None]))
    other = plant.advance(0.0, x, Setpoints(u[None]))
    np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.F, other.F, rtol=0, atol=1e-9 * np.abs(other.F).max())


def test_rates_of_twists_are_those_of_planned_accelerations(robot: RobotModel, x: np.ndarray) -> None:
    Q, v = np.split(x, [robot.nq])
    u = np.random.default_rng(0).uniform(-0.3, 0.3, (M, robot.n))
    planned = IdealPlant(robot, TICK).advance(0.0, x, Setpoints(u))
    rates = robot.twist_rates(Q, v, u, TICK)
    twists = robot.twists(*np.split(planned.states, [robot.nq], axis=1))
    np.testing.assert_allclose(twists[0] + TICK * np.cumsum(rates, axis=0), twists[1:], rtol=0, atol=1e-12)
    if len(rates[0]) == robot.n:
        led_to = IdealPlant(robot, TICK).advance(0.0, x, Setpoints(u, twist_rates=rates))
        assert np.abs(planned.states - x).max() > 1e-2
        np.testing.assert_allclose(
            led_to.states, planned.states, rtol=0, atol=1e-4
        )  # J_C is that of where each tick begins


def test_a_disturbed_plant_takes_the_law_of_what_it_knows() -> None:
    robot = planar_robot(3, 0)
    x = np.r_[np.zeros(3), np.linspace(0.4, 1.0, 6), np.full(9, 0.05)]
    known = robot.nominal
    heavier = known.holding(np.full(2, 5.0), np.full(2, 0.1))
    nothing = np.zeros((M, 9))
    disturbance = Disturbance(robot=heavier, law=known, noise=np.zeros((M, 18)), external_force=nothing)
    rates = np.full((M, 9), 0.1)
    one, other = (
        plant(robot, TICK, friction=JointFriction.none(9)).advance(
            0.0, x, Setpoints(nothing, twist_rates=rates), disturbance
        )
        for plant in (Rk4Plant, MujocoPlant)
    )
    np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-8)
    Q, v = np.split(x, 2)
    np.testing.assert_allclose(one.F[0], robot.task_space_force(Q, v, rates[0]), rtol=1e-9)
    assert (
        np.abs(
            one.states[-1] - Rk4Plant(robot, TICK).advance(0.0, x, Setpoints(nothing, twist_rates=rates)).states[-1]
        ).max()
        > 1e-5
    )
