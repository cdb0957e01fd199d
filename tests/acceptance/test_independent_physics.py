"""The transport task on physics of other authors, coarsely; benchmarks/reliability.py has the paper's mesh."""

import numpy as np
import pytest

from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.plant.mujoco import MujocoPlant
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

pytestmark = pytest.mark.slow

CHANGES = ("controller.nodes=15", "log.plans=false", "log.shares=false", "log.ticks=true")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """The log of a run on each plant."""
    folder = tmp_path_factory.mktemp("runs")
    for plant in ("rk4", "mujoco"):
        simulate(load_task("transport", (*CHANGES, f"plant.kind={plant}")), folder / plant)
    return {plant: read_run(folder / plant) for plant in ("rk4", "mujoco")}


def test_final_poses_agree(logs: dict[str, Run]) -> None:
    """Within 2 mm and 2 mrad, and far within."""
    np.testing.assert_allclose(logs["mujoco"].final["xi"], logs["rk4"].final["xi"], rtol=0, atol=1e-6)


def test_instants_agree_to_a_sample(logs: dict[str, Run]) -> None:
    ours, theirs = (logs[plant].summary() for plant in ("rk4", "mujoco"))
    assert ours.succeeded and theirs.succeeded
    for one, other in zip(ours.stages, theirs.stages, strict=True):
        assert one.switch_time == pytest.approx(other.switch_time, abs=0.1)
        assert one.actual_start == pytest.approx(other.actual_start, abs=0.1)


def test_momentum_and_energy_balance(logs: dict[str, Run]) -> None:
    summary = logs["mujoco"].summary()
    assert summary.momentum_error < 1e-9
    assert summary.energy_error < 1e-9


def test_the_forces_of_a_run_replayed_give_its_motion(logs: dict[str, Run], model: RobotModel) -> None:
    """Open loop, anew every 5 s."""
    ticks = logs["rk4"].ticks
    X, window = np.hstack([ticks["Q"], ticks["v"]]), 5000
    assert np.median(np.diff(ticks["time"])) == pytest.approx(1e-3)
    for start in range(0, len(X) - 1, window):
        logged = X[start : start + window]
        replayed = MujocoPlant(model, 1e-3).replay(logged[0], ticks["F"][start : start + len(logged) - 1])
        assert np.abs(replayed - logged).max() < 1e-9
