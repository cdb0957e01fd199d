"""A mount that closes and opens within a sample."""

import numpy as np
import pytest

from psmpc_cli.plant import Setpoints, build_plant
from psmpc_cli.plant.mount import MountedPlant
from psmpc_cli.robot.model import RobotModel, load_robot
from psmpc_cli.specs.controller import PlantSpec

SPEC = PlantSpec.model_validate({"low_level_rate": 500})
TICKS = 20
HELD = np.arange(TICKS) // 5 % 2 == 1
"""The mount closes after the fifth tick, opens after the tenth, and closes again after the fifteenth."""


def moving(model: RobotModel) -> np.ndarray:
    """A state in which base and joints move."""
    random = np.random.default_rng(4)
    Q = np.array(model.space.integrate(model.space.neutral, random.normal(scale=0.3, size=model.n)))
    return np.concatenate([Q, random.normal(scale=0.1, size=model.n)])


@pytest.mark.parametrize("kind", ["rk4", "mujoco"])
@pytest.mark.parametrize("robot", ["planar_dual_arm", "free_flyer_arm"])
def test_the_base_stands_still_from_tick_to_tick_while_it_is_held(robot: str, kind: str) -> None:
    model = load_robot(robot)
    plant = build_plant(SPEC.model_copy(update={"kind": kind}), model, is_held=True)
    assert isinstance(plant, MountedPlant)
    state = moving(model)
    u = np.tile(np.random.default_rng(5).normal(scale=0.2, size=model.n), (TICKS, 1))
    ticks = plant.advance(0.0, state, Setpoints(u, held=HELD))
    base = model.space.base
    rates = ticks.states[1:, model.nq :]
    assert (rates[HELD][:, base] == 0).all()
    assert (np.abs(rates[~HELD][:, base]) > 0).all()
    where = ticks.states[:, model.space.base_coordinates]
    assert (where[5:10] == where[5]).all() and (where[15:] == where[15]).all()
    assert (ticks.F[HELD][:, base] == 0).all()
    np.testing.assert_allclose(ticks.time, np.arange(TICKS + 1) / 500)
    fixed = build_plant(SPEC.model_copy(update={"kind": kind}), model.mounted)
    alone = fixed.advance(0.0, ticks.states[6], Setpoints(u[6:10]))
    np.testing.assert_array_equal(ticks.states[6:11], alone.states)
    np.testing.assert_array_equal(ticks.F[6:10], alone.F)


@pytest.mark.parametrize("robot", ["planar_dual_arm", "free_flyer_arm"])
def test_the_blow_of_a_mount_that_closes_acts_on_the_base_alone(robot: str) -> None:
    """The joints' rows of H v stay, but for what forces do in 10 us; impulse and work are those of the sample."""
    model = load_robot(robot)
    state = moving(model)
    Q, v = np.split(state, [model.nq])
    plant = build_plant(SPEC.model_copy(update={"low_level_rate": 1e5}), model, is_held=True)
    ticks = plant.advance(0.0, state, Setpoints(np.zeros((1, model.n)), held=np.ones(1, bool)))
    after = ticks.states[1, model.nq :]
    joints = model.space.joint_rates
    H = model.mass_matrix(Q)
    np.testing.assert_allclose((H @ after)[joints], (H @ v)[joints], atol=1e-4 * np.abs(H @ v).max())
    change = model.balance(*np.split(ticks.states[1], [model.nq])) - model.balance(Q, v)
    np.testing.assert_allclose(ticks.impulse_and_work, change, atol=1e-9)
    assert change[-1] < 0
