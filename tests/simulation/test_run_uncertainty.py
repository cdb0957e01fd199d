"""Whole short runs of a robot that is not the one the controller knows."""

from collections.abc import Callable
from functools import cache

import h5py
import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.comparison import compare_runs
from psmpc_cli.logs.run import Run
from psmpc_cli.plant.uncertainty import measurement_noise
from psmpc_cli.simulation.run import build_experiment
from psmpc_cli.specs.load import load_task

from ..short_runs import TASK, there_and_back

CARRY = """\
  - name: carry
    skill: move
    target: {base: [0.1, 0.02, 0], arm_1: [0, 0, 0], arm_2: [0, 0.02, 0]}
    ends_when: {coordinates: [base], tolerance: 5e-3}
"""
THERE, BACK = TASK.replace("kind: ideal,", "kind: rk4, step: 2e-3,").split("  - name: back\n")
THREE_STAGES = f"{THERE}{CARRY}  - name: back\n{BACK}"
"""There, aside and back: what is taken up at the end of `go` is carried through one stage."""

REDUCED_LOG = ("log.shares=false", "log.plans=false")
BODIES = "uncertainty={mass: 0.2, inertia: 0.2, centre_of_mass: 0.01}"
PAYLOAD = "uncertainty.payload={mass: 4, inertia: 0.3}"
NOISE = "uncertainty.noise={position: 1e-3, angle: 1e-3, velocity: 1e-3, angular_velocity: 1e-3}"


Logged = Callable[..., Run]


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Logged:
    """Return the log of a run of three stages, interrupted after so many samples; equal runs are made once."""

    @cache
    def run(*changes: str, samples: int | None = None) -> Run:
        return there_and_back(tmp_path_factory.mktemp("run"), *changes, samples=samples, text=THREE_STAGES)

    return run


def held(log: Run) -> np.ndarray:
    return log["payload/held"].astype(bool)


@pytest.mark.slow
def test_a_block_of_zeros_is_no_block(logged: Logged) -> None:
    zeros = "uncertainty={mass: 0, inertia: {base: 0}, friction: {viscous: 0}, noise: {angle: 0}, delay: 0}"
    one, other = logged(), logged(zeros)
    assert compare_runs(one, other).differences == ()
    assert "uncertainty/body" not in other


def test_other_bodies_make_another_run_whose_balance_closes(logged: Logged) -> None:
    log, known = logged(BODIES, *REDUCED_LOG), logged(*REDUCED_LOG)
    K = min(len(log.time), len(known.time))
    assert np.abs(log["state/Q"][:K] - known["state/Q"][:K]).max() > 1e-4
    assert np.abs(log["balance/momentum"]).max() < 1e-9
    assert np.abs(log["balance/energy"]).max() < 1e-9


def test_the_log_tells_what_was_drawn_with_units(logged: Logged) -> None:
    log = logged(BODIES, *REDUCED_LOG, samples=1)
    assert list(log["uncertainty/body"][:2]) == ["base", "arm_1.1"]
    assert log["uncertainty/centre_of_mass"].shape == (7, 2)
    for name in ("uncertainty/mass_factor", "uncertainty/inertia_factor"):
        assert (np.abs(log[name] - 1) <= 0.2).all()
        assert (log[name] != 1).all()
    with h5py.File(log.path) as file:
        assert file["uncertainty/centre_of_mass"].attrs["units"] == "m"
        assert all(item.attrs["long_name"] for item in file["uncertainty"].values())


UNFILTERED = "controller.measurement_noise={}"


@pytest.mark.slow
def test_the_filtered_state_is_nearer_to_the_true_one_and_no_measurement_less(logged: Logged) -> None:
    errors = []
    for changes in ((UNFILTERED,), ()):
        log = logged(NOISE, *changes, *REDUCED_LOG)
        errors.append(np.std(log["state/Q"] - log["state/Q_true"]))
    assert errors[1] < 0.6 * errors[0]


def test_the_controller_sees_the_noise_and_the_margins_do_not(logged: Logged) -> None:
    log = logged(NOISE, UNFILTERED, "log.ticks=true", *REDUCED_LOG)
    loaded = load_task(log.path.parent / "task.yaml", [NOISE])
    noise = [measurement_noise(loaded.spec.uncertainty.noise, loaded.robot, 0, k, 10)[0] for k in range(len(log.time))]
    seen, true = (np.hstack([log[f"state/Q{of}"], log[f"state/Qdot{of}"]]) for of in ("", "_true"))
    np.testing.assert_allclose(seen - true, noise, atol=1e-15)
    np.testing.assert_array_equal(true[:, :9], log.ticks["Q"][::10])
    model = build_experiment(loaded).problem.model
    np.testing.assert_allclose(log["pose/xi"], np.asarray(model.g(true[:, :9].T)).T, atol=1e-12)
    np.testing.assert_allclose(log.final["xi"], np.asarray(model.g(log.final["Q"])).ravel(), atol=1e-12)
    assert (log["final/Q"] != log.final["Q"]).all()


def test_a_payload_is_held_from_the_end_of_one_stage_to_the_beginning_of_another(logged: Logged) -> None:
    log = logged(PAYLOAD, "object.let_go_by=back", *REDUCED_LOG)
    np.testing.assert_array_equal(held(log), log["window/first"] == 1)
    assert held(log).any()
    taken, let_go = np.flatnonzero(np.diff(held(log).astype(int))) + 1
    energy = log["payload/energy"]
    assert set(np.flatnonzero(energy)) == {taken, let_go}
    assert energy[taken] < 0
    assert np.abs(log["balance/momentum"]).max() < 1e-9
    assert np.abs(log["balance/energy"]).max() < 1e-9


@pytest.mark.slow
def test_knowing_the_payload_brings_the_robot_nearer_to_its_plans(logged: Logged) -> None:
    off = [
        np.abs(log["deviation/Qdot"][held(log)][1:]).max()
        for log in (logged(f"{PAYLOAD[:-1]}, known: {known}}}", *REDUCED_LOG) for known in ("true", "false"))
    ]
    assert off[0] < 0.1 * off[1]


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["ideal", "rk4"])
def test_a_delay_shifts_the_controls(logged: Logged, plant: str) -> None:
    """Nothing moves before the first control arrives; then it is the one of so many samples before."""
    changes = (f"plant.kind={plant}", "log.shares=false")
    prompt, late = logged(*changes), logged(*changes, "uncertainty.delay=0.2 s", "controller.delay=0")
    assert (late["control/u"][:2] == 0).all()
    np.testing.assert_array_equal(late["state/Q_true"][:3], np.tile(late["state/Q_true"][0], (3, 1)))
    np.testing.assert_array_equal(late["control/u"][2], prompt["control/u"][0])
    assert np.abs(late["control/u"][3] - prompt["control/u"][1]).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("offset_free", ["false", "true"])
def test_a_known_delay_is_foreseen_exactly_by_the_plant_of_the_plans(logged: Logged, offset_free: str) -> None:
    changes = ("plant.kind=ideal", "log.shares=false", f"controller.offset_free={offset_free}")
    prompt = logged(*changes)
    known = logged(*changes, "uncertainty.delay=0.3 s", "controller.delay=0.3 s")
    assert len(prompt.time) + 3 == len(known.time)
    np.testing.assert_allclose(known["state/Q"][:-3], known["state/Q_true"][3:], atol=1e-12)
    np.testing.assert_allclose(known["state/Q_true"][3:], prompt["state/Q"], atol=1e-7)


def test_an_impulse_comes_at_its_tick(logged: Logged) -> None:
    blow = "uncertainty.impulse={at: 0.23, linear: [0, 2], angular: 0.1}"
    log, quiet = (logged(*changes, "log.ticks=true", *REDUCED_LOG, samples=4) for changes in ((blow,), ()))
    apart = np.abs(log.ticks["v"] - quiet.ticks["v"]).max(axis=1)
    assert apart[23] < 1e-9 < 1e-2 < apart[24]
    assert np.abs(log["balance/momentum"]).max() < 1e-6


STICKY = "uncertainty.friction.coulomb=0.1"
WRIST = (
    "skills.move.weights={base: [100, 100, 10], arms: [100, 100, 10], control: 0.03}",
    "stages=[{name: turn, skill: move, target: {base: [0, 0, 0], arm_1: [0, 0, 0.2], arm_2: [0, 0, 0]}, "
    "ends_when: {coordinates: all, tolerance: 2e-3}}]",
    *("object=null", "monitors=[]", "published={}", "time_limit=6"),
)
"""One joint turns whose friction is more than the torque that the plan has for it."""


@pytest.mark.slow
@pytest.mark.parametrize("known", [1, 6])
def test_integral_action_bears_a_known_delay(logged: Logged, known: int) -> None:
    """Six samples late, an estimate from what is foreseen instead of what was measured would diverge."""
    late = (f"uncertainty.delay={known / 10} s", f"controller.delay={known / 10} s", "controller.offset_free=true")
    log = logged(BODIES, "uncertainty.friction.viscous=0.1", *WRIST, *late, *REDUCED_LOG, "time_limit=12")
    assert log.attributes["finished"]
    assert np.abs(log["state/Qdot_true"]).max() < 0.3


@pytest.mark.parametrize("offset_free", ["false", "true"])
def test_integral_action_gets_over_friction(logged: Logged, offset_free: str) -> None:
    log = logged(STICKY, *WRIST, f"controller.offset_free={offset_free}", *REDUCED_LOG)
    assert bool(log.attributes["finished"]) == (offset_free == "true")
    assert ("control/disturbance" in log) == (offset_free == "true")
    assert np.abs(log["balance/energy"]).max() < 1e-6


def test_what_remains_at_the_end_is_told_of_the_true_state_too(logged: Logged) -> None:
    log = logged(NOISE, *REDUCED_LOG)
    found = log.summary().end_errors
    assert found is not None
    measured, true = found
    assert measured <= 1
    assert true != measured
    assert logged(*REDUCED_LOG, samples=1).summary().end_errors is None


def test_friction_too_stiff_for_the_step_is_refused(logged: Logged) -> None:
    with pytest.raises(InputError, match=r"uncertainty\.friction: found a step of 0\.002 s, expected at most"):
        logged("uncertainty.friction={coulomb: 1, width: 1e-3}")
