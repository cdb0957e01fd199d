from pathlib import Path

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import LogError
from psmpc_cli.logs.run import read_run
from psmpc_cli.simulation.verify import QUANTITIES, Verification

from ..short_runs import there_and_back

RIGID = ("plant.kind=rk4", "log.shares=false")


def test_the_exact_discretization_leaves_nothing_between_the_nodes(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, *RIGID)
    found = Verification(log)
    assert (found.count, found.samples, found.remarks) == (len(log.time), len(log.time), ())
    assert set(found.horizons) == set(QUANTITIES) - {"plant"}
    assert set(found.loop) == set(QUANTITIES)
    for quantity in ("position", "velocity", "position limit", "velocity limit"):
        assert found.horizons[quantity].value < 1e-7
    assert found.horizons["end condition"].where == "go"
    assert found.horizons["end condition"].value == pytest.approx(1.0, abs=1e-3)
    assert found.loop["plant"].value < 1e-7


@pytest.mark.slow
def test_euler_steps_are_seen_to_miss_the_motion(tmp_path: Path) -> None:
    exact, euler = (
        Verification(there_and_back(tmp_path, *RIGID, f"controller.discretization={kind}", samples=4, name=kind))
        for kind in ("exact", "euler")
    )
    assert euler.horizons["position"].value > 1e-3 > 1e3 * exact.horizons["position"].value


@pytest.mark.slow
def test_the_held_force_costs_in_proportion_to_the_tick(tmp_path: Path) -> None:
    slow, fast = (
        Verification(there_and_back(tmp_path, *RIGID, f"plant.low_level_rate={rate}", samples=5, name=str(rate)))
        for rate in (100, 400)
    )
    assert slow.loop["velocity"].value == pytest.approx(4 * fast.loop["velocity"].value, rel=0.2)


def test_a_limit_the_physics_passes_is_found_with_its_instant(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, *RIGID, "log.ticks=true", samples=5)
    with h5py.File(log.path, "r+") as file:
        file["state/Qdot"][3, 0] = 0.25
    peak = Verification(read_run(log.path)).loop["velocity limit"]
    assert peak.where == log.coordinates[0]
    assert peak.sample == 3
    assert 0.3 <= peak.time <= 0.4
    assert peak.value > 0.04


def test_every_nth_horizon_is_integrated(tmp_path: Path) -> None:
    found = Verification(there_and_back(tmp_path, samples=7), every=3)
    assert (found.count, found.samples) == (3, 7)


@pytest.mark.slow
def test_of_levels_the_first_and_with_ticks_the_closed_loop(tmp_path: Path) -> None:
    htmpc = ("controller.kind=htmpc", *RIGID)
    found = Verification(there_and_back(tmp_path, *htmpc, samples=3))
    assert (found.count, found.samples, found.loop) == (3, 0, {})
    assert "first levels alone" in found.remarks[0]
    assert found.remarks[1].startswith("3 samples of the closed loop were left out")
    found = Verification(there_and_back(tmp_path, *htmpc, "log.ticks=true", samples=3, name="ticks"))
    assert (found.samples, len(found.remarks)) == (3, 1)
    assert found.loop["plant"].value < 1e-7


@pytest.mark.slow
def test_failed_solves_have_no_horizon_and_braking_no_plan(tmp_path: Path) -> None:
    log = there_and_back(tmp_path, "solver.max_iterations=9", "stages[1].priority=3", samples=7)
    failed = int(log["events/solve_failed"].sum())
    assert failed
    found = Verification(log)
    assert (found.count, found.samples) == (7 - failed, 7)
    braking = there_and_back(tmp_path, "solver.max_iterations=1", name="braking")
    assert np.isclose(Verification(braking).samples, 0)


def test_a_log_without_plans_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="found no plans"):
        Verification(there_and_back(tmp_path, "log.plans=false", samples=1))
