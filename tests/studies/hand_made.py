"""Hand-made evidence: what a run would have to say, without any run."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, cast

import numpy as np

from psmpc_cli.logs.summary import StageSummary, Summary, Verdict
from psmpc_cli.studies.claims import Evidence, Onset, RunEvidence, load_claims
from psmpc_cli.studies.weights import SweepCells

STAGES = ("approach", "capture", "transport", "release")

HELD = Verdict("object held", True, 0.05, float("nan"))


def lost(at: float) -> Verdict:
    return Verdict("object held", False, -0.5, at)


def run(
    ends: Sequence[float] = (10.0, 14.0, 24.0, 30.0),
    early: Mapping[str, float] | None = None,
    monitors: Sequence[Verdict] = (HELD,),
    onsets: Mapping[str, Onset] | None = None,
    earliest_ends: Mapping[str, float] | None = None,
    errors: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    nodes: float = 100,
) -> RunEvidence:
    """A run whose stages end at these times, NaN if never; `early` are the actual starts before their time."""
    return RunEvidence(
        summary=summary(ends, early or {}, monitors),
        horizon=4.0,
        nodes=nodes,
        sample_time=0.1,
        epsilon=0.1,
        onsets=onsets or {},
        errors=errors or {},
        earliest_ends=earliest_ends or {},
    )


def evidence(**runs: RunEvidence) -> Evidence:
    """Evidence for the claims on runs, which look at no sweep and no fronts."""
    return Evidence(load_claims(), runs, cast(SweepCells, None), None)


def summary(ends: Sequence[float], early: Mapping[str, float], monitors: Sequence[Verdict]) -> Summary:
    completed = bool(np.isfinite(ends[-1]))
    given: dict[str, Any] = {
        "ended": True,
        "completed": completed,
        "succeeded": completed and all(verdict.held for verdict in monitors),
        "reason": "release met its end condition" if completed else "time limit of 60 s reached",
        "duration": float(np.nan_to_num(ends).max()),
        "stages": tuple(
            stage(name, start, end, early) for name, start, end in zip(STAGES, (0.0, *ends[:-1]), ends, strict=True)
        ),
        "monitors": tuple(monitors),
    }
    return Summary(**{field.name: given.get(field.name) for field in fields(Summary)})


def stage(name: str, start: float, end: float, early: Mapping[str, float]) -> StageSummary:
    given: dict[str, Any] = {
        "name": name,
        "actual_start": early.get(name, start),
        "early": name in early,
        "switch_time": end,
    }
    return StageSummary(**{field.name: given.get(field.name) for field in fields(StageSummary)})


def onset(presence: Mapping[float, float], starts: Mapping[float, float] | None = None, postponed: int = 0) -> Onset:
    """What a waiting stage adds at each sample."""
    return Onset(np.array(list(presence)), np.array(list(presence.values())), starts or {}, postponed)
