"""The low-level law of controllers and plants: in joint space, in task space, and with a load that it knows."""

import numpy as np
import pytest

from psmpc_cli.robot.free_body import body_of
from psmpc_cli.robot.held_load import HeldLoad
from psmpc_cli.robot.low_level import LowLevelLaw, low_level_law
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_robot, load_task
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
    of_chain = load.force(*motion, model.nominal, load.grasps, body_of(GRASPED).vector)
    np.testing.assert_array_equal(law.force(*motion, grasps=law.grasps), of_chain)
    np.testing.assert_array_equal(law.force(*motion), model.computed_torque(*motion))
    Q, v, u = motion
    planned = np.tile(u, (3, 1))
    closed = np.array([False, True, True])
    np.testing.assert_array_equal(law.attainable_accelerations(Q, v, planned, np.zeros(3, bool), 1e-3), planned)
    followed = law.attainable_accelerations(Q, v, planned, closed, 1e-3)
    np.testing.assert_array_equal(followed[0], u)
    assert np.abs(followed[1] - u).max() > 1e-3


@pytest.mark.parametrize("body", [NO_BODY, load_task("transport_grasp", {"object.grasp.known": False}).spec.body])
def test_a_load_that_is_not_known_does_not_count(
    model: RobotModel, motion: tuple[np.ndarray, ...], body: ObjectBody
) -> None:
    law = low_level_law(model, body_of(body), body.grasp)
    assert law.grasps is None
    np.testing.assert_array_equal(law.force(*motion, grasps=np.zeros((2, 5))), model.computed_torque(*motion))


@pytest.mark.parametrize("robot", ["planar_dual_arm", "dual_arm_servicer"])
def test_joints_accelerate_as_commanded_whatever_pushes_the_base(robot: str) -> None:
    """The rows of the base stay what the law asks for; in task space the joints have the accelerations of that law."""
    model = RobotModel(load_robot(robot))
    law = LowLevelLaw(model)
    rng = np.random.default_rng(6)
    base, joints = model.space.base, model.space.joint_rates
    Q = np.array(model.space.integrate(model.neutral, 0.5 * rng.standard_normal(model.n)))
    v, u = 0.2 * rng.standard_normal((2, model.n))
    rates = rng.standard_normal(model.n_twists)
    pushed = 20 * rng.standard_normal((2, base.stop))
    for in_task_space, wanted in ((None, u), (rates, model.task_space_acceleration(Q, v, rates))):
        asked = law.force(Q, v, u, in_task_space)
        F = law.force(Q, v, u, in_task_space, base_force=pushed)
        np.testing.assert_allclose(F[base], asked[base], rtol=1e-12)
        vdot = model.forward_dynamics(Q, v, np.r_[pushed[0], F[joints]])
        np.testing.assert_allclose(vdot[joints], wanted[joints], rtol=0, atol=1e-9 * np.abs(wanted).max())
        assert np.abs(vdot[base] - wanted[base]).max() > 0.05
        same = law.force(Q, v, u, in_task_space, base_force=np.tile(asked[base], (2, 1)))
        np.testing.assert_allclose(same, asked, rtol=0, atol=1e-9 * np.abs(asked).max())


@pytest.mark.parametrize("task", ["transport_grasp", "servicing"])
def test_robot_and_load_react_to_the_mean_of_pulses_and_the_robot_to_the_rest(task: str) -> None:
    """Under the mean the closed chain has the joint accelerations that it has under the force which is asked for."""
    loaded = load_task(task, {"object.grasp.known": True})
    model = RobotModel(loaded.robot)
    law = low_level_law(model, body_of(loaded.spec.body), loaded.spec.body.grasp)
    rng = np.random.default_rng(7)
    base, joints = model.space.base, model.space.joint_rates
    Q = np.array(model.space.integrate(model.neutral, 0.5 * rng.standard_normal(model.n)))
    v, u = 0.2 * rng.standard_normal((2, model.n))
    mean, now = 20 * rng.standard_normal((2, base.stop))

    def force(u: np.ndarray, base_force: np.ndarray | None = None) -> np.ndarray:
        return law.force(Q, v, u, grasps=law.grasps, base_force=base_force)

    # F is linear in u: the acceleration of the base under which its rows are the mean, the joints' as commanded
    H_bb = np.column_stack([(force(u + step) - force(u))[base] for step in np.eye(model.n)[base]])
    reaction = np.r_[np.linalg.solve(H_bb, mean - force(u)[base]), np.zeros(model.space.joints)]
    F = force(u, np.array([mean, mean]))
    np.testing.assert_allclose(F[joints], force(u + reaction)[joints], rtol=0, atol=1e-8 * np.abs(F).max())
    np.testing.assert_allclose(F[base], force(u)[base], rtol=1e-12)
    H = model.mass_matrix(Q)
    rest = H[joints, base] @ np.linalg.solve(H[base, base], now - mean)
    pulsed = force(u, np.array([now, mean]))
    np.testing.assert_allclose(pulsed[joints], F[joints] + rest, rtol=0, atol=1e-8 * np.abs(F).max())
    assert np.abs(rest).max() > 1.0
