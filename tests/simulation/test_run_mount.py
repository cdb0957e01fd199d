"""Runs in which a mount holds the base in one stage, which moves before and after it."""

from functools import cache

import numpy as np
import pytest

from psmpc_cli.control import State
from psmpc_cli.control.controller import Controller
from psmpc_cli.logs.run import Run
from psmpc_cli.simulation.run import simulate
from psmpc_cli.simulation.verify import Verification

from ..docking import BESIDE, docking


@cache
def docked(plant: str) -> Run:
    """The run of it in a plant."""
    return simulate(docking({"plant.kind": plant}))


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["rk4", "mujoco"])
def test_the_base_stands_still_while_the_mount_holds_it_and_moves_before_and_after(plant: str) -> None:
    run = docked(plant)
    assert run.summary().succeeded
    closes, opens, _ = run.stages["switch_time"]
    times = run["ticks/time"]
    held = (times > closes + 0.005) & (times < opens - 0.005)
    assert held.sum() > 100
    assert (run["ticks/Qdot"][held][:, :3] == 0).all()
    assert (run["ticks/Q"][held][:, :3] == run["ticks/Q"][held][0, :3]).all()
    assert (run["ticks/F"][held][:, :3] == 0).all()
    assert np.abs(run["ticks/Qdot"][held][:, 3:]).max() > 0.05
    assert np.abs(run["ticks/Qdot"][times < closes][:, :3]).max() > 5e-3
    assert np.abs(run["ticks/Qdot"][times > opens][:, :3]).max() > 5e-3
    within = (run.time >= closes) & (run.time + 0.1 <= opens)
    assert np.abs(run["deviation/Q"][within]).max() < 1e-4
    assert (run["thrusters/firings"][within] == 0).all()


@pytest.mark.slow
def test_what_is_left_of_the_motion_when_the_mount_closes_is_among_impulse_and_work() -> None:
    """By the balances, to the accuracy of the integrator; without the blow the momentum is off by that of the base."""
    run = docked("rk4")
    closes = run.stages["switch_time"][0]
    at = int(np.searchsorted(run["ticks/time"], closes + 1e-9)) - 1
    assert np.abs(run["ticks/Qdot"][at - 1, :3]).max() > 1e-5
    assert np.ptp(run["balance/momentum"], axis=0).max() < 1e-6
    assert np.ptp(run["balance/energy"]) < 1e-6


@pytest.mark.slow
def test_the_closed_loop_is_verified_through_the_mount() -> None:
    """All samples but those in which the mount closes and opens."""
    run = docked("rk4")
    verification = Verification(run, every=5)
    assert len(run.time) - 2 <= verification.samples < len(run.time)
    assert verification.loop["plant"].value < 1e-6
    assert any("a mount closes or opens" in remark for remark in verification.remarks)


def test_the_force_in_a_loop_of_ones_own_is_that_of_the_mounted_robot() -> None:
    """F_j = H_jj u_j + C_j, and none on the base."""
    task = docking({"stages.dock.mobility": "fixed", "initial": {"base": [0, 0, 0], **BESIDE}})
    controller = Controller(task)
    model = controller.problem.model
    Q = np.concatenate([[0, 0, 0], np.radians([20, 60, 40, -20, -60, -40])])
    v = np.concatenate([np.zeros(3), 0.1 * np.arange(6)])
    command = controller.step(0.0, State(Q, v))
    F = command.force(0.0, State(Q, v))
    assert (F[:3] == 0).all()
    expected = model.mass_matrix(Q)[3:, 3:] @ command.u[0, 3:] + model.bias(Q, v)[3:]
    np.testing.assert_allclose(F[3:], expected, atol=1e-9)
