"""Laws that hold for any robot in any state, and for any inertial parameters."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given

from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.model import RobotModel

from .strategies import Array, State, assert_close_to_differences, jacobian_by_differences, laws, moving_robots


def rate(model: RobotModel, function: ca.Function, Q: Array, v: Array, vdot: Array) -> Array:
    """Time derivative of a function of Q, Qdot and the inertial parameters, by algorithmic differentiation."""
    q, qdot = ca.SX.sym("q", Q.size), ca.SX.sym("v", Q.size)
    value = function(q, qdot, model.nominal.vector)
    slope = ca.jtimes(value, q, qdot) + ca.jtimes(value, qdot, ca.DM(vdot))
    return np.asarray(ca.Function("rate", [q, qdot], [slope])(Q, v).full()).ravel()


@given(moving_robots())
@laws
def test_mass_matrix_is_symmetric_positive_definite_and_gives_the_kinetic_energy(state: State) -> None:
    model, Q, v, _ = state
    H = model.mass_matrix(Q)
    np.testing.assert_array_equal(H, H.T)
    assert np.linalg.eigvalsh(H).min() > 0
    assert model.kinetic_energy(Q, v) == pytest.approx(v @ H @ v / 2, rel=1e-12)


@given(moving_robots())
@laws
def test_momentum_changes_by_the_wrench_on_the_base_alone(state: State) -> None:
    model, Q, v, F = state
    vdot = model.forward_dynamics(Q, v, F)
    moment = F[2] + Q[0] * F[1] - Q[1] * F[0]
    np.testing.assert_allclose(rate(model, model.dynamics.momentum, Q, v, vdot), [F[0], F[1], moment], atol=1e-9)


@given(moving_robots())
@laws
def test_kinetic_energy_changes_by_the_work_of_the_forces(state: State) -> None:
    model, Q, v, F = state
    vdot = model.forward_dynamics(Q, v, F)
    np.testing.assert_allclose(rate(model, model.dynamics.kinetic_energy, Q, v, vdot), F @ v, atol=1e-9)


@given(moving_robots())
@laws
def test_forward_and_inverse_dynamics_are_inverses_of_the_equation_of_motion(state: State) -> None:
    model, Q, v, vdot = state
    F = model.inverse_dynamics(Q, v, vdot)
    np.testing.assert_allclose(F, model.mass_matrix(Q) @ vdot + model.bias(Q, v), atol=1e-9)
    np.testing.assert_allclose(model.forward_dynamics(Q, v, F), vdot, atol=1e-9)


@given(moving_robots())
@laws
def test_bias_is_what_its_definition_says(state: State) -> None:
    model, Q, v, _ = state

    def impulse(q: Array) -> Array:
        return model.mass_matrix(q) @ v

    Hdot_v = jacobian_by_differences(impulse, Q) @ v
    gradient = jacobian_by_differences(lambda q: np.atleast_1d(v @ impulse(q)), Q).ravel() / 2
    assert_close_to_differences(model.bias(Q, v), Hdot_v - gradient)


@pytest.fixture
def state() -> tuple[Array, Array]:
    random = np.random.default_rng(3)
    return np.r_[0.3, -0.2, 0.5, 0.4 * random.standard_normal(6)], 0.1 * random.standard_normal(9)


def kept(model: RobotModel, state: tuple[Array, Array], parameters: InertialParameters | None) -> Array:
    """Momentum and energy (4,)."""
    return np.r_[model.momentum(*state, parameters), model.kinetic_energy(*state, parameters)]


def test_bodies_are_named_from_the_base_outward(model: RobotModel) -> None:
    names = [body.name for body in model.spec.bodies]
    assert [names.index(name) for name in ("base", "arm_1.3", "arm_2.3")] == [0, 3, 6]
    assert len(names) == len(model.nominal.mass) == 7


def test_a_load_adds_a_point_mass_and_a_spin_at_the_gripper(model: RobotModel, state: tuple[Array, Array]) -> None:
    """Momentum and energy are those of the robot and of a body that moves with the gripper."""
    Q, v = state
    rows = model.pose_rows["arm_1"]
    place, velocity = model.poses(Q)[1], (model.J_C(Q).full() @ v)[rows]
    p = 2.0 * velocity[:2]
    spin = 0.3 * velocity[2] + place[0] * p[1] - place[1] * p[0]
    energy = (p @ velocity[:2] + 0.3 * velocity[2] ** 2) / 2
    holding = model.nominal.holding(np.array([2.0, 0.0]), np.array([0.3, 0.0]))
    np.testing.assert_allclose(kept(model, state, holding) - kept(model, state, None), [*p, spin, energy], atol=1e-12)


def test_an_offset_along_the_link_is_another_centre_of_mass(model: RobotModel, state: tuple[Array, Array]) -> None:
    """A link whose centre of mass is where another description has it, is that other robot."""
    d, arm = 0.03, model.spec.arms["arm_1"]
    first = arm.links[0].model_copy(update={"a": arm.links[0].a + d, "b": arm.links[0].b - d})
    moved = arm.model_copy(update={"links": (first, *arm.links[1:])})
    other = RobotModel(model.spec.model_copy(update={"arms": {**model.spec.arms, "arm_1": moved}}))
    offset = np.zeros((7, 2))
    offset[1, 0] = d
    np.testing.assert_allclose(
        kept(model, state, replace(model.nominal, offset=offset)), kept(other, state, None), atol=1e-13
    )
