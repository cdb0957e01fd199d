"""One run from a task to its log: the closed loop, its log, and who watches it."""

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from psmpc_cli import __version__
from psmpc_cli.control.controller import priorities_in_force
from psmpc_cli.errors import InputError, LogError, RunError
from psmpc_cli.logs.comparison import Comparison, compare_logs
from psmpc_cli.logs.run import Run, arrays_in, read_run, run_in
from psmpc_cli.logs.schema import AXES, MOMENTUM, Sample
from psmpc_cli.logs.summary import verdicts
from psmpc_cli.logs.write import Header, LogWriter, claimed
from psmpc_cli.ocp.problem import Stage
from psmpc_cli.robot.bodies import body_names
from psmpc_cli.simulation.loop import Ending, closed_loop
from psmpc_cli.simulation.measures import StageClock
from psmpc_cli.simulation.setup import Experiment, build_experiment
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.load import Task

logger = logging.getLogger(__name__)

Watch = Callable[[Sample], None]


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
        InputError: The log exists already or cannot be written.
        RunError: The log could not be written any further.
    """
    experiment, path = build_experiment(task), None if path is None else Path(path)
    with LogWriter(path, header(experiment), force) as writer:
        _write(experiment, writer, watch, until)
        if path is None:
            return run_in(writer.file)
    return read_run(path)


def _write(experiment: Experiment, writer: LogWriter, watch: Watch, until: int | None = None) -> None:
    """Write every sample of the closed loop and how it ended."""
    onset, samples = experiment.task.onset, closed_loop(experiment, until)
    clock = StageClock(len(experiment.stages), onset.epsilon, onset.series)
    try:
        writer.update(clock.tables)
        while True:
            sample = next(samples)
            writer.append(sample)
            if clock.update(sample):
                writer.update(clock.tables)
            _report(sample, experiment.stages)
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
    final = {"Q": ending.x[: experiment.model.n], "Qdot": ending.x[experiment.model.n :]}
    if not experiment.task.sees_the_state:
        final |= {"Q_true": ending.true[: experiment.model.n], "Qdot_true": ending.true[experiment.model.n :]}
    final["xi"] = experiment.model.poses(ending.true[: experiment.model.n]).ravel()
    return {"final/end_time": ending.time, **{f"final/{name}": value for name, value in final.items()}}


def _verdicts(experiment: Experiment, writer: LogWriter) -> dict[str, ArrayLike]:
    """Return the verdicts of the task's monitors over the samples so far, by their paths in the log."""
    found = verdicts(experiment.task.monitors, arrays_in(writer.file)) if experiment.task.monitors else ()
    return {"monitors/held": [v.held for v in found], "monitors/margin": [v.margin for v in found]}


def _report(sample: Sample, stages: tuple[Stage, ...]) -> None:
    """Log what happened at a sample: what went wrong as a warning, the rest for who wants to know every event."""
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
    task, loaded, draw = experiment.task, experiment.loaded, experiment.uncertainty.draw
    names = tuple(stage.name for stage in experiment.stages)
    drawn: dict[str, ArrayLike] = {
        "uncertainty/body": body_names(experiment.model.spec),
        "uncertainty/axis": AXES,
        "uncertainty/mass_factor": draw.mass_factor,
        "uncertainty/inertia_factor": draw.inertia_factor,
        "uncertainty/centre_of_mass": draw.offset,
    }
    has = {
        "ticks": task.log.ticks,
        "plans": task.log.plans,
        "levels": task.controller.kind == "htmpc",
        "true state": not task.sees_the_state,
        "payload": task.uncertainty.payload is not None,
        "disturbance": task.controller.offset_free,
        "drawn": task.uncertainty.in_force,
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
            "pose_coordinate": labels(loaded.robot, "task"),
            "stage": names,
            "momentum": MOMENTUM,
            "stages/epsilon": task.onset.series,
            "stages/name": names,
            "stages/priority": priorities_in_force(task.controller, experiment.stages),
            "monitors/name": tuple(monitor.name for monitor in task.monitors),
            **(drawn if task.uncertainty.in_force else {}),
        },
        has=frozenset(name for name, yes in has.items() if yes),
        units={path: "1" for path in ("window/presence", "stages/epsilon") if task.onset.kind == "closeness"},
    )


def rerun(log: Run, path: Path, force: bool = False, watch: Watch = lambda sample: None) -> Comparison | None:
    """Repeat a run, up to where its log ends, and compare every dataset but the wall times; None if interrupted.

    Raises:
        LogError: The log holds no samples, or does not describe a run of this version.
        InputError: The new log exists already or cannot be written.
        RunError: It could not be written any further.
    """
    ended, samples = not log.interrupted, len(log.time)
    if not samples:
        raise LogError(f"{log.path}: holds no samples, so there is nothing to compare a run with")
    reason = str(log.attributes["end_reason"])

    def watch_samples(sample: Sample) -> None:
        watch(sample)
        if not ended and sample.number + 1 == samples:
            raise KeyboardInterrupt(reason or "as far as the log goes")

    again = simulate(log.task, path, watch_samples, force)
    if again.interrupted and (ended or len(again.time) < samples):
        return None
    # a killed run has judged no monitor, and may have noted no switch of its last sample
    return compare_logs(log.path, path, None if ended else samples, () if reason else ("stages/", "monitors/"))


def continue_run(log: Run, path: Path | None = None, watch: Watch = lambda sample: None) -> Comparison | None:
    """Run the task of an unfinished log again from its beginning, to the end; None if interrupted.

    Every row that the log holds is compared with the new one, wall times left out. Where all are equal the new log
    takes the place of the old one in one step; where they are not, or if interrupted, the old one stays as it is.

    Args:
        log: The log.
        path: Where the new log goes; the old one's place by default.
        watch: Called with each sample.

    Raises:
        LogError: The run has ended, or the log does not describe a run of this version.
        InputError: The new log cannot be written, or the run still goes on.
        RunError: The new log could not be written any further.
    """
    ensure_unfinished(log)
    if claimed(log.path):
        raise InputError(f"{log.path} cannot be continued: its run still goes on")
    target = log.path.resolve()
    new = path or target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        again = simulate(log.task, new, watch)
        if again.interrupted:
            return None
        comparison = compare_logs(log.path, new, len(log.time), ("stages/", "monitors/", "final/"))
        if path is None and not comparison.differences:
            os.replace(new, target)
        return comparison
    finally:
        if path is None:
            new.unlink(missing_ok=True)


def ensure_unfinished(log: Run) -> None:
    """Make sure that there is something to continue.

    Raises:
        LogError: The run has ended.
    """
    if not log.interrupted:
        raise LogError(
            f"{log.path}: this run has ended ({log.attributes['end_reason']}), so there is nothing to continue"
        )


def unequal_conditions(log: Run) -> tuple[str, ...]:
    """Return what makes it pointless to expect equal numbers: other versions, several threads, a deadline."""
    here = {
        "psmpc_version": __version__,
        "casadi_version": version("casadi"),
        "numpy_version": np.__version__,
    }
    found = [
        f"{name.removesuffix('_version')} {log.attributes.get(name, 'unknown')} wrote the log, this is {running}"
        for name, running in here.items()
        if str(log.attributes.get(name)) != running
    ]
    if os.environ.get("OMP_NUM_THREADS") != "1" and (os.cpu_count() or 1) > 1:
        found.append("OMP_NUM_THREADS is not 1: sums over several threads may be rounded otherwise")
    if (deadline := log.task.spec.solver.deadline) is not None:
        found.append(f"solves have a deadline of {deadline:g} s: how far they come depends on the machine")
    return tuple(found)
