"""The equations of motion in task space, paper (5) and (6), against the same formulas in numpy."""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from psmpc_cli.errors import InputError
from psmpc_cli.robot.dynamics import LARGEST_CONDITION
from psmpc_cli.robot.model import RobotModel

from .robots_in_task_space import planar_robot, spatial_robot
from .strategies import Array, flat, laws

RELATIVE = 1e-9
"""What rounding leaves where cond J_C is up to 1e3: some 1e-16 of it, of its square in the formulas of this test."""


@dataclass(frozen=True)
class Case:
    """A robot in motion, and the wanted accelerations of its poses."""

    model: RobotModel
    Q: Array
    v: Array
    a: Array

    @property
    def J(self) -> Array:
        return np.asarray(self.model.J_C(self.Q).full())

    @property
    def drift(self) -> Array:
        """Jdot v by differences along the motion."""
        h = 1e-4
        space = self.model.space
        twists = [
            self.model.J_C(np.array(space.integrate(self.Q, h * k * self.v))).full() @ self.v for k in (-2, -1, 1, 2)
        ]
        far_back, back, ahead, far_ahead = twists
        return np.asarray((8 * (ahead - back) - (far_ahead - far_back)) / (12 * h))

    @property
    def exact_drift(self) -> Array:
        return flat(self.model.Jdot_v(self.Q, self.v))

    @property
    def law(self) -> Array:
        return flat(self.model.task_space.law(self.Q, self.v, self.a, self.model.nominal.vector))


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Robots in the plane and in space, with and without redundant arms, where J_C is not singular."""
    robot, joints = draw(
        st.sampled_from(((planar_robot, 3), (planar_robot, 4), (spatial_robot, 6), (spatial_robot, 7)))
    )
    model = robot(joints, 0)
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    Q = random.uniform(-3, 3, model.nq)
    attitude = Q[model.space.attitude]
    attitude /= np.linalg.norm(attitude)
    case = Case(model, Q, random.uniform(-1, 1, model.n), random.uniform(-1, 1, model.J_C.size1_out(0)))
    assume(np.linalg.cond(case.J) <= 1e3)
    return case


def assert_same(actual: Array, expected: Array, scale: float | None = None) -> None:
    atol = RELATIVE * (np.abs(expected).max() if scale is None else scale)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=atol)


def consistent_inverse(J: Array, H: Array) -> Array:
    """Jbar = H^-1 J' (J H^-1 J')^-1: the inverse of J of least kinetic energy, by coordinates in which H is 1."""
    root = np.linalg.cholesky(H).T
    return np.asarray(np.linalg.solve(root, np.linalg.pinv(np.linalg.solve(root.T, J.T).T)))


@pytest.mark.slow
@given(cases())
@laws
def test_inertia_and_bias_in_task_space_are_those_of_the_formulas(case: Case) -> None:
    model, J = case.model, case.J
    H = model.mass_matrix(case.Q)
    c = model.bias(case.Q, case.v)
    inverse = consistent_inverse(J, H)
    H_x = inverse.T @ H @ inverse  # (J H^-1 J')^-1
    C_x = inverse.T @ c - H_x @ case.exact_drift  # with Jbar' = H_x J H^-1
    w = model.nominal.vector
    found = model.task_space.C_x(case.Q, case.v, w)
    assert_same(model.task_space.H_x(case.Q, w).full(), H_x)
    assert_same(flat(found), C_x, scale=np.abs(inverse.T @ c).max() + np.abs(H_x @ case.exact_drift).max())
    if len(J) == model.n:  # paper (6)
        np.testing.assert_allclose(inverse @ J, np.eye(model.n), rtol=0, atol=RELATIVE)
    F_m = H_x @ case.a + C_x  # paper (5)
    null = np.eye(model.n) - J.T @ inverse.T
    assert_same(case.law, J.T @ F_m + null @ (c - H @ case.v))


@given(cases())
@laws
def test_the_rate_of_the_jacobian_is_its_derivative_along_the_motion(case: Case) -> None:
    np.testing.assert_allclose(case.exact_drift, case.drift, rtol=0, atol=1e-8 * (1 + np.abs(case.drift).max()))


@given(cases())
@laws
def test_the_law_in_task_space_is_the_one_in_joint_space_for_the_same_accelerations(case: Case) -> None:
    model, Q, v, a, J = case.model, case.Q, case.v, case.a, case.J
    inverse = consistent_inverse(J, model.mass_matrix(Q))
    null = np.eye(model.n) - inverse @ J
    vdot = inverse @ (a - case.exact_drift) - null @ v
    assert_same(flat(model.task_space.acceleration(Q, v, a, model.nominal.vector)), vdot)
    assert_same(case.law, model.computed_torque(Q, v, vdot))
    np.testing.assert_allclose(J @ vdot + case.exact_drift, a, rtol=0, atol=RELATIVE * (1 + np.abs(vdot).max()))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=5)
def test_both_laws_are_equal_up_to_the_largest_condition_number(model: RobotModel, seed: int) -> None:
    """Nearly outstretched: rounding grows with the condition number."""
    random = np.random.default_rng(seed)
    Q = random.uniform(-1, 1, 9)
    Q[4] = 0.025
    assume(850 < model.task_space_condition(Q) < LARGEST_CONDITION)
    case = Case(model, Q, random.uniform(-1, 1, 9), random.uniform(-1, 1, 9))
    vdot = np.linalg.solve(case.J, case.a - case.exact_drift)
    assert_same(case.law, model.computed_torque(Q, case.v, vdot))


@pytest.mark.parametrize(("robot", "joints"), [(planar_robot, 3), (planar_robot, 4), (spatial_robot, 6)])
@given(seed=st.integers(0, 10**6))
@settings(max_examples=3)
def test_f_2_makes_the_poses_a_double_integrator(robot: Callable[..., RobotModel], joints: int, seed: int) -> None:
    """Twists have the rates u, and the force that gives them is that of the law in joint space."""
    model = robot(joints, 0)
    random = np.random.default_rng(seed)
    x, u = random.uniform(-1, 1, 2 * model.n), random.uniform(-1, 1, model.n_twists)
    space = model.space
    chart = space.chart_at(space.normalized(random.uniform(-1, 1, model.nq)))
    Q, v = (rows[0] for rows in chart.from_chart(x[None]))
    J = model.J_C(Q).full()
    assume(np.linalg.cond(J) < 1e3)

    xdot = flat(model.f_2(x, u, chart.anchor))
    np.testing.assert_array_equal(xdot[: model.n], x[model.n :])
    in_chart = (ca.SX(each) for each in (x[: model.n], x[model.n :], xdot[model.n :]))
    vdot = flat(ca.DM(space.charted_acceleration(*in_chart)))
    scale = 1 + np.abs(vdot).max()
    np.testing.assert_allclose(J @ vdot + flat(model.Jdot_v(Q, v)), u, rtol=0, atol=1e-11 * scale)
    assert_same(model.task_space_force(Q, v, u), model.computed_torque(Q, v, vdot))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=3)
def test_f_2_in_space_equals_the_law_in_joint_space_up_to_the_largest_condition_number(seed: int) -> None:
    model = spatial_robot(6, 0)
    random = np.random.default_rng(seed)
    x, u = random.uniform(-1, 1, 2 * model.n), random.uniform(-1, 1, model.n_twists)
    chart = model.space.chart_at(model.neutral)

    turned = np.tile(x, (20_000, 1))
    turned[:, 10] = np.linspace(-3, 3, 20_000)  # the fifth joint, on whose way J_C loses rank
    condition = model.task_space_condition(chart.from_chart(turned)[0])
    x = turned[np.argmax(np.where(condition < LARGEST_CONDITION, condition, 0.0))]
    Q, v = (rows[0] for rows in chart.from_chart(x[None]))
    assume(600 < model.task_space_condition(Q) < LARGEST_CONDITION)

    xdot = flat(model.f_2(x, u, chart.anchor))
    in_chart = (ca.SX(each) for each in (x[: model.n], x[model.n :], xdot[model.n :]))
    vdot = flat(ca.DM(model.space.charted_acceleration(*in_chart)))
    assert_same(vdot, np.linalg.solve(model.J_C(Q).full(), u - flat(model.Jdot_v(Q, v))))
    assert_same(model.task_space_force(Q, v, u), model.computed_torque(Q, v, vdot))


def test_motion_in_the_null_space_comes_to_rest() -> None:
    model = spatial_robot(7, 0)
    Q = np.r_[0, 0, 0, 1, 0, 0, 0, np.linspace(0.3, 1.0, model.nq - 7)]
    null = np.linalg.svd(model.J_C(Q).full())[2][-1]
    vdot = flat(model.task_space.acceleration(Q, null, flat(model.Jdot_v(Q, null)), model.nominal.vector))
    np.testing.assert_allclose(vdot, -null, rtol=0, atol=1e-9)


def test_the_condition_number_says_where_the_jacobian_is_singular(model: RobotModel) -> None:
    bent = np.array([0, 0, 0, 0.5, 0.6, 0.4, -0.5, -0.6, -0.4])
    nearly = bent.copy()
    nearly[4] = 1e-3  # det J_C goes with the sine of each arm's second joint
    assert model.task_space_condition(bent) == pytest.approx(np.linalg.cond(model.J_C(bent).full()))
    assert 1 < model.task_space_condition(bent) < 1e2 < 1e3 < model.task_space_condition(nearly)
    np.testing.assert_array_equal(model.task_space_condition(np.array([bent, nearly])) < 1e3, [True, False])
    assert model.task_space_condition(np.zeros(9)) > 1e9


def test_arms_with_fewer_joints_than_their_pose_has_coordinates_have_no_such_law() -> None:
    with pytest.raises(InputError, match=r"18 coordinates of poses and 17 .* as many joints"):
        _ = spatial_robot(5, 0).task_space
