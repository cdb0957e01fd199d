from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.logs.read import read_log
from psmpc_cli.simulation.deviations import largest_deviations
from psmpc_cli.simulation.measures import state_at

from .logged import there_and_back


def test_a_run_measures_how_far_it_is_off_its_plan(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "plant.kind=rk4", "log.shares=false")
    found = largest_deviations(log)
    position, velocity = found.off_plan
    assert position.value == np.abs(log["deviation/Q"]).max()
    assert velocity.value == np.abs(log["deviation/Qdot"]).max()
    assert velocity.where.endswith(" velocity")
    assert 0 < velocity.value < 1e-3
    assert found.beyond_limits == ()


def test_a_planned_hand_over_meets_its_end_condition(tmp_path: Path) -> None:
    end = largest_deviations(there_and_back(tmp_path)).end_condition
    assert end is not None
    assert end.where == "go"
    assert end.value == pytest.approx(1.0, abs=1e-3)


def test_violations_of_limits_are_what_margins_lack(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, samples=4)
    with h5py.File(log.path, "r+") as file:
        file["margin/velocity"][2, 1] = -0.125
    (beyond,) = largest_deviations(read_log(log.path)).beyond_limits
    assert (beyond.value, beyond.where) == (0.125, f"{log.coordinates[1]} velocity")
    assert beyond.time == log.time[2]


def test_logs_that_measured_less_tell_less(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, samples=2)
    with h5py.File(log.path, "r+") as file:
        for name in ("Q", "Qdot", "end"):
            del file[f"deviation/{name}"]
    found = largest_deviations(read_log(log.path))
    assert (found.off_plan, found.end_condition) == ((), None)


def test_a_state_between_ticks_and_soon_after_is_that_of_constant_acceleration() -> None:
    times, u = np.array([0.0, 0.1, 0.3]), np.array([2.0, -1.0])
    Qdot = np.array([1.0, 1.2, 1.0])
    Q = np.array([0.0, 0.11, 0.33])
    X = np.column_stack([Q, Qdot])
    for time in (0.0, 0.04, 0.2, 0.3, 0.31):
        k = 0 if time < 0.1 else 1
        since = time - times[k]
        expected = [Q[k] + since * Qdot[k] + since**2 / 2 * u[k], Qdot[k] + since * u[k]]
        np.testing.assert_allclose(state_at(times, X, time), expected, atol=1e-12)
