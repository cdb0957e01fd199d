from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import yaml

from psmpc_cli.control import Command, Controller, State
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import Experiment, closed_loop, simulate
from psmpc_cli.solvers import build_solver
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.robot import stack

from ..ocp.transport_windows import sequence_of
from ..short_runs import TASK
from .short_transports import SHORT, Unreliable, run

Build = Callable[..., Experiment]


STEPPED = {
    "psmpc": {},
    "automatic nodes": {"controller.nodes": "auto", "solver.kind": "sqp"},
    "several starts": {"controller.multistart": 3, "controller.pending_cost": 0.1},
    "known delay": {"controller.delay": "0.2 s", "uncertainty.delay": "0.2 s", "controller.offset_free": True},
    "delay to be found": {"uncertainty.delay": "0.2 s"},
    "htmpc": {"controller.kind": "htmpc"},
    "sqp": {"solver.kind": "sqp", "controller.offset_free": True},
}


def stepped(task: Task) -> list[Command]:
    """Step a controller by hand against a double integrator, which commands reach as late as the task says."""
    controller, model = Controller(task), RobotModel(task.robot)
    spec, tick = task.spec.controller, 1 / task.spec.plant.low_level_rate
    Q, v = np.zeros(model.n), np.zeros(model.n)
    late = round(task.spec.uncertainty.delay / spec.sample_time)
    commands: list[Command] = []
    while True:
        now = len(commands) * spec.sample_time
        commands.append(controller.step(now, State(Q, v)))
        if now >= controller.sequence.ended_at - 1e-9:
            return commands
        acting = len(commands) - 1 - late
        u = commands[acting].u if acting >= 0 else np.zeros_like(commands[0].u)
        Qdot = np.vstack([v, v + tick * np.cumsum(u, axis=0)])
        Q = np.cumsum(np.vstack([Q, tick * Qdot[:-1] + tick**2 / 2 * u]), axis=0)[-1]
        v = Qdot[-1]


def acting(commands: list[Command], task: Task) -> list[np.ndarray]:
    """Return the accelerations (M, n) that act at each sample."""
    late = round(task.spec.uncertainty.delay / task.spec.controller.sample_time)
    return [np.zeros_like(commands[0].u)] * late + [command.u for command in commands[: len(commands) - late]]


def assert_decided_as_simulated(task: Task) -> None:
    """Check decisions by hand and in a simulation, bit for bit."""
    *commands, last = stepped(task)
    simulated = simulate(task)
    for path, mine in (
        ("time", [c.time for c in commands]),
        ("control/u", [u[0] for u in acting(commands, task)]),
        ("delay/expected", [c.delay for c in commands]),
        ("window/first", [c.stage.index for c in commands]),
        ("solver/objective", [c.solution.J for c in commands]),
        ("solver/iterations", [c.iterations for c in commands]),
        *((f"events/{name}", [name in c.events for c in commands]) for name in ("appended", "postponed", "braking")),
    ):
        np.testing.assert_array_equal(simulated[path], mine)
    for k, command in enumerate(commands):
        switch_times = simulated["window/instants"][k]
        np.testing.assert_array_equal(switch_times[np.isfinite(switch_times)], command.switch_times)
    switches = [switch for command in (*commands, last) for switch in command.switches]
    assert [stage for stage, _ in switches] == list(range(len(task.spec.stages)))
    np.testing.assert_array_equal([time for _, time in switches], simulated.stages["switch_time"])


@pytest.mark.slow
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
    assert np.abs(state.vector).max() < 1e-3


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
        np.testing.assert_array_equal(one.command.state, other.command.state)
        np.testing.assert_array_equal(one.command.u, other.command.u)
        np.testing.assert_array_equal(one.command.switch_times, other.command.switch_times)


def test_hard_switching_never_looks_past_the_current_stage(experiment_of: Build) -> None:
    samples, ending = run(experiment_of(*SHORT, "controller.kind=hard"))
    assert ending.completed
    assert all(len(sample.command.switch_times) == 0 for sample in samples)
    assert not any(sample.metrics["window/presence"] for sample in samples)


def test_a_solve_of_stages_that_were_solved_is_warm(decisions: list[Command]) -> None:
    """Unless a stage has appeared every solve starts from the last solution, moved in time, or from what is left."""
    for before, after in pairwise(decisions):
        stages, stages_before = ([s.index for s in d.solution.window.stages] for d in (after, before))
        assert after.solution.warm == (stages == stages_before[-len(stages) :])


def test_the_objective_is_made_of_the_costs_of_the_stages(experiment_of: Build) -> None:
    """J = sum of omega_s J_s, and the pending cost of the stages that wait."""
    for sample in closed_loop(experiment_of(*SHORT)):
        command, window = sample.command, sample.command.solution.window
        if "solve_failed" not in command.events:
            pending = window.omega.max() * np.sum(command.switch_times - command.time)
            expected = window.omega @ command.solution.costs + pending
            assert pytest.approx(expected, rel=1e-6) == command.solution.J


@pytest.mark.parametrize(("stage", "ends"), [("approach", False), ("capture", True), ("transport", True)])
def test_a_stage_is_over_once_grippers_have_acted_at_its_planned_end(stage: str, ends: bool) -> None:
    """Though its plan could not be renewed at the sample before, and the robot is far from its target."""
    task = load_task("transport_grasp", {"controller.nodes": 4, "stages.transport.ends_when.object": None})
    problem = build_problem(task)
    controller = Controller(problem, Unreliable(build_solver(problem, task.spec.solver), lambda window: True))
    names = [each.name for each in problem.stages]
    state = State(stack(task.spec.initial, task.robot, "joint") + 0.2, np.zeros(problem.model.n))
    controller.step(0.9, state)
    sequence = sequence_of(names.index(stage), [0.95])
    controller.memory = replace(controller.memory, sequence=sequence)
    assert names.index(stage) + 1 in (problem.held_stages.start, problem.held_stages.stop) or not ends
    controller.step(1.0, state)
    assert controller.sequence.first == names.index(stage) + ends
