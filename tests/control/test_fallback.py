"""What a controller does where a solve fails: the shifted plan, braking, rest."""

from collections.abc import Callable

import numpy as np

from psmpc_cli.control import Controller, State
from psmpc_cli.control.fallback import PlansInForce
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.simulation.run import Experiment, build_experiment, closed_loop
from psmpc_cli.specs.load import load_task

from ..ocp.transport_windows import sequence_of
from .short_transports import QUICK, SHORT, run, states, with_failures

Build = Callable[..., Experiment]


def test_a_failed_solve_leaves_the_shifted_plan(experiment_of: Build) -> None:
    samples, ending = run(with_failures(experiment_of(*SHORT), lambda window: 0.45 < window.start < 0.95))
    failed = [sample.command for sample in samples if "solve_failed" in sample.command.events]
    assert [round(command.time, 1) for command in failed] == [0.5, 0.6, 0.7, 0.8, 0.9]
    assert all(command.outcome.name == "ITERATION_LIMIT" for command in failed)
    before = next(sample.command for sample in samples if round(sample.command.time, 1) == 0.4)
    np.testing.assert_allclose(failed[0].switch_times, before.switch_times)
    assert ending.completed


def test_when_the_plan_is_used_up_the_robot_brakes_to_rest_and_the_run_stops(experiment_of: Build) -> None:
    samples, ending = run(with_failures(experiment_of(*QUICK), lambda window: window.start > 0.95))
    assert (ending.stuck, ending.completed) == (True, False)
    assert "braked to rest" in ending.reason
    assert np.abs(ending.state[9:]).max() < 1e-9
    braking = [sample.command.time for sample in samples if "braking" in sample.command.events]
    assert 0.9 + 4.0 - 0.15 <= braking[0] <= 0.9 + 4.0


def test_without_a_plan_the_robot_stays_at_rest(experiment_of: Build) -> None:
    samples, ending = run(with_failures(experiment_of(*QUICK), lambda window: True))
    assert ending.stuck
    assert np.all(states(samples) == 0)


def test_a_robot_that_moves_brakes_at_once_where_its_first_solve_fails() -> None:
    """A joint 5 deg beyond its limit, outward at 0.15 rad/s: no window has a solution under hard limits."""
    task = load_task("transport", QUICK)
    controller = Controller(task)
    Q, v = np.zeros(9), np.zeros(9)
    Q[3] = np.radians(5) + controller.problem.stages[0].limits.position_high[3]
    v[3] = 0.15
    command = controller.step(0.0, State(Q, v))
    assert "solve_failed" in command.events
    end = command.plan.states_at(np.array([0.5, task.spec.controller.horizon]))
    np.testing.assert_allclose(end[:, 9:], 0, atol=1e-12)
    np.testing.assert_allclose(end[:, 3], Q[3] + 0.5 / 2 * 0.15)


def test_a_plan_is_trusted_no_further_than_to_the_end_of_a_stage() -> None:
    plan = resting_plan(0.0, 8.0, 4, np.zeros(18))
    plans = PlansInForce().on_success(plan, sequence_of(2, [3.0, 5.0])).fully_trusted()
    for stage, end in ((2, 3.0), (3, 5.0), (4, 8.0)):
        trusted = plans.trusted_to_end_of(stage)
        assert not trusted.expires_before_next(end - 0.11, 0.1)
        assert trusted.expires_before_next(end - 0.09, 0.1)


def test_a_switch_that_is_due_takes_place_where_the_measured_state_is_near_its_target() -> None:
    """4 tolerances past it, a few milliseconds before the switch: no motion corrects that in time.

    Soft limits would let the robot rush there and past it, and without the stage that waits it turns back.
    """
    experiment = build_experiment(load_task("transport", {"controller.nodes": 25, "controller.soft_limits": True}))
    controller = experiment.controller
    for sample in closed_loop(experiment):
        command = sample.command
        if len(command.switch_times) and command.switch_times[0] < command.time + 0.105:
            break
    planned, x = command.switch_times[0], sample.ticks.states[-1].copy()
    x[0] -= 4 * command.stage.end.tolerance[0]
    due = controller.step(command.time + 0.1, State.of(x))
    assert 0.001 < planned - due.time < 0.005
    np.testing.assert_array_equal(due.switch_times, planned)
    after = controller.step(due.time + 0.1, State.of(x))
    assert [(switch.stage, switch.time) for switch in after.switches] == [(command.stage.index, planned)]
