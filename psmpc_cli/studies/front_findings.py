"""What the fronts of a Pareto study have to say on their movement, judged. The rules are in docs/reproduce.md."""

from functools import singledispatch

from psmpc_cli.logs.results import Results
from psmpc_cli.studies.findings import EXACTLY, NOTHING, Finding
from psmpc_cli.studies.front_claims import AlongClaim, FrontClaim, OnwardClaim
from psmpc_cli.studies.front_movement import FrontMovement, front_movement
from psmpc_cli.studies.fronts import CLEARLY


def judge_fronts(claim: FrontClaim, results: Results | None) -> Finding:
    """Return what becomes of a claim on the fronts; None stands for a run without a window to find them in."""
    if results is None:
        return _unknown(claim, "no window of the PSMPC run holds the first two stages alone and was solved")
    return _judge(claim, front_movement(results))


def _unknown(claim: FrontClaim, reason: str) -> Finding:
    return Finding(claim.direction, "unknown", "", NOTHING, EXACTLY, False, cause=(reason,))


@singledispatch
def _judge(claim: FrontClaim, movement: FrontMovement) -> Finding:
    raise TypeError(f"found a claim of kind {type(claim).__name__}, expected one with a rule in {__name__}")


@_judge.register
def _judge_along(claim: AlongClaim, movement: FrontMovement) -> Finding:
    """At every sample the optimum moves to the upper left, and never back by more than the last digits."""
    count = len(movement.instants)
    cause = [
        f"at {instant:g} s it moves against it by {step:.2g} of the front"
        for instant, step in zip(movement.instants, movement.against, strict=True)
        if step > CLEARLY
    ]
    cause += [
        f"at {instant:g} s it does not move, or could not be found"
        for instant, moves in zip(movement.instants, movement.moves, strict=True)
        if not moves
    ]
    reproduced = f"{claim.direction} at {movement.moving} of {count}"
    return Finding(claim.direction, reproduced, "", NOTHING, EXACTLY, movement.with_ratio, cause=tuple(cause))


@_judge.register
def _judge_onward(claim: OnwardClaim, movement: FrontMovement) -> Finding:
    """In costs normalized by (12) the front moves to the upper left, on average, from every sample to the next."""
    if len(movement.instants) < 2:
        return _unknown(claim, "there is one sample alone, and nothing to compare its front with")
    holds = movement.with_time()
    cause = () if holds else movement.said_of_time
    return Finding(claim.direction, movement.directions(), "", NOTHING, EXACTLY, holds, cause=cause)
