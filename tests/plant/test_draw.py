import numpy as np
import pytest

from psmpc_cli.plant.draw import draw, measurement_noise, resistance, shares
from psmpc_cli.robot.inertial import body_names, described
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import NoiseSpec, PayloadSpec, UncertaintySpec


def spec(**keys: object) -> UncertaintySpec:
    return UncertaintySpec.model_validate(keys)


def test_a_seed_draws_the_same_again_and_another_seed_something_else(model: RobotModel) -> None:
    given = spec(mass=0.1, inertia=0.1, centre_of_mass=0.01)
    one, again, other = (draw(given, model.spec, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.mass_factor, again.mass_factor)
    np.testing.assert_array_equal(one.offset, again.offset)
    assert not np.isin(one.mass_factor, other.mass_factor).any()


@pytest.mark.parametrize("more", [{"mass": 0.3}, {"centre_of_mass": 0.02}, {"noise": {"angle": 1e-3}}, {"delay": 1}])
def test_other_items_do_not_change_what_is_drawn_for_one(model: RobotModel, more: dict[str, object]) -> None:
    alone, together = draw(spec(inertia=0.1), model.spec, 5), draw(spec(inertia=0.1, **more), model.spec, 5)
    np.testing.assert_array_equal(alone.inertia_factor, together.inertia_factor)


def test_items_are_drawn_independently(model: RobotModel) -> None:
    drawn = draw(spec(mass=0.1, inertia=0.1), model.spec, 5)
    assert not np.isclose(drawn.mass_factor, drawn.inertia_factor).any()


def test_draws_stay_within_their_ranges_by_part_and_fill_them(model: RobotModel) -> None:
    given = spec(mass={"base": 0.2, "arm_1": 0.05}, centre_of_mass={"arms": 0.01})
    drawn = [draw(given, model.spec, seed) for seed in range(200)]
    mass = np.array([each.mass_factor for each in drawn]) - 1
    offset = np.array([each.offset for each in drawn])
    arm_2 = [name.startswith("arm_2") for name in body_names(model.spec)]
    for bodies, width in ((slice(0, 1), 0.2), (slice(1, 4), 0.05)):
        assert 0.95 * width < np.abs(mass[:, bodies]).max() <= width
        assert np.abs(mass[:, bodies].mean()) < 0.2 * width
    assert (mass[:, arm_2] == 0).all()
    assert (offset[:, 0] == 0).all()
    assert 0.0095 < np.abs(offset[:, 1:]).max() <= 0.01


def test_without_ranges_the_robot_is_the_described_one(model: RobotModel) -> None:
    np.testing.assert_array_equal(draw(spec(), model.spec, 3).applied(model.spec).vector, described(model.spec).vector)


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


def test_resistance_is_of_the_coordinates_it_names(model: RobotModel) -> None:
    given = spec(
        friction={"viscous": 0.1, "coulomb": {"arm_2": [0.1, 0.2, 0.3]}},
        force_limits={"base": [10, 20, 3], "arms": 5, "arm_1": [1, 2, 3]},
    )
    way = resistance(given.friction, given.force_limits, model.spec)
    np.testing.assert_array_equal(way.viscous, [0, 0, 0] + 6 * [0.1])
    np.testing.assert_array_equal(way.coulomb, 6 * [0] + [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(way.largest, [10, 20, 3, 1, 2, 3, 5, 5, 5])
    assert np.isinf(resistance(given.friction, {}, model.spec).largest).all()


def test_grippers_share_a_payload(model: RobotModel) -> None:
    payload = {"mass": 5, "inertia": 0.7}
    np.testing.assert_array_equal(shares(PayloadSpec.model_validate(payload), model.spec), [0.5, 0.5])
    given = PayloadSpec.model_validate({**payload, "share": {"arm_1": 0.8, "arm_2": 0.2}})
    np.testing.assert_array_equal(shares(given, model.spec), [0.8, 0.2])
