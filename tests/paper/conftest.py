"""A reproduction from hand-made runs: no solver, all figures."""

from typing import Any

import pytest

from psmpc_cli.paper.judge import Reproduction
from psmpc_cli.studies.sweep import SweepCells

from ..figures.conftest import load, one_arm, run, runs, styled, write_log
from ..synthetic_fronts import synthetic_fronts
from ..synthetic_sweep import synthetic_sweep
from .synthetic_runs import STAGES, TIMES, grasped, hand_made

__all__ = ["load", "one_arm", "run", "runs", "styled", "write_log"]  # fixtures of the figures of runs

CREATED = "2030-01-02T03:04:05+00:00"

HOSTILE = 'seed="<script>alert(1)</script>&amp;\'"'
"""A change that would break a page that does not escape it."""

RUNS: dict[str, dict[str, Any]] = {
    "htmpc": {"ends": (10.3, 17.9, 28.2, 34.6)},
    "smpc": {"early": {"capture": 7.9, "release": 22.6}, "ends": (10.1, 14.8, 24.8, 29.1)},
    "psmpc": {"early": {"capture": 6.2}, "ends": (10.1, 13.2, 23.2, 29.0)},
}


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory: pytest.TempPathFactory) -> Reproduction:
    """Every stage of SMPC and PSMPC waits for two seconds and adds more and more."""
    folder = tmp_path_factory.mktemp("made_up")
    runs = {}
    for method, given in RUNS.items():
        before = dict(zip(STAGES[1:], given["ends"], strict=False)) if method != "htmpc" else {}
        waits = {stage: TIMES[(end - 2.0 < TIMES) & (end > TIMES)] for stage, end in before.items()}
        presence = {stage: {t: 10.0 ** (t - before[stage]) for t in times} for stage, times in waits.items()}
        runs[method] = hand_made(**given, presence=presence, method=method)
    cells = SweepCells(synthetic_sweep(folder / "weights.h5", "5x5", failed=(3,)))
    grasps = {"smpc": grasped(0.08), "psmpc": grasped()}
    return Reproduction(runs, cells, synthetic_fronts(folder / "fronts.h5", failed=(1,)), (HOSTILE,), grasps=grasps)
