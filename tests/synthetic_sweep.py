"""Sweeps as if they had been run: the same file, made-up numbers."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from psmpc_cli.logs.results import Results, read_results
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.runner import COMPUTED, FAILED, REFERENCE, WAITING
from psmpc_cli.studies.sampling import Sampling, parse_sampling
from psmpc_cli.studies.sweep import load_sweep_task, weight_study

T_S, T_H = 10.14, 4.0

EPSILONS = (1e-3, 1e-1)

Numbers = Mapping[str, float | list[float]]


def numbers(ratio: float) -> Numbers:
    """What a run comes to: the larger the ratio, the earlier everything, at more effort from 100 on."""
    decades = float(np.log10(ratio))
    starts = [float(np.clip(round(8.2 - 0.8 * (decades + shift), 1), 6.2, T_S)) for shift in (1.0, 0.0)]
    completion = round(14.0 + 2.0 / (1.0 + ratio), 1)
    return {
        "switch_time": [T_S, completion],
        "actual_start": starts,
        "completion_time": completion,
        "completed": 1.0,
        "succeeded": 1.0,
        "end_error": [0.8],
        "final_error": 0.9,
        "control_effort": 1.0 + ratio / 100,
        "peak_base_force": 50.0,
        "solves": 100.0,
        "solves_failed": 0.0,
    }


def sampling_of(text: str) -> Sampling:
    """A grid, ratios, or random draws, between 1e-3 and 1e3."""
    return parse_sampling(text, (1e-3, 1e3))


@cache
def sweep_task(name: str, epsilons: tuple[float, ...]) -> Task:
    """Load a built-in task for sweeps once for all tests; tasks are not changed."""
    return load_sweep_task(name, (), epsilons)


def synthetic_sweep(
    path: Path,
    sampling: str = "7x7",
    waiting: tuple[int, ...] = (),
    failed: tuple[int, ...] = (),
    of: Callable[[float], Numbers] = numbers,
    epsilons: tuple[float, ...] = EPSILONS,
    task: str = "approach_capture",
    own: Numbers | None = None,
    own_status: int = COMPUTED,
) -> Results:
    """A sweep over the first two stages in which these cells wait and those failed.

    What the task's own priorities come to is what their ratio does, but for these numbers.
    """
    loaded = sweep_task(task, epsilons)
    cells = sampling_of(sampling)
    study = weight_study(loaded, (0, 1), cells)
    results, origins = study.results(path), study.first_equal_runs
    assert origins is not None

    def fill(run: int, prefix: str, place: tuple[int, ...], numbers: Numbers, status: int) -> None:
        """Put a run's numbers in the place it has in its arrays; stages after the second end at intervals of 10 s."""
        values: dict[str, object] = {"reason": "time limit of 30 s reached", "succeeded": 0, "completed": 0}
        if status != FAILED:
            later = len(loaded.spec.stages) - 2
            switches = np.append(numbers["switch_time"], numbers["completion_time"] + 10.0 * np.arange(1, later + 1))
            errors = np.append(numbers["end_error"], np.full(later + 1, np.nan))
            values = {**numbers, "switch_time": switches, "end_error": errors}
        for name, value in {**values, "origin": origins[run], "status": status}.items():
            results[prefix + name][place] = value

    for cell, ratio in enumerate(cells.ratio):
        place = tuple(int(index) for index in np.unravel_index(cell, results["status"].shape))
        if cell not in waiting:
            fill(cell, "", place, of(float(ratio)), FAILED if cell in failed else COMPUTED)
    if own_status != WAITING:
        approach, capture = loaded.spec.stages[:2]
        fill(-1, REFERENCE, (), {**of(capture.priority / approach.priority), **(own or {})}, own_status)
    results.create(force=True)
    return read_results(path, SWEEP)
