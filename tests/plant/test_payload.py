import numpy as np
import pytest

from psmpc_cli.plant.payload import let_go, take_up
from psmpc_cli.robot.inertial import Inertials, WeighedRobot, described, weigh
from psmpc_cli.robot.model import RobotModel

MASS, INERTIA = np.array([3.0, 2.0]), np.array([0.4, 0.3])


@pytest.fixture
def x() -> np.ndarray:
    random = np.random.default_rng(5)
    return np.r_[-1.0, 2.0, 0.5, 0.6 * random.standard_normal(6), 0.2 * random.standard_normal(9)]


@pytest.fixture(scope="module")
def robot(model: RobotModel) -> WeighedRobot:
    return weigh(model.spec)


@pytest.fixture(scope="module")
def free(model: RobotModel) -> Inertials:
    return described(model.spec)


def kept(robot: WeighedRobot, x: np.ndarray, weighed: Inertials) -> tuple[np.ndarray, float]:
    momentum, energy = robot.kept(x, weighed.vector)
    return np.asarray(momentum).ravel(), float(energy)


def test_momentum_goes_through_a_take_up_unchanged(robot: WeighedRobot, free: Inertials, x: np.ndarray) -> None:
    holding = free.holding(MASS, INERTIA)
    contact = take_up(robot, x, free, holding)
    before, after = kept(robot, x, free)[0], kept(robot, contact.x, holding)[0]
    np.testing.assert_allclose(after, before, atol=1e-12)
    np.testing.assert_array_equal(contact.impulse, 0)
    np.testing.assert_array_equal(contact.x[:9], x[:9])
    assert np.abs(contact.x[9:] - x[9:]).max() > 0.01


def test_the_loss_of_a_take_up_is_the_energy_that_is_gone(robot: WeighedRobot, free: Inertials, x: np.ndarray) -> None:
    holding = free.holding(MASS, INERTIA)
    contact = take_up(robot, x, free, holding)
    gone = kept(robot, contact.x, holding)[1] - kept(robot, x, free)[1]
    assert contact.work == pytest.approx(gone, rel=1e-12)
    assert contact.work < 0


def test_the_loss_is_that_of_a_plastic_impact(model: RobotModel, free: Inertials, robot: WeighedRobot) -> None:
    """A robot that drifts with its joints free is stopped in part: 1/2 v' (1 / (J H^-1 J') + 1/M)^-1 v at one gripper.

    The formula is of two bodies that go on together, with the grippers' inverse inertias J H^-1 J' and the object's M.
    """
    rng = np.random.default_rng(1)
    x = np.r_[rng.standard_normal(9), 0.3 * rng.standard_normal(9)]
    held = free.holding(np.array([4.0, 0.0]), np.array([0.5, 0.0]))
    J = np.asarray(model.J_C(x[:9]))[model.poses["arm_1"]]
    v, mobility = J @ x[9:], J @ np.linalg.solve(np.asarray(model.H(x[:9])), J.T)
    together = np.linalg.inv(mobility + np.diag(1 / np.array([4.0, 4.0, 0.5])))
    assert take_up(robot, x, free, held).work == pytest.approx(-float(v @ together @ v) / 2, rel=1e-10)


def test_letting_go_keeps_velocities_and_gives_away_the_object_s_share(
    robot: WeighedRobot, free: Inertials, x: np.ndarray
) -> None:
    holding = free.holding(MASS, INERTIA)
    contact = let_go(robot, x, free, holding)
    np.testing.assert_array_equal(contact.x, x)
    (p, T), (p_left, T_left) = kept(robot, x, holding), kept(robot, x, free)
    np.testing.assert_allclose(p + contact.impulse, p_left, atol=1e-12)
    assert T + contact.work == pytest.approx(T_left, rel=1e-12)


def test_a_robot_at_rest_takes_up_an_object_at_rest_without_loss(
    robot: WeighedRobot, free: Inertials, x: np.ndarray
) -> None:
    resting = np.r_[x[:9], np.zeros(9)]
    contact = take_up(robot, resting, free, free.holding(MASS, INERTIA))
    np.testing.assert_array_equal(contact.x, resting)
    assert contact.work == 0
