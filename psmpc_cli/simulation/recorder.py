"""What is recorded of a closed loop: the log of `simulate`, and that of a loop of one's own."""

import json
import logging
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli import __version__
from psmpc_cli.control.controller import Controller
from psmpc_cli.control.interface import Command, make_read_only
from psmpc_cli.control.sequence import Switch
from psmpc_cli.control.window_builder import priorities_in_force
from psmpc_cli.errors import InputError, RunError
from psmpc_cli.logs.conditions import THRUSTERS, TRUE_STATE, WHEELS, Recorded
from psmpc_cli.logs.run import Run, read_run, run_in
from psmpc_cli.logs.schema import KEEP_GOING, MOMENTUM, NEW_TARGETS, Q_COORDINATE, SLIDING, Sample, conditions_of
from psmpc_cli.logs.verdicts import verdicts
from psmpc_cli.logs.write import Header, LogWriter
from psmpc_cli.native.library import Library, compile_all, describe_compiler, describe_processor
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.plant import Ticks
from psmpc_cli.plant.grasp import Capture
from psmpc_cli.plant.uncertainty import Uncertainty
from psmpc_cli.plant.wheels import WheelTicks
from psmpc_cli.robot.dynamics import LARGEST_CONDITION
from psmpc_cli.robot.model import shape_of
from psmpc_cli.simulation.clearance import clearance_header
from psmpc_cli.simulation.measures import Counterfactuals, GraspRecord, Meter, StageClock
from psmpc_cli.solvers.sqp import libraries as solver_libraries
from psmpc_cli.specs.arguments import rejected, require
from psmpc_cli.specs.document import counted
from psmpc_cli.specs.robots.robot import RobotSpec, labels

logger = logging.getLogger(__name__)

Watch = Callable[[Sample], None]

OWN_LOOP = "own loop"
"""Attribute `plant` of the log of a loop that `simulate` did not run."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedLoop:
    """A closed loop as it is measured and recorded.

    Attributes:
        problem: The task made computable.
        counterfactuals: Solves windows that are measured and never applied.
        uncertainty: What the controller does not know; None without any, or where nobody knows it.
        capture: The object and its grasps; None of an object without a mass, or where nobody knows what became of it.
        initial_state: Initial state [Q; v] (nq + n,).
        compiled: Solver, and the plant where it is simulated, run as compiled C.
        plant_kind: Name of the plant in the log.
        knows_ticks: The true state is known at every tick.
        is_simulated: psmpc simulates the plant.
        keep_going: A mission that can no longer succeed goes on to its time limit.
        changes_targets: Targets of stages may change while it runs.
    """

    problem: Problem
    counterfactuals: Counterfactuals
    uncertainty: Uncertainty | None
    capture: Capture | None
    initial_state: np.ndarray
    compiled: bool
    plant_kind: str
    knows_ticks: bool = True
    is_simulated: bool = True
    keep_going: bool = False
    changes_targets: bool = False

    @property
    def recorded(self) -> Recorded:
        """What decides which datasets the log has."""
        return Recorded(self.problem.task, self.knows_ticks, self.is_simulated, self.changes_targets)


@dataclass(frozen=True, eq=False)
class Ending:
    """How a run ended.

    Attributes:
        completed: The last stage met its end condition.
        reason: Why the run stopped.
        time: When [s].
        state: The last state [Q; v] as the controller saw it (nq + n,).
        true_state: What that state really was (nq + n,).
        switches: Stages that ended since the last sample, the last stage among them.
        stuck: The run could not go on.
    """

    completed: bool
    reason: str
    time: float
    state: np.ndarray
    true_state: np.ndarray
    switches: tuple[Switch, ...] = ()
    stuck: bool = False


Samples = Generator[Sample, None, Ending]
"""The samples of a closed loop, which returns how it ended."""


def record(
    loop: RecordedLoop,
    samples: Samples,
    path: Path | None = None,
    watch: Watch = lambda sample: None,
    force: bool = False,
) -> Run:
    """Record a closed loop while it runs, sample by sample, and return the run as it is read from its log.

    Args:
        loop: What is known of the loop beforehand: its task, its plant, what is unknown to the controller.
        samples: Generator that runs the loop: it yields samples and returns how the loop ended.
        path: File of the log; by default the log is kept in memory alone.
        watch: Called with each sample after it is written.
        force: Overwrite an earlier log.

    Returns:
        The run, of as many samples as there were up to an interruption.

    Raises:
        InputError: The log exists already or cannot be written.
        RunError: The log could not be written any further.
    """
    absolute_path = None if path is None else path.absolute()  # a watcher may change the working folder
    with LogWriter(path, header(loop), force) as writer:
        _write_run(loop, samples, writer, watch)
        if absolute_path is None:
            return run_in(writer.file).with_problem(loop.problem)
    return read_run(absolute_path).with_problem(loop.problem)


def _write_run(loop: RecordedLoop, samples: Samples, writer: LogWriter, watch: Watch) -> None:
    """Run a closed loop and write what it yields, so that the log is complete up to any interruption or error.

    Written at every sample: its row, and the tables of the whole run that it has changed (when stages ended and
    started, what became of grasps, which targets were changed). At the end: the final state, and whether the task's
    monitors held (its verdicts).

    Args:
        loop: What is known of the loop beforehand.
        samples: Generator that runs the loop: it yields samples and returns how the loop ended.
        writer: Writes the log.
        watch: Called with each sample after it is written.

    Raises:
        Exception: What the loop, the writer or `watch` raises; the log then names the error. A KeyboardInterrupt is not
            raised: it ends the run cleanly.
    """
    stages = loop.problem.stages
    clock = StageClock(len(stages), loop.problem.spec.onset)
    records = (clock,) if loop.capture is None else (clock, GraspRecord(loop.capture))
    changes_of_targets = list[dict[str, Any]]()
    try:
        writer.update(clock.tables)
        while isinstance(sample := _next_sample_or_ending(samples), Sample):
            writer.write(sample)
            if sample.command.new_targets:
                changes_of_targets += [
                    {"time": sample.command.time, "stage": stage, "target": target}
                    for stage, target in sample.command.new_targets
                ]
                writer.update_attributes({NEW_TARGETS: json.dumps(changes_of_targets)})
            for record_of_run in records:
                has_changed = record_of_run.update(sample)
                if has_changed:
                    writer.update(record_of_run.tables)
            _log_events(sample, stages)
            make_read_only(sample.ticks)  # a watcher must not change what is recorded
            watch(sample)
    except KeyboardInterrupt as interruption:
        reason = str(interruption) or "interrupted"
        writer.finish(finished=False, reason=reason, values={**clock.tables, **_verdict_tables(loop, writer)})
        return
    except Exception as error:
        reason = str(error) if isinstance(error, RunError) else f"{type(error).__name__}: {error}"
        with suppress(RunError):  # if the log cannot be written either, the first error is raised
            writer.finish(finished=False, reason=reason, values=clock.tables)
        raise
    ending = sample
    clock.end(ending.switches)
    writer.update({**clock.tables, **_final_state(loop, ending)})
    writer.finish(ending.completed, ending.reason, _verdict_tables(loop, writer), ending.stuck)


def _next_sample_or_ending(samples: Samples) -> Sample | Ending:
    """Return the next sample of a closed loop, or how it ended; a StopIteration of a watcher means neither."""
    try:
        return next(samples)
    except StopIteration as stop:
        ending: Ending = stop.value
        return ending


def _final_state(loop: RecordedLoop, ending: Ending) -> dict[str, ArrayLike]:
    """Return time, state and poses at the end of a run, by their paths in the log."""
    model = loop.problem.model
    Q, v = np.split(ending.state, [model.nq])
    Q_true, v_true = np.split(ending.true_state, [model.nq])
    final = {"Q": Q, "Qdot": v, "xi": model.poses(Q_true).ravel()}
    if TRUE_STATE.holds(loop.recorded):
        final |= {"Q_true": Q_true, "Qdot_true": v_true}
    if loop.capture is not None:
        final["object_pose"], final["object_velocity"] = loop.capture.pose_and_velocity
    return {"final/end_time": ending.time, **{f"final/{name}": value for name, value in final.items()}}


def _verdict_tables(loop: RecordedLoop, writer: LogWriter) -> dict[str, ArrayLike]:
    """Return the verdicts of the task's monitors over the samples so far, by their paths in the log."""
    judged = verdicts(loop.problem.spec, run_in(writer.file).arrays) if loop.problem.spec.judged else ()
    return {
        "monitors/held": [verdict.held for verdict in judged],
        "monitors/margin": [verdict.margin for verdict in judged],
    }


def _log_events(sample: Sample, stages: tuple[Stage, ...]) -> None:
    """Tell the user who watches a run what happened at a sample: failures as warnings, other events as information.

    The events are those of `Command.events`: `appended`, for example, says that a stage entered the window, and
    `postponed` that the window with the next stage has no solution yet.

    Args:
        sample: The sample.
        stages: All stages of the task, for their names.
    """
    command = sample.command
    for switch in command.switches:
        logger.info("%.2f s: %s ended at %.2f s", command.time, stages[switch.stage].name, switch.time)
    if "appended" in command.events:
        logger.info("%.2f s: %s entered the window", command.time, stages[command.sequence.last].name)
    if "postponed" in command.events:
        name = stages[command.sequence.last + 1].name
        logger.info("%.2f s: %s was seen but could not be solved for yet", command.time, name)
    for stage, _ in command.new_targets:
        logger.info("%.2f s: %s has another target", command.time, stage)
    if "missed" in command.events:
        back_to = stages[command.sequence.first].name
        consequence = f"back to {back_to}" if "returned" in command.events else "there is no other try"
        logger.warning("%.2f s: the object was missed or lost; %s", command.time, consequence)
    braking = "braking" in command.events
    what_goes_on = "the robot brakes to rest" if braking else "the shifted plan goes on"
    if "unmeasured" in command.events:
        instead = what_goes_on if braking else "the plan's prediction is used for it"
        logger.warning("%.2f s: the state was not measured; %s", command.time, instead)
    elif "solve_failed" in command.events:
        logger.warning("%.2f s: solve failed (%s); %s", command.time, command.outcome.name.lower(), what_goes_on)
    if "load_dropped" in command.events:
        logger.warning("%.2f s: the estimated load does not explain the motion; its prior counts again", command.time)
    if "near_singular" in command.events:
        instead = "the law in joint space is used until then: bend the arms"
        logger.warning("%.2f s: J_C has a condition number above %g; %s", command.time, LARGEST_CONDITION, instead)


def header(loop: RecordedLoop) -> Header:
    """Collect what the log says of a run before it begins, so that the log alone suffices to understand and repeat it.

    Args:
        loop: The loop that is to be recorded.

    Returns:
        Attributes of the file (versions, machine, settings, the texts of task and robot); the values along the
        dimensions of datasets (names of coordinates, stages, monitors); and which optional datasets the log has.
    """
    task = loop.problem.spec
    loaded_task = loop.problem.task
    uncertainty = loop.uncertainty
    capture = loop.capture
    stage_names = tuple(stage.name for stage in loop.problem.stages)
    space = loop.problem.model.space
    # an attitude in space has four coordinates in Q and three in v, so Q has labels of its own
    coordinates_of_Q = {Q_COORDINATE: labels(loaded_task.robot, "joint", of_error=False)} if space.nq > space.n else {}
    return Header(
        attributes={
            "psmpc_version": __version__,
            "casadi_version": version("casadi"),
            "numpy_version": np.__version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "task_name": task.name,
            "controller": task.controller.kind,
            "solver": task.solver.kind,
            "compiled": loop.compiled,
            "processor": describe_processor(),
            "compiler": describe_compiler() if loop.compiled else "",
            "plant": loop.plant_kind,
            "sample_time": task.controller.sample_time,
            "horizon": task.controller.horizon,
            "nodes": task.controller.nodes,
            "onset": task.onset.kind,
            SLIDING: ", ".join(
                name for name in labels(loaded_task.robot, "joint") if name in loaded_task.robot.sliding
            ),
            "seed": task.seed,
            KEEP_GOING: loop.keep_going,
            **({NEW_TARGETS: "[]"} if loop.changes_targets else {}),
            "digest": loaded_task.digest,
            "task_yaml": loaded_task.task_yaml,
            "robot_yaml": loaded_task.robot_yaml,
        },
        values={
            "coordinate": labels(loaded_task.robot, "joint"),
            **coordinates_of_Q,
            "pose_coordinate": labels(loaded_task.robot, "task", of_error=False),
            "stage": stage_names,
            "momentum": MOMENTUM[loaded_task.robot.dimension],
            **({"load/moment": _moments_of_load(loop.problem)} if task.finds_load else {}),
            **(masses_header(loaded_task.robot) if task.finds_masses else {}),
            "stages/epsilon": task.onset.series,
            "stages/name": stage_names,
            "stages/priority": priorities_in_force(task.controller, loop.problem.stages),
            "monitors/name": tuple(task.judged),
            "monitors/unit": tuple(task.judged.values()),
            **({} if capture is None else capture.header),
            **(clearance_header(loop.problem) if task.keeps_clear else {}),
            **(thrusters_header(loaded_task.robot) if THRUSTERS.holds(loop.recorded) else {}),
            **({"wheel": wheel_labels(loaded_task.robot)} if WHEELS.holds(loop.recorded) else {}),
            **({} if uncertainty is None else uncertainty.drawn),
        },
        has=conditions_of(loop.recorded),
    )


def _moments_of_load(problem: Problem) -> tuple[str, ...]:
    """Return the names of the moments of inertia of a load that is estimated: one of a payload, else principal ones."""
    if problem.spec.uncertainty.carried.is_estimated:
        return ("all axes",)
    return ("xx", "yy", "zz")[-problem.model.space.n_principal :]


def wheel_labels(robot: RobotSpec) -> tuple[str, ...]:
    """Return the names of the reaction wheels of a robot in the log."""
    return tuple(f"wheel {number}" for number, _ in enumerate(robot.wheels, start=1))


def thrusters_header(robot: RobotSpec) -> dict[str, tuple[str, ...]]:
    """Return the names of the thrusters of a robot, by path in the log."""
    return {"thruster": tuple(f"thruster_{number}" for number, _ in enumerate(robot.thrusters, start=1))}


def masses_header(robot: RobotSpec) -> dict[str, tuple[str, ...]]:
    """Return names of bodies and arms whose masses are found out, by path in the log."""
    return {"masses/body": tuple(body.name for body in robot.bodies), "masses/arm": tuple(robot.arms)}


def libraries_of_solver(problem: Problem) -> list[Library]:
    """Return the compiled libraries that the solver of a problem needs; none where it needs none."""
    return list(solver_libraries(problem)) if problem.spec.solver.traits.real_time else []


class Recorder:
    """Records a loop of one's own as a `Run`, as `simulate` records its own.

    `add` keeps a command and costs no time in the loop. `run` measures all of them, which takes further solves (how
    much each stage acts on the control), so it is called when the loop has ended. A sample lasts until the next
    command, whose state is the measured one at its end. What happens in between is known where `add` is given the
    ticks, the periods of the low-level controller; without them forces, base efforts and the balances of momentum and
    energy are NaN. What becomes of an object with a mass is not recorded.
    """

    def __init__(self, controller: Controller) -> None:
        """Record the commands of a controller.

        Raises:
            InputError: It is no controller.
        """
        require("controller", controller, Controller, "a Controller")
        self._controller = controller
        self._commands: list[Command] = []
        self._ticks: list[Ticks | None] = []

    def __repr__(self) -> str:
        return f"<Recorder of {self._controller.problem.spec.name}: {counted(len(self), 'command', 'commands')}>"

    def __len__(self) -> int:
        """Return the number of commands."""
        return len(self._commands)

    def add(self, command: Command, ticks: Ticks | None = None) -> None:
        """Add what the controller decided at a sample, and what the robot did then if that is known.

        Nothing is computed yet, so it costs no time in the loop.

        Args:
            command: The command, from `Controller.step`.
            ticks: What the robot did until the next sample, at the ticks of `command.u` (the periods of the low-level
                controller). They are given with all commands but the last one, or with none. Forces that are not known
                are NaN.

        Raises:
            InputError: The command is another controller's or does not come after the one before, or the ticks are not
                those of its sample.
        """
        require("command", command, Command, "a Command, from Controller.step")
        require("ticks", ticks, (Ticks, type(None)), "Ticks, or None")
        if command.law.model is not self._controller.problem.model:
            raise rejected("command", command, f"one of {self._controller}")
        if self._commands and command.time <= self._commands[-1].time:
            before = self._commands[-1].time
            raise InputError(f"command: found {command.time:g} s after {before:g} s, expected a later one")
        if ticks is not None:
            if self._commands and self._ticks[-1] is None:
                raise InputError("ticks: found some after a command without any, expected them with every command")
            ticks = _ticks_as_arrays(ticks, command)
        self._commands.append(command)
        self._ticks.append(ticks)

    def run(self, reason: str | None = None) -> Run:
        """Measure what was recorded of a loop of one's own and return it as a run, in memory.

        The run has the same measures as a simulated one. Some of them take further solves: how much each stage acts on
        the control. It ends where its last stage does; commands after that are left out. The ticks of a command, the
        periods of the low-level controller, tell what the robot did until the next one.

        Args:
            reason: Why the loop ended, if it did so before the last stage; by default the controller's `failure`.

        Returns:
            The run, without a file.

        Raises:
            InputError: There is no command yet, or some have ticks and others none. The last may be without: its ticks
                are not over yet.
        """
        require("reason", reason, (str, type(None)), "a text, or None")
        if not self._commands:
            raise InputError("found no command, expected at least one: Recorder.add(command)")
        knows_ticks = self._ticks[0] is not None
        if knows_ticks and None in self._ticks[:-1]:
            raise InputError("ticks: found a command without any, expected them with all commands but the last")
        problem = self._controller.problem
        first_ticks = self._ticks[0]
        loop = RecordedLoop(
            problem=problem,
            counterfactuals=Counterfactuals(self._controller),
            uncertainty=None,  # what disturbs the robot, and what becomes of an object, is not known
            capture=None,
            initial_state=self._commands[0].state if first_ticks is None else first_ticks.states[0],
            # the further solves use compiled code, which is made here if it is not in the cache
            compiled=problem.spec.solver.compiled and compile_all(libraries_of_solver(problem)),
            plant_kind=OWN_LOOP,
            knows_ticks=knows_ticks,
            is_simulated=False,
            changes_targets=any(command.new_targets for command in self._commands),
        )
        return record(loop, self._measured_samples(loop, reason or self._controller.failure or "the loop ended"))

    def _measured_samples(self, loop: RecordedLoop, reason: str) -> Samples:
        """Yield the recorded samples as the loop of `simulate` yields its own, and return how the loop ended.

        The end is where the last stage has met its end condition and the task's time after that has passed; or else
        where records end.

        Args:
            loop: What is known of the loop.
            reason: Why the loop ended, where the last stage had not.
        """
        wheel_momenta = self._commands[0].wheels if len(self._commands[0].wheels) else None
        meter = Meter(loop.counterfactuals, loop.uncertainty, loop.capture, loop.initial_state, wheel_momenta)
        last_stage = loop.problem.stages[-1]
        mission_ends_at = np.inf
        rounding = 1e-9  # of sums of sample times [s]
        time = self._commands[0].time
        end_state = loop.initial_state
        for command, ticks in zip(self._commands, self._given_or_single_ticks(), strict=True):
            state = command.state if ticks is None else ticks.states[0]
            ending = partial(
                Ending, time=command.time, state=command.state, true_state=state, switches=command.switches
            )
            if any(switch.stage == last_stage.index for switch in command.switches):
                mission_ends_at = command.acts_at + loop.problem.spec.time_after_end
            if command.time >= mission_ends_at - rounding:
                return ending(completed=True, reason=f"{last_stage.name} met its end condition")
            if ticks is None:  # the last command, after which nothing is known
                return ending(completed=False, reason=reason)
            in_force = self._command_in_force(float(ticks.time[0]))
            yield meter.measure(command, ticks, state, u=in_force.u, contact=None, in_force=in_force)
            time = float(ticks.time[-1])
            end_state = ticks.states[-1]
        return Ending(completed=False, reason=reason, time=time, state=end_state, true_state=end_state)

    def _command_in_force(self, time: float) -> Command:
        """Return the last command that is expected to act at a time [s]; the first one before there is any."""
        acting = [command for command in self._commands if command.acts_at <= time + command.tick / 2]
        return acting[-1] if acting else self._commands[0]

    def _given_or_single_ticks(self) -> Iterator[Ticks | None]:
        """Yield what the robot did after every command, for the metrics of its sample.

        Yields:
            The ticks that the user gave. Where none were given, a single long tick from the measured state of the
            command to that of the next one, with unknown forces (NaN); after the last command None.
        """
        next_commands = [*self._commands[1:], None]
        for command, ticks, next_command in zip(self._commands, self._ticks, next_commands, strict=True):
            wheels_at_end = command.wheels if next_command is None else next_command.wheels
            if ticks is not None and ticks.wheels is not None:
                yield ticks
                continue
            if ticks is not None:
                yield replace(ticks, wheels=_interpolated_wheels(command, wheels_at_end, len(ticks.F)))
                continue
            if next_command is None:
                yield None
                continue
            base_rates = self._controller.problem.model.parts["base"]
            yield Ticks(
                time=np.array([command.acts_at, next_command.acts_at]),
                states=np.array([command.state, next_command.state]),
                F=np.full((1, command.u.shape[1]), np.nan),
                impulse_and_work=np.full(base_rates.stop + 1, np.nan),  # an impulse for each rate of the base, the work
                wheels=_interpolated_wheels(command, wheels_at_end, ticks=1),
            )


def _interpolated_wheels(command: Command, momenta_at_end: np.ndarray, ticks: int) -> WheelTicks | None:
    """Return what wheels did over the ticks of a sample, where only their momenta at both ends are known.

    Args:
        command: Command of the sample, with the momenta at its beginning.
        momenta_at_end: Angular momenta that the wheels store at its end (W,) [N m s].
        ticks: Number of ticks M.

    Returns:
        Momenta that change at a constant rate (M + 1, W), and unknown torques (NaN); None for a robot without wheels.
    """
    if not len(command.wheels):
        return None
    momenta = np.linspace(command.wheels, momenta_at_end, ticks + 1)
    return WheelTicks(momentum=momenta, torque=np.full((ticks, len(momenta_at_end)), np.nan))


def _ticks_as_arrays(ticks: Ticks, command: Command) -> Ticks:
    """Check the ticks that a user's own loop has recorded of a sample, and return them as arrays of floats.

    Where they are not given, the commanded forces are taken to be the applied ones, and impulse and work are NaN.

    Args:
        ticks: What the robot did over the sample, as the user gives it.
        command: The command of the sample, which has M ticks.

    Raises:
        InputError: An array is not as large as the ticks of the command make it, or times do not go on from the
            command's.
    """
    M, n = command.u.shape
    ticks = replace(ticks, commanded=ticks.F if ticks.commanded is None else ticks.commanded)
    shapes = {"time": (M + 1,), "states": (M + 1, len(command.state)), "F": (M, n), "commanded": (M, n)}
    for name, shape in shapes.items():
        if shape_of(getattr(ticks, name)) != shape:
            raise rejected(f"ticks.{name}", getattr(ticks, name), f"numbers {shape}")
    n_impulse_and_work = command.law.model.parts["base"].stop + 1  # an impulse for each rate of the base, and the work
    if shape_of(ticks.impulse_and_work) not in ((), (n_impulse_and_work,)):
        raise rejected("ticks.impulse_and_work", ticks.impulse_and_work, f"numbers ({n_impulse_and_work},)")
    time = np.array(ticks.time, dtype=float)
    begins_with_command = abs(time[0] - command.time) <= command.tick
    if not (begins_with_command and (np.diff(time) > 0).all()):
        span = f"{time[0]:g} s to {time[-1]:g} s"
        raise InputError(f"ticks.time: found {span}, expected ascending times from {command.time:g} s on")
    return replace(
        ticks,
        time=time,
        states=np.array(ticks.states, dtype=float),
        F=np.array(ticks.F, dtype=float),
        commanded=np.array(ticks.commanded, dtype=float),
        impulse_and_work=np.array(np.broadcast_to(ticks.impulse_and_work, (n_impulse_and_work,)), dtype=float),
    )
