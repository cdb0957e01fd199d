"""Laws that hold for any robot in any state."""

import casadi as ca
import numpy as np
from hypothesis import given

from .differences import Array, assert_close_to_differences, jacobian_by_differences
from .strategies import State, flat, laws, moving_robots


def rate(function: ca.Function, Q: Array, Qdot: Array, Qddot: Array) -> Array:
    """Time derivative of a function of Q and Qdot, by algorithmic differentiation."""
    q, v = ca.SX.sym("q", Q.size), ca.SX.sym("v", Q.size)
    value = function(q, v)
    return flat(ca.Function("rate", [q, v], [ca.jtimes(value, q, v) + ca.jtimes(value, v, ca.DM(Qddot))])(Q, Qdot))


@given(moving_robots())
@laws
def test_inertia_is_symmetric_and_positive_definite(state: State) -> None:
    model, Q, _, _ = state
    H = model.H(Q).full()
    np.testing.assert_array_equal(H, H.T)
    assert np.linalg.eigvalsh(H).min() > 0


@given(moving_robots())
@laws
def test_kinetic_energy_is_the_quadratic_form_of_the_inertia(state: State) -> None:
    model, Q, Qdot, _ = state
    np.testing.assert_allclose(flat(model.kinetic_energy(Q, Qdot)), Qdot @ model.H(Q).full() @ Qdot / 2, rtol=1e-12)


@given(moving_robots())
@laws
def test_joint_torques_leave_the_momentum_alone(state: State) -> None:
    model, Q, Qdot, F = state
    F[model.parts["base"]] = 0.0
    Qddot = flat(model.forward_dynamics(Q, Qdot, F))
    np.testing.assert_allclose(rate(model.momentum, Q, Qdot, Qddot), 0.0, atol=1e-9)


@given(moving_robots())
@laws
def test_momentum_changes_by_the_wrench_on_the_base(state: State) -> None:
    model, Q, Qdot, F = state
    Qddot = flat(model.forward_dynamics(Q, Qdot, F))
    moment = F[2] + Q[0] * F[1] - Q[1] * F[0]
    np.testing.assert_allclose(rate(model.momentum, Q, Qdot, Qddot), [F[0], F[1], moment], atol=1e-9)


@given(moving_robots())
@laws
def test_kinetic_energy_changes_by_the_work_of_the_forces(state: State) -> None:
    model, Q, Qdot, F = state
    Qddot = flat(model.forward_dynamics(Q, Qdot, F))
    np.testing.assert_allclose(rate(model.kinetic_energy, Q, Qdot, Qddot), F @ Qdot, atol=1e-9)


@given(moving_robots())
@laws
def test_forward_and_inverse_dynamics_are_inverses(state: State) -> None:
    model, Q, Qdot, Qddot = state
    F = model.inverse_dynamics(Q, Qdot, Qddot)
    np.testing.assert_allclose(flat(model.forward_dynamics(Q, Qdot, F)), Qddot, atol=1e-9)


@given(moving_robots())
@laws
def test_low_level_law_makes_the_robot_a_double_integrator(state: State) -> None:
    model, Q, Qdot, u = state
    F = flat(model.low_level(Q, Qdot, u))
    np.testing.assert_allclose(F, model.H(Q).full() @ u + flat(model.C_Qdot(Q, Qdot)), atol=1e-9)
    Qddot = flat(model.forward_dynamics(Q, Qdot, F))
    np.testing.assert_allclose(np.concatenate([Qdot, Qddot]), flat(model.f_1(np.concatenate([Q, Qdot]), u)), atol=1e-9)


@given(moving_robots())
@laws
def test_coriolis_term_is_what_its_definition_says(state: State) -> None:
    model, Q, Qdot, _ = state

    def impulse(q: Array) -> Array:
        return np.asarray(model.H(q).full() @ Qdot)

    def quadratic_form(q: Array) -> Array:
        return np.atleast_1d(Qdot @ impulse(q))

    Hdot_Qdot = jacobian_by_differences(impulse, Q) @ Qdot
    by_definition = Hdot_Qdot - jacobian_by_differences(quadratic_form, Q).ravel() / 2
    assert_close_to_differences(flat(model.C_Qdot(Q, Qdot)), by_definition)
