"""The judged claims as plain data and as words: what `psmpc reproduce` prints, writes and reports."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

from psmpc_cli import __version__
from psmpc_cli.logs.results import Results
from psmpc_cli.simulation.recommendation import recommend
from psmpc_cli.simulation.sweep_cells import SweepCells
from psmpc_cli.studies.ablation import Ablation
from psmpc_cli.studies.findings import Finding, Value
from psmpc_cli.studies.front_table import front_rows
from psmpc_cli.studies.reproduce import TASK, JudgedClaim, Reproduction

FORMAT = 1
"""Version of `as_data`; grows when a key changes its meaning or goes."""

HEADINGS = ("claim", "published", "reproduced", "difference", "tolerance", "holds")


def as_data(reproduction: Reproduction, created: str) -> dict[str, Any]:
    """Return the claim table as JSON takes it; what is not known, or has no sense, is null. Keys: docs/reproduce.md."""
    return {
        "format": FORMAT,
        "psmpc_version": __version__,
        "created": created,
        "task": TASK,
        "changes": list(reproduction.changes),
        "digests": {name: str(log.attributes["digest"]) for name, log in reproduction.logs.items()},
        "weights": _weights_data(reproduction.weights),
        "fronts": _fronts_data(reproduction.fronts),
        "claims": [_claim_data(judged) for judged in reproduction.judged],
        "ablations": [_ablation_data(ablation) for ablation in reproduction.ablations],
        "held": len(reproduction.judged) - len(reproduction.failing),
        "failed": len(reproduction.failing),
    }


def cells(judged: JudgedClaim) -> Mapping[str, str]:
    """Return a claim's row as text, by heading."""
    finding = judged.finding
    texts = (
        judged.claim.id,
        shown(finding.published, finding.unit),
        shown(finding.reproduced, finding.unit),
        _signed(finding),
        _tolerance(finding),
        verdict(finding),
    )
    return dict(zip(HEADINGS, texts, strict=True))


def verdict(finding: Finding) -> str:
    """Return in words whether a claim holds."""
    if finding.earlier:
        return "yes, earlier"
    return "yes" if finding.holds else "no"


def shown(value: Value, unit: str) -> str:
    """Return a published or reproduced value as text; times in a row with the relation they stand in."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{_number(value, unit)} {unit}".rstrip() if math.isfinite(value) else "never"
    texts = [entry for entry in value if isinstance(entry, str)]
    times = [entry for entry in value if isinstance(entry, float)]
    return _related(times, unit) if times else ", ".join(texts) or "none"


def _related(times: Sequence[float], unit: str) -> str:
    """Return times with the relation each stands in to the one before it."""
    relations = ("<" if one < other else ">=" for one, other in pairwise(times))
    rest = (f" {relation} {shown(time, unit)}" for relation, time in zip(relations, times[1:], strict=True))
    return shown(times[0], unit) + "".join(rest)


def _number(value: float, unit: str) -> str:
    """Return a time with one or two digits, another number with as many as it has."""
    return f"{value:.2f}".removesuffix("0") if unit else f"{value:g}"


def _signed(finding: Finding) -> str:
    if not math.isfinite(finding.difference):
        return "-"
    return f"{finding.difference:+.2f} {finding.unit}" if finding.unit else f"{finding.difference:+g}"


def _tolerance(finding: Finding) -> str:
    return f"{finding.tolerance:.2f} {finding.unit}" if finding.tolerance > 0 else "exact"


def _claim_data(judged: JudgedClaim) -> dict[str, Any]:
    claim, finding = judged.claim, judged.finding
    return {
        "id": claim.id,
        "statement": claim.statement,
        "source": claim.source,
        "unit": finding.unit or None,
        "published": _plain(finding.published),
        "reproduced": _plain(finding.reproduced),
        "difference": _plain(finding.difference),
        "tolerance": _plain(finding.tolerance),
        "holds": finding.holds,
        "earlier": finding.earlier,
        "cause": "; ".join(finding.cause) or None,
    }


def _weights_data(cells: SweepCells | None) -> dict[str, Any] | None:
    if cells is None:
        return None
    best = recommend(cells)
    return {
        "task": cells.task.spec.name,
        "digest": str(cells.results.attributes["digest"]),
        "sampling": str(cells.results.attributes["sampling"]),
        "failed_cells": int(cells.failed.sum()),
        "failed_solves": cells.count("fallbacks"),
        "recommended": None if best is None else best.ratio,
    }


def _fronts_data(results: Results | None) -> dict[str, Any] | None:
    if results is None:
        return None
    samples = [{key: _plain(value) for key, value in asdict(row).items()} for row in front_rows(results)]
    return {"stages": results["stage"].tolist(), "method": str(results.attributes["method"]), "samples": samples}


def _ablation_data(ablation: Ablation) -> dict[str, Any]:
    numbers = {name: _plain(float(value)) for name, value in ablation.numbers.items()}
    return {"name": ablation.name, "sentence": ablation.sentence, "numbers": numbers}


def _plain(value: Value) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
