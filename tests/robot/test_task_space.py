"""The robot seen from its poses: eqs. (5), (6) and the field f_2."""

import numpy as np
import pytest
from hypothesis import assume, given

from psmpc_cli.errors import InputError
from psmpc_cli.robot.model import RobotModel, build_model, task_coriolis, task_inertia
from psmpc_cli.specs.robot import Arm, RobotSpec

from .differences import Array
from .strategies import State, flat, laws, moving_robots


def pose_acceleration(model: RobotModel, Q: Array, Qdot: Array, Qddot: Array) -> Array:
    return np.asarray(model.J_C(Q).full() @ Qddot + flat(model.Jdot_Qdot(Q, Qdot)))


@given(moving_robots(3, 3))
@laws
def test_task_space_equation_of_motion_holds(state: State) -> None:
    model, Q, Qdot, Qddot = state
    J_C = model.J_C(Q).full()
    assume(np.linalg.cond(J_C) < 1e4)
    F_m = np.linalg.solve(J_C.T, flat(model.inverse_dynamics(Q, Qdot, Qddot)))
    left = task_inertia(model, Q) @ pose_acceleration(model, Q, Qdot, Qddot) + task_coriolis(model, Q, Qdot)
    np.testing.assert_allclose(left, F_m, rtol=0, atol=1e-9 * (1 + np.abs(F_m).max()))


@given(moving_robots())
@laws
def test_f_2_applies_the_damped_inverse(state: State) -> None:
    model, Q, Qdot, Qddot = state
    u = pose_acceleration(model, Q, Qdot, Qddot)
    J_C, wanted = model.J_C(Q).full(), u - flat(model.Jdot_Qdot(Q, Qdot))
    damped = J_C.T @ np.linalg.solve(J_C @ J_C.T + 1e-4 * np.eye(model.m), wanted)
    xdot = flat(model.f_2(np.concatenate([Q, Qdot]), u))
    np.testing.assert_array_equal(xdot[: model.n], Qdot)
    np.testing.assert_allclose(xdot[model.n :], damped, rtol=0, atol=1e-8 * (1 + np.abs(damped).max()))


def test_f_2_reaches_the_acceleration_asked_for_as_damping_vanishes(planar_dual_arm: RobotSpec) -> None:
    Q, Qdot, u = np.array([0.1, -0.2, 0.3, 0.8, 0.5, 1.0, -0.8, -0.5, -1.0]), np.full(9, 0.1), np.linspace(-1, 1, 9)
    misses = []
    for damping in (1e-1, 1e-2, 1e-5):
        model = build_model(planar_dual_arm, damping)
        Qddot = flat(model.f_2(np.concatenate([Q, Qdot]), u))[9:]
        misses.append(np.abs(pose_acceleration(model, Q, Qdot, Qddot) - u).max())
    assert misses[0] > misses[1] > misses[2]
    assert misses[2] < 1e-7


def test_f_2_stays_bounded_where_the_jacobian_is_singular(model: RobotModel) -> None:
    for u in np.eye(9):
        Qddot = flat(model.f_2(np.zeros(18), u))[9:]
        assert np.linalg.norm(Qddot) <= 50.0


def test_singular_jacobian_is_refused_by_arm(model: RobotModel) -> None:
    Q = np.array([0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.0, 0.5])
    with pytest.raises(InputError, match=r"'planar_dual_arm' is singular at Q = .* because of arm_2: its condition"):
        task_inertia(model, Q)
    with pytest.raises(InputError, match="singular"):
        task_coriolis(model, Q, np.zeros(9))


def test_jacobian_that_is_not_square_is_refused_by_arm(planar_dual_arm: RobotSpec) -> None:
    arm = planar_dual_arm.arms["arm_1"]
    shorter = Arm(mount=arm.mount, links=arm.links[:2])
    model = build_model(planar_dual_arm.model_copy(update={"arms": {"left": arm, "right": shorter}}))
    with pytest.raises(InputError, match=r"is 9 x 8.*expected 3 joints an arm; right has 2"):
        task_inertia(model, np.zeros(8))
    with pytest.raises(InputError, match="square"):
        task_coriolis(model, np.zeros(8), np.zeros(8))
    with pytest.raises(InputError, match="square"):
        model.H_x(np.zeros(8))


def test_an_arm_with_too_few_joints_is_refused_though_another_has_more(planar_dual_arm: RobotSpec) -> None:
    arm = planar_dual_arm.arms["arm_1"]
    arms = {"short": Arm(mount=arm.mount, links=arm.links[:2]), "long": Arm(mount=arm.mount, links=arm.links[:1] * 4)}
    model = build_model(planar_dual_arm.model_copy(update={"arms": arms}))
    with pytest.raises(InputError, match="because of short: its condition"):
        task_inertia(model, np.full(9, 0.3))
