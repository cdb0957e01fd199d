"""What one run has to say on the claims: its summary, and how each stage came to act on the control."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from psmpc_cli.logs.read import Log
from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.outlook import look_ahead
from psmpc_cli.ocp.stages import build_stages
from psmpc_cli.robot.model import build_model
from psmpc_cli.simulation.summary import StageSummary, Summary, summarize, task_of
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.claims import Moment

NEAR = 1e-6
"""Times closer than this are the same [s]."""


@dataclass(frozen=True, eq=False)
class Onset:
    """How a waiting stage came to act on the control.

    Attributes:
        time: Samples at which it waited in the window (W,) [s].
        presence: Norm of the control it added in its onset coordinates (W,) [m/s^2, rad/s^2].
        starts: Its actual start [s] for each threshold [m/s^2, rad/s^2] that the log follows.
        postponed: Samples at which the window with it had no solution yet.
    """

    time: np.ndarray
    presence: np.ndarray
    starts: Mapping[float, float]
    postponed: int

    def thresholds(self, earliest: float, latest: float) -> tuple[float, float]:
        """Return between which thresholds, the upper one included, it starts from `earliest` to `latest` [s]."""
        return self.largest(earliest - NEAR), self.largest(latest + NEAR)

    def largest(self, before: float = np.inf) -> float:
        """Return the largest presence at samples before a time [s]; 0 if there is none."""
        return float(np.max(self.presence[self.time < before], initial=0.0))


@dataclass(frozen=True, eq=False)
class Nearness:
    """How near a stage is to its end condition.

    Attributes:
        time: Samples, and the end of the run (K,) [s].
        tolerances: Largest error of the condition's coordinates, in tolerances (K,) [1].
    """

    time: np.ndarray
    tolerances: np.ndarray

    def at(self, time: float) -> float:
        """Return the largest error at a time [s], in tolerances."""
        return float(np.interp(time, self.time, self.tolerances))


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a run has to say.

    Attributes:
        summary: Its summary.
        horizon, nodes, sample_time: As it ran.
        epsilon: Threshold that marks an actual start [m/s^2, rad/s^2].
        onsets: By stage; those that waited in a window.
        nearness: By stage; those with an end condition.
        earliest_ends: By stage, the time before which velocity limits let none end [s].
    """

    summary: Summary
    horizon: float
    nodes: float
    sample_time: float
    epsilon: float
    onsets: Mapping[str, Onset]
    nearness: Mapping[str, Nearness]
    earliest_ends: Mapping[str, float]

    def stage(self, name: str) -> StageSummary | None:
        """Return the summary of a stage; None if the run knows none of this name."""
        return next((stage for stage in self.summary.stages if stage.name == name), None)

    def time_of(self, moment: Moment) -> float:
        """Return when something happened [s]; NaN if it did not."""
        stage = self.stage(moment.stage)
        if stage is None:
            return float("nan")
        return stage.switch_time if moment.event == "end" else stage.actual_start

    def regular_start(self, name: str) -> float:
        """Return when the stage before this one ended [s]; NaN if it did not, 0 for the first."""
        ends = [0.0, *(stage.switch_time for stage in self.summary.stages)]
        names = [stage.name for stage in self.summary.stages]
        return ends[names.index(name)] if name in names else float("nan")


def gather_evidence(log: Log) -> Evidence:
    """Return what a log has to say."""
    task = task_of(log)
    controller = task.spec.controller
    return Evidence(
        summary=summarize(log),
        horizon=controller.horizon,
        nodes=np.nan if controller.nodes == "auto" else controller.nodes,
        sample_time=controller.sample_time,
        epsilon=task.spec.onset.epsilon,
        onsets=dict(_onsets(log)),
        nearness=dict(_nearness(log, task)),
        earliest_ends={outlook.stage.name: outlook.earliest_end for outlook in look_ahead(task)},
    )


def _onsets(log: Log) -> Iterator[tuple[str, Onset]]:
    presence, beyond = log["window/presence"], log["window/first"] + log["window/count"]
    postponed = log["events/postponed"].astype(bool)
    for index, name in enumerate(log.stage_names):
        waited = np.isfinite(presence[:, index])
        if waited.any():
            starts = zip(log.stages["epsilon"], log.stages["actual_start_by_epsilon"][index], strict=True)
            yield (
                name,
                Onset(
                    time=log.time[waited],
                    presence=presence[waited, index],
                    starts={float(epsilon): float(start) for epsilon, start in starts},
                    postponed=int(np.sum(postponed & (beyond == index))),
                ),
            )


def _nearness(log: Log, task: Task) -> Iterator[tuple[str, Nearness]]:
    model = build_model(task.robot)
    costs = StageCosts(model)
    known = np.isfinite(log.final["time"])
    time = np.append(log.time, log.final["time"])[: len(log.time) + known]
    Q = np.vstack([log["state/Q"], log.final["Q"]])[: len(time)]
    for stage in build_stages(task.spec, task.robot, model):
        if stage.end_rows and len(time):
            error = costs.errors(stage, np.hstack([Q, np.zeros_like(Q)]))[:, list(stage.end_rows)]
            yield stage.name, Nearness(time, np.max(np.abs(error) / stage.tolerance, axis=1))
