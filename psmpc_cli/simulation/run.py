"""One run: the experiment that a task describes, and its closed loop."""

import gc
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
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
from psmpc_cli.simulation.recorder import Ending, RecordedLoop, Watch, libraries_of_solver, record
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

    Returns:
        The experiment. Parts that a task does not need are None: what the controller does not know, an object with its
        grasps (a capture), reaction wheels.
    """
    problem = build_problem(loaded)
    task = problem.spec
    model = problem.model
    compiled = compile_for(problem)
    controller = Controller(problem)
    uncertainty = Uncertainty(task, model) if task.is_uncertain else None
    friction_of_joints = None if uncertainty is None else uncertainty.friction
    capture = build_capture(task, model)
    wheel_drive = drive_of(task, model)
    # a task gives numbers by part of the robot; velocities, as errors do, have three numbers for an attitude in space
    initial_Q = stack(task.initial, loaded.robot, "joint")
    initial_v = stack(task.initial_velocity, loaded.robot, "joint", missing=0.0, of_error=True)
    return Experiment(
        problem=problem,
        controller=controller,
        counterfactuals=Counterfactuals(controller),
        plant=build_plant(
            spec=task.plant,
            model=model,
            native=compiled,
            friction=friction_of_joints,
            capture=capture,
            force_limits=force_limits_of(task, model.spec),
            firing=firing_of(task, model),
            drive=wheel_drive,
            is_held=bool(task.stages_on_mount(model.spec)),  # by a mount, in some stage
        ),
        drive=wheel_drive,
        uncertainty=uncertainty,
        capture=capture,
        initial_state=np.r_[initial_Q, initial_v],
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
    """Compile the libraries that a run of a problem needs and that are not in the cache, several at once.

    Returns:
        Whether the run uses compiled code: the task allows it, needs some, and all of it could be made.
    """
    return problem.spec.solver.compiled and compile_all(libraries_for(problem))


def libraries_for(problem: Problem) -> list[Library]:
    """Return the libraries of C code that a run of a problem compiles: those of its solver and of its plant."""
    task = problem.spec
    functions_of_plant = _functions_of_all_tick_kinds(task, problem.model) if task.plant.traits.compiles else []
    return [*libraries_of_solver(problem), *map(library_of, functions_of_plant)]


def _functions_of_all_tick_kinds(task: TaskSpec, model: RobotModel) -> list[ca.Function]:
    """List the functions with which the plant `rk4` of a task advances by a tick, so that a run compiles them first.

    A tick is one period of the low-level loop. There is a function for each kind of tick that may occur in the run:
    with the low-level law in joint or in task space, and with or without thrust on the base, which stages may switch
    off.

    Args:
        task: The task, whose plant is `rk4`.
        model: The robot.
    """
    capture = build_capture(task, model)
    tick_length, substeps = ticks_of(task.plant)
    base_kind = TickKind(
        tick_length,
        substeps,
        disturbed=disturbs(task),
        limited=force_limits_of(task, model.spec) is not None,
    )
    base_drive_varies = task.changes_mobility(model.spec)  # from stage to stage: what moves the base
    thrusters_fire = task.fires(model.spec)
    in_task_space_choices = (False, True) if task.acts_in_task_space else (False,)
    pushed_choices = sorted({False, thrusters_fire}) if base_drive_varies else [thrusters_fire]
    kinds = [
        replace(base_kind, in_task_space=in_task_space, driven_varies=base_drive_varies, is_pushed=is_pushed)
        for in_task_space in in_task_space_choices
        for is_pushed in pushed_choices
    ]
    if capture is not None:  # an object with a mass, which moves with the robot or on its own
        return [capture_tick(capture, kind) for kind in kinds]
    functions = [tick_function(model, kind) for kind in kinds]
    if task.stages_on_mount(model.spec):
        # a mounted base does not move, so its model is another one, which thrusters never push
        functions.append(tick_function(model.mounted, replace(base_kind, is_pushed=False)))
    return functions


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
        until: Index of the stage at whose end the loop stops; by default it goes on to the end of the task.
    """
    with exempt_from_collection():
        return (yield from _samples(experiment, until))


def _samples(experiment: Experiment, until: int | None) -> Generator[Sample, None, Ending]:
    """Simulate a closed loop sample by sample: yield what each sample leaves for the log, and return how it ended.

    A sample lasts from one measurement to the next: the state is measured, the controller decides, its command is sent,
    and the plant advances under the command that has arrived by then.

    Args:
        experiment: Controller, plant and disturbances, built for this run alone.
        until: Index of the stage at whose end the loop stops; None for the end of the task.
    """
    controller = experiment.controller
    plant = experiment.plant
    uncertainty = experiment.uncertainty
    capture = experiment.capture
    wheel_momenta = None if experiment.drive is None else experiment.drive.momentum
    meter = Meter(experiment.counterfactuals, uncertainty, capture, experiment.initial_state, wheel_momenta)
    state = experiment.initial_state
    braking_until = np.inf  # end of the motion by which a robot without a plan comes to rest [s]
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
            controller.retarget(name, target, feasibility=False)  # targets out of reach are not rejected
        wheel_momenta = None if experiment.drive is None else experiment.drive.momentum
        command = controller.step(now, State.of(measured, wheel_momenta), object_pose, holding)
        if (ending := _ending_if_over(experiment, command, state, braking_until, time_after_end)) is not None:
            return ending
        stopped = partial(
            Ending, completed=False, time=now, state=command.state, true_state=state, switches=command.switches
        )
        if any(switch.stage == until for switch in command.switches):
            return stopped(reason="stopped at the end of a stage")
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
            return stopped(reason="the motion diverged, faster than it can be simulated", stuck=True)
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
    """Commands on their way to the robot, which arrive late. Times are counted in ticks from the start of the run.

    A command acts from the tick at which it arrives until the next command arrives. It has setpoints for the ticks of
    one sample; where the next command is later than that, the last setpoint is held. Commands arrive in order. Before
    the first one nothing is commanded.
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
        """Send the command of a sample: it arrives after the delay of the task, with a random jitter drawn for it."""
        delay = self._delay
        if self._jitter:
            delay = max(0.0, delay + self._jitter * float(stream(self._seed, "delay", sample).standard_normal()))
        arrival = sample * self._ticks_per_sample + round(delay * self._rate)
        arrival_before = self._sent[-1].arrives_at if self._sent else 0
        self._sent.append(_SentCommand(max(arrival, arrival_before), command))

    def over_sample(self, sample: int) -> tuple[Command, Setpoints]:
        """Return the command in force when a sample begins, and the setpoints of the low-level law at its ticks.

        Commands reach the robot late and at any tick, so the setpoints may be those of several commands, each from its
        arrival on. Before the first command has arrived nothing is commanded, and it counts as the one in force.

        Args:
            sample: Number of the sample.

        Returns:
            The command, and the setpoints that the plant follows over the sample, a row for each of its M ticks.
        """
        first_tick = sample * self._ticks_per_sample
        end_tick = first_tick + self._ticks_per_sample
        # a command is over when the next one has arrived
        while len(self._sent) > 1 and self._sent[1].arrives_at <= first_tick:
            self._sent.pop(0)
        arrives_at, command = self._sent[0]
        is_alone = len(self._sent) == 1 or self._sent[1].arrives_at >= end_tick
        if not (arrives_at == first_tick and is_alone):
            return command, self._setpoints_of_several(first_tick)
        # mostly one command arrives as the sample begins and no other within it: its setpoints are taken as they are
        return command, Setpoints(
            u=command.u,
            closed=command.closed,
            twist_rates=command.twist_rates,
            driven=command.driven if self._changes_mobility else None,
            shut=command.shut,
            load=command.law.load,
            held=command.held if len(command.held) else None,
        )

    def _setpoints_of_several(self, first_tick: int) -> Setpoints:
        """Put the setpoints of a sample together from those of several commands, each from its arrival on.

        A command has setpoints for the M ticks of one sample; the last of them is held until the next command arrives.
        Before the first arrival there is no motion, grippers are open, and the base is moved by what moves it at the
        first tick of that command.

        Args:
            first_tick: Number of the sample's first tick, counted from the start of the run.

        Returns:
            A row for each of the M ticks of the sample.
        """
        command = self._sent[0].command
        M = self._ticks_per_sample
        u = np.zeros((M, command.law.model.n))
        grippers_closed = np.zeros(M, bool)
        driven_axes = np.tile(command.driven[0], (M, 1))
        shut_thrusters = np.repeat(command.shut[:1], M, axis=0)
        held_by_mount = np.repeat(command.held[:1], M, axis=0)  # (0,) where no mount ever holds the base
        in_task_space = any(sent.command.twist_rates is not None for sent in self._sent)
        twist_rates = np.zeros((M, command.law.model.n_twists)) if in_task_space else None
        run_ticks = np.arange(first_tick, first_tick + M)
        # a command overwrites what earlier ones set, from the tick of its arrival on
        for arrives_at, arrived in self._sent:
            has_arrived = run_ticks >= arrives_at
            # ticks since the arrival; the last setpoint holds where the next command is late
            own_ticks = np.minimum(run_ticks[has_arrived] - arrives_at, M - 1)
            u[has_arrived] = arrived.u[own_ticks]
            grippers_closed[has_arrived] = arrived.closed[own_ticks]
            driven_axes[has_arrived] = arrived.driven[own_ticks]
            shut_thrusters[has_arrived] = arrived.shut[own_ticks]
            if len(held_by_mount):
                held_by_mount[has_arrived] = arrived.held[own_ticks]
            if twist_rates is not None:
                twist_rates[has_arrived] = _rates_in_task_space(arrived)[own_ticks]
        return Setpoints(
            u=u,
            closed=grippers_closed,
            twist_rates=twist_rates,
            driven=driven_axes if self._changes_mobility else None,
            shut=shut_thrusters,
            load=command.law.load,
            held=held_by_mount if len(held_by_mount) else None,
        )


def _rates_in_task_space(command: Command) -> np.ndarray:
    """Return the rates of J_C v (M, k) of a command, also of one for the law in joint space: those that u leads to."""
    if command.twist_rates is not None:
        return command.twist_rates
    model = command.law.model
    Q, v = np.split(command.state, [model.nq])
    return np.asarray(model.twist_rates(Q, v, command.u, command.tick))


def _ending_if_over(
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
    ending = partial(Ending, time=now, state=command.state, true_state=state, switches=command.switches)
    if experiment.controller.failure and not experiment.keep_going:
        return ending(completed=False, reason=experiment.controller.failure)
    # ended_at is infinite until the last stage has ended
    if now >= experiment.controller.sequence.ended_at + time_after_end - rounding:
        return ending(completed=True, reason=f"{experiment.problem.stages[-1].name} met its end condition")
    if now >= braking_until - rounding:
        cause = "the state was not measured" if "unmeasured" in command.events else "no window could be solved"
        reason = f"{cause} and the plan was used up; the robot braked to rest"
        return ending(completed=False, reason=reason, stuck=True)
    if now >= experiment.problem.spec.time_limit - rounding and not experiment.controller.done:
        return ending(completed=False, reason=f"time limit of {experiment.problem.spec.time_limit:g} s reached")
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
        path: File of the log; by default the log is kept in memory alone.
        watch: Called with each sample.
        force: Overwrite an earlier log.
        until: Index of the stage at whose end the run stops; by default it goes on to the end of the task.
        keep_going: Let a mission that can no longer succeed go on to its time limit.
        new_targets: Called before each sample with its time [s]; returns the targets that change then, by name of the
            stage, as `Controller.retarget` takes them; whether they are within reach is not checked.

    Raises:
        SpecError: A new target is not one that its stage can have.
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
