"""What a sweep has to say on the actual start, measured and judged. The rules are explained in docs/reproduce.md."""

from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from psmpc_cli.simulation.sweep_cells import SweepCells, along_ratio
from psmpc_cli.studies.claims import Claim
from psmpc_cli.studies.findings import ABSOLUTE, EXACTLY, NOTHING, RELATIVE, Finding
from psmpc_cli.studies.sweep_claims import ChosenClaim, SettlesClaim, TrendClaim, WeightsFloorClaim

ROUNDING = 1e-9
"""Times nearer to each other than this are the same [s]."""


@dataclass(frozen=True)
class Trend:
    """How the actual start follows the ratio, for one threshold.

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


@dataclass(frozen=True)
class Slack:
    """How close an actual start comes to t_s - T_h: start, ratio, threshold, and the start less t_s - T_h [s]."""

    slack: float
    start: float
    ratio: float
    epsilon: float


@dataclass(frozen=True)
class Settled:
    """Where the start stabilizes: as at the largest ratio [s], and from which ratio on it is that to one sample."""

    start: float
    ratio: float


def trends(cells: SweepCells) -> tuple[Trend, ...]:
    """Return for each threshold how the start follows the ratio."""
    found = []
    for epsilon, values in zip(cells.epsilons, cells.of("actual_start").T, strict=True):
        start = along_ratio(cells, values)
        rises = start.highest - np.minimum.accumulate(start.lowest)
        worst = int(np.argmax(rises))
        found.append(
            Trend(
                epsilon=float(epsilon),
                rise=float(rises[worst]),
                ratio=float(start.ratio[worst]),
                first=float(start.middle[0]),
                last=float(start.middle[-1]),
            )
        )
    return tuple(found)


def least_slack(cells: SweepCells) -> Slack:
    """Return which start comes closest to t_s - T_h, or lies before it most, of all cells and thresholds."""
    starts = cells.of("actual_start")
    slacks = np.where(cells.ended[:, None], starts - cells.floor[:, None], np.inf)
    cell, threshold = np.unravel_index(np.argmin(slacks), slacks.shape)
    return Slack(
        slack=float(slacks[cell, threshold]),
        start=float(starts[cell, threshold]),
        ratio=float(cells.ratio[cell]),
        epsilon=float(cells.epsilons[threshold]),
    )


def settled(cells: SweepCells) -> Settled:
    """Return where the start for the chosen threshold stabilizes."""
    start = along_ratio(cells, cells.of("actual_start")[:, cells.chosen])
    apart = np.abs(start.middle - start.middle[-1]) > cells.task.spec.controller.sample_time + ROUNDING
    first = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
    return Settled(float(start.middle[-1]), float(start.ratio[first]))


def judge_weights(claim: Claim, cells: SweepCells) -> Finding:
    """Return what becomes of a claim on the weights; of a sweep without a cell that ended, nothing holds."""
    if not cells.ended.any():
        reasons = sorted({str(reason) for reason in cells.of("reason")[cells.failed]})
        return Finding(NOTHING, NOTHING, "s", NOTHING, EXACTLY, False, cause=("no cell came to its end", *reasons))
    return _judge(claim, cells)


@singledispatch
def _judge(claim: Claim, cells: SweepCells) -> Finding:
    raise TypeError(f"found a claim of kind {type(claim).__name__}, expected one with a rule in {__name__}")


@_judge.register
def _judge_trend(claim: TrendClaim, cells: SweepCells) -> Finding:
    """For every threshold no larger ratio starts more than a sample later, and the largest one starts early."""
    sample, found = cells.task.spec.controller.sample_time, trends(cells)
    worst = max(found, key=lambda trend: trend.rise)
    shown = found[cells.chosen]
    rising = [trend for trend in found if trend.rise > sample + ROUNDING]
    level = [trend for trend in found if trend.first - trend.last <= sample + ROUNDING]
    cause = [
        f"for epsilon = {one.epsilon:g} it is {one.rise:.2f} s later at ratio {one.ratio:.4g} than at one no larger"
        for one in rising
    ]
    cause += [
        f"for epsilon = {one.epsilon:g} it is {one.first:.2f} s at the smallest, {one.last:.2f} s at the largest ratio"
        for one in level
    ]
    reproduced = f"{shown.first:.2f} s to {shown.last:.2f} s"
    return Finding("advances", reproduced, "s", worst.rise, sample, not cause, cause=tuple(cause))


@_judge.register
def _judge_floor(claim: WeightsFloorClaim, cells: SweepCells) -> Finding:
    """No start of any cell, for any threshold, lies more than a sample before the floor."""
    sample, least = cells.task.spec.controller.sample_time, least_slack(cells)
    holds = least.slack >= -sample - ROUNDING
    where = f"at ratio {least.ratio:.4g} and epsilon = {least.epsilon:g} it starts at {least.start:.2f} s"
    cause = () if holds else (f"{where}, {-least.slack:.2f} s before t_s - T_h",)
    return Finding("not below 0", least.slack, "s", min(least.slack, 0.0), sample, holds, cause=cause)


@_judge.register
def _judge_settles(claim: SettlesClaim, cells: SweepCells) -> Finding:
    """The time at which it stabilizes holds within the tolerance of published times."""
    found = settled(cells)
    difference, tolerance = found.start - claim.published, max(ABSOLUTE, RELATIVE * claim.published)
    holds = abs(difference) <= tolerance + ROUNDING
    floor = float(np.median(cells.floor[cells.ended]))
    points = (
        f"from ratio {found.ratio:.4g} on it is {found.start:.2f} s to one sample, for epsilon = "
        f"{cells.epsilons[cells.chosen]:g}",
        f"t_s - T_h = {floor:.2f} s, and no start can come before",
    )
    return Finding(claim.published, found.start, "s", difference, tolerance, holds, cause=() if holds else points)


@_judge.register
def _judge_chosen(claim: ChosenClaim, cells: SweepCells) -> Finding:
    """At the ratio Capture completes before it does with equal weights, at less effort than at the largest ratio."""
    completion, effort = (along_ratio(cells, cells.of(name)) for name in ("completion_time", "control_effort"))
    logs = np.log(completion.ratio)
    there, equal = (int(np.argmin(np.abs(logs - np.log(ratio)))) for ratio in (claim.ratio, 1.0))
    sooner, spared = (
        completion.highest[there] < completion.lowest[equal] - ROUNDING,
        effort.highest[there] < effort.lowest[-1],
    )
    names = [f"{ratio:.4g}" for ratio in completion.ratio]
    reproduced = (
        f"{completion.middle[there]:.2f} s, {completion.middle[equal]:.2f} s at {names[equal]}; "
        f"effort {effort.middle[there]:.3g}, {effort.middle[-1]:.3g} at {names[-1]}"
    )
    cause = [] if sooner else [f"at ratio {names[there]} it completes no earlier than at {names[equal]}"]
    cause += [] if spared else [f"at ratio {names[there]} it takes no less effort than at {names[-1]}"]
    return Finding("sooner, at less effort", reproduced, "", NOTHING, EXACTLY, not cause, cause=tuple(cause))
