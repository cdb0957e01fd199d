"""Judges the claims: what was run for them, the rules on settings and studies, and why some claims do not hold."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.ocp.feasibility.forecast import earliest_ends
from psmpc_cli.paper.ablations import Ablation
from psmpc_cli.paper.claims import Claim, Finding, load_claims
from psmpc_cli.paper.missions import (
    MISSION_RULES,
    ROUNDING,
    Mission,
    StageTime,
    format_time,
    judge_missions,
    mission_of,
    not_below,
    stage_times,
    time_tolerance,
    to_succeed,
)
from psmpc_cli.specs.task import ObjectCheck
from psmpc_cli.studies.front_movement import FrontMovement
from psmpc_cli.studies.fronts import LEAST_IMPROVEMENT
from psmpc_cli.studies.sweep import AlongRatio, SweepCells


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

    @property
    def task(self) -> str:
        """Name of the task whose runs are judged."""
        return next(iter(self.runs.values())).task.spec.name

    @cached_property
    def summaries(self) -> dict[str, Summary]:
        """The summaries of the runs."""
        return {name: run.summary() for name, run in self.runs.items()}

    @cached_property
    def missions(self) -> dict[str, Mission]:
        """What the rules read of the runs."""
        horizons = {name: run.task.spec.controller.horizon for name, run in self.runs.items()}
        return {name: mission_of(summary, horizons[name]) for name, summary in self.summaries.items()}

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
        """The claims that do not hold, without those on inputs: a changed input is no failure."""
        return tuple(finding for finding in self.findings if not finding.holds and finding.claim.apart != "input")

    def part(self, apart: str | None) -> tuple[Finding, ...]:
        """Return the findings that are counted, or with a kind of `APART` those that stand apart for that reason."""
        return tuple(finding for finding in self.findings if finding.claim.apart == apart)

    def count(self, apart: str | None = None) -> tuple[int, int]:
        """Count the published claims, or those apart for a reason: how many hold, of how many."""
        holds = [finding.holds for finding in self.part(apart)]
        return sum(holds), len(holds)

    @property
    def outcome(self) -> str:
        """How many claims hold, as a sentence."""
        held, count = self.count()
        apart = []
        for kind, name in (("input", "on inputs"), ("definition", "from definitions"), ("ours", "of our own")):
            part, whole = self.count(kind)
            apart.append(f"{part} of {whole} {name}")
        return f"{held} of {count} claims hold; not counted: {', '.join(apart)}"

    def published(self, method: str, starts: bool) -> dict[str, float]:
        """Return the published ends, or actual starts, of a method's stages [s]."""
        claims = [claim for claim in load_claims() if claim.rule == "time" and claim.group == method]
        chosen = [claim for claim in claims if claim.reads[0].endswith("_real") == starts]
        return {stage_times(claim, self.missions)[0].name: claim.number for claim in chosen}


def judge(claim: Claim, reproduction: Reproduction) -> Finding:
    """Judge a claim; without a cell that completed no claim on the weights holds."""
    if claim.rule in MISSION_RULES:
        finding = judge_missions(claim, reproduction.missions)
        if finding.holds and not finding.earlier:
            return finding
        return finding._replace(cause=tuple(CAUSES[claim.rule](finding, reproduction)))
    cells = reproduction.weights
    if claim.group == "weights" and not cells.ended.any():
        return Finding(claim, np.nan, False, cause=("no cell of the sweep completed", *_reasons(cells)))
    finding = RULES[claim.rule](claim, reproduction)
    return finding._replace(cause=()) if finding.holds else finding


def _setting(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that all runs have the setting."""
    values = {getattr(run.task.spec.controller, claim.reads[0]) for run in reproduction.runs.values()}
    set_values = sorted(np.nan if value == "auto" else float(value) for value in values)
    reproduced = next((value for value in set_values if value != claim.number), claim.number)
    return Finding(claim, reproduced, set_values == [claim.number], reproduced - claim.number)


def _reasons(cells: SweepCells) -> list[str]:
    """Return why cells of a sweep failed, each reason once."""
    return sorted({str(reason) for reason in cells.quantity("reason")[cells.failed]})


def _unfinished(cells: SweepCells) -> list[str]:
    """Return what there is to say of cells that did not end: nothing is known of a claim on all cells there."""
    missing = ", ".join(dict.fromkeys(f"{ratio:.4g}" for ratio in np.sort(cells.ratio[~cells.ended])))
    return [f"no cell ended at ratio {missing}", *_reasons(cells)] if missing else []


def _weights_floor(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that all cells ended, and no actual start, for any threshold, is more than a sample before t_s - T_h."""
    cells = reproduction.weights
    slacks = np.where(cells.ended[:, None], cells.quantity("actual_start") - cells.earliest_start[:, None], np.inf)
    cell, k = np.unravel_index(np.argmin(slacks), slacks.shape)
    slack = float(slacks[cell, k])
    finding = not_below(claim, slack, cells.task.spec.controller.sample_time)
    cause = _unfinished(cells)
    if not finding.holds:
        where = f"at ratio {cells.ratio[cell]:.4g} and epsilon = {cells.epsilons[k]:g} {cells.names[1]}"
        cause.insert(0, _below(where, slack))
    return finding._replace(holds=not cause, cause=tuple(cause))


def _delivered(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that, by the mechanics of a grasped body, the runs deliver the object or do not, as published.

    An object that was never taken, or that is still held, is neither.
    """
    grasps = reproduction.grasps
    found = [_object_outcome(grasps[name.removeprefix("grasp.")].summary()) for name in claim.reads]
    outcomes = tuple(outcome for outcome, _ in found)
    return Finding(claim, tuple(text for _, text in found), outcomes == claim.published)


def _object_outcome(summary: Summary) -> tuple[str, str]:
    """Return whether a grasped object was delivered, not delivered, or not let go at all, and what became of it."""
    verdicts = {one.name: one for one in summary.monitors}
    capture = summary.capture
    taken = verdicts[ObjectCheck.TAKEN]
    kept = verdicts[ObjectCheck.NOT_LOST]
    delivered = verdicts[ObjectCheck.DELIVERED]
    if delivered.held:
        return "delivered", "delivered"
    if not taken.held:
        return "not taken", "not taken"
    if not kept.held:
        return "not delivered", f"lost at {kept.broken_at:.1f} s"
    if capture is None or np.isnan(capture.left_at):
        return "still held", "still held"
    return "not delivered", f"let go {100 * capture.distance:.1f} cm off at {capture.speed:.2f} m/s"


def _trend(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that for every threshold no larger ratio starts more than a sample later, and the largest starts early.

    All cells have to have ended.
    """
    cells = reproduction.weights
    sample = cells.task.spec.controller.sample_time
    cause = _unfinished(cells)
    rises = []
    shown = []
    for epsilon, values in zip(cells.epsilons, cells.quantity("actual_start").T, strict=True):
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
    start = AlongRatio(cells, cells.quantity("actual_start")[:, cells.chosen])
    if not _has_ratio(start, cells.ratio.max()):
        return Finding(claim, np.nan, False, np.nan, tolerance, cause=tuple(_unfinished(cells)))
    last = float(start.middle[-1])
    difference = last - claim.number
    cause = f"t_s - T_h = {float(np.median(cells.earliest_start[cells.ended])):.2f} s, and no start can be before it"
    return Finding(claim, last, abs(difference) <= tolerance + ROUNDING, difference, tolerance, cause=(cause,))


def _has_ratio(along: AlongRatio, ratio: float) -> bool:
    """Tell whether a cell of a ratio of the weights ended."""
    return bool(np.isclose(along.ratio, ratio, rtol=SAME_RATIO, atol=0.0).any())


def _chosen(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that Capture completes earlier at the ratio than at 1, with less effort than at the largest ratio."""
    cells = reproduction.weights
    completion, effort = (AlongRatio(cells, cells.quantity(name.partition(".")[2])) for name in claim.reads)
    compared = (claim.ratio, 1.0, float(cells.ratio.max()))
    missing = [f"no cell ended at ratio {ratio:.4g}" for ratio in compared if not _has_ratio(completion, ratio)]
    if missing:
        return Finding(claim, "unknown", False, cause=(*missing, *_reasons(cells)))
    there, equal, _ = (int(np.argmin(np.abs(np.log(completion.ratio / ratio)))) for ratio in compared)
    reproduced = (
        f"{completion.middle[there]:.2f} s, {completion.middle[equal]:.2f} s at 1; "
        f"effort {effort.middle[there]:.3g}, {effort.middle[-1]:.3g} at {completion.ratio[-1]:.4g}"
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

SAME_RATIO = 1e-6
"""Ratios of weights that differ by a smaller part are the same."""

RULES: Mapping[str, Callable[[Claim, Reproduction], Finding]] = {
    "setting": _setting,
    "delivered": _delivered,
    "trend": _trend,
    "weights_floor": _weights_floor,
    "settles": _settles,
    "chosen": _chosen,
    "along_ratio": _along_ratio,
    "along_time": _along_time,
}
"""The rules on settings and studies by the names that claims.yaml has for them; those on runs: `MISSION_RULES`."""


def mission_end(summary: Summary) -> tuple[str, ...]:
    """Return how a mission ended: why the run ended, and its monitors."""
    monitors = (
        f"'{verdict.name}' was violated at {verdict.broken_at:.1f} s, by up to {-verdict.margin:.3f}"
        if np.isfinite(verdict.broken_at)
        else f"'{verdict.name}' {'held' if verdict.held else 'was not judged'}, margin {verdict.margin:.3f}"
        for verdict in summary.monitors
    )
    return tuple(filter(None, (summary.reason, ", ".join(monitors))))


def _why_time(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield the causes of a difference from a published time."""
    published = finding.claim.number
    (stage_time,) = stage_times(finding.claim, reproduction.missions)
    if np.isnan(stage_time.time):
        yield _explain_missing(stage_time, reproduction)
        return
    run = reproduction.runs[stage_time.method]
    summary = reproduction.summaries[stage_time.method]
    late = stage_time.time > published
    if not late:
        ended = "succeeded" if summary.succeeded else f"failed: {'; '.join(mission_end(summary))}"
        yield f"earlier than published, and the mission {ended}"
    if stage_time.is_start:
        yield _explain_start(stage_time, reproduction)
        return
    if late:
        Q = [np.interp(published, run.motion.time, row) for row in run.motion.Q_seen.T]
        error = run.problem.costs.end_error(run.problem.stages[stage_time.index], np.r_[Q, np.zeros(len(Q))])
        yield f"at {published:g} s {stage_time.name} was still {error:.1f} tolerances away"
    earliest, _ = earliest_ends(run.task, run.problem.stages)[stage_time.index]
    if published < earliest:
        yield f"within its velocity limits {stage_time.name} cannot end before {earliest:.2f} s"


def _why_starts(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield when the stages that a claim reads start, or why they do not or do not end."""
    for start in stage_times(finding.claim, reproduction.missions):
        if np.isfinite(start.time):
            yield _explain_start(start, reproduction)
        if not start.has_ended:
            yield _explain_missing(start, reproduction)


def _why_not_early(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield when the stages that do not start early start."""
    for start in stage_times(finding.claim, reproduction.missions):
        if not start.is_early:
            yield _explain_start(start, reproduction)


def _why_floor(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield which stage starts too long before the one before it ends, and which do not end."""
    for start in stage_times(finding.claim, reproduction.missions):
        slack = start.time - (start.ended - start.mission.horizon)
        if slack < -start.mission.sample_time - ROUNDING:
            yield _below(start.name, slack)
        if not start.has_ended:
            yield _explain_missing(start, reproduction)


def _why_order(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield how runs ended that are to succeed and did not."""
    for method in to_succeed(finding.claim):
        summary = reproduction.summaries[method]
        if not summary.succeeded:
            yield f"the mission of {method} failed: {'; '.join(mission_end(summary))}"


def _why_mission(finding: Finding, reproduction: Reproduction) -> Iterable[str]:
    """Return how the mission ended."""
    return mission_end(reproduction.summaries[finding.claim.reads[0]])


CAUSES: Mapping[str, Callable[[Finding, Reproduction], Iterable[str]]] = {
    "time": _why_time,
    "on_time": _why_starts,
    "once_seen": _why_starts,
    "floor": _why_floor,
    "all_early": _why_not_early,
    "order": _why_order,
    "mission": _why_mission,
    "released_early": _why_starts,
}
"""What is computed of why a claim on runs does not hold, by its rule."""


def _explain_missing(stage_time: StageTime, reproduction: Reproduction) -> str:
    """Describe why a stage did not end, or did not start because the one before it did not end."""
    event = "start" if stage_time.is_start and np.isnan(stage_time.ended) else "end"
    return f"{stage_time.name} did not {event}: {reproduction.summaries[stage_time.method].reason}"


def _explain_start(start: StageTime, reproduction: Reproduction) -> str:
    """Describe when a stage starts, and how that depends on the threshold."""
    run = reproduction.runs[start.method]
    starts = sorted(zip(run.stages["epsilon"], run.stages["actual_start_by_epsilon"][start.index], strict=True))
    by_epsilon = ", ".join(f"{format_time(time)} for epsilon = {epsilon:g}" for epsilon, time in starts)
    when = f"{start.name} starts at {format_time(start.time)}, {start.end} = {format_time(start.ended)}"
    return f"{when}; by its {run.task.spec.onset.kind} it starts at {by_epsilon}"


def _below(what: str, slack: float) -> str:
    """Describe a start that lies before the instant before which none may lie, by its difference from it [s]."""
    return f"{what} starts {-slack:.2f} s before t_s - T_h"
