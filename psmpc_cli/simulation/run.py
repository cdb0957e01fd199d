"""One run from a loaded task to a closed log: the closed loop, its log and whoever watches."""

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TypedDict

import numpy as np

from psmpc_cli import __version__
from psmpc_cli.control.controller import priorities_in_force
from psmpc_cli.errors import RunError
from psmpc_cli.logs.read import read_log
from psmpc_cli.logs.record import Record
from psmpc_cli.logs.write import Header, LogWriter, write_monitors
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.robot.bodies import body_names
from psmpc_cli.simulation.checkpoint import Checkpoint
from psmpc_cli.simulation.loop import Ending, simulate
from psmpc_cli.simulation.monitors import verdicts
from psmpc_cli.simulation.setup import Experiment, build_experiment
from psmpc_cli.simulation.stage_times import StageClock
from psmpc_cli.specs.coordinates import labels
from psmpc_cli.specs.load import Task

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Progress:
    """What a watcher is told after each sample."""

    record: Record
    stage: str
    fallbacks: int


def run(
    loaded: Task, path: Path, force: bool = False, watch: Callable[[Progress], None] = lambda progress: None
) -> Ending | None:
    """Run a task, write its log, and return how it ended; None if it was interrupted.

    An interruption (KeyboardInterrupt, from anywhere or raised by the watcher) ends the run cleanly: the log holds
    everything up to then and says `finished = false`.

    Raises:
        InputError: The log exists already or cannot be written.
        RunError: The log could not be written any further.
    """
    experiment = build_experiment(loaded)
    with LogWriter(path, header(experiment), force) as writer:
        ending = write_records(experiment, writer, watch, new_clock(experiment))
    judge(loaded, path)
    return ending


def judge(loaded: Task, path: Path) -> None:
    """Write the verdicts of the task's monitors into a closed log."""
    if verdict := verdicts(loaded.spec, read_log(path)):
        write_monitors(path, np.array([v.held for v in verdict]), np.array([v.margin for v in verdict]))


def new_clock(experiment: Experiment) -> StageClock:
    """Return the clock of an experiment's stages."""
    onset = experiment.task.onset
    return StageClock(len(experiment.stages), onset.epsilon, onset.series)


def write_records(
    experiment: Experiment,
    writer: LogWriter,
    watch: Callable[[Progress], None],
    clock: StageClock,
    start: Checkpoint | None = None,
    fallbacks: int = 0,
) -> Ending | None:
    """Write every record of the closed loop and tell the watcher, until the run ends or is interrupted.

    Args:
        experiment: The experiment.
        writer: Its log.
        watch: Told after each sample.
        clock: When the stages ended and started, up to the start.
        start: Where to go on from; by default the beginning.
        fallbacks: How many samples before had no solution.
    """
    samples = simulate(experiment, start)
    try:
        writer.update_stages(clock.times)
        while True:
            record = next(samples)
            writer.append(record)
            if clock.update(record):
                writer.update_stages(clock.times)
            fallbacks += "fallback" in record.flags
            _report(record, experiment.stages)
            watch(Progress(record, experiment.stages[record.window_first].name, fallbacks))
    except StopIteration as stop:
        ending: Ending = stop.value
    except KeyboardInterrupt as interruption:
        writer.update_stages(clock.times)
        writer.finish(False, str(interruption) or "interrupted", *_nowhere(experiment))
        return None
    except RunError as error:
        with suppress(RunError):
            writer.finish(False, str(error), *_nowhere(experiment))
        raise
    clock.hand_over(tuple((switch.stage, switch.time) for switch in ending.switches))
    writer.update_stages(clock.times)
    xi = experiment.model.poses(ending.true[: experiment.model.n]).ravel()
    writer.finish(ending.completed, ending.reason, ending.time, ending.x, xi, ending.true)
    return ending


def _nowhere(experiment: Experiment) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the final time, state and poses of a run that has none."""
    return np.nan, np.full(2 * experiment.model.n, np.nan), np.full(experiment.model.m, np.nan)


def _report(record: Record, stages: tuple[Stage, ...]) -> None:
    """Log what happened at a sample: what went wrong as a warning, the rest for who wants to know every event."""
    for stage, instant in record.switches:
        logger.info("%.2f s: %s ended at %.2f s", record.time, stages[stage].name, instant)
    last = record.window_first + len(record.instants)
    if "appended" in record.flags:
        logger.info("%.2f s: %s entered the window", record.time, stages[last].name)
    if "postponed" in record.flags:
        logger.info("%.2f s: %s was seen but could not be solved for yet", record.time, stages[last + 1].name)
    goes_on = "the robot brakes to rest" if "braking" in record.flags else "the shifted plan goes on"
    if "unmeasured" in record.flags:
        stands_in = goes_on if "braking" in record.flags else "the plan's prediction stands in for it"
        logger.warning("%.2f s: the state was not measured; %s", record.time, stands_in)
    elif "fallback" in record.flags:
        logger.warning("%.2f s: solve failed (%s); %s", record.time, record.solve.status, goes_on)


def header(experiment: Experiment) -> Header:
    """Return what the log says of the run before it begins."""
    task, loaded = experiment.task, experiment.loaded
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
        coordinates=labels(loaded.robot, "joint"),
        pose_coordinates=labels(loaded.robot, "task"),
        stages=tuple(stage.name for stage in experiment.stages),
        priorities=tuple(priorities_in_force(task.controller, experiment.stages)),
        epsilons=task.onset.series,
        ticks=task.log.ticks,
        plans=task.log.plans,
        monitors=tuple(monitor.name for monitor in task.monitors),
        levels=task.controller.kind == "htmpc",
        offset_free=task.controller.offset_free,
        **_uncertain(experiment),
        units={path: "1" for path in ("window/presence", "stages/epsilon") if task.onset.kind == "closeness"},
    )


class _Uncertain(TypedDict):
    """What a header says of an uncertainty."""

    noisy: bool
    payload: bool
    bodies: tuple[str, ...]
    drawn: dict[str, np.ndarray]


def _uncertain(experiment: Experiment) -> _Uncertain:
    spec, draw = experiment.uncertainty.spec, experiment.uncertainty.draw
    drawn = {
        "uncertainty/mass_factor": draw.mass_factor,
        "uncertainty/inertia_factor": draw.inertia_factor,
        "uncertainty/centre_of_mass": draw.offset,
    }
    return {
        "noisy": not experiment.task.sees_the_state,
        "payload": spec.payload is not None,
        "bodies": body_names(experiment.model.spec) if spec.in_force else (),
        "drawn": drawn if spec.in_force else {},
    }
