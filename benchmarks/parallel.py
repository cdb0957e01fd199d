"""Measures what a second process brings a sweep, beside a loop of pure arithmetic: prints a table of docs/sweeps.md.

    python benchmarks/parallel.py [KEY=VALUE ...]          keys of the task, such as solver=sqp

Both are timed in turn, with one process and with two, so that whatever else the machine does falls on all four alike.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pages import markdown

from psmpc_cli.studies.runner import compute, run_study
from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, parse_sampling, weight_study

CELLS, RANGE = "4x4", (1e-1, 1e2)
ITEMS, ADDITIONS = 16, 8_000_000
ROUNDS = 3


def add(additions: int) -> int:
    """Return a sum, for the work of it."""
    total = 0
    for number in range(additions):
        total += number & 7
    return total


def time_loop(jobs: int) -> float:
    """Return how long the loops take in so many processes [s]."""
    began = time.perf_counter()
    for _ in compute(add, [ADDITIONS] * ITEMS, jobs):
        pass
    return time.perf_counter() - began


def time_sweep(jobs: int, changes: tuple[str, ...]) -> float:
    """Return how long a sweep of runs that share nothing takes in so many processes [s]."""
    study = weight_study(load_sweep_task(DEFAULT_TASK, changes), (0, 1), parse_sampling(CELLS, RANGE), every_cell=True)
    with tempfile.TemporaryDirectory() as directory:
        began = time.perf_counter()
        run_study(study, Path(directory) / "sweep.h5", jobs)
        return time.perf_counter() - began


def main(changes: tuple[str, ...]) -> None:
    """Measure and print."""
    timed: dict[str, Callable[[int], float]] = {
        "a loop of arithmetic": time_loop,
        "16 runs of a sweep that share nothing": lambda jobs: time_sweep(jobs, changes),
    }
    times: dict[tuple[str, int], list[float]] = {(name, jobs): [] for name in timed for jobs in (1, 2)}
    time_sweep(2, changes)  # whatever is compiled is compiled now
    for _ in range(ROUNDS):
        for name, jobs in times:
            times[name, jobs].append(timed[name](jobs))
    efficiency = {name: float(np.median(times[name, 1]) / np.median(times[name, 2]) / 2) for name in timed}
    rows = [
        (name, *(f"{np.median(times[name, jobs]):.1f}" for jobs in (1, 2)), f"{efficiency[name]:.2f}") for name in timed
    ]
    print("\n".join(markdown(("", "one process [s]", "two [s]", "efficiency of two"), rows)))


if __name__ == "__main__":
    main(tuple(sys.argv[1:]))
