"""A bench as plain data, and as a JSON file."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.studies.bench import Bench
from psmpc_cli.studies.bench_freedom import Freedom, grow_with_freedom
from psmpc_cli.studies.bench_machine import describe_machine
from psmpc_cli.studies.bench_problems import POLISHED
from psmpc_cli.studies.bench_solves import Solved
from psmpc_cli.studies.bench_statistics import spread
from psmpc_cli.studies.bench_summary import Gaps, finest, gaps, grow, summarize_bench

FORMAT = 1
"""Version of the document."""

DIGITS = 9
"""Digits of the numbers in it."""

Data = dict[str, object]


def document(bench: Bench, freedom: Sequence[Freedom] = ()) -> Data:
    """Return everything a bench found as plain data; what is not a number becomes None."""
    rows = summarize_bench(bench)
    found: Data = {
        "format": FORMAT,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "task": {"name": bench.loaded.spec.name, "digest": bench.loaded.digest},
        "choices": asdict(bench.choices),
        "optimum_tolerance": POLISHED,
        "compiled": bench.compiled,
        "machine": describe_machine(),
        "wall_over_busy": _wall_over_busy(bench),
        "windows": [_window(bench, index) for index in range(len(bench.windows))],
        "problems": [_problem(bench, *key) for key in bench.posed],
        "solves": [_solve(bench, solved) for solved in bench.solved],
        "summary": [asdict(row) for row in rows],
        "growth_with_nodes": [asdict(growth) for growth in grow(rows)],
        "growth_with_freedom": [asdict(growth) for growth in grow_with_freedom(freedom)],
        "robots": [{"arms": one.arms, "joints": one.joints, "freedom": one.n} for one in freedom],
    }
    plain = _plain(found)
    assert isinstance(plain, dict)
    return plain


def _wall_over_busy(bench: Bench) -> float:
    """Return the wall time of all solves over their processor time: 1 on a machine that does nothing else."""
    return sum(float(one.times.sum()) for one in bench.solved) / sum(one.busy for one in bench.solved)


def _window(bench: Bench, index: int) -> Data:
    recorded = bench.windows[index]
    return {
        "window": index,
        "controller": recorded.controller,
        "phase": recorded.phase,
        "time": recorded.window.start,
        "stages": [stage.name for stage in recorded.window.stages],
        "guessed_instants": recorded.instants,
    }


def _problem(bench: Bench, index: int, nodes: str) -> Data:
    posed = bench.posed[index, nodes]
    found: Data = {"window": index, "nodes": nodes, "counts": posed.counts, "variables": posed.variables}
    optimum = posed.optimum
    if optimum is None:
        return found | {"objective": None, "instants": None, "cost_over_time": None, "apart": None}
    return found | {
        "objective": optimum.objective,
        "instants": optimum.instants,
        "cost_over_time": optimum.over_time,
        "apart": optimum.apart,
    }


def _solve(bench: Bench, solved: Solved) -> Data:
    own, best = gaps(solved, bench.posed[solved.index, solved.nodes]), finest(bench)
    to_finest = Gaps(np.nan, np.nan, np.nan) if best is None else gaps(solved, bench.posed[solved.index, best])
    return {
        "window": solved.index,
        "nodes": solved.nodes,
        "stages": solved.stages,
        **asdict(solved.way),
        "outcome": solved.outcome.name.lower(),
        "iterations": solved.iterations,
        "objective_gap": own.objective,
        "instant_gap": own.instants,
        "cost_over_time_to_finest": to_finest.over_time,
        "instant_gap_to_finest": to_finest.instants,
        "violation": solved.violation,
        "busy": solved.busy / len(solved.times),
        "time": asdict(spread(solved.times)),
    }


def _plain(value: object) -> object:
    """Return data with arrays as lists, numbers to so many digits, and without what JSON has no word for."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def refuse_document(path: Path, force: bool) -> None:
    """Refuse to write a document where something else stands.

    Raises:
        InputError: The path is a directory, or taken and not to be overwritten.
    """
    if path.is_dir():
        raise InputError(f"--json {path} is a directory: name a file in it, such as {path / 'bench.json'}")
    if path.exists() and not force:
        raise InputError(f"--json {path} exists already: choose another file, or overwrite it with --force")


def write_document(path: Path, found: Data, force: bool = False) -> None:
    """Write a bench as JSON.

    Raises:
        InputError: The file exists already or cannot be written.
    """
    refuse_document(path, force)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_text(found), encoding="utf-8")
    except OSError as error:
        raise InputError(f"--json {path} cannot be written: {error.strerror or error}") from None


def _text(found: Data) -> str:
    """Return JSON with one entry of a list a line."""
    parts = []
    for key, value in found.items():
        text = json.dumps(value, allow_nan=False)
        if isinstance(value, list) and value:
            text = "[\n" + ",\n".join(f"  {json.dumps(entry, allow_nan=False)}" for entry in value) + "\n ]"
        parts.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"
