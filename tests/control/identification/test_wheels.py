"""What the controller takes wheels to store: what is measured, or follows from sample to sample; torques of motors."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.control.identification.wheels import WheelEstimate, WheelEstimator
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.plant.base import Setpoints
from psmpc_cli.simulation.run import build_experiment
from psmpc_cli.specs.load import Task

from ...wheeled import changing_in, planar_in, spatial_in


@pytest.mark.parametrize("build", [planar_in, spatial_in])
def test_what_wheels_store_follows_where_it_is_not_measured(tmp_path: Path, build: Callable[..., Task]) -> None:
    """From sample to sample without a drift: to rounding, as long as no motor is cut; with the split of the torques."""
    experiment = build_experiment(build(tmp_path, {}, torque=10.0))
    drive = experiment.drive
    assert drive is not None
    x = experiment.initial_state
    for sample in range(30):
        time = 0.1 * sample
        command = experiment.controller.step(time, psmpc.State.of(x))
        np.testing.assert_allclose(command.wheels, drive.momentum, rtol=0, atol=1e-12)
        state = psmpc.State.of(x, drive.momentum)
        torques = command.motor_torques(time, state)
        ticks = experiment.plant.advance(time, x, Setpoints(command.u, driven=command.driven))
        assert ticks.wheels is not None
        np.testing.assert_allclose(torques, ticks.wheels.torque[0], rtol=0, atol=1e-12)
        F = command.force(time, state)
        np.testing.assert_allclose(F, ticks.F[0], rtol=0, atol=1e-11)
        x = ticks.states[-1]
    assert np.abs(drive.momentum - drive.wheels.initial).max() > 1e-3
    with pytest.raises(
        psmpc.InputError, match=rf"found wheels \(7,\), expected \({drive.wheels.count},\), one of each"
    ):
        experiment.controller.step(3.0, psmpc.State.of(x, np.zeros(7)))


def test_what_wheels_store_while_thrusters_unload_them(tmp_path: Path) -> None:
    experiment = build_experiment(changing_in(tmp_path, {}, unloading=0.004))
    drive = experiment.drive
    assert drive is not None
    drive.momentum = drive.wheels.initial + 0.01
    x = experiment.initial_state
    first = psmpc.State.of(x, drive.momentum)
    for sample in range(5):
        state = psmpc.State.of(x) if sample else first
        command = experiment.controller.step(0.1 * sample, state)
        np.testing.assert_allclose(command.wheels, drive.momentum, rtol=0, atol=1e-12)
        x = experiment.plant.advance(0.1 * sample, x, Setpoints(command.u, driven=command.driven)).states[-1]
    assert np.abs(drive.momentum - drive.wheels.initial).max() < 0.009


def test_what_stages_to_come_start_from(tmp_path: Path) -> None:
    """Thrusters, wheels, nothing, thrusters: what wheels store stays but where they turn the base; there L does."""
    problem = build_problem(changing_in(tmp_path))
    model = problem.model
    estimator = WheelEstimator(problem)
    wheels = estimator.wheels
    random = np.random.default_rng(2)
    states = []
    for stage in range(4):
        Q = model.space.path(model.neutral, 0.2 * random.standard_normal((1, model.n)))[-1]
        states.append((stage, Q, 0.1 * random.standard_normal(model.n)))
    _, Q, v = states[0]
    h = wheels.initial
    stored = estimator.stored_in_stages(WheelEstimate(h, 0.0, Q, v), states)
    np.testing.assert_allclose(stored[0], wheels.axes @ h, atol=1e-15)
    _, Q, v = states[1]
    L = model.momentum(Q, v, model.nominal.storing(wheels.axes @ h))[model.space.rotation]
    np.testing.assert_allclose(stored[1], L, atol=1e-14)
    _, Q, v = states[2]
    kept = model.momentum(Q, v, model.nominal.storing(stored[2]))[model.space.rotation]
    np.testing.assert_allclose(kept, L, atol=1e-14)
    np.testing.assert_allclose(stored[3], stored[2], atol=1e-15)


def test_a_wheel_that_is_not_measured_follows(tmp_path: Path) -> None:
    problem = build_problem(spatial_in(tmp_path))
    model = problem.model
    estimator = WheelEstimator(problem)
    rest = np.zeros(model.n)
    first = estimator.after_measurement(None, 0, 0.0, model.neutral, rest, None)
    np.testing.assert_array_equal(first.momentum, estimator.wheels.initial)
    measured = np.array([0.2, np.nan, 0.1, np.nan])
    then = estimator.after_measurement(first, 0, 0.1, model.neutral, rest, measured)
    np.testing.assert_allclose(then.momentum, [0.2, *estimator.wheels.initial[1:2], 0.1, 0.0], atol=1e-15)


def test_motor_torques_are_of_robots_with_wheels() -> None:
    controller = psmpc.Controller(psmpc.load_task("transport", {"controller.nodes": 5}))
    state = psmpc.State(np.zeros(9), np.zeros(9))
    command = controller.step(0.0, state)
    assert command.wheels.shape == (0,)
    with pytest.raises(psmpc.InputError, match="found planar_dual_arm, expected a robot with wheels"):
        command.motor_torques(0.0, state)
    with pytest.raises(psmpc.InputError, match="expected none: planar_dual_arm has none"):
        controller.step(0.1, psmpc.State(np.zeros(9), np.zeros(9), np.zeros(2)))
