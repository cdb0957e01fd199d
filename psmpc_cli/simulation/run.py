"""One run: the experiment that a task describes, and its closed loop."""

import gc
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

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
from psmpc_cli.specs.robots.robot import RobotSpec, stack
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
    """Build all that a closed loop of a task needs: its controller, its plant, and what disturbs them.

    An experiment has memory (the estimates of the controller, the object in its grasps), so every run needs one of its
    own.

    Args:
        loaded: The task with its robot, validated.
    """
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
    """List the functions that the plant `rk4` of a task evaluates at every tick, which a run compiles beforehand.

    There is one for each kind of tick that may occur: with the low-level law in joint or in task space, and with or
    without thrust on the base, which stages may switch off.
    """
    capture = build_capture(task, model)
    base_kind = TickKind(
        *ticks_of(task.plant), disturbed=disturbs(task), limited=force_limits_of(task, model.spec) is not None
    )
    base_drive_varies = task.changes_mobility(model.spec)
    thrusters_fire = task.fires(model.spec)
    laws_in_task_space = (False, True) if task.acts_in_task_space else (False,)
    pushed_choices = sorted({False, thrusters_fire}) if base_drive_varies else [thrusters_fire]
    kinds = [
        replace(base_kind, in_task_space=in_task_space, driven_varies=base_drive_varies, is_pushed=is_pushed)
        for in_task_space in laws_in_task_space
        for is_pushed in pushed_choices
    ]
    if capture is not None:
        return [capture_tick(capture, kind) for kind in kinds]
    ticks = [tick_function(model, kind) for kind in kinds]
    if task.stages_on_mount(model.spec):
        ticks.append(tick_function(model.mounted, replace(base_kind, is_pushed=False)))
    return ticks


@contextmanager
def exempt_from_collection() -> Iterator[None]:
    """Leave all objects that exist now out of garbage collections.

    With the functions of a task a full collection takes as long as several decisions, and one of them has to wait.
    """
    if gc.get_freeze_count():  # a caller has frozen objects already, and says when they count again
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


DIVERGED = 1e9
"""Norm of states and forces, in units of the SI, beyond which a motion has diverged."""


def closed_loop(experiment: Experiment, until: int | None = None) -> Generator[Sample, None, Ending]:
    """Run the closed loop of an experiment: yield its samples, and return how it ended.

    At every sample the state is measured, the controller decides, its command is sent, and the plant advances under the
    command that has arrived by then. Last, the sample's metrics are collected.

    Args:
        experiment: The experiment, built for this run alone.
        until: Index of the stage at whose end the loop stops; by default that of the task.
    """
    with exempt_from_collection():
        return (yield from _samples(experiment, until))


def _samples(experiment: Experiment, until: int | None) -> Generator[Sample, None, Ending]:
    """Yield the samples of `closed_loop`, and return how it ended."""
    controller = experiment.controller
    plant = experiment.plant
    uncertainty = experiment.uncertainty
    capture = experiment.capture
    wheel_momenta = None if experiment.drive is None else experiment.drive.momentum
    meter = Meter(experiment.counterfactuals, uncertainty, capture, experiment.initial_state, wheel_momenta)
    state = experiment.initial_state
    braking_until = np.inf
    sample_number = 0
    stage = 0
    sample_time = experiment.problem.spec.controller.sample_time
    time_after_end = experiment.problem.spec.time_after_end
    delayed_commands = _DelayedCommands(experiment.problem.spec, experiment.problem.model.spec)
    while True:
        now = sample_number * sample_time
        measured = state if uncertainty is None else uncertainty.measured(sample_number, state)
        object_pose = None if capture is None else capture.measured(sample_number)
        holding = None if capture is None else capture.holding
        for name, target in (experiment.new_targets(now) or {}).items():
            controller.retarget(name, target, feasibility=False)
        wheel_momenta = None if experiment.drive is None else experiment.drive.momentum
        command = controller.step(now, State.of(measured, wheel_momenta), object_pose, holding)
        if (ending := _ending(experiment, command, state, braking_until, time_after_end)) is not None:
            return ending
        if any(switch.stage == until for switch in command.switches):
            return Ending(False, "stopped at the end of a stage", now, command.state, state, command.switches)
        braking_until = command.plan.end if "braking" in command.events else np.inf
        # commands may arrive late: what acts over this sample may be an earlier command
        delayed_commands.send(sample_number, command)
        in_force, setpoints = delayed_commands.over_sample(sample_number)
        previous_stage = stage
        stage = in_force.sequence.first
        # a payload that is taken up or let go changes velocities at once
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


class _SentCommand(NamedTuple):
    """A command on its way: the tick of the run at which it arrives, and the command."""

    arrives_at: int
    command: Command


class _DelayedCommands:
    """The way of commands to the robot, which takes a while. Times are counted in ticks from the start of the run.

    A command acts from its first tick on when it arrives, and until the next one does; its last tick holds where that
    one is late. Commands arrive in order. Before the first one nothing is commanded.
    """

    def __init__(self, task: TaskSpec, robot: RobotSpec) -> None:
        rate = task.plant.low_level_rate
        self._ticks_per_sample = round(task.controller.sample_time * rate)
        self._rate = rate
        self._delay = task.uncertainty.delay
        self._jitter = task.uncertainty.jitter
        self._seed = task.seed
        self._changes_mobility = task.changes_mobility(robot)
        self._sent: list[_SentCommand] = []

    def send(self, sample: int, command: Command) -> None:
        """Send the command of a sample."""
        delay = self._delay
        if self._jitter:
            delay = max(0.0, delay + self._jitter * float(stream(self._seed, "delay", sample).standard_normal()))
        arrival = sample * self._ticks_per_sample + round(delay * self._rate)
        before = self._sent[-1].arrives_at if self._sent else 0
        self._sent.append(_SentCommand(max(arrival, before), command))

    def over_sample(self, sample: int) -> tuple[Command, Setpoints]:
        """Return the command in force when a sample begins, and the setpoints of the low-level law at its ticks.

        Commands reach the robot late and at any tick, so the setpoints may be those of several commands, each from its
        arrival on. Before the first has arrived nothing is commanded (zeros), and it counts as the one in force.

        Args:
            sample: Number of the sample.
        """
        first_tick = sample * self._ticks_per_sample
        end_tick = first_tick + self._ticks_per_sample
        while len(self._sent) > 1 and self._sent[1].arrives_at <= first_tick:
            self._sent.pop(0)
        arrives_at, command = self._sent[0]
        load = command.law.load
        # mostly one command arrives as the sample begins and no other within it: its setpoints are taken as they are
        is_alone = len(self._sent) == 1 or self._sent[1].arrives_at >= end_tick
        if arrives_at == first_tick and is_alone:
            driven_axes = command.driven if self._changes_mobility else None
            held = command.held if len(command.held) else None
            return command, Setpoints(
                command.u, command.closed, command.twist_rates, driven_axes, command.shut, load, held
            )
        u = np.zeros((self._ticks_per_sample, command.law.model.n))
        closed = np.zeros(self._ticks_per_sample, bool)
        driven_axes = np.tile(command.driven[0], (self._ticks_per_sample, 1))
        shut_thrusters = np.repeat(command.shut[:1], self._ticks_per_sample, axis=0)
        held = np.repeat(command.held[:1], self._ticks_per_sample, axis=0)
        in_task_space = any(sent.command.twist_rates is not None for sent in self._sent)
        twist_rates = np.zeros((self._ticks_per_sample, command.law.model.n_twists)) if in_task_space else None
        run_ticks = np.arange(first_tick, end_tick)
        for arrives_at, arrived in self._sent:
            is_in_force = run_ticks >= arrives_at
            # ticks since the arrival; the last setpoint holds where the next command is late
            own_ticks = np.minimum(run_ticks[is_in_force] - arrives_at, self._ticks_per_sample - 1)
            u[is_in_force] = arrived.u[own_ticks]
            closed[is_in_force] = arrived.closed[own_ticks]
            driven_axes[is_in_force] = arrived.driven[own_ticks]
            shut_thrusters[is_in_force] = arrived.shut[own_ticks]
            if len(held):
                held[is_in_force] = arrived.held[own_ticks]
            if twist_rates is not None:
                twist_rates[is_in_force] = _twist_rates(arrived)[own_ticks]
        return command, Setpoints(
            u=u,
            closed=closed,
            twist_rates=twist_rates,
            driven=driven_axes if self._changes_mobility else None,
            shut=shut_thrusters,
            load=load,
            held=held if len(held) else None,
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
    """Decide whether a run is over at a sample, and return how it ended; None if it goes on.

    It is over when the last stage has ended and the task's time after that has passed, when the mission can no longer
    succeed, when the robot has braked to rest without a plan, or at the time limit.

    Args:
        experiment: The experiment.
        command: What the controller decided at the sample.
        state: True state [Q; v] (nq + n,).
        braking_until: When a braking motion without a plan ends [s]; infinite without one.
        time_after_end: How long the run goes on after its last stage [s].
    """
    now = command.time
    rounding = 1e-9  # of sums of sample times [s]
    switches = command.switches
    if experiment.controller.failure and not experiment.keep_going:
        return Ending(False, experiment.controller.failure, now, command.state, state, switches)
    if now >= experiment.controller.sequence.ended_at + time_after_end - rounding:
        return Ending(
            True, f"{experiment.problem.stages[-1].name} met its end condition", now, command.state, state, switches
        )
    if now >= braking_until - rounding:
        cause = "the state was not measured" if "unmeasured" in command.events else "no window could be solved"
        reason = f"{cause} and the plan was used up; the robot braked to rest"
        return Ending(False, reason, now, command.state, state, switches, stuck=True)
    if now >= experiment.problem.spec.time_limit - rounding and not experiment.controller.done:
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
    or lost the object, or took too long, and the task declares no other try (`if_missed`) or all were used up.

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
