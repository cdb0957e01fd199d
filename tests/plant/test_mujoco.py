"""MuJoCo as a plant."""

import sys
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.plant import Setpoints, build_plant
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.plant.rk4 import Rk4Plant
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.controller import PlantSpec

TICK = 1e-3


@pytest.fixture
def u() -> np.ndarray:
    """Two seconds of accelerations, rich in frequencies."""
    return 0.5 * np.sin(np.outer(TICK * np.arange(2000), np.arange(1, 10)) + np.arange(9))


def test_one_percent_of_a_links_inertia_shows_in_a_replay(model: RobotModel, x: np.ndarray, u: np.ndarray) -> None:
    ticks = Rk4Plant(model, TICK).advance(0.0, x, Setpoints(u))
    arm = model.spec.arms["arm_1"]
    links = (arm.links[0].model_copy(update={"inertia": 1.01 * arm.links[0].inertia}), *arm.links[1:])
    arms = {**model.spec.arms, "arm_1": arm.model_copy(update={"links": links})}
    other = RobotModel(model.spec.model_copy(update={"arms": arms}))
    assert np.abs(MujocoPlant(other, TICK).replay(x, ticks.F) - ticks.states).max() > 1e-6


def test_divergence_is_visible(
    model: RobotModel, x: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """MuJoCo by itself would restart from zero and write a file."""
    monkeypatch.chdir(tmp_path)
    ticks = MujocoPlant(model, TICK).advance(0.0, x, Setpoints(np.full((3, 9), np.nan)))
    assert np.isnan(ticks.states[-1]).all()
    assert "The simulation is unstable" in caplog.text
    assert list(tmp_path.iterdir()) == []


def test_a_step_of_the_integrator_is_chosen(model: RobotModel) -> None:
    plant = build_plant(PlantSpec(kind="mujoco", step=5e-4), model)
    assert isinstance(plant, MujocoPlant)
    assert (plant.engine.opt.timestep, plant.substeps) == (5e-4, 2)


def test_without_the_package_the_extra_is_named(model: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "psmpc_cli.plant.mujoco", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'psmpc\[mujoco\]', or choose plant rk4"):
        build_plant(PlantSpec(kind="mujoco"), model)
