"""The rules that judge the paper's claims, and the computed causes of what does not hold: docs/reproduce.md."""

from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise

import numpy as np

from psmpc_cli.logs.summary import Summary
from psmpc_cli.studies.claims import ROUNDING, Claim, Evidence, Finding, Moment, least_slack, settled, trends
from psmpc_cli.studies.fronts import CLEARLY
from psmpc_cli.studies.weights import along_ratio

ABSOLUTE, RELATIVE = 0.8, 0.05
"""Tolerance of a published time: this many seconds or this part of it, whichever is larger."""

UNIT = "m/s^2, rad/s^2"

NO_WINDOW = "no window of the PSMPC run holds the first two stages alone and was solved"


def judge(claim: Claim, evidence: Evidence) -> Finding:
    """Return what becomes of a claim; without a cell that completed no claim on the weights holds."""
    cells = evidence.weights
    if claim.group == "weights" and not cells.ended.any():
        reasons = sorted({str(reason) for reason in cells.of("reason")[cells.failed]})
        return Finding(claim, float("nan"), False, "s", cause=("no cell of the sweep completed", *reasons))
    return RULES[claim.rule](claim, evidence)


def within(published: float) -> float:
    """Return the tolerance of a published time [s]."""
    return max(ABSOLUTE, RELATIVE * published)


def _setting(claim: Claim, evidence: Evidence) -> Finding:
    """All runs have the setting."""
    (name,), published = claim.reads, _number(claim)
    found = sorted({float(getattr(run, name)) for run in evidence.runs.values()})
    reproduced = next((value for value in found if value != published), published)
    holds = found == [published]
    cause = () if holds else (f"the runs were made with {', '.join(f'{value:g}' for value in found)}",)
    unit = "s" if name == "horizon" else ""
    return Finding(claim, reproduced, holds, unit, reproduced - published, cause=cause)


def _time(claim: Claim, evidence: Evidence) -> Finding:
    """A time is within its tolerance, or earlier if the mission succeeded."""
    moment, published = evidence.moment(claim.reads[0]), _number(claim)
    difference, tolerance = moment.time - published, within(published)
    near = abs(difference) <= tolerance + ROUNDING
    earlier = not near and difference < 0 and moment.run.summary.succeeded
    cause = () if near else _cause_of_time(moment, published, evidence)
    return Finding(claim, moment.time, near or earlier, "s", difference, tolerance, earlier, cause)


def _cause_of_time(moment: Moment, published: float, evidence: Evidence) -> tuple[str, ...]:
    run, tolerance = moment.run, within(published)
    if np.isnan(moment.time):
        return (_never(moment),)
    late = moment.time > published
    points = [] if late else [_earlier(run.summary)]
    if moment.event == "start":
        return *points, *_thresholds(moment, published - tolerance, published + tolerance)
    points.append(_increments(moment, evidence))
    if late and moment.stage in run.errors:
        error = float(np.interp(published, *run.errors[moment.stage]))
        digits = 0 if error >= 10 else 1
        points.append(f"at {published:g} s {moment.stage} was still {error:.{digits}f} tolerances away")
    return *points, *_too_early_for_limits(moment, published)


def _on_time(claim: Claim, evidence: Evidence) -> Finding:
    """A stage starts when the stage before it ends, to one sample."""
    return _start(claim, evidence, 0.0, lambda start: [_monitors(start.run.summary)])


def _once_seen(claim: Claim, evidence: Evidence) -> Finding:
    """A stage starts a horizon before the stage before it ends, to one sample."""
    return _start(claim, evidence, evidence.moment(claim.reads[0]).run.horizon, _postponed)


def _start(claim: Claim, evidence: Evidence, lead: float, more: Callable[[Moment], list[str]]) -> Finding:
    start = evidence.moment(claim.reads[0])
    end, sample = evidence.end_before(start), start.run.sample_time
    expected = end.time - lead
    difference = start.time - expected
    holds = abs(difference) <= sample + ROUNDING
    never = [_never(moment) for moment in (start, end) if np.isnan(moment.time)]
    cause = never[:1] or [_both(start, end), *_thresholds(start, expected - sample, expected + sample), *more(start)]
    return Finding(claim, difference, holds, "s", difference, sample, cause=() if holds else _told(cause))


def _floor(claim: Claim, evidence: Evidence) -> Finding:
    """No stage starts more than a sample before the end of the stage before it comes into the horizon."""
    starts = [evidence.moment(name) for name in claim.reads]
    run = starts[0].run
    slacks = {start.stage: start.time - (evidence.end_before(start).time - run.horizon) for start in starts}
    least = min((slack for slack in slacks.values() if np.isfinite(slack)), default=float("nan"))
    holds = bool(least >= -run.sample_time - ROUNDING)
    cause = [
        f"{start.stage} starts {-slacks[start.stage]:.2f} s before {evidence.end_before(start).symbol} - T_h: an "
        "earlier end was predicted"
        for start in starts
        if slacks[start.stage] < 0
    ] or [f"no stage ended: {run.summary.reason}"]
    return Finding(claim, least, holds, "s", min(least, 0.0), run.sample_time, cause=() if holds else _told(cause))


def _all_early(claim: Claim, evidence: Evidence) -> Finding:
    """All of the stages start early."""
    starts = [evidence.moment(name) for name in claim.reads]
    run, names = starts[0].run, [start.stage for start in starts]
    early = tuple(name for name in names if (stage := run.stage(name)) is not None and stage.early)
    cause = []
    for name in sorted(set(names) - set(early)):
        onset = run.onsets.get(name)
        added = f"adds at most {onset.largest():.2g} {UNIT} before its time" if onset else "never waits in a window"
        cause.append(f"{name} {added}; epsilon = {run.epsilon:g}")
    return Finding(claim, early, not cause, cause=tuple(cause))


def _order(claim: Claim, evidence: Evidence) -> Finding:
    """The times are in this order, however small the difference."""
    moments = [evidence.moment(name) for name in claim.reads]
    times = tuple(moment.time for moment in moments)
    holds = all(one < other for one, other in pairwise(times))
    cause = [
        f"{one} = {_seconds(one.time)} is not before {other} = {_seconds(other.time)}"
        for one, other in pairwise(moments)
        if not one.time < other.time
    ]
    published = claim.published if isinstance(claim.published, tuple) else ()
    for moment, time in zip(moments, map(float, published), strict=True):
        cause += [f"{moment}: {point}" for point in _too_early_for_limits(moment, time)]
    return Finding(claim, times, holds, "s", cause=() if holds else _told(cause))


def _mission(claim: Claim, evidence: Evidence) -> Finding:
    """The mission ends as published."""
    summary = evidence.runs[claim.reads[0]].summary
    reproduced = "succeeds" if summary.succeeded else "fails"
    holds = reproduced == claim.published
    return Finding(claim, reproduced, holds, cause=() if holds else mission_end(summary))


def _released_early(claim: Claim, evidence: Evidence) -> Finding:
    """A monitor is violated after the last stage has started and before the stage before it ends."""
    start = evidence.moment(claim.reads[0])
    end, summary = evidence.end_before(start), start.run.summary
    losses = [verdict.broken_at for verdict in summary.monitors if np.isfinite(verdict.broken_at)]
    lost = min(losses, default=float("nan"))
    holds = bool(start.time <= lost < end.time)
    reproduced = f"lost at {lost:.1f} s, {end.symbol} = {end.time:.1f} s" if losses else "not lost"
    return Finding(claim, reproduced, holds, cause=() if holds else _told([_both(start, end), _monitors(summary)]))


def _trend(claim: Claim, evidence: Evidence) -> Finding:
    """For every threshold no larger ratio starts more than a sample later, and the largest one starts early."""
    cells = evidence.weights
    sample, found = cells.task.spec.controller.sample_time, trends(cells)
    shown, worst = found[cells.chosen], max(trend.rise for trend in found)
    cause = [
        f"for epsilon = {one.epsilon:g} it is {one.rise:.2f} s later at ratio {one.ratio:.4g} than at a smaller or "
        "equal ratio"
        for one in found
        if one.rise > sample + ROUNDING
    ]
    cause += [
        f"for epsilon = {one.epsilon:g} it is {one.first:.2f} s at the smallest, {one.last:.2f} s at the largest ratio"
        for one in found
        if one.first - one.last <= sample + ROUNDING
    ]
    reproduced = f"{shown.first:.2f} s to {shown.last:.2f} s"
    return Finding(claim, reproduced, not cause, "s", worst, sample, cause=tuple(cause))


def _weights_floor(claim: Claim, evidence: Evidence) -> Finding:
    """No actual start of any cell, for any threshold, is more than a sample before t_s - T_h."""
    sample = evidence.weights.task.spec.controller.sample_time
    slack, start, ratio, epsilon = least_slack(evidence.weights)
    holds = slack >= -sample - ROUNDING
    where = f"at ratio {ratio:.4g} and epsilon = {epsilon:g} it starts at {start:.2f} s"
    cause = () if holds else (f"{where}, {-slack:.2f} s before t_s - T_h",)
    return Finding(claim, slack, holds, "s", min(slack, 0.0), sample, cause=cause)


def _settles(claim: Claim, evidence: Evidence) -> Finding:
    """The actual start at the largest ratio is within the tolerance of published times."""
    cells, published = evidence.weights, _number(claim)
    (start, ratio), tolerance = settled(cells), within(published)
    holds = abs(start - published) <= tolerance + ROUNDING
    cause = (
        f"from ratio {ratio:.4g} on it is {start:.2f} s to one sample, for epsilon = {cells.epsilons[cells.chosen]:g}",
        f"t_s - T_h = {float(np.median(cells.floor[cells.ended])):.2f} s, and no start can be before it",
    )
    return Finding(claim, start, holds, "s", start - published, tolerance, cause=() if holds else cause)


def _chosen(claim: Claim, evidence: Evidence) -> Finding:
    """At the ratio Capture completes earlier than with equal weights, at less effort than at the largest ratio."""
    cells = evidence.weights
    completion, effort = (along_ratio(cells, cells.of(name.partition(".")[2])) for name in claim.reads)
    logs, names = np.log(completion.ratio), [f"{ratio:.4g}" for ratio in completion.ratio]
    there, equal = (int(np.argmin(np.abs(logs - np.log(ratio)))) for ratio in (claim.ratio, 1.0))
    reproduced = (
        f"{completion.middle[there]:.2f} s, {completion.middle[equal]:.2f} s at {names[equal]}; "
        f"effort {effort.middle[there]:.3g}, {effort.middle[-1]:.3g} at {names[-1]}"
    )
    cause = []
    if not completion.highest[there] < completion.lowest[equal] - ROUNDING:
        cause.append(f"at ratio {names[there]} it completes no earlier than at {names[equal]}")
    if not effort.highest[there] < effort.lowest[-1]:
        cause.append(f"at ratio {names[there]} it takes no less effort than at {names[-1]}")
    return Finding(claim, reproduced, not cause, cause=tuple(cause))


def _along_ratio(claim: Claim, evidence: Evidence) -> Finding:
    """At every sample the optimum moves to the upper left as the ratio grows, and never back by more than rounding."""
    movement = evidence.fronts
    if movement is None:
        return Finding(claim, "unknown", False, cause=(NO_WINDOW,))
    cause = [
        f"at {instant:g} s it moves against it by {step:.2g} of the front"
        for instant, step in zip(movement.instants, movement.against, strict=True)
        if step > CLEARLY
    ]
    cause += [
        f"at {instant:g} s it does not move, or was not found"
        for instant, moves in zip(movement.instants, movement.moves, strict=True)
        if not moves
    ]
    reproduced = f"{claim.published} at {movement.moving} of {len(movement.instants)}"
    return Finding(claim, reproduced, not cause, cause=tuple(cause))


def _along_time(claim: Claim, evidence: Evidence) -> Finding:
    """In normalized costs the front moves to the upper left, on average, from every sample to the next."""
    movement = evidence.fronts
    if movement is None or len(movement.instants) < 2:
        reason = NO_WINDOW if movement is None else "the fronts of a single sample cannot be compared"
        return Finding(claim, "unknown", False, cause=(reason,))
    holds = movement.with_time
    return Finding(claim, movement.directions(), holds, cause=() if holds else movement.over_time)


RULES: Mapping[str, Callable[[Claim, Evidence], Finding]] = {
    "setting": _setting,
    "time": _time,
    "on_time": _on_time,
    "once_seen": _once_seen,
    "floor": _floor,
    "all_early": _all_early,
    "order": _order,
    "mission": _mission,
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
    return _told([summary.reason, _monitors(summary)])


def _number(claim: Claim) -> float:
    if not isinstance(claim.published, float):
        raise TypeError(f"{claim.id}: found {claim.published!r}, expected a published number")
    return claim.published


def _earlier(summary: Summary) -> str:
    if summary.succeeded:
        return "earlier than published, and the mission succeeded"
    return f"earlier than published does not count because the mission failed ({'; '.join(mission_end(summary))})"


def _never(moment: Moment) -> str:
    known = moment.run.stage(moment.stage) is not None
    reason = moment.run.summary.reason if known else "the task has no such stage"
    return f"{moment.stage} did not {moment.event}: {reason}"


def _thresholds(start: Moment, earliest: float, latest: float) -> list[str]:
    """Return which thresholds would give a start between two times [s], and how the start depends on them."""
    run, stage, onset = start.run, start.stage, start.run.onsets.get(start.stage)
    if onset is None:
        return [f"{stage} never waits in a window"]
    above, at_most = onset.thresholds(earliest, latest)
    between = f"a start from {earliest:.2f} s to {latest:.2f} s"
    needed = f"no epsilon gives {between}"
    if latest >= run.regular_start(stage):  # above its largest presence a stage starts on time
        needed = f"{between} takes an epsilon above {above:.2g}"
    elif at_most > above:
        needed = f"{between} takes an epsilon above {above:.2g} and up to {at_most:.2g}"
    starts = ", ".join(f"{_seconds(time)} for {epsilon:g}" for epsilon, time in sorted(onset.starts.items()))
    by_epsilon = [f"by epsilon it starts at {starts}"] if starts else []
    return [f"{stage} starts where the control it adds reaches epsilon = {run.epsilon:g} {UNIT}", needed, *by_epsilon]


def _postponed(start: Moment) -> list[str]:
    onset = start.run.onsets.get(start.stage)
    if onset is None or not onset.postponed:
        return []
    return [f"it was within the horizon at {onset.postponed} samples at which the window with it had no solution yet"]


def _increments(moment: Moment, evidence: Evidence) -> str:
    """Return how much of a difference arises between one published end and the next."""
    published = evidence.claims.published(moment.method, "end")
    off, symbols = [0.0], ["the start"]
    for symbol, stage in evidence.claims.stages.items():
        time = evidence.moment(f"{moment.method}.{symbol}").time
        if stage in published and np.isfinite(time):
            off.append(time - published[stage])
            symbols.append(symbol)
        if stage == moment.stage:
            break
    gains = zip(pairwise(off), pairwise(symbols), strict=True)
    return "the difference arises " + ", ".join(
        f"{there - here:+.2f} s from {one} to {other}" for (here, there), (one, other) in gains
    )


def _too_early_for_limits(moment: Moment, published: float) -> list[str]:
    """Return that a published end is before the earliest that velocity limits allow, if so."""
    earliest = moment.run.earliest_ends.get(moment.stage, -np.inf)
    if moment.event == "start" or published >= earliest:
        return []
    limited = f"within its velocity limits {moment.stage} cannot end before {earliest:.2f} s"
    return [f"published is {published:g} s, but {limited}"]


def _monitors(summary: Summary) -> str:
    said = []
    for verdict in summary.monitors:
        if np.isfinite(verdict.broken_at):
            said.append(f"'{verdict.name}' was violated at {verdict.broken_at:.1f} s, by up to {-verdict.margin:.3f}")
        else:
            said.append(f"'{verdict.name}' {'held' if verdict.held else 'was not judged'}, margin {verdict.margin:.3f}")
    return ", ".join(said)


def _both(start: Moment, end: Moment) -> str:
    return f"{start.stage} starts at {_seconds(start.time)}, {end.symbol} = {_seconds(end.time)}"


def _seconds(time: float) -> str:
    return "never" if np.isnan(time) else f"{time:.2f} s"


def _told(points: Iterable[str]) -> tuple[str, ...]:
    """Return the points that are not empty."""
    return tuple(point for point in points if point)
