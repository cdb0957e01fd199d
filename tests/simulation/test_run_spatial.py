"""Spatial tasks in closed loop: simulated, logged, replayed, repeated, verified, studied."""

from pathlib import Path

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.simulation.replay import continue_run, replay, rerun
from psmpc_cli.simulation.run import simulate
from psmpc_cli.simulation.verify import Verification
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.fronts import STATUS
from psmpc_cli.studies.pareto import ParetoSettings, solve_pareto

THERE = {"position": [0.1, 0.1, -0.1], "attitude": {"axis": [0.6, 0, 0.8], "angle": "30 deg"}}


def task(*changes: str) -> Task:
    """The small free-flyer turns and flies, then unfolds its arm."""
    skill = {"space": "joint", "weights": {"base": [100] * 6, "arm": [10] * 3, "control": 0.1}}
    stages = [
        {"name": "fly", "target": {"base": THERE, "arm": [0, 0, 0]}, "ends_when": {"coordinates": ["base"]}},
        {"name": "unfold", "target": {"base": THERE, "arm": [0.3, 0, 0.2]}, "ends_when": {"coordinates": ["all"]}},
    ]
    for stage in stages:
        stage |= {"skill": "move", "ends_when": {**stage["ends_when"], "tolerance": 0.01}}
    given = {
        "robot": "free_flyer_arm",
        "initial": {"base": {"position": [0, 0, 0]}, "arm": [0, 0, 0]},
        "controller": {"nodes": 12, "horizon": 3},
        "skills": {"move": skill},
        "stages": stages,
        "log": {"plans": True, "ticks": True},
        "solver": {"compiled": False},
    }
    return load_task(given, changes)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a run."""
    path = tmp_path_factory.mktemp("spatial") / "run.h5"
    simulate(task(), path)
    return path


@pytest.fixture(scope="module")
def run(log: Path) -> Run:
    return read_run(log)


def test_a_mission_succeeds_and_keeps_its_balances(run: Run) -> None:
    summary = run.summary()
    assert summary.succeeded
    assert summary.failed_solves == 0
    assert summary.stages[1].early
    assert max(summary.momentum_error, summary.energy_error) < 1e-11
    omega = run.ticks["v"][:, 3:6]
    assert np.abs(omega).max() < 0.3 * 1.005


def test_coordinates_are_named_and_attitudes_unit_quaternions(run: Run) -> None:
    assert run.Q_coordinates[2:8] == ("base.z", "base.qw", "base.qx", "base.qy", "base.qz", "arm.1")
    assert run.coordinates[2:7] == ("base.z", "base.rx", "base.ry", "base.rz", "arm.1")
    assert run.Q.shape[1] == run.v.shape[1] + 1 == 10
    assert run["pose/xi"].shape[1] == 14
    np.testing.assert_allclose(np.linalg.norm(run.ticks["Q"][:, 3:7], axis=1), 1, rtol=0, atol=1e-12)
    dataset = run.to_xarray()
    np.testing.assert_array_equal(dataset["state/Q"].sel(Q_coordinate="base.qw"), run.Q[:, 3])
    poses = run.motion.poses_at(np.linspace(0, run.time[-1], 7))
    np.testing.assert_allclose(np.linalg.norm(poses[:, 10:14], axis=1), 1)


def test_a_replayed_horizon_is_the_logged_one(run: Run) -> None:
    for sample in (0, int(np.argmax(run["window/count"] > 1)), len(run.time) - 1):
        assert replay(run, sample).largest < 1e-12


@pytest.mark.slow
def test_a_repeated_run_is_equal_and_a_cut_one_continues(log: Path, run: Run, tmp_path: Path) -> None:
    comparison = rerun(run, tmp_path / "again.h5")
    assert comparison is not None
    assert comparison.differences == ()

    def stop(sample: object) -> None:
        nonlocal count
        count += 1
        if count == 5:
            raise KeyboardInterrupt

    count = 0
    cut = simulate(task(), tmp_path / "cut.h5", stop)
    assert cut.interrupted
    comparison = continue_run(read_run(tmp_path / "cut.h5"))
    assert comparison is not None
    assert comparison.differences == ()


@pytest.mark.slow
def test_the_physics_follows_the_plans(run: Run) -> None:
    found = Verification(run, every=10)
    assert found.horizons["velocity"].value < 1e-9
    assert found.loop["plant"].value < 1e-8


@pytest.mark.slow
def test_the_engines_agree_in_closed_loop(run: Run) -> None:
    other = simulate(task("plant.kind=mujoco"))
    np.testing.assert_allclose(other.Q, run.Q, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_an_uncertain_run_says_what_was_drawn_and_what_was_true() -> None:
    uncertain = (
        "uncertainty={mass: 0.1, centre_of_mass: 0.005, noise: {angle: 1e-4, angular_velocity: 1e-4}, delay: 0.1 s,"
        " impulse: {at: 1, linear: [0.1, 0, 0.05], angular: [0, 0.01, 0]}}"
    )
    found = simulate(task(uncertain))
    assert found["uncertainty/centre_of_mass"].shape == (4, 3)
    seen = found["state/Q"][:, 3:7]
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1, atol=1e-12)
    assert 0 < np.abs(seen - found.Q[:, 3:7]).max() < 0.1
    assert found.summary().momentum_error < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "error"), [("ideal", 1e-8), ("rk4", 1e-4)])
def test_a_known_delay_is_foreseen_over_turns_too(run: Run, plant: str, error: float) -> None:
    found = simulate(task("uncertainty.delay=0.3 s", "controller.delay=0.3", f"plant.kind={plant}"))
    summary = found.summary()
    assert summary.succeeded
    assert [stage.switch_time for stage in summary.stages] == pytest.approx(
        [stage.switch_time + 0.3 for stage in run.summary().stages], abs=1e-3
    )
    np.testing.assert_allclose(found["state/Q"][:-3], found["state/Q_true"][3:], rtol=0, atol=error)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [None, 0, 2], ids=["without", "at once", "late"])
def test_integral_action_gets_over_friction_in_space(delay: int | None) -> None:
    friction = "uncertainty={mass: 0.3, inertia: 0.3, friction: {coulomb: 0.03, width: 0.08}}"
    late = [f"{key}={0.1 * (delay or 0):g} s" for key in ("uncertainty.delay", "controller.delay")]
    found = simulate(task(friction, *late, f"controller.offset_free={delay is not None}", "time_limit=16"))
    assert found.summary().succeeded == (delay is not None)
    assert found.summary().momentum_error < 1e-9


@pytest.mark.slow
def test_studies_take_spatial_tasks() -> None:
    results = psmpc.sweep(task(), {"stages.unfold.priority": [1, 10]})
    np.testing.assert_array_equal(results["succeeded"], 1)
    assert results["end_time"].shape == (2,)
    drawn = psmpc.monte_carlo(task("uncertainty={mass: 0.1, noise: {angle: 1e-4}}"), 2, jobs=1)
    np.testing.assert_array_equal(drawn["succeeded"], 1)
    assert len(np.unique(drawn["switch_time"][:, 0])) == 2
    runs = psmpc.compare(task(), ["psmpc", "hard"], jobs=1)
    ends = {name: run.summary().stages[-1].switch_time for name, run in runs.items()}
    assert ends["psmpc"] < ends["hard"]


@pytest.mark.slow
def test_fronts_in_space_hold_the_run_s_instant(log: Path, run: Run, tmp_path: Path) -> None:
    """The end condition is met at the limits: any earlier instant has no solution."""
    settings = ParetoSettings(stages="1,2", at=(0.1, 0.8), points=3, method="both", free=False)
    found = solve_pareto(run, settings, tmp_path / "fronts.h5", jobs=1)
    for method in ("weighted", "constrained"):
        assert (found[f"{method}_status"] == STATUS.index("optimal")).all()
        assert (np.diff(found[f"{method}_J_2"]) < 0).all()
    samples = np.searchsorted(run.time, found["instant"] - 1e-6)
    np.testing.assert_allclose(found["t_s"], run["window/instants"][samples, 0], atol=1e-4)
