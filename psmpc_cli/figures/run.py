"""A log made ready to draw: the robot and the stages it speaks of, rebuilt from the texts it carries."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.errors import LogError, SpecError
from psmpc_cli.logs.read import Log
from psmpc_cli.ocp.problem import Stage, build_stages
from psmpc_cli.robot.model import RobotModel, build_model
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.task import TaskSpec

Array = np.ndarray


@dataclass(frozen=True)
class Span:
    """When a stage was the current one [s].

    Attributes:
        index, name: The stage.
        start, end: First and last instant; of a stage the run did not end, the end of the run.
        early: Its actual start where that lies before `start`, else None.
    """

    index: int
    name: str
    start: float
    end: float
    early: float | None


@dataclass(frozen=True, eq=False)
class Run:
    """A log and what it is about.

    Attributes:
        task: The task that ran.
        model: The robot that ran it.
        stages: The task's stages as numbers.
        time: Sample times, then the end of the run where it is known (K or K + 1,) [s].
        Q, Qdot, xi: True state and poses at these times.
        Q_seen, Qdot_seen: The state the controller saw: measured, or foreseen over a known delay.
        spans: The stages that were reached, in order; of one that only acted ahead of its time, `start` is the end.
    """

    log: Log
    task: TaskSpec
    model: RobotModel
    stages: tuple[Stage, ...]
    time: Array
    Q: Array
    Qdot: Array
    xi: Array
    Q_seen: Array
    Qdot_seen: Array
    spans: tuple[Span, ...]

    @property
    def end(self) -> float:
        """Last time there is a state of [s]."""
        return float(self.time[-1])

    def poses_at(self, time: Array) -> Array:
        """Return xi (K, m) [m, rad] at times (K,) [s], interpolated between samples."""
        return np.column_stack([np.interp(time, self.time, row) for row in self.xi.T])

    def coordinates_at(self, time: float) -> Array:
        """Return Q (n,) [m, rad] at a time [s], interpolated between samples."""
        return np.array([np.interp(time, self.time, row) for row in self.Q.T])


def load_run(log: Log) -> Run:
    """Return what a log is about.

    Raises:
        LogError: It holds no sample, or its texts are not a task and a robot of this version.
    """
    if not len(log.time):
        raise LogError(f"{log.path}: holds no sample, the run ended before its first one; there is nothing to draw")
    loaded = _loaded(log)
    model = build_model(loaded.robot)
    if (model.n, model.m, len(loaded.spec.stages)) != (
        log["state/Q"].shape[1],
        log["pose/xi"].shape[1],
        len(log.stages["name"]),
    ):
        raise LogError(f"{log.path}: its task_yaml and robot_yaml do not describe the run it holds")
    motion = _with_final(log)
    return Run(
        log=log,
        task=loaded.spec,
        model=model,
        stages=build_stages(loaded.spec, loaded.robot, model),
        spans=stage_spans(log, float(motion["time"][-1])),
        **motion,
    )


def stage_spans(log: Log, end: float) -> tuple[Span, ...]:
    """Return when each stage that was reached, or acted early, was the current one; the run lasted to `end` [s]."""
    spans: list[Span] = []
    start = float(log.time[0])
    for index, name in enumerate(log.stage_names):
        actual, switch = float(log.stages["actual_start"][index]), float(log.stages["switch_time"][index])
        early = actual if index and log.stages["early"][index] and actual < start else None
        if spans and start >= end and early is None:
            break
        spans.append(Span(index, name, start, switch if np.isfinite(switch) else end, early))
        start = spans[-1].end
    return tuple(spans)


def _loaded(log: Log) -> Task:
    texts = (str(log.attributes[name]) for name in ("task_yaml", "robot_yaml", "task_name"))
    try:
        return parse_task(*texts)
    except SpecError as error:
        raise LogError(f"{log.path}: its texts of task and robot do not hold in this version:\n{error}") from None


def _with_final(log: Log) -> dict[str, Array]:
    """Return time, poses and states of all samples and of the end of the run, where it was reached."""
    time, final = log.time, log.final
    ended = np.isfinite(final["time"]) and final["time"] > time[-1]

    def along(column: Array, last: Array) -> Array:
        return np.concatenate([column, last[None]]) if ended else column

    found = {"time": along(time, final["time"]), "xi": along(log["pose/xi"], final["xi"])}
    known = "state/Q_true" in log.columns and "Q_true" in final
    for name in ("Q", "Qdot"):
        true = f"{name}_true" if known else name
        found[name] = along(log[f"state/{true}"], final[true])
        found[f"{name}_seen"] = along(log[f"state/{name}"], final[name])
    return found
