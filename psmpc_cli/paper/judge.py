"""The rules that judge the paper's claims and our own, and the computed causes of what does not hold."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from importlib.resources import files
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, TypeAdapter

from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.ocp.feasibility import earliest_ends
from psmpc_cli.paper.ablations import Ablation
from psmpc_cli.paper.fronts import FrontMovement
from psmpc_cli.specs.task import OBJECT_CHECKS
from psmpc_cli.studies.fronts import LEAST_IMPROVEMENT
from psmpc_cli.studies.sweep import AlongRatio, SweepCells

Value = float | str | tuple[float, ...] | tuple[str, ...]

HEADINGS = ("claim", "published", "reproduced", "difference", "tolerance", "holds")


class Claim(BaseModel):
    """What the paper says.

    Attributes:
        id: Its name, which stays; the part before the first dot names its group, such as psmpc or order.
        topic: What a claim on one method is about.
        statement: What it says.
        source: Where the paper says so.
        rule: How it is judged, one of `psmpc_cli.paper.judge.RULES`.
        reads: The quantities that the rule looks at.
        published: Their published value.
        unit: Of what is published and reproduced.
        ratio: The ratio of two weights that the claim is about.
        beside: It is our own test of what the paper says; it is not counted among the published claims.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    topic: Literal["times", "starts", "mission"] | None = None
    statement: str
    source: str
    rule: str
    reads: tuple[str, ...]
    published: float | str | tuple[float, ...] | tuple[str, ...]
    unit: Literal["s", ""] = "s"
    ratio: float = 1.0
    beside: bool = False

    @property
    def group(self) -> str:
        """The method it is about, `setting`, `order`, `weights`, `fronts` or `grasp`."""
        return self.id.partition(".")[0]

    @property
    def number(self) -> float:
        """The published number; NaN if something else is published."""
        return self.published if isinstance(self.published, float) else math.nan


@cache
def load_claims() -> tuple[Claim, ...]:
    """Return the claims that ship with the package, in the order of the table."""
    text = files("psmpc_cli.paper").joinpath("claims.yaml").read_text(encoding="utf-8")
    return TypeAdapter(tuple[Claim, ...]).validate_python(yaml.safe_load(text))


class Finding(NamedTuple):
    """What became of a claim.

    Attributes:
        claim: The claim.
        reproduced: What was measured, in the unit of what is published; NaN where it never happened.
        holds: Whether the claim holds.
        difference: Reproduced less published; NaN where there is none.
        tolerance: Largest difference at which the claim holds; 0 where it holds exactly or not at all.
        earlier: It holds although the difference is larger: earlier than published, and the mission succeeded.
        cause: Why it does not hold, or is earlier, point by point; empty otherwise.
    """

    claim: Claim
    reproduced: Value
    holds: bool
    difference: float = math.nan
    tolerance: float = 0.0
    earlier: bool = False
    cause: tuple[str, ...] = ()

    @property
    def row(self) -> tuple[str, ...]:
        """The finding as text, in the order of `HEADINGS`."""
        unit = self.claim.unit
        difference = f"{self.difference:+.2f} {unit}" if unit else f"{self.difference:+g}"
        return (
            self.claim.id,
            format_value(self.claim.published, unit),
            format_value(self.reproduced, unit),
            difference if math.isfinite(self.difference) else "-",
            f"{self.tolerance:.2f} {unit}" if self.tolerance > 0 else "exact",
            "yes, earlier" if self.earlier else "yes" if self.holds else "no",
        )


def format_value(value: Value, unit: str) -> str:
    """Write a published or reproduced value; times in a row with the relation between neighbours."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        number = f"{value:.2f}".removesuffix("0") if unit else f"{value:g}"
        return f"{number} {unit}".rstrip() if math.isfinite(value) else "never"
    texts = [format_value(entry, unit) for entry in value]
    times = [entry for entry in value if isinstance(entry, float)]
    for i, (one, other) in enumerate(pairwise(times), start=1):
        texts[i] = f"{'<' if one < other else '>='} {texts[i]}"
    return (" " if times else ", ").join(texts) or "none"


ABSOLUTE = 0.8
RELATIVE = 0.05
"""Tolerance of a published time: this many seconds or this part of it, whichever is larger."""

ROUNDING = 1e-9
"""Times closer than this are the same [s]."""

ENDS = ("t1", "t2", "t3", "t_end")
"""The times at which the stages end, as the paper writes them."""


class StageTime:
    """The end of a stage of a run, such as t1, or the actual start of the one after it, t1_real.

    Attributes:
        symbol: As the paper writes it.
        run, summary: The run.
        index, name: Of the stage that ends or starts.
        time: When it does [s]; NaN if it did not.
        end, ended: Symbol and time [s] of the end of the stage before one that starts; of a stage that ends, its own.
    """

    def __init__(self, symbol: str, run: Run, summary: Summary) -> None:
        self.symbol = symbol
        self.run = run
        self.summary = summary
        self.end = symbol.removesuffix("_real")
        before = ENDS.index(self.end)
        self.index = before + (self.end != symbol)
        self.name = summary.stages[self.index].name
        self.ended = summary.stages[before].switch_time
        self.time = self.ended if self.end == symbol else summary.stages[self.index].actual_start


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What was run for the claims, and what became of them.

    Attributes:
        runs: By method.
        weights: The sweep over the weights of Approach and Capture.
        fronts: Their Pareto fronts in the PSMPC run; None if none of its windows holds both alone.
        changes: Keys of the task that were changed.
        ablations: The ablations of the PSMPC run, if they were run.
        grasps: By method, runs with an object that has a mass.
    """

    runs: Mapping[str, Run]
    weights: SweepCells
    fronts: Results | None
    changes: tuple[str, ...] = ()
    ablations: tuple[Ablation, ...] = ()
    grasps: Mapping[str, Run] = field(default_factory=dict)

    @cached_property
    def summaries(self) -> dict[str, Summary]:
        """The summaries of the runs."""
        return {name: run.summary() for name, run in self.runs.items()}

    @cached_property
    def movement(self) -> FrontMovement | None:
        """How the fronts move."""
        return None if self.fronts is None else FrontMovement(self.fronts)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The judged claims."""
        return tuple(judge(claim, self) for claim in load_claims())

    @property
    def failing(self) -> tuple[Finding, ...]:
        """The claims that do not hold."""
        return tuple(finding for finding in self.findings if not finding.holds)

    def count(self, beside: bool = False) -> tuple[int, int]:
        """Count the published claims, or those beside them: how many hold, of how many."""
        counted = [finding.holds for finding in self.findings if finding.claim.beside == beside]
        return sum(counted), len(counted)

    @property
    def outcome(self) -> str:
        """How many claims hold, as a sentence."""
        held, count = self.count()
        others, beside = self.count(beside=True)
        return f"{held} of {count} claims hold, and {others} of {beside} of our own beside them"

    def stage_times(self, claim: Claim) -> list[StageTime]:
        """Return the times that a claim reads, such as psmpc.t1_real."""
        parted = (name.partition(".") for name in claim.reads)
        return [StageTime(symbol, self.runs[method], self.summaries[method]) for method, _, symbol in parted]

    def published(self, method: str, starts: bool) -> dict[str, float]:
        """Return the published ends, or actual starts, of a method's stages [s]."""
        claims = [claim for claim in load_claims() if claim.rule == "time" and claim.group == method]
        chosen = [claim for claim in claims if claim.reads[0].endswith("_real") == starts]
        return {self.stage_times(claim)[0].name: claim.number for claim in chosen}


def judge(claim: Claim, reproduction: Reproduction) -> Finding:
    """Judge a claim; without a cell that completed no claim on the weights holds."""
    cells = reproduction.weights
    if claim.group == "weights" and not cells.ended.any():
        reasons = sorted({str(reason) for reason in cells.of("reason")[cells.failed]})
        return Finding(claim, np.nan, False, cause=("no cell of the sweep completed", *reasons))
    finding = RULES[claim.rule](claim, reproduction)
    return finding._replace(cause=()) if finding.holds and not finding.earlier else finding


def time_tolerance(published: float) -> float:
    """Return the tolerance of a published time [s]."""
    return max(ABSOLUTE, RELATIVE * published)


def _setting(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that all runs have the setting."""
    values = {getattr(run.task.spec.controller, claim.reads[0]) for run in reproduction.runs.values()}
    found = sorted(np.nan if value == "auto" else float(value) for value in values)
    reproduced = next((value for value in found if value != claim.number), claim.number)
    return Finding(claim, reproduced, found == [claim.number], reproduced - claim.number)


def _time(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that a time is within its tolerance, or earlier if the mission succeeded."""
    (stage_time,) = reproduction.stage_times(claim)
    published = claim.number
    difference = stage_time.time - published
    tolerance = time_tolerance(published)
    near = abs(difference) <= tolerance + ROUNDING
    earlier = not near and difference < 0 and stage_time.summary.succeeded
    cause = () if near else tuple(_causes_of_difference(stage_time, published))
    return Finding(claim, stage_time.time, near or earlier, difference, tolerance, earlier, cause)


def _causes_of_difference(stage_time: StageTime, published: float) -> Iterator[str]:
    """Yield the causes of a difference from a published time."""
    late = stage_time.time > published
    summary = stage_time.summary
    run = stage_time.run
    if np.isnan(stage_time.time):
        yield _explain_missing(stage_time)
        return
    if not late:
        ended = "succeeded" if summary.succeeded else f"failed: {'; '.join(mission_end(summary))}"
        yield f"earlier than published, and the mission {ended}"
    if stage_time.symbol != stage_time.end:
        yield _explain_start(stage_time)
        return
    if late:
        Q = [np.interp(published, run.motion.time, row) for row in run.motion.Q_seen.T]
        error = run.problem.costs.end_error(run.problem.stages[stage_time.index], np.r_[Q, np.zeros(len(Q))])
        yield f"at {published:g} s {stage_time.name} was still {error:.1f} tolerances away"
    earliest, _ = earliest_ends(run.task, run.problem.stages)[stage_time.index]
    if published < earliest:
        yield f"within its velocity limits {stage_time.name} cannot end before {earliest:.2f} s"


def _coincides(claim: Claim, reproduction: Reproduction, horizons: int) -> Finding:
    """Check that a stage starts so many horizons before the one before it ends, to one sample."""
    (start,) = reproduction.stage_times(claim)
    controller = start.run.task.spec.controller
    difference = start.time - (start.ended - horizons * controller.horizon)
    holds = abs(difference) <= controller.sample_time + ROUNDING
    cause = _explain_missing(start) if np.isnan(difference) else _explain_start(start)
    return Finding(claim, difference, holds, difference, controller.sample_time, cause=(cause,))


def _floor(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that no stage starts more than a sample before the previous stage's end comes into the horizon."""
    starts = reproduction.stage_times(claim)
    controller = starts[0].run.task.spec.controller
    slacks = {start: start.time - (start.ended - controller.horizon) for start in starts}
    known = [start for start in starts if np.isfinite(slacks[start])]
    if not known:
        return Finding(claim, np.nan, False, np.nan, controller.sample_time, cause=(_explain_missing(starts[0]),))
    first = min(known, key=lambda start: slacks[start])
    return _not_below(claim, slacks[first], controller.sample_time, first.name)


def _weights_floor(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that no actual start of any cell, for any threshold, is more than a sample before t_s - T_h."""
    cells = reproduction.weights
    slacks = np.where(cells.ended[:, None], cells.of("actual_start") - cells.floor[:, None], np.inf)
    cell, k = np.unravel_index(np.argmin(slacks), slacks.shape)
    where = f"at ratio {cells.ratio[cell]:.4g} and epsilon = {cells.epsilons[k]:g} {cells.names[1]}"
    return _not_below(claim, float(slacks[cell, k]), cells.task.spec.controller.sample_time, where)


def _not_below(claim: Claim, slack: float, sample: float, first: str) -> Finding:
    """Judge the smallest difference of a start from the instant before which none may lie, and what has it."""
    cause = f"{first} starts {-slack:.2f} s before t_s - T_h"
    return Finding(claim, slack, slack >= -sample - ROUNDING, min(slack, 0.0), sample, cause=(cause,))


def _all_early(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that all of the stages start early."""
    starts = reproduction.stage_times(claim)
    early = tuple(start.name for start in starts if start.summary.stages[start.index].early)
    cause = tuple(_explain_start(start) for start in starts if start.name not in early)
    return Finding(claim, early, not cause, cause=cause)


def _order(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that the times are in this order, however small the difference."""
    times = tuple(stage_time.time for stage_time in reproduction.stage_times(claim))
    return Finding(claim, times, all(one < other for one, other in pairwise(times)))


def _mission(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that the mission ends as published."""
    summary = reproduction.summaries[claim.reads[0]]
    reproduced = "succeeds" if summary.succeeded else "fails"
    return Finding(claim, reproduced, reproduced == claim.published, cause=mission_end(summary))


def _delivered(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that, by the mechanics of a grasped body, the runs deliver the object or do not, as published."""
    found = tuple(_object_outcome(reproduction.grasps[name.removeprefix("grasp.")].summary()) for name in claim.reads)
    holds = tuple("delivered" if end == "delivered" else "not delivered" for end in found) == claim.published
    return Finding(claim, found, holds)


def _object_outcome(summary: Summary) -> str:
    """Return what became of a grasped object."""
    verdicts = {one.name: one for one in summary.monitors}
    found = summary.capture
    taken, kept, delivered = (verdicts[deed] for deed in OBJECT_CHECKS)
    if delivered.held:
        return "delivered"
    if taken.held and kept.held and found is not None:
        return f"let go {100 * found.distance:.1f} cm off at {found.speed:.2f} m/s"
    return f"lost at {kept.broken_at:.1f} s" if taken.held else "not taken"


def _released_early(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that a monitor is violated after the last stage has started and before the stage before it ends."""
    (start,) = reproduction.stage_times(claim)
    lost = min((one.broken_at for one in start.summary.monitors if np.isfinite(one.broken_at)), default=np.nan)
    reproduced = f"lost at {lost:.1f} s, {start.end} = {start.ended:.1f} s" if np.isfinite(lost) else "not lost"
    return Finding(claim, reproduced, start.time <= lost < start.ended, cause=(_explain_start(start),))


def _trend(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that for every threshold no larger ratio starts more than a sample later, and the largest starts early."""
    cells = reproduction.weights
    sample = cells.task.spec.controller.sample_time
    cause = []
    rises = []
    shown = []
    for epsilon, values in zip(cells.epsilons, cells.of("actual_start").T, strict=True):
        start = AlongRatio(cells, values)
        rise = float(np.max(start.highest - np.minimum.accumulate(start.lowest)))
        first, last = start.middle[[0, -1]]
        rises.append(rise)
        shown.append(f"{first:.2f} s to {last:.2f} s")
        if rise > sample + ROUNDING or first - last <= sample + ROUNDING:
            cause.append(f"for epsilon = {epsilon:g} from {shown[-1]}, by up to {rise:.2f} s later at a larger ratio")
    return Finding(claim, shown[cells.chosen], not cause, max(rises), sample, cause=tuple(cause))


def _settles(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that the actual start at the largest ratio is within the tolerance of published times."""
    cells = reproduction.weights
    tolerance = time_tolerance(claim.number)
    last = float(AlongRatio(cells, cells.of("actual_start")[:, cells.chosen]).middle[-1])
    difference = last - claim.number
    cause = f"t_s - T_h = {float(np.median(cells.floor[cells.ended])):.2f} s, and no start can be before it"
    return Finding(claim, last, abs(difference) <= tolerance + ROUNDING, difference, tolerance, cause=(cause,))


def _chosen(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that Capture completes earlier at the ratio than at 1, with less effort than at the largest ratio."""
    cells = reproduction.weights
    completion, effort = (AlongRatio(cells, cells.of(name.partition(".")[2])) for name in claim.reads)
    logs = np.log(completion.ratio)
    names = [f"{ratio:.4g}" for ratio in completion.ratio]
    there, equal = (int(np.argmin(np.abs(logs - np.log(ratio)))) for ratio in (claim.ratio, 1.0))
    reproduced = (
        f"{completion.middle[there]:.2f} s, {completion.middle[equal]:.2f} s at {names[equal]}; "
        f"effort {effort.middle[there]:.3g}, {effort.middle[-1]:.3g} at {names[-1]}"
    )
    sooner = completion.highest[there] < completion.lowest[equal] - ROUNDING
    return Finding(claim, reproduced, bool(sooner and effort.highest[there] < effort.lowest[-1]))


def _along_ratio(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that at every sample the optimum moves to the upper left as the ratio grows, and back by rounding alone."""
    movement = reproduction.movement
    if movement is None:
        return Finding(claim, "unknown", False, cause=(NO_FRONTS,))
    cause = list[str]()
    for instant, step, moves in zip(movement.instants, movement.against, movement.moves, strict=True):
        if step > LEAST_IMPROVEMENT or not moves:
            how = f"moves against it by {step:.2g} of the front" if moves else "does not move, or was not found"
            cause.append(f"at {instant:g} s it {how}")
    return Finding(
        claim, f"{claim.published} at {movement.moving} of {len(movement.instants)}", not cause, cause=tuple(cause)
    )


def _along_time(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that in normalized costs the mean of the front moves to the upper left from every sample to the next."""
    movement = reproduction.movement
    if movement is None or len(movement.instants) < 2:
        return Finding(claim, "unknown", False, cause=(NO_FRONTS,))
    return Finding(claim, movement.directions(), movement.with_time, cause=movement.over_time)


NO_FRONTS = "fewer windows of the PSMPC run than needed hold the first two stages alone and were solved"


RULES: Mapping[str, Callable[[Claim, Reproduction], Finding]] = {
    "setting": _setting,
    "time": _time,
    "on_time": partial(_coincides, horizons=0),
    "once_seen": partial(_coincides, horizons=1),
    "floor": _floor,
    "all_early": _all_early,
    "order": _order,
    "mission": _mission,
    "delivered": _delivered,
    "released_early": _released_early,
    "trend": _trend,
    "weights_floor": _weights_floor,
    "settles": _settles,
    "chosen": _chosen,
    "along_ratio": _along_ratio,
    "along_time": _along_time,
}
"""The rules by the names that claims.yaml has for them."""


def mission_end(summary: Summary) -> tuple[str, ...]:
    """Return how a mission ended: why the run ended, and its monitors."""
    monitors = (
        f"'{verdict.name}' was violated at {verdict.broken_at:.1f} s, by up to {-verdict.margin:.3f}"
        if np.isfinite(verdict.broken_at)
        else f"'{verdict.name}' {'held' if verdict.held else 'was not judged'}, margin {verdict.margin:.3f}"
        for verdict in summary.monitors
    )
    return tuple(filter(None, (summary.reason, ", ".join(monitors))))


def _explain_missing(stage_time: StageTime) -> str:
    """Describe why a stage did not end or start."""
    event = "end" if stage_time.symbol == stage_time.end else "start"
    return f"{stage_time.name} did not {event}: {stage_time.summary.reason}"


def _explain_start(start: StageTime) -> str:
    """Describe when a stage starts, and how that depends on the threshold."""
    stages = start.run.stages
    kind = start.run.task.spec.onset.kind
    found = sorted(zip(stages["epsilon"], stages["actual_start_by_epsilon"][start.index], strict=True))
    by_epsilon = ", ".join(f"{_format_time(time)} for epsilon = {epsilon:g}" for epsilon, time in found)
    when = f"{start.name} starts at {_format_time(start.time)}, {start.end} = {_format_time(start.ended)}"
    return f"{when}; by its {kind} it starts at {by_epsilon}"


def _format_time(time: float) -> str:
    return "never" if np.isnan(time) else f"{time:.2f} s"
