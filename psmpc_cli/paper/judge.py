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
from psmpc_cli.studies.sweep import QuantityByRatio, SweepCells


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
        return Finding(claim, np.nan, False, cause=("no cell of the sweep completed", *_reasons_of_failed_cells(cells)))
    finding = RULES[claim.rule](claim, reproduction)
    return finding._replace(cause=()) if finding.holds else finding


def _judge_setting(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that all runs have the setting."""
    values = {getattr(run.task.spec.controller, claim.reads[0]) for run in reproduction.runs.values()}
    set_values = sorted(np.nan if value == "auto" else float(value) for value in values)
    reproduced = next((value for value in set_values if value != claim.number), claim.number)
    return Finding(claim, reproduced, set_values == [claim.number], reproduced - claim.number)


def _reasons_of_failed_cells(cells: SweepCells) -> list[str]:
    """Return why cells of a sweep failed, each reason once."""
    return sorted({str(reason) for reason in cells.quantity("reason")[cells.failed]})


def _causes_by_unfinished_cells(cells: SweepCells) -> list[str]:
    """Return at which ratios cells did not end, and why cells failed; empty if all ended.

    A claim on all cells does not hold then, since nothing is known of it there.
    """
    missing = ", ".join(dict.fromkeys(f"{ratio:.4g}" for ratio in np.sort(cells.ratio[~cells.ended])))
    return [f"no cell ended at ratio {missing}", *_reasons_of_failed_cells(cells)] if missing else []


def _judge_earliest_starts(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that no actual start, for any threshold, is more than a sample before t_s - T_h, and that all cells ended.

    Before t_s - T_h, the end t_s of the first stage less the horizon T_h, the second stage is in no window.
    """
    cells = reproduction.weights
    # by cell and threshold, how long after t_s - T_h a start is; infinite in cells that did not end
    slacks = np.where(cells.ended[:, None], cells.quantity("actual_start") - cells.earliest_start[:, None], np.inf)
    cell, k = np.unravel_index(np.argmin(slacks), slacks.shape)
    slack = float(slacks[cell, k])
    finding = not_below(claim, slack, cells.task.spec.controller.sample_time)
    cause = _causes_by_unfinished_cells(cells)
    if not finding.holds:
        where = f"at ratio {cells.ratio[cell]:.4g} and epsilon = {cells.epsilons[k]:g} {cells.names[1]}"
        cause.insert(0, _describe_too_early_start(where, slack))
    return finding._replace(holds=not cause, cause=tuple(cause))


def _judge_deliveries(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that, by the mechanics of a grasped body, the runs deliver the object or do not, as published.

    An object that was never taken, or that is still held, is neither.
    """
    grasps = reproduction.grasps
    found = [_object_outcome(grasps[name.removeprefix("grasp.")].summary()) for name in claim.reads]
    outcomes = tuple(outcome for outcome, _ in found)
    return Finding(claim, tuple(text for _, text in found), outcomes == claim.published)


def _object_outcome(summary: Summary) -> tuple[str, str]:
    """Return what became of a grasped object in a run, from the verdicts of its summary.

    Returns:
        The outcome, by which claims are judged: delivered, not delivered, not taken, or still held; and a text that
        says more of it, for the table of claims.
    """
    verdicts = {verdict.name: verdict for verdict in summary.monitors}
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


def _judge_trend_of_starts(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check the claim that a larger ratio of priorities makes the second stage start earlier.

    For every threshold epsilon of the actual start, no larger ratio may start more than a sample later than a smaller
    one, and the largest has to start more than a sample earlier than the smallest. All cells, the runs of the sweep
    over ratios, have to have ended.
    """
    cells = reproduction.weights
    sample = cells.task.spec.controller.sample_time
    cause = _causes_by_unfinished_cells(cells)
    rises = []
    shown = []
    for epsilon, values in zip(cells.epsilons, cells.quantity("actual_start").T, strict=True):
        # the lowest, middle and highest start at each ratio, from the smallest on
        start = QuantityByRatio(cells, values)
        rise = float(np.max(start.highest - np.minimum.accumulate(start.lowest)))
        first, last = start.middle[[0, -1]]
        rises.append(rise)
        shown.append(f"{first:.2f} s to {last:.2f} s")
        if rise > sample + ROUNDING or first - last <= sample + ROUNDING:
            cause.append(f"for epsilon = {epsilon:g} from {shown[-1]}, by up to {rise:.2f} s later at a larger ratio")
    return Finding(
        claim,
        reproduced=shown[cells.shown_threshold],  # at the threshold of the task
        holds=not cause,
        difference=max(rises),
        tolerance=sample,
        cause=tuple(cause),
    )


def _judge_start_at_largest_ratio(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that the actual start at the largest ratio is within the tolerance of published times."""
    cells = reproduction.weights
    tolerance = time_tolerance(claim.number)
    start = QuantityByRatio(cells, cells.quantity("actual_start")[:, cells.shown_threshold])
    if not _has_ended_cell_at(start, cells.ratio.max()):
        cause = tuple(_causes_by_unfinished_cells(cells))
        return Finding(claim, reproduced=np.nan, holds=False, tolerance=tolerance, cause=cause)
    last = float(start.middle[-1])
    difference = last - claim.number
    holds = abs(difference) <= tolerance + ROUNDING
    earliest = float(np.median(cells.earliest_start[cells.ended]))
    cause = (f"t_s - T_h = {earliest:.2f} s, and no start can be before it",)
    return Finding(claim, last, holds, difference, tolerance, cause=cause)


def _has_ended_cell_at(along: QuantityByRatio, ratio: float) -> bool:
    """Tell whether a cell of a ratio of the weights ended."""
    return bool(np.isclose(along.ratio, ratio, rtol=SAME_RATIO, atol=0.0).any())


def _judge_chosen_ratio(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check the claim that a ratio of priorities is a good choice.

    At the ratio of the claim Capture has to complete earlier than at ratio 1, with less effort than at the largest
    ratio of the sweep. Where several cells have the same ratio, the claim has to hold between all of them.
    """
    cells = reproduction.weights
    # the claim reads weights.completion_time and weights.control_effort, quantities of the sweep over the weights
    completion, effort = (QuantityByRatio(cells, cells.quantity(name.partition(".")[2])) for name in claim.reads)
    compared = (claim.ratio, 1.0, float(cells.ratio.max()))
    missing = [f"no cell ended at ratio {ratio:.4g}" for ratio in compared if not _has_ended_cell_at(completion, ratio)]
    if missing:
        return Finding(claim, "unknown", False, cause=(*missing, *_reasons_of_failed_cells(cells)))
    # indices of the ratios that are compared; that of the largest is the last one
    there, equal, _ = (int(np.argmin(np.abs(np.log(completion.ratio / ratio)))) for ratio in compared)
    reproduced = (
        f"{completion.middle[there]:.2f} s, {completion.middle[equal]:.2f} s at 1; "
        f"effort {effort.middle[there]:.3g}, {effort.middle[-1]:.3g} at {completion.ratio[-1]:.4g}"
    )
    is_sooner = completion.highest[there] < completion.lowest[equal] - ROUNDING
    return Finding(claim, reproduced, bool(is_sooner and effort.highest[there] < effort.lowest[-1]))


def _judge_fronts_along_ratio(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that at every sample the optimum moves to the upper left as the ratio grows, and back by rounding alone."""
    movement = reproduction.movement
    if movement is None:
        return Finding(claim, "unknown", False, cause=(NO_FRONTS,))
    cause = list[str]()
    for instant, step, moves in zip(movement.instants, movement.steps_back, movement.moves_at, strict=True):
        if step > LEAST_IMPROVEMENT or not moves:
            how = f"moves against it by {step:.2g} of the front" if moves else "does not move, or was not found"
            cause.append(f"at {instant:g} s it {how}")
    return Finding(
        claim, f"{claim.published} at {movement.n_moving} of {len(movement.instants)}", not cause, cause=tuple(cause)
    )


def _judge_fronts_along_time(claim: Claim, reproduction: Reproduction) -> Finding:
    """Check that in normalized costs the mean of the front moves to the upper left from every sample to the next."""
    movement = reproduction.movement
    if movement is None or len(movement.instants) < 2:
        return Finding(claim, "unknown", False, cause=(NO_FRONTS,))
    return Finding(claim, movement.directions(), movement.moves_over_time, cause=movement.over_time)


NO_FRONTS = "fewer windows of the PSMPC run than needed hold the first two stages alone and were solved"

SAME_RATIO = 1e-6
"""Ratios of weights that differ by a smaller part are the same."""

RULES: Mapping[str, Callable[[Claim, Reproduction], Finding]] = {
    "setting": _judge_setting,
    "delivered": _judge_deliveries,
    "trend": _judge_trend_of_starts,
    "weights_floor": _judge_earliest_starts,
    "settles": _judge_start_at_largest_ratio,
    "chosen": _judge_chosen_ratio,
    "along_ratio": _judge_fronts_along_ratio,
    "along_time": _judge_fronts_along_time,
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


def _causes_of_another_time(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield sentences on why a measured time differs from the published one, for the report of a reproduction.

    The time is the end or the actual start of one stage. What may explain it is that the stage did not end, that an
    earlier time let the mission fail, how far the stage was from its target at the published time, and how early its
    velocity limits let it end.
    """
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
        at_rest = np.r_[Q, np.zeros(len(Q))]  # only the pose is judged, so velocities are left out
        error = run.problem.costs.end_error(run.problem.stages[stage_time.index], at_rest)
        yield f"at {published:g} s {stage_time.name} was still {error:.1f} tolerances away"
    earliest, _ = earliest_ends(run.task, run.problem.stages)[stage_time.index]
    if published < earliest:
        yield f"within its velocity limits {stage_time.name} cannot end before {earliest:.2f} s"


def _causes_by_starts(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield when the stages that a claim reads start, or why they do not or do not end."""
    for start in stage_times(finding.claim, reproduction.missions):
        if np.isfinite(start.time):
            yield _explain_start(start, reproduction)
        if not start.has_ended:
            yield _explain_missing(start, reproduction)


def _causes_of_late_starts(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield when the stages that do not start early start."""
    for start in stage_times(finding.claim, reproduction.missions):
        if not start.is_early:
            yield _explain_start(start, reproduction)


def _causes_of_too_early_starts(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield which stage starts too long before the one before it ends, and which do not end."""
    for start in stage_times(finding.claim, reproduction.missions):
        slack = start.time - (start.ended - start.mission.horizon)
        if slack < -start.mission.sample_time - ROUNDING:
            yield _describe_too_early_start(start.name, slack)
        if not start.has_ended:
            yield _explain_missing(start, reproduction)


def _causes_by_failed_runs(finding: Finding, reproduction: Reproduction) -> Iterator[str]:
    """Yield how runs ended that are to succeed and did not."""
    for method in to_succeed(finding.claim):
        summary = reproduction.summaries[method]
        if not summary.succeeded:
            yield f"the mission of {method} failed: {'; '.join(mission_end(summary))}"


def _causes_by_mission_end(finding: Finding, reproduction: Reproduction) -> Iterable[str]:
    """Return how the mission ended."""
    return mission_end(reproduction.summaries[finding.claim.reads[0]])


CAUSES: Mapping[str, Callable[[Finding, Reproduction], Iterable[str]]] = {
    "time": _causes_of_another_time,
    "on_time": _causes_by_starts,
    "once_seen": _causes_by_starts,
    "floor": _causes_of_too_early_starts,
    "all_early": _causes_of_late_starts,
    "order": _causes_by_failed_runs,
    "mission": _causes_by_mission_end,
    "released_early": _causes_by_starts,
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


def _describe_too_early_start(what: str, slack: float) -> str:
    """Describe a start that lies before the instant before which none may lie, by its difference from it [s]."""
    return f"{what} starts {-slack:.2f} s before t_s - T_h"
