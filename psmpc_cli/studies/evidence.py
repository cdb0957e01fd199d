"""The quantities by which the paper's claims are judged: of the runs, the sweep over the weights, the Pareto fronts."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import StageSummary, Summary
from psmpc_cli.ocp.feasibility import look_ahead
from psmpc_cli.ocp.problem import StageCosts, build_stages
from psmpc_cli.robot.model import build_model
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.claims import REAL, Claims, Event
from psmpc_cli.studies.front_movement import FrontMovement
from psmpc_cli.studies.weights import SweepCells, along_ratio

ROUNDING = 1e-9
"""Times closer than this are the same [s]."""

BETWEEN_SAMPLES = 1e-6
"""Margin for a time on the grid of the samples [s]."""


@dataclass(frozen=True, eq=False)
class Onset:
    """How a waiting stage came to act on the control.

    Attributes:
        time: Samples at which it waited in the window (W,) [s].
        presence: Norm of the control it added in its onset coordinates (W,) [m/s^2, rad/s^2].
        starts: Its actual start [s] for each threshold [m/s^2, rad/s^2] that the log follows.
        postponed: Number of samples at which the window with it had no solution yet.
    """

    time: np.ndarray
    presence: np.ndarray
    starts: Mapping[float, float]
    postponed: int

    def thresholds(self, earliest: float, latest: float) -> tuple[float, float]:
        """Return between which thresholds, the upper one included, it starts from `earliest` to `latest` [s]."""
        return self.largest(earliest - BETWEEN_SAMPLES), self.largest(latest + BETWEEN_SAMPLES)

    def largest(self, before: float = np.inf) -> float:
        """Return the largest presence at samples before a time [s]; 0 if there is none."""
        return float(np.max(self.presence[self.time < before], initial=0.0))


@dataclass(frozen=True, eq=False)
class RunEvidence:
    """What one run shows.

    Attributes:
        summary: Its summary.
        horizon, nodes, sample_time: As it ran.
        epsilon: Threshold that marks an actual start [m/s^2, rad/s^2].
        onsets: By stage; those that waited in a window.
        errors: By stage with an end condition: times (K,) [s] and the largest error of its coordinates there (K,)
            [tolerances].
        earliest_ends: By stage, the earliest end that the velocity limits allow [s].
    """

    summary: Summary
    horizon: float
    nodes: float
    sample_time: float
    epsilon: float
    onsets: Mapping[str, Onset]
    errors: Mapping[str, tuple[np.ndarray, np.ndarray]]
    earliest_ends: Mapping[str, float]

    def stage(self, name: str) -> StageSummary | None:
        """Return the summary of a stage; None if the run has no stage of this name."""
        return next((stage for stage in self.summary.stages if stage.name == name), None)

    def regular_start(self, name: str) -> float:
        """Return when the stage before this one ended [s]; NaN if it did not, 0 for the first."""
        ends = [0.0, *(stage.switch_time for stage in self.summary.stages)]
        names = [stage.name for stage in self.summary.stages]
        return ends[names.index(name)] if name in names else float("nan")


@dataclass(frozen=True, eq=False)
class Moment:
    """A time of a run: the end of a stage, or its actual start.

    Attributes:
        method: The run's controller.
        symbol: As the paper writes it, such as t1 or t1_real.
        stage: The stage that ends or starts.
        event: Which of both.
        time: When it happened [s]; NaN if it did not.
        run: The run.
    """

    method: str
    symbol: str
    stage: str
    event: Event
    time: float
    run: RunEvidence

    def __str__(self) -> str:
        return f"{self.symbol} of {self.method.upper()}"


@dataclass(frozen=True, eq=False)
class Evidence:
    """What all claims are judged on.

    Attributes:
        claims: All claims, which name the stages and what else is published.
        runs: By method.
        weights: The sweep over the weights of Approach and Capture.
        fronts: How their Pareto fronts move; None if no window of the PSMPC run holds both alone.
    """

    claims: Claims
    runs: Mapping[str, RunEvidence]
    weights: SweepCells
    fronts: FrontMovement | None

    def moment(self, name: str) -> Moment:
        """Return the moment of a name such as psmpc.t1_real."""
        method, _, symbol = name.partition(".")
        stage, event = self.claims.event(symbol)
        run = self.runs[method]
        found = run.stage(stage)
        time = float("nan") if found is None else found.switch_time if event == "end" else found.actual_start
        return Moment(method, symbol, stage, event, time, run)

    def end_before(self, start: Moment) -> Moment:
        """Return the end of the stage before one that starts."""
        return self.moment(f"{start.method}.{start.symbol.removesuffix(REAL)}")


def gather_run(log: Run) -> RunEvidence:
    """Return what a log shows."""
    task = log.task
    controller = task.spec.controller
    return RunEvidence(
        summary=log.summary(),
        horizon=controller.horizon,
        nodes=np.nan if controller.nodes == "auto" else controller.nodes,
        sample_time=controller.sample_time,
        epsilon=task.spec.onset.epsilon,
        onsets=dict(_onsets(log)),
        errors=dict(_errors(log, task)),
        earliest_ends={outlook.stage.name: outlook.earliest_end for outlook in look_ahead(task)},
    )


def _onsets(log: Run) -> Iterator[tuple[str, Onset]]:
    presence, beyond = log["window/presence"], log["window/first"] + log["window/count"]
    postponed = log["events/postponed"].astype(bool)
    for index, name in enumerate(log.stage_names):
        waited = np.isfinite(presence[:, index])
        starts = zip(log.stages["epsilon"], log.stages["actual_start_by_epsilon"][index], strict=True)
        if waited.any():
            yield (
                name,
                Onset(
                    time=log.time[waited],
                    presence=presence[waited, index],
                    starts={float(epsilon): float(start) for epsilon, start in starts},
                    postponed=int(np.sum(postponed & (beyond == index))),
                ),
            )


def _errors(log: Run, task: Task) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    model = build_model(task.robot)
    costs = StageCosts(model)
    known = np.isfinite(log.final["time"])
    time = np.append(log.time, log.final["time"])[: len(log.time) + known]
    Q = np.vstack([log["state/Q"], log.final["Q_seen"]])[: len(time)]
    for stage in build_stages(task.spec, task.robot, model):
        if stage.end_rows and len(time):
            error = costs.errors(stage, np.hstack([Q, np.zeros_like(Q)]))[:, list(stage.end_rows)]
            yield stage.name, (time, np.max(np.abs(error) / stage.tolerance, axis=1))


class Trend(NamedTuple):
    """How the actual start depends on the ratio, for one threshold.

    Attributes:
        epsilon: The threshold [m/s^2, rad/s^2].
        rise: Largest amount by which one cell starts later than another of a smaller ratio, or of the same [s].
        ratio: The ratio of the later one.
        first, last: Start at the smallest and at the largest ratio [s].
    """

    epsilon: float
    rise: float
    ratio: float
    first: float
    last: float


def trends(cells: SweepCells) -> tuple[Trend, ...]:
    """Return for each threshold how the actual start depends on the ratio."""
    found = []
    for epsilon, values in zip(cells.epsilons, cells.of("actual_start").T, strict=True):
        start = along_ratio(cells, values)
        rises = start.highest - np.minimum.accumulate(start.lowest)
        worst = int(np.argmax(rises))
        ends = float(start.middle[0]), float(start.middle[-1])
        found.append(Trend(float(epsilon), float(rises[worst]), float(start.ratio[worst]), *ends))
    return tuple(found)


def least_slack(cells: SweepCells) -> tuple[float, float, float, float]:
    """Return the actual start closest to t_s - T_h, or furthest before it, of all cells and thresholds.

    Its distance from there [s], itself [s], ratio and threshold.
    """
    starts = cells.of("actual_start")
    slacks = np.where(cells.ended[:, None], starts - cells.floor[:, None], np.inf)
    at = np.unravel_index(np.argmin(slacks), slacks.shape)
    return float(slacks[at]), float(starts[at]), float(cells.ratio[at[0]]), float(cells.epsilons[at[1]])


def settled(cells: SweepCells) -> tuple[float, float]:
    """Return the actual start at the largest ratio [s], and from which ratio on it stays there to one sample."""
    start = along_ratio(cells, cells.of("actual_start")[:, cells.chosen])
    apart = np.abs(start.middle - start.middle[-1]) > cells.task.spec.controller.sample_time + ROUNDING
    first = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
    return float(start.middle[-1]), float(start.ratio[first])
