"""A reproduction from made-up runs: no solver, all figures."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.studies.judge import Reproduction
from psmpc_cli.studies.weights import sweep_cells

from ..figures.made_up import Story, write_story
from ..made_up_fronts import made_up_fronts
from ..made_up_sweep import made_up_sweep

CREATED = "2030-01-02T03:04:05+00:00"

HOSTILE = 'seed="<script>alert(1)</script>&amp;\'"'
"""A change that would break a page that does not escape it."""

STORIES: dict[str, dict[str, Any]] = {
    "htmpc": {"early": {}, "ends": (10.3, 17.9, 28.2, 34.6)},
    "smpc": {"early": {1: 7.9, 3: 22.6}, "ends": (10.1, 14.8, 24.8, 29.1)},
    "psmpc": {"early": {1: 6.2}, "ends": (10.1, 13.2, 23.2, 29.0)},
}


def made_up(path: Path, method: str) -> Run:
    """The log of a made-up run, in which every stage waits for two seconds and adds more and more."""
    attributes = {"controller": method, "digest": method * 8, "casadi_version": "3.8", "numpy_version": "2.0"}
    log = read_run(write_story(path, Story(**STORIES[method], attributes=attributes)))
    presence = np.full_like(log["window/presence"], np.nan)
    for stage, end in enumerate(STORIES[method]["ends"][:-1], start=1):
        waits = (log.time > end - 2.0) & (log.time < end) & (method != "htmpc")
        presence[waits, stage] = 10.0 ** (log.time[waits] - end)
    return replace(log, arrays={**log.arrays, "window/presence": presence})


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory: pytest.TempPathFactory) -> Reproduction:
    folder = tmp_path_factory.mktemp("made_up")
    logs = {name: made_up(folder / f"{name}.h5", name) for name in STORIES}
    cells = sweep_cells(made_up_sweep(folder / "weights.h5", "5x5", failed=(3,)))
    return Reproduction(logs, cells, made_up_fronts(folder / "fronts.h5", failed=(1,)), (HOSTILE,))
