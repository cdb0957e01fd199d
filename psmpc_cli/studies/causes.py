"""Why a claim does not hold: computed from the runs, in words."""

from collections.abc import Collection, Mapping
from itertools import pairwise

import numpy as np

from psmpc_cli.simulation.summary import Summary
from psmpc_cli.studies.claims import TITLES, FloorClaim, Moment, OrderClaim, ReleaseClaim, StartClaim, TimeClaim
from psmpc_cli.studies.evidence import Evidence, Onset

UNIT = "m/s^2, rad/s^2"

Cause = tuple[str, ...]
"""What there is to say, point by point."""


def of_time(claim: TimeClaim, evidence: Evidence, tolerance: float) -> Cause:
    """Return why something does not happen at its published time, to within the tolerance [s]."""
    moment, time = claim.moment, evidence.time_of(claim.moment)
    if np.isnan(time):
        return (_never(moment, evidence),)
    parts = [] if time > claim.published else [_earlier(evidence.summary)]
    if moment.event == "start":
        parts += _threshold(moment, evidence, claim.published - tolerance, claim.published + tolerance)
    else:
        late = time > claim.published
        parts += [_increments(claim, evidence), _remoteness(moment, claim.published, evidence) if late else ""]
        parts += [_floor(moment, claim.published, evidence)]
    return _told(*parts)


def of_start(claim: StartClaim, expected: float, evidence: Evidence) -> Cause:
    """Return why a stage does not start when it is expected to [s]."""
    for moment in (claim.start, claim.end):
        if np.isnan(evidence.time_of(moment)):
            return (_never(moment, evidence),)
    earliest, latest = expected - evidence.sample_time, expected + evidence.sample_time
    parts = [_times(claim.start, claim.end, evidence), *_threshold(claim.start, evidence, earliest, latest)]
    if claim.when == "on time":
        return _told(*parts, _monitors(evidence.summary))
    return _told(*parts, _postponed(claim.start, evidence))


def of_floor(claim: FloorClaim, evidence: Evidence) -> Cause:
    """Return which stages start before the end of the one before them comes into the horizon."""
    parts = []
    for start, end in claim.pairs:
        slack = evidence.time_of(start) - evidence.time_of(end) + evidence.horizon
        if slack < 0:
            parts.append(f"{start.stage} starts {-slack:.2f} s before {end.symbol} - T_h; predicted was an earlier end")
    return tuple(parts) or (f"no stage ended: {evidence.summary.reason}",)


def of_no_early_start(missing: Collection[str], evidence: Evidence) -> Cause:
    """Return how little the stages that do not start early add to the control before their time."""
    parts = []
    for name in sorted(missing):
        onset = evidence.onsets.get(name)
        added = (
            "never waits in a window" if onset is None else f"adds {onset.largest():.2g} {UNIT} at most before its time"
        )
        parts.append(f"{name} {added}; epsilon = {evidence.epsilon:g}")
    return _told(*parts)


def of_order(claim: OrderClaim, runs: Mapping[str, Evidence]) -> Cause:
    """Return which times are out of order, and which of the published ones no run could have."""
    parts = []
    for one, other in pairwise(claim.moments):
        before, after = (runs[moment.run].time_of(moment) for moment in (one, other))
        if not before < after:
            parts.append(f"{_of(one)} = {_seconds(before)} is not before {_of(other)} = {_seconds(after)}")
    for moment, published in zip(claim.moments, claim.published, strict=True):
        if floor := _floor(moment, published, runs[moment.run]):
            parts.append(f"{_of(moment)}: {floor}")
    return _told(*parts)


def of_mission(summary: Summary) -> Cause:
    """Return how the mission went."""
    return _told(summary.reason, _monitors(summary))


def of_no_release(claim: ReleaseClaim, evidence: Evidence) -> Cause:
    """Return what happens instead of the object's early release."""
    return _told(_times(claim.start, claim.end, evidence), _monitors(evidence.summary))


def _earlier(summary: Summary) -> str:
    if summary.succeeded:
        return "earlier than published, and the mission succeeded"
    return f"earlier than published does not count, for the mission failed ({'; '.join(of_mission(summary))})"


def _never(moment: Moment, evidence: Evidence) -> str:
    known = evidence.stage(moment.stage) is not None
    reason = evidence.summary.reason if known else "the task has no such stage"
    return f"{moment.stage} did not {moment.event}: {reason}"


def _threshold(start: Moment, evidence: Evidence, earliest: float, latest: float) -> list[str]:
    """Return which thresholds would give a start between two times [s], and how the start depends on them."""
    onset = evidence.onsets.get(start.stage)
    if onset is None:
        return [f"{start.stage} never waits in a window"]
    starts = ", ".join(f"{_seconds(time)} for {epsilon:g}" for epsilon, time in sorted(onset.starts.items()))
    return [
        f"{start.stage} starts where the control it adds reaches epsilon = {evidence.epsilon:g} {UNIT}",
        _needed(onset, evidence.regular_start(start.stage), earliest, latest),
        f"by epsilon it starts at {starts}" if starts else "",
    ]


def _postponed(start: Moment, evidence: Evidence) -> str:
    onset = evidence.onsets.get(start.stage)
    if onset is None or not onset.postponed:
        return ""
    return f"it was seen at {onset.postponed} samples at which the window with it had no solution yet"


def _needed(onset: Onset, regular: float, earliest: float, latest: float) -> str:
    """Return the thresholds that give a start between two times; above its largest presence a stage starts on time."""
    above, at_most = onset.thresholds(earliest, latest)
    between = f"a start from {earliest:.2f} s to {latest:.2f} s"
    if latest >= regular:
        return f"{between} takes an epsilon above {above:.2g}"
    if at_most > above:
        return f"{between} takes an epsilon above {above:.2g} and up to {at_most:.2g}"
    return f"no epsilon gives {between}"


def _increments(claim: TimeClaim, evidence: Evidence) -> str:
    """Return how much of a difference arises between one published time and the next."""
    times = [*claim.before, (claim.moment, claim.published)]
    known = [(moment, published) for moment, published in times if np.isfinite(evidence.time_of(moment))]
    off = [0.0, *(evidence.time_of(moment) - published for moment, published in known)]
    names = ["the start", *(moment.symbol for moment, _ in known)]
    gains = zip(pairwise(off), pairwise(names), strict=True)
    return "the difference arises " + ", ".join(
        f"{there - here:+.2f} s from {one} to {other}" for (here, there), (one, other) in gains
    )


def _remoteness(moment: Moment, published: float, evidence: Evidence) -> str:
    """Return how far a stage was from its end condition when it is published to have ended [s]."""
    nearness = evidence.nearness.get(moment.stage)
    if nearness is None:
        return ""
    tolerances = nearness.at(published)
    return f"at {published:g} s {moment.stage} was still {tolerances:.{0 if tolerances >= 10 else 1}f} tolerances away"


def _floor(moment: Moment, published: float, evidence: Evidence) -> str:
    """Return that a published end lies before the earliest that velocity limits allow, if it does."""
    earliest = evidence.earliest_ends.get(moment.stage, -np.inf)
    if moment.event == "start" or published >= earliest:
        return ""
    limited = f"within its velocity limits {moment.stage} cannot end before {earliest:.2f} s"
    return f"published is {published:g} s, but {limited}"


def _monitors(summary: Summary) -> str:
    said = []
    for verdict in summary.monitors:
        if np.isfinite(verdict.broken_at):
            said.append(f"'{verdict.name}' broke at {verdict.broken_at:.1f} s, by up to {-verdict.margin:.3f}")
        else:
            said.append(f"'{verdict.name}' {'held' if verdict.held else 'was not judged'}, margin {verdict.margin:.3f}")
    return ", ".join(said)


def _times(start: Moment, end: Moment, evidence: Evidence) -> str:
    started, ended = evidence.time_of(start), evidence.time_of(end)
    return f"{start.stage} starts at {_seconds(started)}, {end.symbol} = {_seconds(ended)}"


def _of(moment: Moment) -> str:
    return f"{moment.symbol} of {TITLES[moment.run]}"


def _seconds(time: float) -> str:
    return "never" if np.isnan(time) else f"{time:.2f} s"


def _told(*points: str) -> Cause:
    """Return the points that say something."""
    return tuple(point for point in points if point)
