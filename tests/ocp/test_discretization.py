import numpy as np
import pytest
from psmpc_cli.ocp.discretization import step_function

from psmpc_cli.ocp.problem import StageCosts
from psmpc_cli.robot.model import RobotModel


def advance(step, x: np.ndarray, u: np.ndarray, duration: float, steps: int) -> np.ndarray:
    for _ in range(steps):
        x = np.asarray(step(x, u, duration / steps)).ravel()
    return x


@pytest.fixture
def x_u(model: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    x = np.r_[0, 0, 0, 0.5, 0.6, 0.4, -0.5, -0.6, -0.4, 0.1 * random.standard_normal(9)]
    return x, 0.3 * random.standard_normal(9)


def test_exact_step_does_not_depend_on_how_it_is_divided(model: RobotModel, x_u) -> None:
    step = step_function(model, "joint", "exact")
    np.testing.assert_allclose(advance(step, *x_u, 0.4, 1), advance(step, *x_u, 0.4, 7), atol=1e-13)


def test_euler_step_converges_to_the_exact_one_with_first_order(model: RobotModel, x_u) -> None:
    exact = advance(step_function(model, "joint", "exact"), *x_u, 0.4, 1)
    euler = step_function(model, "joint", "euler")
    errors = [np.abs(advance(euler, *x_u, 0.4, steps) - exact).max() for steps in (10, 20)]
    assert errors[0] / errors[1] == pytest.approx(2, rel=1e-6)


def test_task_input_is_the_acceleration_of_the_poses(model: RobotModel, costs: StageCosts, x_u) -> None:
    x, u = x_u
    h = 1e-4
    after = advance(step_function(model, "task", "exact"), x, u, h, 1)
    Qddot = (after[9:] - x[9:]) / h
    np.testing.assert_allclose(costs.task_acceleration(x[None], Qddot[None])[0], u, atol=2e-2)
