"""The paper's claims on its simulations as data, and the quantities of runs and studies by which they are judged."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict

from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import StageSummary, Summary
from psmpc_cli.ocp.feasibility import look_ahead
from psmpc_cli.ocp.problem import StageCosts, build_stages
from psmpc_cli.robot.model import build_model
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.fronts import FrontMovement
from psmpc_cli.studies.weights import SweepCells, along_ratio

Event = Literal["end", "start"]
Value = float | str | tuple[float, ...] | tuple[str, ...]

REAL = "_real"
"""Suffix of the symbol of an actual start."""

HEADINGS = ("claim", "published", "reproduced", "difference", "tolerance", "holds")


class Claim(BaseModel):
    """What the paper says.

    Attributes:
        id: Its name, which stays; the part before the first dot names its group, such as psmpc or order.
        topic: What a claim on one method is about.
        statement: What it says.
        source: Where the paper says so.
        rule: How it is judged, one of `psmpc_cli.studies.judge.RULES`.
        reads: The quantities that the rule looks at.
        published: Their published value.
        ratio: The ratio of two weights that the claim is about.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    topic: Literal["times", "starts", "mission"] | None = None
    statement: str
    source: str
    rule: str
    reads: tuple[str, ...]
    published: float | str | tuple[float, ...] | tuple[str, ...]
    ratio: float = 1.0

    @property
    def group(self) -> str:
        """The method it is about, `setting`, `order`, `weights` or `fronts`."""
        return self.id.partition(".")[0]


class Claims(BaseModel):
    """All claims.

    Attributes:
        stages: The stage that each published time ends, by symbol.
        claims: In the order of the table.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    stages: Mapping[str, str]
    claims: tuple[Claim, ...]

    def event(self, symbol: str) -> tuple[str, Event]:
        """Return which stage ends or actually starts at the time of a symbol such as t1 or t1_real."""
        if not symbol.endswith(REAL):
            return self.stages[symbol], "end"
        symbols = list(self.stages)
        return self.stages[symbols[symbols.index(symbol.removesuffix(REAL)) + 1]], "start"

    def published(self, method: str, event: Event) -> dict[str, float]:
        """Return the published ends, or actual starts, of a method's stages [s]."""
        found: dict[str, float] = {}
        for claim in self.claims:
            if claim.rule == "time" and claim.group == method and isinstance(claim.published, float):
                stage, of = self.event(claim.reads[0].partition(".")[2])
                found |= {stage: claim.published} if of == event else {}
        return found


@cache
def load_claims() -> Claims:
    """Return the claims that ship with the package."""
    text = files("psmpc_cli.studies").joinpath("claims.yaml").read_text(encoding="utf-8")
    return Claims.model_validate(yaml.safe_load(text))


@dataclass(frozen=True)
class Finding:
    """What became of a claim.

    Attributes:
        claim: The claim.
        reproduced: What was measured, in the unit of what is published; NaN where it never happened.
        holds: Whether the claim holds.
        unit: `s`, or empty.
        difference: Reproduced less published; NaN where there is none.
        tolerance: Largest difference at which the claim holds; 0 where it holds exactly or not at all.
        earlier: It holds although the difference is larger: earlier than published, and the mission succeeded.
        cause: Why it does not hold, or is earlier, point by point; empty otherwise.
    """

    claim: Claim
    reproduced: Value
    holds: bool
    unit: str = ""
    difference: float = math.nan
    tolerance: float = 0.0
    earlier: bool = False
    cause: tuple[str, ...] = ()

    @property
    def row(self) -> dict[str, str]:
        """The finding as text, by heading."""
        verdict = "yes, earlier" if self.earlier else "yes" if self.holds else "no"
        difference = f"{self.difference:+.2f} {self.unit}" if self.unit else f"{self.difference:+g}"
        texts = (
            self.claim.id,
            shown(self.claim.published, self.unit),
            shown(self.reproduced, self.unit),
            difference if math.isfinite(self.difference) else "-",
            f"{self.tolerance:.2f} {self.unit}" if self.tolerance > 0 else "exact",
            verdict,
        )
        return dict(zip(HEADINGS, texts, strict=True))


def shown(value: Value, unit: str) -> str:
    """Return a published or reproduced value as text; times in a row with the relation between neighbours."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        number = f"{value:.2f}".removesuffix("0") if unit else f"{value:g}"
        return f"{number} {unit}".rstrip() if math.isfinite(value) else "never"
    texts = [entry for entry in value if isinstance(entry, str)]
    times = [entry for entry in value if isinstance(entry, float)]
    return _related(times, unit) if times else ", ".join(texts) or "none"


def _related(times: Sequence[float], unit: str) -> str:
    relations = ("<" if one < other else ">=" for one, other in pairwise(times))
    rest = (f" {relation} {shown(time, unit)}" for relation, time in zip(relations, times[1:], strict=True))
    return shown(times[0], unit) + "".join(rest)


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
