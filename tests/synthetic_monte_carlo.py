"""Monte Carlo studies as if they had been run: the same file, made-up numbers."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.schema import MONTE_CARLO
from psmpc_cli.studies.monte_carlo import MonteCarloRuns, monte_carlo_study
from psmpc_cli.studies.runner import COMPUTED, FAILED

NOISE = ("uncertainty.noise={position: 1e-3}", "seed=10")


def synthetic_monte_carlo(
    path: Path,
    runs: int = 12,
    waiting: tuple[int, ...] = (),
    crashed: Collection[int] = (),
    late: tuple[int, ...] = (),
    dropped: tuple[int, ...] = (),
    task: str = "transport",
) -> MonteCarloRuns:
    """A study in which these runs wait, crashed, came to the time limit, or dropped the object."""
    study = monte_carlo_study(task, runs, NOISE)
    stages, monitors = len(study.task.spec.stages), len(study.task.spec.monitors)
    results = study.results(path)
    for run in sorted({*range(runs)} - {*waiting}):
        ends = 7.0 * np.arange(1, stages + 1) + 0.01 * run
        margin = np.full(monitors, -0.01 if run in dropped else 0.04)
        values: dict[str, object] = {
            "completed": run not in late,
            "succeeded": run not in (*late, *dropped),
            "reason": "time limit of 60 s reached" if run in late else "release met its end condition",
            "end_time": 60.0 if run in late else ends[-1],
            "switch_time": np.where(np.arange(stages) == stages - 1, np.nan, ends) if run in late else ends,
            "actual_start": ends - 7.0,
            "final_error": 300.0 if run in late else 0.8 + 0.02 * run,
            "relative_position_margin": 0.5,
            "relative_velocity_margin": -0.01 * run,
            **({"monitor_margin": margin} if monitors else {}),
            "control_effort": 50.0 + run,
            "status": COMPUTED,
        }
        if run in crashed:
            values = {"reason": "ZeroDivisionError: by zero", "status": FAILED}
        for name, value in values.items():
            results[name][run] = value
    results.create(force=True)
    return MonteCarloRuns(read_results(path, MONTE_CARLO))
