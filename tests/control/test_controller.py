from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from time import perf_counter

import numpy as np
import pytest
import yaml

from psmpc_cli.control import Command, Controller, State
from psmpc_cli.errors import RunError
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import Experiment, build_experiment, closed_loop, simulate
from psmpc_cli.solvers import Solution, Solver
from psmpc_cli.specs.load import Task, load_task

from ..short_runs import TASK
from .short_transports import QUICK, SHORT, run, states, with_failures

Build = Callable[..., Experiment]

STEPPED = {
    "psmpc": {},
    "automatic nodes": {"controller.nodes": "auto", "solver.kind": "sqp"},
    "several starts": {"controller.multistart": 3, "controller.pending_cost": 0.1},
    "known delay": {"controller.known_delay": 2, "uncertainty.delay": 2, "controller.offset_free": True},
    "htmpc": {"controller.kind": "htmpc"},
    "sqp": {"solver.kind": "sqp", "controller.offset_free": True},
}


def stepped(task: Task) -> list[Command]:
    """Step a controller by hand against a double integrator, the state measured as late as the controller knows."""
    controller, model = Controller(task), RobotModel(task.robot)
    spec, tick = task.spec.controller, 1 / task.spec.plant.low_level_rate
    Q, v = np.zeros(model.n), np.zeros(model.n)
    measured = [State(Q, v)] * (spec.known_delay + 1)
    commands: list[Command] = []
    while not controller.done:
        commands.append(controller.step(len(commands) * spec.sample_time, measured[0]))
        u = commands[-1].u
        Qdot = np.vstack([v, v + tick * np.cumsum(u, axis=0)])
        Q = np.cumsum(np.vstack([Q, tick * Qdot[:-1] + tick**2 / 2 * u]), axis=0)[-1]
        v = Qdot[-1]
        measured = [*measured[1:], State(Q, v)]
    return commands


def assert_decided_as_simulated(task: Task) -> None:
    """Check decisions by hand and in a simulation, bit for bit."""
    *commands, last = stepped(task)
    simulated = simulate(task)
    for path, mine in (
        ("time", [c.time for c in commands]),
        ("control/u", [c.u[0] for c in commands]),
        ("window/first", [c.stage.index for c in commands]),
        ("solver/objective", [c.solution.J for c in commands]),
        ("solver/iterations", [c.iterations for c in commands]),
        *((f"events/{name}", [name in c.events for c in commands]) for name in ("appended", "postponed", "braking")),
    ):
        np.testing.assert_array_equal(simulated[path], mine)
    for k, command in enumerate(commands):
        instants = simulated["window/instants"][k]
        np.testing.assert_array_equal(instants[np.isfinite(instants)], command.instants)
    switches = [switch for command in (*commands, last) for switch in command.switches]
    assert [stage for stage, _ in switches] == list(range(len(task.spec.stages)))
    np.testing.assert_array_equal([time for _, time in switches], simulated.stages["switch_time"])


@pytest.mark.parametrize("changes", STEPPED.values(), ids=list(STEPPED))
def test_stepped_by_hand_it_decides_as_in_a_simulation(changes: dict[str, object]) -> None:
    assert_decided_as_simulated(load_task(yaml.safe_load(TASK), changes))


def test_stepped_by_hand_through_windows_with_several_switches() -> None:
    assert_decided_as_simulated(load_task("transport", SHORT))


def test_a_controller_that_is_done_holds_its_target() -> None:
    controller = Controller(load_task(yaml.safe_load(TASK)))
    state, commands = State(np.zeros(9), np.zeros(9)), list[Command]()
    for k in range(60):
        commands.append(controller.step(0.1 * k, state))
        state = State.of(commands[-1].plan.states_at(np.array([0.1 * (k + 1)]))[0])
    assert controller.done
    assert [switch.stage for command in commands for switch in command.switches] == [0, 1]
    assert np.abs(state.x).max() < 1e-3


def test_the_force_of_a_tick_is_computed_torque() -> None:
    task = load_task("transport", [*SHORT, "plant.kind=rk4", "log.ticks=true", "time_limit=0.2"])
    simulated = simulate(task)
    command = Controller(task).step(0.0, State(simulated["state/Q"][0], simulated["state/Qdot"][0]))
    for tick in (0, 1, 57, 99):
        state = State(simulated.ticks["Q"][tick], simulated.ticks["v"][tick])
        force = command.force(simulated.ticks["time"][tick], state)
        np.testing.assert_allclose(force, simulated.ticks["F"][tick], rtol=1e-9, atol=1e-12)


def test_smpc_is_psmpc_with_equal_priorities(experiment_of: Build) -> None:
    equal = [f"stages.{name}.priority=1" for name in ("approach", "capture", "transport", "release")]
    smpc, _ = run(experiment_of(*SHORT, "time_limit=2.5", "controller.kind=smpc"))
    psmpc, _ = run(experiment_of(*SHORT, "time_limit=2.5", *equal))
    assert len(smpc) == len(psmpc) > 20
    for one, other in zip(smpc, psmpc, strict=True):
        np.testing.assert_array_equal(one.command.x, other.command.x)
        np.testing.assert_array_equal(one.command.u, other.command.u)
        np.testing.assert_array_equal(one.command.instants, other.command.instants)


def test_hard_switching_never_looks_past_the_current_stage(experiment_of: Build) -> None:
    samples, ending = run(experiment_of(*SHORT, "controller.kind=hard"))
    assert ending.completed
    assert all(len(sample.command.instants) == 0 for sample in samples)
    assert not any(sample.metrics["window/presence"] for sample in samples)


def test_a_failed_solve_leaves_the_shifted_plan(experiment_of: Build) -> None:
    samples, ending = run(with_failures(experiment_of(*SHORT), lambda window: 0.45 < window.start < 0.95))
    failed = [sample.command for sample in samples if "solve_failed" in sample.command.events]
    assert [round(command.time, 1) for command in failed] == [0.5, 0.6, 0.7, 0.8, 0.9]
    assert all(command.outcome.name == "ITERATION_LIMIT" for command in failed)
    before = next(sample.command for sample in samples if round(sample.command.time, 1) == 0.4)
    np.testing.assert_allclose(failed[0].instants, before.instants)
    assert ending.completed


def test_when_the_plan_is_used_up_the_robot_brakes_to_rest_and_the_run_stops(experiment_of: Build) -> None:
    samples, ending = run(with_failures(experiment_of(*QUICK), lambda window: window.start > 0.95))
    assert (ending.stuck, ending.completed) == (True, False)
    assert "braked to rest" in ending.reason
    assert np.abs(ending.x[9:]).max() < 1e-9
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


def test_a_switch_that_is_due_takes_place_where_the_measured_state_is_near_its_target() -> None:
    """4 tolerances past it, a few milliseconds before the switch: no motion corrects that in time.

    Soft limits would let the robot rush there and past it, and without the stage that waits it turns back.
    """
    experiment = build_experiment(load_task("transport", {"controller.nodes": 25, "controller.soft_limits": True}))
    controller = experiment.controller
    for sample in closed_loop(experiment):
        command = sample.command
        if len(command.instants) and command.instants[0] < command.time + 0.105:
            break
    planned, x = command.instants[0], sample.ticks.X[-1].copy()
    x[0] -= 4 * command.stage.tolerance[0]
    due = controller.step(command.time + 0.1, State.of(x))
    assert 0.001 < planned - due.time < 0.005
    np.testing.assert_array_equal(due.instants, planned)
    after = controller.step(due.time + 0.1, State.of(x))
    assert [(switch.stage, switch.time) for switch in after.switches] == [(command.stage.index, planned)]


def test_an_append_that_cannot_be_solved_is_postponed(experiment_of: Build) -> None:
    fails = with_failures(experiment_of(*SHORT), lambda window: len(window.stages) > 1 and window.start < 0.95)
    samples, ending = run(fails)
    postponed = [s.command for s in samples if "postponed" in s.command.events and s.command.time < 0.95]
    assert postponed
    assert all(command.outcome.usable and len(command.instants) == 0 for command in postponed)
    assert ending.completed


def test_an_append_whose_solve_ran_out_of_iterations_goes_on_from_its_iterate(experiment_of: Build) -> None:
    changes = (*SHORT, "solver.kind=sqp")
    usual = next(s for s in closed_loop(experiment_of(*changes)) if "appended" in s.command.events).command
    limited = with_failures(experiment_of(*changes), lambda w: len(w.stages) > 1 and w.start < usual.time + 0.25)
    resumed = next(s for s in closed_loop(limited) if "appended" in s.command.events).command
    assert resumed.time == pytest.approx(usual.time + 0.3)
    assert resumed.solution.iterations < usual.solution.iterations


class Clocked(Solver):
    """A solver that records when each solve has to stop, by the beginning of its window."""

    deadline = 0.03

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self.stops = defaultdict[float, list[float]](list)

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        self.stops[window.start].append(self.stop_time(perf_counter()))
        return self.solver.solve(window, guess, previous, within)


def test_all_solves_of_a_sample_share_its_deadline(experiment_of: Build) -> None:
    fails = with_failures(experiment_of(*SHORT), lambda window: len(window.stages) > 1 and window.start < 0.95)
    clocked = Clocked(fails.controller.law.solver)
    list(closed_loop(replace(fails, controller=Controller(fails.problem, clocked))))
    several = [stops for stops in clocked.stops.values() if len(stops) > 1]
    assert several
    for window_with, *windows_without in several:  # which are left a share of it
        assert len(set(windows_without)) == 1
        assert 0 < windows_without[0] - window_with < Clocked.deadline
    lasts = [stops[-1] for stops in clocked.stops.values()]
    assert len(set(lasts)) == len(lasts)  # each sample has a deadline of its own


def test_a_state_that_is_not_measured_is_that_of_the_plan() -> None:
    controller = Controller(load_task("transport", SHORT))
    before = controller.step(0.0, State(np.zeros(9), np.zeros(9)))
    x = before.plan.states_at(np.array([0.1]))[0]
    Q = np.where(np.arange(9) == 2, np.nan, x[:9])
    command = controller.step(0.1, State(Q, x[9:]))
    assert "unmeasured" in command.events
    np.testing.assert_array_equal(command.x, x)


def test_without_a_measurement_nothing_begins() -> None:
    controller = Controller(load_task("transport", SHORT))
    with pytest.raises(RunError, match="nothing is measured at 0 s"):
        controller.step(0.0, State(np.full(9, np.nan), np.zeros(9)))


def test_a_solve_of_the_same_stages_is_warm(decisions: list[Command]) -> None:
    """Without an append or a drop every solve starts from the last solution, moved in time."""
    for before, after in pairwise(decisions):
        stages, stages_before = ([s.index for s in d.solution.window.stages] for d in (after, before))
        assert after.solution.warm == (stages == stages_before)


def test_the_objective_is_made_of_the_costs_of_the_stages(experiment_of: Build) -> None:
    """J = sum of omega_s J_s, and the pending cost of the stages that wait."""
    for sample in closed_loop(experiment_of(*SHORT)):
        command, window = sample.command, sample.command.solution.window
        if "solve_failed" not in command.events:
            pending = window.omega.max() * np.sum(command.instants - command.time)
            expected = window.omega @ command.solution.costs + pending
            assert pytest.approx(expected, rel=1e-6) == command.solution.J
