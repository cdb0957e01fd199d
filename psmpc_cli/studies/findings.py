"""Judges the claims: each kind has one pure function from the runs' evidence to a finding.

The rules are explained in docs/reproduce.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import singledispatch
from itertools import pairwise

import numpy as np

from psmpc_cli.studies import causes
from psmpc_cli.studies.claims import (
    Claim,
    EarlyClaim,
    FloorClaim,
    MissionClaim,
    OrderClaim,
    ReleaseClaim,
    SettingClaim,
    StartClaim,
    TimeClaim,
)
from psmpc_cli.studies.evidence import Evidence

ABSOLUTE, RELATIVE = 0.8, 0.05
"""Tolerance of a published time: so many seconds or this part of it, whichever is larger."""

EXACTLY, NOTHING = 0.0, float("nan")
"""Tolerance of what holds as stated or not at all; the difference of what is no number."""

Value = float | str | tuple[float, ...] | tuple[str, ...]
Runs = Mapping[str, Evidence]


@dataclass(frozen=True)
class Finding:
    """What became of a claim.

    Attributes:
        published, reproduced: What is compared, in the claim's unit; NaN where it never happened.
        unit: `s`, or empty.
        difference: Reproduced less published; NaN where there is none.
        tolerance: Largest difference at which the claim holds; 0 where it holds exactly or not at all.
        holds: Whether it does.
        earlier: It does although the difference is larger: earlier than published, and the mission succeeded.
        cause: Why it does not hold, or is earlier, point by point; empty otherwise.
    """

    published: Value
    reproduced: Value
    unit: str
    difference: float
    tolerance: float
    holds: bool
    earlier: bool = False
    cause: causes.Cause = ()


@singledispatch
def judge(claim: Claim, runs: Runs) -> Finding:
    """Return what becomes of a claim on runs, by method; each kind of claim registers its own rule below."""
    raise TypeError(f"found a claim of kind {type(claim).__name__}, expected one with a rule in {__name__}")


@judge.register
def judge_setting(claim: SettingClaim, runs: Runs) -> Finding:
    """A setting holds if all runs have it."""
    found = sorted({float(getattr(evidence, claim.name)) for evidence in runs.values()})
    holds = found == [claim.published]
    cause = () if holds else (f"the runs were made with {', '.join(f'{value:g}' for value in found)}",)
    reproduced = next((value for value in found if value != claim.published), claim.published)
    unit = "s" if claim.name == "horizon" else ""
    return Finding(claim.published, reproduced, unit, reproduced - claim.published, EXACTLY, holds, cause=cause)


@judge.register
def judge_time(claim: TimeClaim, runs: Runs) -> Finding:
    """A time holds within its tolerance, or earlier if the mission succeeded."""
    evidence = runs[claim.moment.run]
    reproduced = evidence.time_of(claim.moment)
    difference, tolerance = reproduced - claim.published, max(ABSOLUTE, RELATIVE * claim.published)
    near = abs(difference) <= tolerance + 1e-9
    earlier = not near and difference < 0 and evidence.summary.succeeded
    cause = () if near else causes.of_time(claim, evidence, tolerance)
    return Finding(claim.published, reproduced, "s", difference, tolerance, near or earlier, earlier, cause)


@judge.register
def judge_start(claim: StartClaim, runs: Runs) -> Finding:
    """A start coincides with an end, or with a horizon before it, to one sample: starts are known no better."""
    evidence = runs[claim.start.run]
    lead = evidence.horizon if claim.when == "once seen" else 0.0
    expected, found = evidence.time_of(claim.end) - lead, evidence.time_of(claim.start)
    holds = abs(found - expected) <= evidence.sample_time + 1e-9
    cause = () if holds else causes.of_start(claim, expected, evidence)
    return Finding(0.0, found - expected, "s", found - expected, evidence.sample_time, holds, cause=cause)


@judge.register
def judge_floor(claim: FloorClaim, runs: Runs) -> Finding:
    """No start lies more than a sample before the floor; the finding is about the one nearest to it."""
    evidence = runs[claim.pairs[0][0].run]
    slacks = [evidence.time_of(start) - (evidence.time_of(end) - evidence.horizon) for start, end in claim.pairs]
    known = [slack for slack in slacks if np.isfinite(slack)]
    least = min(known, default=float("nan"))
    holds = bool(least >= -evidence.sample_time - 1e-9)
    cause = () if holds else causes.of_floor(claim, evidence)
    return Finding("not below 0", least, "s", min(least, 0.0), evidence.sample_time, holds, cause=cause)


@judge.register
def judge_early(claim: EarlyClaim, runs: Runs) -> Finding:
    """All of these stages start early."""
    evidence = runs[claim.starts[0].run]
    names = tuple(moment.stage for moment in claim.starts)
    early = tuple(name for name in names if (stage := evidence.stage(name)) is not None and stage.premature)
    cause = () if early == names else causes.of_no_early_start(set(names) - set(early), evidence)
    return Finding(names, early, "", NOTHING, EXACTLY, early == names, cause=cause)


@judge.register
def judge_order(claim: OrderClaim, runs: Runs) -> Finding:
    """The times come one after another, however little lies between them."""
    times = tuple(runs[moment.run].time_of(moment) for moment in claim.moments)
    holds = all(one < next_one for one, next_one in pairwise(times))
    cause = () if holds else causes.of_order(claim, runs)
    return Finding(claim.published, times, "s", NOTHING, EXACTLY, holds, cause=cause)


@judge.register
def judge_mission(claim: MissionClaim, runs: Runs) -> Finding:
    """The mission ends as published."""
    summary = runs[claim.run].summary
    words = {True: "succeeds", False: "fails"}
    holds = summary.succeeded == claim.succeeds
    cause = () if holds else causes.of_mission(summary)
    published, reproduced = words[claim.succeeds], words[summary.succeeded]
    return Finding(published, reproduced, "", NOTHING, EXACTLY, holds, cause=cause)


@judge.register
def judge_release(claim: ReleaseClaim, runs: Runs) -> Finding:
    """A monitor breaks before the destination is reached and after the stage that lets go has started early."""
    evidence = runs[claim.start.run]
    start, end = evidence.time_of(claim.start), evidence.time_of(claim.end)
    losses = [verdict.broken_at for verdict in evidence.summary.monitors if np.isfinite(verdict.broken_at)]
    lost = min(losses, default=float("nan"))
    holds = bool(start <= lost < end)
    reproduced = f"lost at {lost:.1f} s, {claim.end.symbol} = {end:.1f} s" if losses else "not lost"
    cause = () if holds else causes.of_no_release(claim, evidence)
    return Finding("lost too early", reproduced, "", NOTHING, EXACTLY, holds, cause=cause)
