"""One run: the experiment that a task describes, its closed loop, and its log."""

import logging
from collections import deque
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli import __version__
from psmpc_cli.control.controller import Controller
from psmpc_cli.control.interface import Command, State
from psmpc_cli.control.sequence import Switch
from psmpc_cli.control.window_builder import priorities_in_force
from psmpc_cli.errors import RunError
from psmpc_cli.logs.run import Run, read_run, run_in
from psmpc_cli.logs.schema import MOMENTUM, Q_COORDINATE, Sample
from psmpc_cli.logs.summary import verdicts
from psmpc_cli.logs.write import Header, LogWriter
from psmpc_cli.native.functions import maker_of
from psmpc_cli.native.library import describe_compiler, describe_processor, make_all
from psmpc_cli.ocp.problem import Problem, build_problem
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.plant import Plant, build_plant, ticks_of
from psmpc_cli.plant.grasp import Capture, build_capture
from psmpc_cli.plant.rk4 import capture_tick, tick_function
from psmpc_cli.plant.uncertainty import Uncertainty, disturbs
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.measures import Counterfactuals, GraspRecord, Meter, StageClock
from psmpc_cli.solvers.sqp import libraries as solver_libraries
from psmpc_cli.specs.arguments import as_path, require, require_callable, require_whole
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.robot import labels, stack
from psmpc_cli.specs.task import TaskSpec

logger = logging.getLogger(__name__)

Watch = Callable[[Sample], None]


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything one run needs. Controller, counterfactuals and plant hold state: build a new experiment for every run.

    Attributes:
        problem: The task made computable.
        controller: Its controller.
        counterfactuals: Solves what is measured alone.
        plant: The physics.
        uncertainty: What the controller does not know; None without any.
        capture: The object and its grasps; None of an object without a mass.
        x0: Initial state [Q; v] (nq + n,).
        compiled: Solver and plant run as compiled C.
    """

    problem: Problem
    controller: Controller
    counterfactuals: Counterfactuals
    plant: Plant
    uncertainty: Uncertainty | None
    capture: Capture | None
    x0: np.ndarray
    compiled: bool


def build_experiment(loaded: Task) -> Experiment:
    """Return the experiment a task describes."""
    problem = build_problem(loaded)
    task = problem.spec
    model = problem.model
    compiled = compile_for(problem)
    controller = Controller(problem)
    uncertainty = Uncertainty(task, model) if task.uncertainty.in_force else None
    resistance = None if uncertainty is None else uncertainty.resistance
    capture = build_capture(task, model)
    Q = stack(task.initial, loaded.robot, "joint")
    return Experiment(
        problem=problem,
        controller=controller,
        counterfactuals=Counterfactuals(controller),
        plant=build_plant(task.plant, model, compiled, resistance, capture),
        uncertainty=uncertainty,
        capture=capture,
        x0=np.r_[Q, stack(task.initial_velocity, loaded.robot, "joint", 0.0, of_error=True)],
        compiled=compiled,
    )


def converging(loaded: Task) -> Task:
    """Return the task with a solver that solves each window to its optimum, however long that takes.

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
    task = problem.spec
    if not task.solver.compiled:
        return False
    makers = list(solver_libraries(problem)) if task.solver.traits.real_time else []
    if task.plant.traits.compiles:
        makers.append(maker_of(_tick_function(task, problem.model)))
    return make_all(makers)


def _tick_function(task: TaskSpec, model: RobotModel) -> ca.Function:
    """Return the function that the plant `rk4` of a task evaluates at every tick."""
    tick, substeps = ticks_of(task.plant)
    capture = build_capture(task, model)
    if capture is None:
        return tick_function(model, tick, substeps, disturbs(task))
    return capture_tick(capture.law, tick, substeps)


BOUND = 1e9
"""Coordinates and rates, or forces, of a larger norm are those of a motion that diverged, in any unit of the SI."""


@dataclass(frozen=True, eq=False)
class Ending:
    """How a run ended.

    Attributes:
        completed: The last stage met its end condition.
        reason: Why the run stopped.
        time: When [s].
        x: In which state, as the controller saw it (nq + n,).
        true: In which state it was (nq + n,).
        switches: Stages that ended since the last sample, the last stage among them.
        stuck: The run could not go on.
    """

    completed: bool
    reason: str
    time: float
    x: np.ndarray
    true: np.ndarray
    switches: tuple[Switch, ...] = ()
    stuck: bool = False


def closed_loop(experiment: Experiment, until: int | None = None) -> Generator[Sample, None, Ending]:
    """Run the closed loop of an experiment, which is built for this run, and return how it ended.

    Args:
        experiment: The experiment.
        until: Index of the stage at whose end the loop stops; by default that of the task.
    """
    controller = experiment.controller
    plant = experiment.plant
    uncertainty = experiment.uncertainty
    capture = experiment.capture
    meter = Meter(experiment.counterfactuals, uncertainty, capture, experiment.x0)
    x = experiment.x0
    braking_until = np.inf
    number = 0
    stage = 0
    sample_time = experiment.problem.spec.controller.sample_time
    link = _Link(experiment.problem.spec, experiment.x0, experiment.problem.model.space)
    while True:
        now = number * sample_time
        seen = link.measured(x if uncertainty is None else uncertainty.measured(number, x))
        pose = None if capture is None else link.measured_object(capture.measured(number))
        command = controller.step(now, State.of(seen), pose)
        if (ending := _ending(experiment, command, x, braking_until)) is not None:
            return ending
        if any(switch.stage == until for switch in command.switches):
            return Ending(False, "stopped at the end of a stage", now, command.x, x, command.switches)
        braking_until = command.plan.end if "braking" in command.events else np.inf
        before = stage
        stage = command.sequence.first
        contact = None
        u, closed = link.commanded(command.u, command.closed)
        if uncertainty is None:
            ticks = plant.advance(now, x, u, None, closed)
        else:
            contact = uncertainty.contact(x, before, stage)
            ticks = uncertainty.advance(plant, number, now, contact.x, u, stage, closed)
        if not np.vdot(ticks.X, ticks.X) + np.vdot(ticks.F, ticks.F) < BOUND**2:  # nor where it is not a number
            why = "the motion diverged, faster than it can be simulated"
            return Ending(False, why, now, command.x, x, command.switches, stuck=True)
        yield meter.measure(command, ticks, x, u, contact)
        x = ticks.X[-1]
        number = number + 1


class _Link:
    """The delays between controller and robot.

    Time is that at which a control acts. The controller knows of c samples: what it decides at sample k was measured at
    k - c. The rest of the delay it does not know of: controls reach the robot late by so many samples.
    """

    def __init__(self, task: TaskSpec, x0: np.ndarray, space: ConfigurationSpace) -> None:
        """Start with a robot that drifts into its initial state, and zero controls under way."""
        known = task.controller.known_delay
        Q, v = np.split(x0, [space.nq])
        n = space.n
        none = np.zeros((round(task.controller.sample_time * task.plant.low_level_rate), n))
        before = (-back * task.controller.sample_time * v for back in range(known, 0, -1))
        self._measured: deque[np.ndarray] = deque(np.r_[np.array(space.integrate(Q, step)), v] for step in before)
        self._poses: deque[np.ndarray | None] = deque([None] * known)
        self._commanded = deque([(none, np.zeros(len(none), bool))] * (task.uncertainty.delay - known))

    def measured(self, x: np.ndarray) -> np.ndarray:
        """Return the state that reaches the controller where x is measured now."""
        self._measured.append(x)
        return self._measured.popleft()

    def measured_object(self, pose: np.ndarray) -> np.ndarray | None:
        """Return the pose of the object that reaches the controller where this one is measured now; None before any."""
        self._poses.append(pose)
        return self._poses.popleft()

    def commanded(self, u: np.ndarray, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accelerations (M, n) and whether to close (M,) that reach the robot where these are commanded."""
        self._commanded.append((u, closed))
        return self._commanded.popleft()


def _ending(experiment: Experiment, command: Command, x: np.ndarray, braking_until: float) -> Ending | None:
    """Return the ending if the run is over: last stage at its target, time limit, or at rest without a plan."""
    now = command.time
    seen = command.x
    switches = command.switches
    if experiment.controller.done:
        return Ending(True, f"{experiment.problem.stages[-1].name} met its end condition", now, seen, x, switches)
    if now >= braking_until - 1e-9:
        why = "the state was not measured" if "unmeasured" in command.events else "no window could be solved"
        why = f"{why} and the plan was used up; the robot braked to rest"
        return Ending(False, why, now, seen, x, switches, stuck=True)
    if now >= experiment.problem.spec.time_limit - 1e-9:
        return Ending(False, f"time limit of {experiment.problem.spec.time_limit:g} s reached", now, seen, x, switches)
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
    everything up to then, is not `finished`, and has no final time.

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
    with LogWriter(path, header(experiment), force) as writer:
        _write(experiment, writer, watch, until)
        if path is None:
            return run_in(writer.file).with_problem(experiment.problem)
    return read_run(path)


def _write(experiment: Experiment, writer: LogWriter, watch: Watch, until: int | None = None) -> None:
    """Write every sample of the closed loop and how it ended."""
    samples = closed_loop(experiment, until)
    stages = experiment.problem.stages
    clock = StageClock(len(stages), experiment.problem.spec.onset)
    records = (clock,) if experiment.capture is None else (clock, GraspRecord(experiment.capture))
    try:
        writer.update(clock.tables)
        while True:
            sample = next(samples)
            writer.write(sample)
            for record in records:
                if record.update(sample):
                    writer.update(record.tables)
            _report(sample, stages)
            watch(sample)
    except StopIteration as stop:
        ending: Ending = stop.value
    except KeyboardInterrupt as interruption:
        writer.finish(False, str(interruption) or "interrupted", {**clock.tables, **_verdicts(experiment, writer)})
        return
    except RunError as error:
        with suppress(RunError):
            writer.finish(False, str(error), clock.tables)
        raise
    clock.end(ending.switches)
    writer.update(clock.tables)
    final = {**_final(experiment, ending), **_verdicts(experiment, writer)}
    writer.finish(ending.completed, ending.reason, final, ending.stuck)


def _final(experiment: Experiment, ending: Ending) -> dict[str, ArrayLike]:
    """Return time, state and poses at the end of a run, by their paths in the log."""
    model = experiment.problem.model
    Q, v = np.split(ending.x, [model.nq])
    Q_true, v_true = np.split(ending.true, [model.nq])
    final = {"Q": Q, "Qdot": v, "xi": model.poses(Q_true).ravel()}
    if not experiment.problem.spec.sees_the_state:
        final |= {"Q_true": Q_true, "Qdot_true": v_true}
    if experiment.capture is not None:
        final["object_pose"], final["object_velocity"] = experiment.capture.pose_and_velocity
    return {"final/end_time": ending.time, **{f"final/{name}": value for name, value in final.items()}}


def _verdicts(experiment: Experiment, writer: LogWriter) -> dict[str, ArrayLike]:
    """Return the verdicts of the task's monitors over the samples so far, by their paths in the log."""
    found = verdicts(experiment.problem.spec, run_in(writer.file).arrays) if experiment.problem.spec.judged else ()
    return {"monitors/held": [v.held for v in found], "monitors/margin": [v.margin for v in found]}


def _report(sample: Sample, stages: tuple[Stage, ...]) -> None:
    """Log what happened at a sample: failures as warnings, other events as information."""
    command = sample.command
    for switch in command.switches:
        logger.info("%.2f s: %s ended at %.2f s", command.time, stages[switch.stage].name, switch.time)
    if "appended" in command.events:
        logger.info("%.2f s: %s entered the window", command.time, stages[command.sequence.last].name)
    if "postponed" in command.events:
        name = stages[command.sequence.last + 1].name
        logger.info("%.2f s: %s was seen but could not be solved for yet", command.time, name)
    braking = "braking" in command.events
    goes_on = "the robot brakes to rest" if braking else "the shifted plan goes on"
    if "unmeasured" in command.events:
        instead = goes_on if braking else "the plan's prediction is used for it"
        logger.warning("%.2f s: the state was not measured; %s", command.time, instead)
    elif "solve_failed" in command.events:
        logger.warning("%.2f s: solve failed (%s); %s", command.time, command.outcome.name.lower(), goes_on)


def header(experiment: Experiment) -> Header:
    """Return what the log says of the run before it begins."""
    task = experiment.problem.spec
    loaded = experiment.problem.task
    uncertainty = experiment.uncertainty
    names = tuple(stage.name for stage in experiment.problem.stages)
    space = experiment.problem.model.space
    of_Q = {Q_COORDINATE: labels(loaded.robot, "joint", of_error=False)} if space.nq > space.n else {}
    has = {
        "ticks": task.log.ticks,
        "plans": task.log.plans,
        "levels": task.controller.traits.has_levels,
        "true state": not task.sees_the_state,
        "payload": task.uncertainty.payload is not None,
        "disturbance": task.controller.offset_free,
        "drawn": uncertainty is not None,
        Q_COORDINATE: bool(of_Q),
        "object": experiment.capture is not None,
        "object at ticks": experiment.capture is not None and task.log.ticks,
    }
    return Header(
        attributes={
            "psmpc_version": __version__,
            "casadi_version": version("casadi"),
            "numpy_version": np.__version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "task_name": task.name,
            "controller": task.controller.kind,
            "solver": task.solver.kind,
            "compiled": experiment.compiled,
            "processor": describe_processor(),
            "compiler": describe_compiler() if experiment.compiled else "",
            "plant": task.plant.kind,
            "sample_time": task.controller.sample_time,
            "horizon": task.controller.horizon,
            "nodes": task.controller.nodes,
            "onset": task.onset.kind,
            "seed": task.seed,
            "digest": loaded.digest,
            "task_yaml": loaded.task_yaml,
            "robot_yaml": loaded.robot_yaml,
        },
        values={
            "coordinate": labels(loaded.robot, "joint"),
            **of_Q,
            "pose_coordinate": labels(loaded.robot, "task", of_error=False),
            "stage": names,
            "momentum": MOMENTUM[loaded.robot.dimension],
            "stages/epsilon": task.onset.series,
            "stages/name": names,
            "stages/priority": priorities_in_force(task.controller, experiment.problem.stages),
            "monitors/name": task.judged,
            **({} if experiment.capture is None else experiment.capture.header),
            **({} if uncertainty is None else uncertainty.drawn),
        },
        has=frozenset(name for name, yes in has.items() if yes),
    )
