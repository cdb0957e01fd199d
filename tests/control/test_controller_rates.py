"""Changes of commanded accelerations in closed loop: what they cost, and how far limits of jerk hold, tick by tick."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from psmpc_cli.control import Command, Controller, State
from psmpc_cli.robot.motion import over_ticks
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.robots.robot import resolve_limits, stack

from ..free_flyer import turning
from .short_transports import Unreliable

SHARE = 1.03
"""Share of a limit of jerk that ticks may reach."""


WEIGHED = ("skills.move.weights.rate=0.01", "skills.gentle.weights.rate=0.01")


class Flown(NamedTuple):
    """What was commanded until the task was done.

    Attributes:
        u: Accelerations over the ticks of each sample (samples, M, n).
        stages: Index of the stage that each tick is in (samples, M).
        end: When the task was done [s].
        failed: Samples without a solution.
        excess: Largest excess of a limit of velocity, by coordinate (n,).
    """

    u: np.ndarray
    stages: np.ndarray
    end: float
    failed: int
    excess: np.ndarray


def flown(task: Task, longest: float = 30.0) -> Flown:
    """Step the controller of a task until it is done, on a robot that follows its commands exactly."""
    controller = Controller(task)
    space = controller.problem.model.space
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(controller.problem.model.n))
    limits = resolve_limits(task.robot, task.spec.limits)
    commanded = list[np.ndarray]()
    stages = list[np.ndarray]()
    excess = np.full(len(state.v), -np.inf)
    failed = 0
    time = 0.0
    while not controller.done and time < longest:
        command = controller.step(time, state)
        failed += "solve_failed" in command.events
        commanded.append(command.u)
        stages.append(command.sequence.first + np.searchsorted(command.switch_times, command.edges[:-1], side="right"))
        Q, v = over_ticks(space, state.Q, state.v, command.u, command.tick)
        excess = np.maximum(excess, np.maximum(v - limits.velocity_high, limits.velocity_low - v).max(axis=0))
        state = State(Q[-1], v[-1])
        time = round(time + task.spec.controller.sample_time, 6)
    assert controller.done
    return Flown(np.array(commanded), np.array(stages), time, failed, excess)


def there_and_back(*changes: str) -> Task:
    """The planar robot moves its base by 0.3 m, then its arms while the base comes back; control costs little."""
    weights: dict[str, Any] = {"base": [100, 100, 10], "arms": [10, 10, 10], "control": 0.01}
    end = {"coordinates": ["base"], "tolerance": 5e-3}
    return load_task(
        {
            "robot": "planar_dual_arm",
            "initial": {"base": [0, 0, 0], "arms": [0, 0, 0]},
            "controller": {"nodes": 20, "horizon": 3},
            "skills": {name: {"space": "joint", "weights": weights} for name in ("move", "gentle")},
            "stages": [
                {"name": "go", "skill": "move", "target": {"base": [0.3, 0.1, 0], "arms": [0, 0, 0]}, "ends_when": end},
                {
                    "name": "return",
                    "skill": "gentle",
                    "target": {"base": [0, 0, 0], "arms": [0.2, -0.2, 0.1]},
                    "ends_when": {**end, "coordinates": ["all"]},
                },
            ],
        },
        changes,
    )


def jerks(task: Task, run: Flown) -> np.ndarray:
    """Return the largest change of the acceleration from tick to tick, over the length of a tick, by coordinate."""
    ticks = run.u.reshape(-1, run.u.shape[2])
    return np.abs(np.diff(ticks, axis=0, prepend=0.0)).max(axis=0) * task.spec.plant.low_level_rate


def total_variation(run: Flown) -> float:
    """Sum of the changes of the accelerations from sample to sample, each at its first tick."""
    return float(np.abs(np.diff(run.u[:, 0], axis=0)).sum())


@pytest.mark.slow
def test_a_weight_on_the_rate_makes_commands_smooth() -> None:
    """Motions as fast as their limits allow take two samples more, in which accelerations build up and fall."""
    without, weighed = (flown(there_and_back(*change)) for change in ((), WEIGHED))
    assert total_variation(weighed) < 2 / 3 * total_variation(without)
    assert weighed.end <= without.end + 0.2 + 1e-9
    assert weighed.failed == 0


PLANAR = "limits={base: {jerk: [1, 1, 2]}, arm_1: {jerk: [2, 2, [-1, 2]]}}"
SPATIAL = "limits={base: {jerk: [0.4, 0.4, 0.4, 0.6, 0.6, 0.6]}, arms: {jerk: [2, 2, 2]}}"


@pytest.mark.parametrize("rate", [20.0, 1000.0])
def test_limits_of_jerk_hold_at_every_tick_of_a_planar_run(rate: float) -> None:
    task = there_and_back(PLANAR, f"plant.low_level_rate={rate}")
    run = flown(task)
    limits = resolve_limits(task.robot, task.spec.limits)
    changes = np.diff(run.u.reshape(-1, 9), axis=0, prepend=0.0) * rate
    assert (changes <= SHARE * limits.jerk_high).all()
    assert (changes >= SHARE * limits.jerk_low).all()
    assert run.failed == 0
    limited = np.isfinite(limits.jerk_high)
    assert (jerks(task, run)[~limited] > 2).any()  # what has no limit jumps as before


def test_ramps_exceed_limits_of_velocity_by_no_more_than_they_differ_from_plans() -> None:
    """By a quarter of the jerk times the square of an interval."""
    task = there_and_back(PLANAR)
    h = task.spec.controller.horizon / 20
    excess = flown(task).excess[:6]
    jerk = np.array([1, 1, 2, 2, 2, 2])
    assert (excess <= jerk * h**2 / 4).all()
    assert excess.max() > 1e-4  # the base gets as fast as it may


@pytest.mark.slow
def test_limits_of_jerk_hold_at_every_tick_of_a_spatial_run() -> None:
    task = turning(60, SPATIAL)
    run = flown(task)
    limits = resolve_limits(task.robot, task.spec.limits)
    assert (jerks(task, run) <= SHARE * limits.jerk_high).all()
    assert run.failed == 0


def test_limits_of_a_stage_hold_from_the_tick_on_at_which_it_begins() -> None:
    task = there_and_back("skills.gentle.limits={base: {jerk: [0.5, 0.5, 1]}}")
    run = flown(task)
    changes = np.abs(np.diff(run.u.reshape(-1, 9), axis=0, prepend=0.0)) * task.spec.plant.low_level_rate
    is_limited = run.stages.ravel() == 1
    assert (changes[is_limited, :3] <= SHARE * np.array([0.5, 0.5, 1.0])).all()
    assert changes[~is_limited, :3].max() > 10


def test_a_disturbance_that_is_taken_off_commands_makes_no_jump() -> None:
    task = there_and_back(PLANAR, "controller.offset_free=true", "uncertainty.noise.velocity=1e-3")
    run = flown(task)
    limits = resolve_limits(task.robot, task.spec.limits)
    assert (jerks(task, run) <= SHARE * limits.jerk_high).all()


def test_a_robot_without_a_plan_brakes_to_rest_within_limits_of_jerk() -> None:
    task = there_and_back(PLANAR, "limits.arm_2={jerk: [2, 2, 2]}", "controller.horizon=1", "controller.nodes=10")
    controller = Controller(task, Unreliable(Controller(task).law.solver, lambda window: window.start > 1.2))
    state = State(stack(task.spec.initial, task.robot, "joint"), np.zeros(9))
    commands = list[Command]()
    for sample in range(60):
        command = controller.step(0.1 * sample, state)
        commands.append(command)
        Q, v = over_ticks(controller.problem.model.space, state.Q, state.v, command.u, command.tick)
        state = State(Q[-1], v[-1])
    first = next(command for command in commands if "braking" in command.events)
    assert np.abs(first.state[9:]).max() > 0.1
    assert np.abs(state.v).max() < 1e-3
    ticks = np.vstack([command.u for command in commands])
    limits = resolve_limits(task.robot, task.spec.limits)
    assert (np.abs(np.diff(ticks, axis=0, prepend=0.0)) / 1e-3 <= SHARE * limits.jerk_high).all()
