"""Monitors: named bounds on a signal during a stage that decide whether the mission succeeded."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.logs.read import Log
from psmpc_cli.specs.task import MonitorSpec, TaskSpec


@dataclass(frozen=True)
class Verdict:
    """Whether a monitor held, and by what margin: the smallest distance of the signal to its bounds.

    Attributes:
        margin: In the signal's unit; negative where it was broken; NaN where no sample falls into the stage.
        broken_at: First sample at which it was broken [s], NaN if it held.
    """

    name: str
    held: bool
    margin: float
    broken_at: float


def verdicts(task: TaskSpec, log: Log) -> tuple[Verdict, ...]:
    """Return the verdict of every monitor of the task over a log."""
    return tuple(_verdict(monitor, log) for monitor in task.monitors)


def _verdict(monitor: MonitorSpec, log: Log) -> Verdict:
    during = log["window/first"] == log.stage_names.index(monitor.during)
    if not during.any():
        return Verdict(monitor.name, False, np.nan, np.nan)
    values, time = signal(monitor, log)[during], log.time[during]
    margins = [np.full(len(values), np.inf)]
    if monitor.above_start_at_most is not None:
        margins.append(values[0] + monitor.above_start_at_most - values)
    if monitor.below_start_at_most is not None:
        margins.append(values - values[0] + monitor.below_start_at_most)
    if monitor.at_most is not None:
        margins.append(monitor.at_most - values)
    if monitor.at_least is not None:
        margins.append(values - monitor.at_least)
    margin = np.min(margins, axis=0)
    broken = np.flatnonzero(~(margin >= 0))  # a signal that is not a number holds no bound
    return Verdict(
        monitor.name, not len(broken), float(margin.min()), float(time[broken[0]]) if len(broken) else np.nan
    )


def signal(monitor: MonitorSpec, log: Log) -> np.ndarray:
    """Return the monitored signal at every sample (K,): distance [m] between two frames, or speed [m/s] of one or more.

    Speed is that of the frame's position between samples, the largest of the named frames.
    """
    positions = [_position(log, name) for name in monitor.of]
    if monitor.quantity == "distance":
        origin = positions[1] if len(positions) > 1 else _position(log, "base")
        return np.asarray(np.linalg.norm(positions[0] - origin, axis=1))
    step = np.gradient(log.time) if len(log.time) > 1 else np.ones(1)
    steps = [np.linalg.norm(np.gradient(p, axis=0), axis=1) if len(p) > 1 else np.zeros(1) for p in positions]
    return np.asarray(np.max(steps, axis=0) / step)


def _position(log: Log, frame: str) -> np.ndarray:
    names = list(log.pose_coordinates)
    return log["pose/xi"][:, [names.index(f"{frame}.x"), names.index(f"{frame}.y")]]
