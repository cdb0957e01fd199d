"""Draws from a seed, and the effect of taking up and releasing a payload."""

import numpy as np
import pytest

from psmpc_cli.plant import ForceLimits
from psmpc_cli.plant.uncertainty import (
    draw_bodies,
    force_limits_of,
    friction_of,
    measurement_noise,
    release,
    take_up,
)
from psmpc_cli.robot.dynamics import InertialParameters
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.uncertainty import NoiseSpec, PayloadSpec, UncertaintySpec


def spec(**keys: object) -> UncertaintySpec:
    return UncertaintySpec.model_validate(keys)


def test_a_seed_draws_the_same_again_and_another_seed_something_else(model: RobotModel) -> None:
    given = spec(mass=0.1, inertia=0.1, centre_of_mass=0.01)
    one, again, other = (draw_bodies(given, model.spec, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.mass_factor, again.mass_factor)
    np.testing.assert_array_equal(one.offset, again.offset)
    assert not np.isin(one.mass_factor, other.mass_factor).any()
    assert not np.isclose(one.mass_factor, one.inertia_factor).any()


@pytest.mark.parametrize("more", [{"mass": 0.3}, {"centre_of_mass": 0.02}, {"noise": {"angle": 1e-3}}, {"delay": 0.1}])
def test_other_items_do_not_change_what_is_drawn_for_one(model: RobotModel, more: dict[str, object]) -> None:
    alone, together = (draw_bodies(spec(inertia=0.1, **others), model.spec, 5) for others in ({}, more))
    np.testing.assert_array_equal(alone.inertia_factor, together.inertia_factor)


def test_draws_stay_within_their_ranges_by_part_and_fill_them(model: RobotModel) -> None:
    given = spec(mass={"base": 0.2, "arm_1": 0.05}, centre_of_mass={"arms": 0.01})
    drawn = [draw_bodies(given, model.spec, seed) for seed in range(200)]
    mass = np.array([each.mass_factor for each in drawn]) - 1
    offset = np.array([each.offset for each in drawn])
    arm_2 = [name.startswith("arm_2") for name in (body.name for body in model.spec.bodies)]
    for bodies, width in ((slice(0, 1), 0.2), (slice(1, 4), 0.05)):
        assert 0.95 * width < np.abs(mass[:, bodies]).max() <= width
        assert np.abs(mass[:, bodies].mean()) < 0.2 * width
    assert (mass[:, arm_2] == 0).all()
    assert (offset[:, 0] == 0).all()
    assert 0.0095 < np.abs(offset[:, 1:]).max() <= 0.01


def test_without_ranges_the_robot_is_the_nominal_one(model: RobotModel) -> None:
    drawn = draw_bodies(spec(), model.spec, 3).true_parameters(model.nominal)
    np.testing.assert_array_equal(drawn.vector, model.nominal.vector)


def test_noise_is_a_function_of_seed_and_sample_with_its_deviations(model: RobotModel) -> None:
    given = NoiseSpec(position=1e-3, angle=2e-3, velocity=3e-3, angular_velocity=4e-3)
    late, again = (measurement_noise(given, model.spec, 1, 57, 100) for _ in range(2))
    np.testing.assert_array_equal(late, again)
    every = np.vstack([measurement_noise(given, model.spec, 1, sample, 100) for sample in range(100)])
    expected = np.repeat([1e-3, 2e-3, 3e-3, 4e-3], [2, 7, 2, 7])
    np.testing.assert_allclose(every.std(axis=0), expected, rtol=0.05)
    np.testing.assert_allclose(every.mean(axis=0) / expected, 0, atol=0.05)
    assert np.abs(np.corrcoef(every.T) - np.eye(18)).max() < 0.05
    assert not np.array_equal(late[0], measurement_noise(given, model.spec, 1, 58, 100)[0])


def test_friction_is_of_the_coordinates_it_names(model: RobotModel) -> None:
    coefficients = {"viscous": 0.1, "coulomb": {"arm_2": [0.1, 0.2, 0.3]}}
    friction = friction_of(spec(friction=coefficients), model.spec)
    np.testing.assert_array_equal(friction.viscous, [0, 0, 0] + 6 * [0.1])
    np.testing.assert_array_equal(friction.coulomb, 6 * [0] + [0.1, 0.2, 0.3])


def limits_of(*changes: str) -> ForceLimits | None:
    task = load_task("transport", changes)
    return force_limits_of(task.spec, task.robot)


LIMITED = "limits.base.force=[[-10, 20], null, 3]", "limits.arm_2.force=[5, 5, 5]"


def test_forces_are_cut_at_the_share_that_is_there_of_what_robot_and_task_declare() -> None:
    assert limits_of() is None
    inf = np.inf
    whole = limits_of(*LIMITED, "skills.move.limits={base: {force: [1, 1, 1]}}")
    assert whole is not None
    np.testing.assert_array_equal(whole.low, [-10, -inf, -3, -inf, -inf, -inf, -5, -5, -5])
    np.testing.assert_array_equal(whole.high, [20, inf, 3, inf, inf, inf, 5, 5, 5])
    less = limits_of(*LIMITED, "uncertainty.force_share={base: 0.5, arms: [1, 0.8, 2]}")
    assert less is not None
    np.testing.assert_array_equal(less.low, [-5, -inf, -1.5, -inf, -inf, -inf, -5, -4, -10])
    np.testing.assert_array_equal(less.high, [10, inf, 1.5, inf, inf, inf, 5, 4, 10])
    half = limits_of(*LIMITED, "uncertainty.force_share=0.5")
    assert half is not None
    np.testing.assert_array_equal(half.high, 0.5 * whole.high)


def test_grippers_share_a_payload() -> None:
    payload = {"mass": 5, "inertia": 0.7}
    arms = ("arm_1", "arm_2")
    assert PayloadSpec.model_validate(payload).shares(arms) == [0.5, 0.5]
    assert PayloadSpec.model_validate({**payload, "share": {"arm_1": 0.8, "arm_2": 0.2}}).shares(arms) == [0.8, 0.2]


@pytest.fixture
def holding(model: RobotModel) -> InertialParameters:
    return model.nominal.holding(np.array([3.0, 2.0]), np.array([0.4, 0.3]))


def kept(model: RobotModel, x: np.ndarray, robot: InertialParameters) -> tuple[np.ndarray, float]:
    Q, v = np.split(x, 2)
    return model.momentum(Q, v, robot), model.kinetic_energy(Q, v, robot)


def test_a_take_up_conserves_momentum_and_loses_energy(
    model: RobotModel, holding: InertialParameters, x: np.ndarray
) -> None:
    contact = take_up(model, x, model.nominal, holding)
    (p, T), (p_after, T_after) = kept(model, x, model.nominal), kept(model, contact.state, holding)
    np.testing.assert_allclose(p_after, p, atol=1e-12)
    np.testing.assert_array_equal(contact.momentum_and_energy[:-1], 0)
    np.testing.assert_array_equal(contact.state[:9], x[:9])
    assert np.abs(contact.state[9:] - x[9:]).max() > 0.01
    assert contact.momentum_and_energy[-1] == pytest.approx(T_after - T, rel=1e-12)
    assert contact.momentum_and_energy[-1] < 0


def test_the_loss_is_that_of_a_plastic_impact(model: RobotModel) -> None:
    """A robot that drifts with its joints free is stopped in part: 1/2 v' (1 / (J H^-1 J') + 1/M)^-1 v at one gripper.

    The formula is of two bodies that move together, with the gripper's inverse inertia J H^-1 J' and the object's M.
    """
    rng = np.random.default_rng(1)
    x = np.r_[rng.standard_normal(9), 0.3 * rng.standard_normal(9)]
    held = model.nominal.holding(np.array([4.0, 0.0]), np.array([0.5, 0.0]))
    J = model.J_C(x[:9]).full()[model.pose_rows["arm_1"]]
    v, mobility = J @ x[9:], J @ np.linalg.solve(model.mass_matrix(x[:9]), J.T)
    together = np.linalg.inv(mobility + np.diag(1 / np.array([4.0, 4.0, 0.5])))
    assert take_up(model, x, model.nominal, held).momentum_and_energy[-1] == pytest.approx(
        -float(v @ together @ v) / 2, rel=1e-10
    )


def test_a_release_keeps_velocities_and_gives_away_the_objects_share(
    model: RobotModel, holding: InertialParameters, x: np.ndarray
) -> None:
    contact = release(model, x, model.nominal, holding)
    (p, T), (p_left, T_left) = kept(model, x, holding), kept(model, x, model.nominal)
    np.testing.assert_array_equal(contact.state, x)
    np.testing.assert_allclose(p + contact.momentum_and_energy[:-1], p_left, atol=1e-12)
    assert T + contact.momentum_and_energy[-1] == pytest.approx(T_left, rel=1e-12)
