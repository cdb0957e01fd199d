"""Sweeps as if they had been run: the same file, made-up numbers."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.studies.runner import COMPUTED, FAILED
from psmpc_cli.studies.sampling import Sampling, parse_sampling
from psmpc_cli.studies.sweep import load_sweep_task, weight_study

T_S, T_H = 10.14, 4.0

EPSILONS = (1e-3, 1e-1)

Numbers = Mapping[str, float | list[float]]


def numbers(ratio: float) -> Numbers:
    """What a cell comes to: the larger the ratio, the earlier everything, at more effort from 100 on."""
    decades = float(np.log10(ratio))
    starts = [float(np.clip(round(8.2 - 0.8 * (decades + shift), 1), 6.2, T_S)) for shift in (1.0, 0.0)]
    completion = round(14.0 + 2.0 / (1.0 + ratio), 1)
    return {
        "switch_time": [T_S, completion],
        "actual_start": starts,
        "completion_time": completion,
        "final_error": 0.9,
        "control_effort": 1.0 + ratio / 100,
        "solves": 100.0,
        "solves_failed": 0.0,
    }


def sampling_of(text: str) -> Sampling:
    """A grid, ratios, or random draws, between 1e-3 and 1e3."""
    return parse_sampling(text, (1e-3, 1e3))


def synthetic_sweep(
    path: Path,
    sampling: str = "7x7",
    waiting: tuple[int, ...] = (),
    failed: tuple[int, ...] = (),
    of: Callable[[float], Numbers] = numbers,
    epsilons: tuple[float, ...] = EPSILONS,
    task: str = "approach_capture",
) -> Results:
    """A sweep over the first two stages in which these cells wait and those failed."""
    loaded = load_sweep_task(task, (), epsilons)
    cells = sampling_of(sampling)
    study = weight_study(loaded, (0, 1), cells)
    results, origins = study.results(path), study.origins
    assert origins is not None
    for cell, ratio in enumerate(cells.ratio):
        values: dict[str, object] = {"reason": "time limit of 30 s reached", "origin": origins[cell], "status": FAILED}
        if cell not in failed:
            switches = np.full(len(loaded.spec.stages), np.nan)
            switches[:2] = of(float(ratio))["switch_time"]
            values = {**of(float(ratio)), "switch_time": switches, "origin": origins[cell], "status": COMPUTED}
        for name, value in values.items() if cell not in waiting else ():
            results[name][np.unravel_index(cell, results["status"].shape)] = value
    results.create(force=True)
    return read_results(path, SWEEP)
