"""The rules of the claims that are on single runs of the transport task, and what they read of a run.

A run that stopped before its last stage ended shows less than a whole one. So a claim on a stage takes that this stage,
or the one before it, has ended, and none holds because something has not happened yet.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from psmpc_cli.logs.summary import Summary
from psmpc_cli.paper.claims import Claim, Finding, load_claims

ABSOLUTE = 0.8
RELATIVE = 0.05
"""Tolerance of a published time: this many seconds or this part of it, whichever is larger."""

ROUNDING = 1e-9
"""Times closer than this are the same [s]."""

ENDS = ("t1", "t2", "t3", "t_end")
"""The times at which the stages end, as the paper writes them."""


@dataclass(frozen=True)
class Mission:
    """When the stages of a run started and ended, and what became of the mission.

    Attributes:
        stages: Names of the stages (S,).
        starts: When each actually started (S,) [s]; NaN if it did not.
        ends: When each ended (S,) [s]; NaN if it did not.
        succeeded: The last stage ended, and every monitor held.
        broken_at: When the first monitor was violated [s]; NaN if none was.
        horizon: T_h [s].
        sample_time: Of the controller [s].
    """

    stages: tuple[str, ...]
    starts: tuple[float, ...]
    ends: tuple[float, ...]
    succeeded: bool
    broken_at: float
    horizon: float
    sample_time: float

    @property
    def outcome(self) -> str:
        """Whether it succeeds, fails by a monitor, or stops before its last stage has ended."""
        if self.succeeded:
            return "succeeds"
        return "fails" if math.isfinite(self.broken_at) or math.isfinite(self.ends[-1]) else "stops"


Missions = Mapping[str, Mission]
"""Missions by method."""


def mission_of(summary: Summary, horizon: float) -> Mission:
    """Return what the rules read of a run with this horizon [s]."""
    return Mission(
        stages=tuple(stage.name for stage in summary.stages),
        starts=tuple(stage.actual_start for stage in summary.stages),
        ends=tuple(stage.switch_time for stage in summary.stages),
        succeeded=summary.succeeded is True,
        broken_at=float(np.fmin.reduce([verdict.broken_at for verdict in summary.monitors], initial=np.nan)),
        horizon=horizon,
        sample_time=summary.sample_time,
    )


class StageTime:
    """The end of a stage of a run, such as t1, or the actual start of the one after it, t1_real.

    Attributes:
        symbol: As the paper writes it.
        method, mission: The run.
        index, name: Of the stage that ends or starts.
        end, ended: Symbol and time [s] of the end of the stage before one that starts; of a stage that ends, its own.
        time: When it does [s]; NaN if it did not, or if the stage before one that starts did not end.
        has_ended: Whether the stage that ends or starts has ended.
    """

    def __init__(self, quantity: str, missions: Missions) -> None:
        self.method, _, self.symbol = quantity.partition(".")
        self.mission = missions[self.method]
        self.end = self.symbol.removesuffix("_real")
        before = ENDS.index(self.end)
        self.index = before + self.is_start
        self.name = self.mission.stages[self.index]
        self.ended = self.mission.ends[before]
        start = self.mission.starts[self.index] if math.isfinite(self.ended) else math.nan
        self.time = start if self.is_start else self.ended
        self.has_ended = math.isfinite(self.mission.ends[self.index])

    @property
    def is_start(self) -> bool:
        """Whether it is an actual start."""
        return self.end != self.symbol

    @property
    def is_early(self) -> bool:
        """Whether it is a start before the stage before it has ended."""
        return self.is_start and self.time < self.ended - ROUNDING


def stage_times(claim: Claim, missions: Missions) -> list[StageTime]:
    """Return the times that a claim reads, such as psmpc.t1_real."""
    return [StageTime(quantity, missions) for quantity in claim.reads]


def time_tolerance(published: float) -> float:
    """Return the tolerance of a published time [s]."""
    return max(ABSOLUTE, RELATIVE * published)


def judge_missions(claim: Claim, missions: Missions) -> Finding:
    """Judge a claim on runs, one whose rule is in `MISSION_RULES`, without the causes."""
    return MISSION_RULES[claim.rule](claim, missions)


def not_below(claim: Claim, slack: float, sample: float) -> Finding:
    """Judge the smallest difference of a start from the instant before which none may lie [s]."""
    return Finding(claim, slack, slack >= -sample - ROUNDING, min(slack, 0.0), sample)


def _time(claim: Claim, missions: Missions) -> Finding:
    """Check that a time is within its tolerance, or earlier if the mission succeeded."""
    (stage_time,) = stage_times(claim, missions)
    difference = stage_time.time - claim.number
    tolerance = time_tolerance(claim.number)
    near = abs(difference) <= tolerance + ROUNDING
    earlier = not near and difference < 0 and stage_time.mission.succeeded
    return Finding(claim, stage_time.time, near or earlier, difference, tolerance, earlier)


def _coincides(claim: Claim, missions: Missions, horizons: int) -> Finding:
    """Check that a stage starts so many horizons before the one before it ends, to one sample, and ends later."""
    (start,) = stage_times(claim, missions)
    sample = start.mission.sample_time
    difference = start.time - (start.ended - horizons * start.mission.horizon)
    holds = start.has_ended and abs(difference) <= sample + ROUNDING
    return Finding(claim, difference, holds, difference, sample)


def _floor(claim: Claim, missions: Missions) -> Finding:
    """Check that all stages end, and none starts more than a sample before the previous one's end is in the horizon."""
    starts = stage_times(claim, missions)
    mission = starts[0].mission
    slacks = [start.time - (start.ended - mission.horizon) for start in starts]
    smallest = float(np.fmin.reduce(slacks))
    finding = not_below(claim, smallest, mission.sample_time)
    return finding._replace(holds=finding.holds and all(start.has_ended for start in starts))


def _all_early(claim: Claim, missions: Missions) -> Finding:
    """Check that all of the stages start before the one before them has ended."""
    starts = stage_times(claim, missions)
    early = tuple(start.name for start in starts if start.is_early)
    return Finding(claim, early, len(early) == len(starts))


def _order(claim: Claim, missions: Missions) -> Finding:
    """Check that the times are in this order, however small the difference, and runs that are to succeed do so."""
    read = stage_times(claim, missions)
    times = tuple(stage_time.time for stage_time in read)
    succeed = all(missions[method].succeeded for method in to_succeed(claim))
    return Finding(claim, times, succeed and all(one < other for one, other in pairwise(times)))


def to_succeed(claim: Claim) -> list[str]:
    """Return the methods that a claim reads and whose mission, as published, succeeds."""
    read = {quantity.partition(".")[0] for quantity in claim.reads}
    missions = [one for one in load_claims() if one.rule == "mission" and one.published == "succeeds"]
    return [one.group for one in missions if one.group in read]


def _mission(claim: Claim, missions: Missions) -> Finding:
    """Check that the mission ends as published: one that stops early has not failed for the published reason."""
    outcome = missions[claim.reads[0]].outcome
    return Finding(claim, outcome, outcome == claim.published)


def _released_early(claim: Claim, missions: Missions) -> Finding:
    """Check that a monitor is violated after the last stage has started and before the stage before it ends."""
    (start,) = stage_times(claim, missions)
    lost = start.mission.broken_at
    reproduced = f"lost at {lost:.1f} s, {start.end} = {format_time(start.ended)}"
    return Finding(claim, reproduced if math.isfinite(lost) else "not lost", start.time <= lost < start.ended)


MISSION_RULES: Mapping[str, Callable[[Claim, Missions], Finding]] = {
    "time": _time,
    "on_time": partial(_coincides, horizons=0),
    "once_seen": partial(_coincides, horizons=1),
    "floor": _floor,
    "all_early": _all_early,
    "order": _order,
    "mission": _mission,
    "released_early": _released_early,
}
"""The rules on runs by the names that claims.yaml has for them."""


def format_time(time: float) -> str:
    """Write a time [s], or that there is none."""
    return "never" if math.isnan(time) else f"{time:.2f} s"
