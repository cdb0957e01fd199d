"""Closed loops of a robot with thrusters: what is logged of them, that it repeats, and pulses against their means."""

from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.logs.run import Run
from psmpc_cli.report.texts import measure_rows, warnings_of
from psmpc_cli.robot.actuators.thrusters import STANDARD_GRAVITY, Thrusters
from psmpc_cli.simulation.replay import continue_run, replay, rerun
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.load import load_task

SHORT = {"time_limit": 1.5, "controller": {"horizon": 4, "nodes": 20}, "log": {"ticks": True, "plans": True}}


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(load_task("thrust_and_reach", SHORT))


def test_impulses_and_firings_are_those_of_the_ticks(run: Run) -> None:
    thrust = run["ticks/thrust"]
    impulse = run["thrusters/impulse"]
    assert impulse.shape == (15, 8)
    np.testing.assert_allclose(thrust.reshape(15, 100, 8).sum(axis=1) * 1e-3, impulse)
    begins = np.diff(np.vstack([np.zeros(8), thrust > 0]), axis=0) > 0
    np.testing.assert_array_equal(begins.reshape(15, 100, 8).sum(axis=1), run["thrusters/firings"])
    assert impulse.sum() > 20
    assert (np.abs(run["thrusters/owed"][:, :2]) < 1.5).all()
    model = run.problem.model
    space = model.space
    own = np.column_stack(space.along_base_axes(run["ticks/Q"].T, run["ticks/F"].T))
    wrenches = Thrusters.of(model.spec.thrusters).wrenches
    np.testing.assert_allclose(own[:, space.base], thrust @ wrenches.T, atol=1e-9)


def test_the_summary_has_propellant_and_firings(run: Run) -> None:
    fired = run.summary().thrusters
    assert fired is not None
    assert fired.impulse == pytest.approx(run["thrusters/impulse"].sum())
    assert fired.firings == run["thrusters/firings"].sum()
    assert fired.propellant == pytest.approx(fired.impulse / (60 * STANDARD_GRAVITY))
    assert fired.owed[0] == pytest.approx(np.linalg.norm(run["thrusters/owed"][:, :2], axis=1).max())
    rows = dict(measure_rows(run.summary()))
    assert rows["thrusters, impulse"].endswith("g of propellant")
    assert run.summary().limits_dynamics


@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
def test_a_run_repeats_from_its_log_to_the_last_bit(run: Run, plant: str) -> None:
    if plant != "rk4":
        run = simulate(load_task("thrust_and_reach", {**SHORT, "plant": plant, "time_limit": 0.5}))
    again = rerun(run)
    assert again is not None
    assert again.differences == ()
    assert replay(run, len(run.time) - 1).largest == 0.0


def test_an_interrupted_run_is_completed(tmp_path: Path) -> None:
    def stop(sample: object) -> None:
        nonlocal left
        left -= 1
        if not left:
            raise KeyboardInterrupt

    left = 4
    path = tmp_path / "stopped.h5"
    task = load_task("thrust_and_reach", {**SHORT, "time_limit": 0.8})
    stopped = simulate(task, path, stop)
    assert stopped.interrupted
    completed = continue_run(stopped)
    assert completed is not None
    assert completed.differences == ()


@pytest.mark.parametrize("change", [{"mobility": "free-floating"}, {"plant": "ideal"}])
def test_thrusters_that_are_not_used_are_not_logged(change: dict[str, object]) -> None:
    run = simulate(load_task("thrust_and_reach", {**SHORT, **change, "time_limit": 0.3}))
    assert "thrusters/impulse" not in run
    assert run.summary().thrusters is None


@pytest.mark.parametrize(("change", "is_found"), [({}, False), ({"mobility": "free-floating"}, True)])
def test_no_delay_is_looked_for_where_pulses_look_like_one(change: dict[str, object], is_found: bool) -> None:
    run = simulate(load_task("thrust_and_reach", {**SHORT, **change, "time_limit": 0.4}))
    assert (run["delay/deviation"] > 0).all() == is_found
    assert is_found or not run["delay/expected"].any()


def test_a_delay_that_is_not_looked_for_is_warned_of_unless_it_is_given() -> None:
    late = {"uncertainty.delay": "0.1 s"}
    short = {**SHORT, "time_limit": 0.3}
    warnings = warnings_of(simulate(load_task("thrust_and_reach", short | late)).summary())
    (warning,) = [text for text in warnings if "pulses of thrusters" in text]
    assert warning.startswith("commands came 100 ms late")
    given = simulate(load_task("thrust_and_reach", {**short, **late, "controller.delay": "0.1 s"}))
    assert not any("pulses" in text for text in warnings_of(given.summary()))
    assert not any("pulses" in text for text in warnings_of(simulate(load_task("thrust_and_reach", short)).summary()))


def test_thrusters_are_off_in_a_stage_that_floats() -> None:
    """From the tick of the switch on, in the middle of a sample; the balances hold."""
    stages = {
        "stages[0].ends_when": None,
        "stages[0].at": 0.55,
        "stages[1].mobility": "free-floating",
        "stages[1].priority": 1,
    }
    run = simulate(load_task("thrust_and_reach", {**SHORT, "time_limit": 1.0, **stages}))
    thrust = run["ticks/thrust"]
    assert thrust[:550].any()
    assert not thrust[551:].any()
    np.testing.assert_allclose(run["ticks/F"][551:, :3], 0.0, atol=1e-9)
    assert not run["thrusters/owed"][-1].any()
    assert run.summary().momentum_error < 1e-9


@pytest.mark.slow
def test_pulses_end_a_mission_as_soon_as_their_means() -> None:
    """Within 1 s, with impulses within a tenth; the impulse that is refused is less than a pulse in ten."""
    pulsed, continuous = (
        simulate(load_task("thrust_and_reach", {"plant.thrusters": fire, "controller.nodes": 20}))
        for fire in ("pulsed", "continuous")
    )
    for each in (pulsed, continuous):
        assert each.summary().succeeded
    assert abs(pulsed.summary().duration - continuous.summary().duration) < 1.0
    fired, meant = pulsed.summary().thrusters, continuous.summary().thrusters
    assert fired is not None and meant is not None
    assert fired.impulse == pytest.approx(meant.impulse, rel=0.1)
    assert fired.firings > meant.firings
    assert fired.refused[0] < 0.02 * fired.impulse


@pytest.mark.slow
def test_with_a_reserve_of_speed_pulses_exceed_no_limit_and_the_run_repeats() -> None:
    changes = {"log.shares": False, "log.plans": True}
    excess = {}
    for factor in (0, 3):
        found = simulate(load_task("thrust_and_reach", {**changes, "controller.speed_reserve": factor}))
        assert found.summary().succeeded
        stages = found.problem.stages
        limit = np.array([stages[stage].limits.velocity_high for stage in found["window/first"]])
        excess[factor] = -(found["margin/velocity"] / limit).min()
    assert excess[0] > 0.01
    assert excess[3] < 0.005
    # the last run
    assert found["margin/speed_reserve"].max() > 0.0
    assert replay(found, int(found["margin/speed_reserve"].max(axis=1).argmax())).largest == 0.0
    again = rerun(found)
    assert again is not None
    assert again.differences == ()
