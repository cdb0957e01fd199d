"""One run: the experiment that a task describes, and its closed loop."""

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

from psmpc_cli.control.controller import Controller
from psmpc_cli.control.interface import Command, State
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.native.compiled import library_of
from psmpc_cli.native.library import Library, compile_all
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.plant import Plant, build_plant, ticks_of
from psmpc_cli.plant.grasp import build_capture
from psmpc_cli.plant.rk4 import capture_tick, tick_function
from psmpc_cli.plant.uncertainty import Uncertainty, disturbs, force_limits_of
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.measures import Counterfactuals, Meter
from psmpc_cli.simulation.recorder import Ending, RecordedLoop, Watch, libraries_of, record
from psmpc_cli.specs.arguments import as_path, require, require_callable, require_whole
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robot import stack
from psmpc_cli.specs.task import TaskSpec


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment(RecordedLoop):
    """Everything one run needs. Controller, counterfactuals and plant hold state: build a new experiment for every run.

    Attributes:
        controller: The controller.
        plant: The physics.
    """

    controller: Controller
    plant: Plant


def build_experiment(loaded: Task) -> Experiment:
    """Build the experiment that a task describes: its controller, its plant, and what disturbs them."""
    problem = build_problem(loaded)
    task = problem.spec
    model = problem.model
    compiled = compile_for(problem)
    controller = Controller(problem)
    uncertainty = Uncertainty(task, model) if task.uncertainty.in_force else None
    friction = None if uncertainty is None else uncertainty.friction
    capture = build_capture(task, model)
    Q = stack(task.initial, loaded.robot, "joint")
    return Experiment(
        problem=problem,
        controller=controller,
        counterfactuals=Counterfactuals(controller),
        plant=build_plant(task.plant, model, compiled, friction, capture, force_limits_of(task, model.spec)),
        uncertainty=uncertainty,
        capture=capture,
        initial_state=np.r_[Q, stack(task.initial_velocity, loaded.robot, "joint", 0.0, of_error=True)],
        compiled=compiled,
        plant_kind=task.plant.kind,
    )


def converging(loaded: Task) -> Task:
    """Change the solver of a task to one that solves each window to its optimum, however long that takes.

    What is asked of single windows, such as a front, is about their optima; in closed loop one iteration a sample is
    enough because the next sample goes on from there.
    """
    solver = loaded.spec.solver.to_optimum().model_copy(update={"deadline": None})
    return replace(loaded, spec=loaded.spec.model_copy(update={"solver": solver}))


def compile_for(problem: Problem) -> bool:
    """Compile what a run of a problem needs and is not in the cache, several libraries at once.

    Returns:
        Whether the run uses compiled code: the task allows it, needs some, and all of it could be made.
    """
    return problem.spec.solver.compiled and compile_all(libraries_for(problem))


def libraries_for(problem: Problem) -> list[Library]:
    """Return what a run of a problem compiles, of its solver and its plant."""
    task = problem.spec
    ticks = _tick_functions(task, problem.model) if task.plant.traits.compiles else []
    return [*libraries_of(problem), *map(library_of, ticks)]


def _tick_functions(task: TaskSpec, model: RobotModel) -> list[ca.Function]:
    """Build the functions that the plant `rk4` of a task evaluates at every tick, which a run compiles beforehand."""
    tick, substeps = ticks_of(task.plant)
    capture = build_capture(task, model)
    is_limited = force_limits_of(task, model.spec) is not None
    laws = [False, True] if task.acts_in_task_space else [False]
    if capture is not None:
        return [capture_tick(capture, substeps, disturbs(task), is_limited, law) for law in laws]
    return [tick_function(model, tick, substeps, disturbs(task), is_limited, law) for law in laws]


DIVERGED = 1e9
"""Norm of states and forces, in units of the SI, beyond which a motion has diverged."""


def closed_loop(experiment: Experiment, until: int | None = None) -> Generator[Sample, None, Ending]:
    """Run the closed loop of an experiment: yield its samples, and return how it ended.

    Args:
        experiment: The experiment, built for this run alone.
        until: Index of the stage at whose end the loop stops; by default that of the task.
    """
    controller = experiment.controller
    plant = experiment.plant
    uncertainty = experiment.uncertainty
    capture = experiment.capture
    meter = Meter(experiment.counterfactuals, uncertainty, capture, experiment.initial_state)
    state = experiment.initial_state
    braking_until = np.inf
    sample_number = 0
    stage = 0
    sample_time = experiment.problem.spec.controller.sample_time
    time_after_end = experiment.problem.spec.time_after_end
    delays = _Delays(experiment.problem.spec, experiment.initial_state, experiment.problem.model.space)
    while True:
        now = sample_number * sample_time
        measured = delays.measured(state if uncertainty is None else uncertainty.measured(sample_number, state))
        object_pose = None if capture is None else delays.measured_object(capture.measured(sample_number))
        command = controller.step(now, State.of(measured), object_pose)
        if (ending := _ending(experiment, command, state, braking_until, time_after_end)) is not None:
            return ending
        if any(switch.stage == until for switch in command.switches):
            return Ending(False, "stopped at the end of a stage", now, command.state, state, command.switches)
        braking_until = command.plan.end if "braking" in command.events else np.inf
        previous_stage = stage
        stage = command.sequence.first
        contact = None
        u, closed, twist_rates = delays.commanded(command)
        if uncertainty is None:
            ticks = plant.advance(now, state, u, None, closed, twist_rates)
        else:
            contact = uncertainty.contact(state, previous_stage, stage)
            ticks = uncertainty.advance(plant, sample_number, now, contact.state, u, stage, closed, twist_rates)
        if (
            not np.vdot(ticks.states, ticks.states) + np.vdot(ticks.F, ticks.F) < DIVERGED**2
        ):  # nor where it is not a number
            reason = "the motion diverged, faster than it can be simulated"
            return Ending(False, reason, now, command.state, state, command.switches, stuck=True)
        yield meter.measure(command, ticks, state, u, contact)
        state = ticks.states[-1]
        sample_number += 1


class _Applied(NamedTuple):
    """What reaches the robot over a sample: accelerations, whether to close, and rates of twists; see `Command`."""

    u: np.ndarray
    closed: np.ndarray
    twist_rates: np.ndarray | None = None


class _Delays:
    """Delays measurements on their way to the controller, and controls on their way to the robot.

    Time is that at which a control acts. The controller knows of c samples: what it decides at sample k was measured at
    k - c. The rest of the delay it does not know of: controls reach the robot late by so many samples.
    """

    def __init__(self, task: TaskSpec, initial_state: np.ndarray, space: ConfigurationSpace) -> None:
        """Start with a robot that drifts into its initial state, and zero controls under way."""
        known_delay = task.controller.known_delay
        Q, v = np.split(initial_state, [space.nq])
        n = space.n
        none = np.zeros((round(task.controller.sample_time * task.plant.low_level_rate), n))
        before = (-back * task.controller.sample_time * v for back in range(known_delay, 0, -1))
        self._measured: deque[np.ndarray] = deque(np.r_[np.array(space.integrate(Q, step)), v] for step in before)
        self._poses: deque[np.ndarray | None] = deque([None] * known_delay)
        self._commanded = deque([_Applied(none, np.zeros(len(none), bool))] * (task.uncertainty.delay - known_delay))

    def measured(self, state: np.ndarray) -> np.ndarray:
        """Take in the state that is measured now, and return the one that reaches the controller now."""
        self._measured.append(state)
        return self._measured.popleft()

    def measured_object(self, pose: np.ndarray) -> np.ndarray | None:
        """Take in the pose of the object that is measured now, and return the one that reaches the controller now.

        None reaches it before the first one has come through.
        """
        self._poses.append(pose)
        return self._poses.popleft()

    def commanded(self, command: Command) -> "_Applied":
        """Take in what is commanded now, and return what acts now."""
        self._commanded.append(_Applied(command.u, command.closed, command.twist_rates))
        return self._commanded.popleft()


def _ending(
    experiment: Experiment, command: Command, state: np.ndarray, braking_until: float, time_after_end: float
) -> Ending | None:
    """Return the ending if the run is over: last stage at its target, time limit, or at rest without a plan."""
    now = command.time
    switches = command.switches
    if now >= experiment.controller.sequence.ended_at + time_after_end - 1e-9:
        return Ending(
            True, f"{experiment.problem.stages[-1].name} met its end condition", now, command.state, state, switches
        )
    if now >= braking_until - 1e-9:
        cause = "the state was not measured" if "unmeasured" in command.events else "no window could be solved"
        reason = f"{cause} and the plan was used up; the robot braked to rest"
        return Ending(False, reason, now, command.state, state, switches, stuck=True)
    if now >= experiment.problem.spec.time_limit - 1e-9 and not experiment.controller.done:
        reason = f"time limit of {experiment.problem.spec.time_limit:g} s reached"
        return Ending(False, reason, now, command.state, state, switches)
    return None


def simulate(
    task: Task,
    path: Path | str | None = None,
    watch: Watch = lambda sample: None,
    force: bool = False,
    until: int | None = None,
) -> Run:
    """Run a task in closed loop and return the run.

    An interruption (KeyboardInterrupt, from anywhere or raised by the watcher) ends the run cleanly: it holds
    everything up to then, is not `finished`, and has no final time. Any other error of the watcher is raised; the log
    holds everything up to then as well, and names it. The arrays of samples are read-only.

    Args:
        task: The task.
        path: Its log; in memory alone by default.
        watch: Called with each sample.
        force: Overwrite an earlier log.
        until: Index of the stage at whose end the run stops; by default that of the task.

    Raises:
        InputError: An argument is of another type, or the log exists already or cannot be written.
        RunError: The log could not be written any further.
    """
    require("task", task, Task, "a Task, from load_task")
    path = None if path is None else as_path("path", path)
    require_callable("watch", watch, "a sample")
    require("force", force, bool, "True or False")
    if until is not None:
        require_whole("until", until, least=0, most=len(task.spec.stages) - 1)
    experiment = build_experiment(task)
    return record(experiment, closed_loop(experiment, until), path, watch, force)
