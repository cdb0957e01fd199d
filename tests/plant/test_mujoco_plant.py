import sys
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.errors import InputError
from psmpc_cli.plant import build_plant
from psmpc_cli.plant.mujoco_plant import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.simulation.loop import simulate
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.specs.task import PlantSpec

from ..robot.strategies import State, laws, moving_robots

TICK = 1e-3


@pytest.fixture
def x() -> np.ndarray:
    random = np.random.default_rng(3)
    return np.r_[0.3, -0.2, 0.5, 0.4 * random.standard_normal(6), 0.1 * random.standard_normal(9)]


@pytest.fixture
def u() -> np.ndarray:
    """Five seconds of accelerations, rich in frequencies."""
    return 0.5 * np.sin(np.outer(TICK * np.arange(5000), np.arange(1, 10)) + np.arange(9))


@pytest.fixture(autouse=True)
def own_warnings() -> Iterator[None]:
    """A plant says where MuJoCo's warnings go; put that back."""
    before = mujoco.get_mju_user_warning()
    yield
    mujoco.set_mju_user_warning(before)


def state_changes(model: RobotModel, before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, float]:
    """Return by how much the robot model's momentum and energy differ between two states."""
    n = model.n
    momentum, energy = (
        [np.asarray(of(x[:n], x[n:])).ravel() for x in (before, after)] for of in (model.momentum, model.kinetic_energy)
    )
    return momentum[1] - momentum[0], float((energy[1] - energy[0])[0])


def test_forces_of_the_other_plant_give_its_motion(model: RobotModel, x: np.ndarray, u: np.ndarray) -> None:
    """Open loop over five seconds: nothing pulls the two together."""
    ticks = Rk4Plant(model, TICK).advance(0.0, x, u)
    assert np.abs(ticks.X - x).max() > 1
    np.testing.assert_allclose(MujocoPlant(model, TICK).replay(x, ticks.F), ticks.X, rtol=0, atol=1e-10)
    np.testing.assert_allclose(MujocoPlant(model, TICK, 4).replay(x, ticks.F), ticks.X, rtol=0, atol=1e-10)


def test_a_hundredth_of_a_links_inertia_shows_in_a_replay(model: RobotModel, x: np.ndarray, u: np.ndarray) -> None:
    ticks = Rk4Plant(model, TICK).advance(0.0, x, u)
    arm = model.spec.arms["arm_1"]
    links = (arm.links[0].model_copy(update={"inertia": 1.01 * arm.links[0].inertia}), *arm.links[1:])
    arms = {**model.spec.arms, "arm_1": arm.model_copy(update={"links": links})}
    other = build_model(model.spec.model_copy(update={"arms": arms}))
    assert np.abs(MujocoPlant(other, TICK).replay(x, ticks.F) - ticks.X).max() > 1e-5


@given(moving_robots(most=3), st.integers(1, 3))
@laws
def test_momentum_changes_by_the_impulse_and_energy_by_the_work(state: State, substeps: int) -> None:
    """The robot model's momentum and energy, at the states of an engine that knows neither."""
    model, Q, Qdot, u = state
    x = np.r_[Q, 0.2 * Qdot]
    ticks = MujocoPlant(model, TICK, substeps).advance(0.0, x, np.tile(0.2 * u, (50, 1)))
    momentum, energy = state_changes(model, x, ticks.X[-1])
    np.testing.assert_allclose(momentum, ticks.impulse, atol=1e-9)
    assert energy == pytest.approx(ticks.work, abs=1e-9)


def test_momentum_is_conserved_without_base_force(model: RobotModel, x: np.ndarray) -> None:
    F = np.zeros((20_000, 9))
    F[:, 3:] = 0.05 * np.sin(np.outer(TICK * np.arange(len(F)), np.arange(1, 7)) + np.arange(6))
    X = MujocoPlant(model, TICK).replay(x, F)
    momenta = np.array([state_changes(model, x, state)[0] for state in X[::500]])
    assert np.abs(X[:, 3:9] - x[3:9]).max() > 0.1
    assert np.abs(momenta).max() < 1e-9


def test_angles_go_on_beyond_a_turn(model: RobotModel) -> None:
    x = np.zeros(18)
    x[11] = 20.0
    assert MujocoPlant(model, TICK).replay(x, np.zeros((1000, 9)))[-1, 2] > 4 * np.pi


def test_a_sample_depends_on_its_start_alone(model: RobotModel, x: np.ndarray, u: np.ndarray) -> None:
    plant = MujocoPlant(model, TICK)
    first = plant.advance(2.0, x, u[:100])
    plant.advance(0.0, -x, u[100:200])
    again = plant.advance(2.0, x, u[:100])
    np.testing.assert_array_equal(first.X, again.X)
    np.testing.assert_array_equal(first.impulse, again.impulse)
    np.testing.assert_allclose(first.time, 2 + TICK * np.arange(101))


def test_what_diverges_is_not_hidden(
    model: RobotModel, x: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """MuJoCo would start anew from zero and write a file."""
    monkeypatch.chdir(tmp_path)
    ticks = MujocoPlant(model, TICK).advance(0.0, x, np.full((3, 9), np.nan))
    assert np.isnan(ticks.X[-1]).all()
    assert "The simulation is unstable" in caplog.text
    assert list(tmp_path.iterdir()) == []


def test_the_closed_loop_is_the_same_in_both(experiment_of: Callable[..., Experiment]) -> None:
    """Three seconds on a coarse mesh."""
    runs = []
    for plant in ("rk4", "mujoco"):
        experiment = experiment_of("controller.nodes=10", "log.shares=false", f"plant.kind={plant}")
        runs.append(list(islice(simulate(experiment), 30)))
    rk4, engine = runs
    assert np.abs(rk4[-1].Q - rk4[0].Q).max() > 0.1
    for one, other in zip(rk4, engine, strict=True):
        np.testing.assert_allclose(one.Q, other.Q, atol=1e-8)
        np.testing.assert_allclose(one.instants, other.instants, atol=1e-6)
        assert np.abs(other.momentum_error).max() < 1e-9
        assert abs(other.energy_error) < 1e-9


def test_a_step_of_the_integrator_is_chosen(model: RobotModel) -> None:
    plant = build_plant(PlantSpec(kind="mujoco", step=5e-4), model)
    assert isinstance(plant, MujocoPlant)
    assert (plant.engine.opt.timestep, plant.substeps) == (5e-4, 2)


def test_without_the_package_the_extra_is_named(model: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "psmpc_cli.plant.mujoco_plant", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'psmpc\[mujoco\]', or choose plant rk4"):
        build_plant(PlantSpec(kind="mujoco"), model)
