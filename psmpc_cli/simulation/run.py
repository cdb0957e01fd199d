"""One run: the experiment that a task describes, and its closed loop."""

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from psmpc_cli.control.controller import Controller
from psmpc_cli.control.interface import Command, State
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import Sample
from psmpc_cli.native.compiled import library_of
from psmpc_cli.native.library import Library, compile_all
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.plant import Plant, Setpoints, Ticks, build_plant, ticks_of
from psmpc_cli.plant.grasp import build_capture
from psmpc_cli.plant.thrusters import firing_of
from psmpc_cli.plant.tick_functions import TickKind, capture_tick, tick_function
from psmpc_cli.plant.uncertainty import Uncertainty, disturbs, force_limits_of, stream
from psmpc_cli.plant.wheels import WheelDrive, drive_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.measures import Counterfactuals, Meter
from psmpc_cli.simulation.recorder import Ending, RecordedLoop, Watch, libraries_of, record
from psmpc_cli.specs.arguments import as_path, require, require_callable, require_whole
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robot import RobotSpec, stack
from psmpc_cli.specs.task import TaskSpec

NewTargets = Callable[[float], Mapping[str, Any] | None]
"""Tells at the time of a sample [s] which targets are others from then on: by the names of their stages, as a task file
has them; none, or None, most of the time."""


def no_new_targets(time: float) -> Mapping[str, Any]:
    """Return no targets: those of the task stay."""
    return {}


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment(RecordedLoop):
    """Everything one run needs. Controller, counterfactuals and plant hold state: build a new experiment for every run.

    Attributes:
        controller: The controller.
        plant: The physics.
        drive: The wheels of the plant; None of a robot without any.
        new_targets: Tells at each sample which targets are others from then on.
    """

    controller: Controller
    plant: Plant
    drive: WheelDrive | None = None
    new_targets: "NewTargets" = no_new_targets


def build_experiment(loaded: Task) -> Experiment:
    """Build the experiment that a task describes: its controller, its plant, and what disturbs them."""
    problem = build_problem(loaded)
    task = problem.spec
    model = problem.model
    compiled = compile_for(problem)
    controller = Controller(problem)
    uncertainty = Uncertainty(task, model) if task.is_uncertain else None
    friction = None if uncertainty is None else uncertainty.friction
    capture = build_capture(task, model)
    drive = drive_of(task, model)
    Q = stack(task.initial, loaded.robot, "joint")
    return Experiment(
        problem=problem,
        controller=controller,
        counterfactuals=Counterfactuals(controller),
        plant=build_plant(
            spec=task.plant,
            model=model,
            native=compiled,
            friction=friction,
            capture=capture,
            force_limits=force_limits_of(task, model.spec),
            firing=firing_of(task, model),
            drive=drive,
            is_held=bool(task.stages_on_mount(model.spec)),
        ),
        drive=drive,
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
    """Build the functions that the plant `rk4` of a task evaluates at every tick, which a run compiles beforehand.

    There is one for each kind of tick that may occur: with the law in joint or in task space, and with or without
    thrust on the base where stages switch thrusters off.
    """
    capture = build_capture(task, model)
    plain = TickKind(
        *ticks_of(task.plant), disturbed=disturbs(task), limited=force_limits_of(task, model.spec) is not None
    )
    varies = task.changes_mobility(model.spec)
    fires = task.fires(model.spec)
    laws_in_task_space = (False, True) if task.acts_in_task_space else (False,)
    thrusts = sorted({False, fires}) if varies else [fires]
    kinds = [
        replace(plain, in_task_space=in_task_space, varies=varies, is_pushed=has_thrust)
        for in_task_space in laws_in_task_space
        for has_thrust in thrusts
    ]
    if capture is not None:
        return [capture_tick(capture, kind) for kind in kinds]
    ticks = [tick_function(model, kind) for kind in kinds]
    if task.stages_on_mount(model.spec):
        ticks.append(tick_function(model.mounted, replace(plain, is_pushed=False)))
    return ticks


DIVERGED = 1e9
"""Norm of states and forces, in units of the SI, beyond which a motion has diverged."""


def closed_loop(experiment: Experiment, until: int | None = None) -> Generator[Sample, None, Ending]:
    """Run the closed loop of an experiment: yield its samples, and return how it ended.

    At every sample the state is measured, the controller decides, its command is sent, and the plant advances by what
    has arrived. What is known of the sample is measured last.

    Args:
        experiment: The experiment, built for this run alone.
        until: Index of the stage at whose end the loop stops; by default that of the task.
    """
    controller = experiment.controller
    plant = experiment.plant
    uncertainty = experiment.uncertainty
    capture = experiment.capture
    wheels = None if experiment.drive is None else experiment.drive.momentum
    meter = Meter(experiment.counterfactuals, uncertainty, capture, experiment.initial_state, wheels)
    state = experiment.initial_state
    braking_until = np.inf
    sample_number = 0
    stage = 0
    sample_time = experiment.problem.spec.controller.sample_time
    time_after_end = experiment.problem.spec.time_after_end
    line = _Line(experiment.problem.spec, experiment.problem.model.spec)
    while True:
        now = sample_number * sample_time
        measured = state if uncertainty is None else uncertainty.measured(sample_number, state)
        object_pose = None if capture is None else capture.measured(sample_number)
        holding = None if capture is None else capture.holding
        for name, target in (experiment.new_targets(now) or {}).items():
            controller.retarget(name, target, feasibility=False)
        wheels = None if experiment.drive is None else experiment.drive.momentum
        command = controller.step(now, State.of(measured, wheels), object_pose, holding)
        if (ending := _ending(experiment, command, state, braking_until, time_after_end)) is not None:
            return ending
        if any(switch.stage == until for switch in command.switches):
            return Ending(False, "stopped at the end of a stage", now, command.state, state, command.switches)
        braking_until = command.plan.end if "braking" in command.events else np.inf
        line.send(sample_number, command)
        in_force, setpoints = line.over_sample(sample_number)
        previous_stage = stage
        stage = in_force.sequence.first
        contact = None
        disturbance = None
        if uncertainty is not None:
            contact = uncertainty.contact(state, previous_stage, stage)
            disturbance = uncertainty.disturbance(sample_number, now, stage, in_force.law)
        ticks = plant.advance(now, state if contact is None else contact.state, setpoints, disturbance)
        if _has_diverged(ticks):
            reason = "the motion diverged, faster than it can be simulated"
            return Ending(False, reason, now, command.state, state, command.switches, stuck=True)
        yield meter.measure(command, ticks, state, setpoints.u, contact, in_force)
        state = ticks.states[-1]
        sample_number += 1


def _has_diverged(ticks: Ticks) -> bool:
    """Tell whether states or forces are beyond what any robot reaches, or not numbers."""
    squared_norm = np.vdot(ticks.states, ticks.states) + np.vdot(ticks.F, ticks.F)
    return bool(np.isnan(squared_norm) or squared_norm >= DIVERGED**2)


class _Line:
    """The way of commands to the robot, which takes a while. Times are counted in ticks from the start of the run.

    A command acts from its first tick on when it arrives, and until the next one does; its last tick holds where that
    one is late. Commands arrive in order. Before the first one nothing is commanded.
    """

    def __init__(self, task: TaskSpec, robot: RobotSpec) -> None:
        rate = task.plant.low_level_rate
        self._ticks = round(task.controller.sample_time * rate)
        self._rate = rate
        self._delay = task.uncertainty.delay
        self._jitter = task.uncertainty.jitter
        self._seed = task.seed
        self._changes_mobility = task.changes_mobility(robot)
        self._arrived: list[tuple[int, Command]] = []

    def send(self, sample: int, command: Command) -> None:
        """Send the command of a sample."""
        delay = self._delay
        if self._jitter:
            delay = max(0.0, delay + self._jitter * float(stream(self._seed, "delay", sample).standard_normal()))
        arrival = sample * self._ticks + round(delay * self._rate)
        before = self._arrived[-1][0] if self._arrived else 0
        self._arrived.append((max(arrival, before), command))

    def over_sample(self, sample: int) -> tuple[Command, Setpoints]:
        """Return the command in force when a sample begins, and the setpoints over the sample.

        Before the first command has arrived it is that one.
        """
        now = sample * self._ticks
        while len(self._arrived) > 1 and self._arrived[1][0] <= now:
            self._arrived.pop(0)
        arrival, command = self._arrived[0]
        load = command.law.load
        if arrival == now and (len(self._arrived) == 1 or self._arrived[1][0] >= now + self._ticks):
            driven = command.driven if self._changes_mobility else None
            held = command.held if len(command.held) else None
            return command, Setpoints(command.u, command.closed, command.twist_rates, driven, command.shut, load, held)
        u = np.zeros((self._ticks, command.law.model.n))
        closed = np.zeros(self._ticks, bool)
        driven = np.tile(command.driven[0], (self._ticks, 1))
        shut = np.repeat(command.shut[:1], self._ticks, axis=0)
        held = np.repeat(command.held[:1], self._ticks, axis=0)
        in_task_space = any(each.twist_rates is not None for _, each in self._arrived)
        twist_rates = np.zeros((self._ticks, command.law.model.n_twists)) if in_task_space else None
        ticks = np.arange(now, now + self._ticks)
        for begins, each in self._arrived:
            acts = ticks >= begins
            own = np.minimum(ticks[acts] - begins, self._ticks - 1)
            u[acts] = each.u[own]
            closed[acts] = each.closed[own]
            driven[acts] = each.driven[own]
            shut[acts] = each.shut[own]
            if len(held):
                held[acts] = each.held[own]
            if twist_rates is not None:
                twist_rates[acts] = _twist_rates(each)[own]
        return command, Setpoints(
            u, closed, twist_rates, driven if self._changes_mobility else None, shut, load, held if len(held) else None
        )


def _twist_rates(command: Command) -> np.ndarray:
    """Return the rates of J_C v (M, k) of a command, also of one for the law in joint space: those that u leads to."""
    if command.twist_rates is not None:
        return command.twist_rates
    model = command.law.model
    Q, v = np.split(command.state, [model.nq])
    return np.asarray(model.twist_rates(Q, v, command.u, command.tick))


def _ending(
    experiment: Experiment, command: Command, state: np.ndarray, braking_until: float, time_after_end: float
) -> Ending | None:
    """Return the ending if the run is over.

    The last stage is at its target, the mission can no longer succeed, the robot is at rest without a plan, or the time
    limit is reached.
    """
    now = command.time
    switches = command.switches
    if experiment.controller.failure and not experiment.keep_going:
        return Ending(False, experiment.controller.failure, now, command.state, state, switches)
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
    keep_going: bool = False,
    new_targets: NewTargets | None = None,
) -> Run:
    """Run a task in closed loop and return the run.

    A run ends when its last stage does, at the time limit, or when the mission can no longer succeed: grippers missed
    or lost the object, and the task declares no other try (`if_missed`) or all were used up.

    An interruption (KeyboardInterrupt, from anywhere or raised by the watcher) ends the run cleanly: it holds
    everything up to then, is not `finished`, and has no final time. Any other error of the watcher is raised; the log
    holds everything up to then as well, and names it. The arrays of samples are read-only.

    Args:
        task: The task.
        path: Its log; in memory alone by default.
        watch: Called with each sample.
        force: Overwrite an earlier log.
        until: Index of the stage at whose end the run stops; by default that of the task.
        keep_going: Let a mission that can no longer succeed go on to its time limit.
        new_targets: Called before each sample with its time [s]; returns the targets that change then, by name of the
            stage, as `Controller.retarget` takes them; whether they are within reach is not checked.

    Raises:
        SpecError: A new target is none of its stage.
        InputError: An argument is of another type, or the log exists already or cannot be written.
        RunError: The log could not be written any further.
    """
    require("task", task, Task, "a Task, from load_task")
    path = None if path is None else as_path("path", path)
    require_callable("watch", watch, "a sample")
    require("force", force, bool, "True or False")
    require("keep_going", keep_going, bool, "True or False")
    if new_targets is not None:
        require_callable("new_targets", new_targets, "a time")
    if until is not None:
        require_whole("until", until, least=0, most=len(task.spec.stages) - 1)
    experiment = replace(
        build_experiment(task),
        keep_going=keep_going,
        changes_targets=new_targets is not None,
        new_targets=new_targets or no_new_targets,
    )
    return record(experiment, closed_loop(experiment, until), path, watch, force)
