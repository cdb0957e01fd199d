"""The Monte Carlo study: a task in closed loop many times, each with other random numbers for its uncertainty."""

import shlex
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import ResultsWriter
from psmpc_cli.simulation.monte_carlo_runs import CRASHED, ENDED
from psmpc_cli.specs.load import load_task
from psmpc_cli.studies.cell import Outcome, lost_cell
from psmpc_cli.studies.monte_carlo_file import MonteCarlo, create_monte_carlo, resume_monte_carlo, todo
from psmpc_cli.studies.monte_carlo_run import Run, run_once
from psmpc_cli.studies.parallel import Calls
from psmpc_cli.studies.sweep import SweepProgress

LIGHT = ("log.shares=false", "log.plans=false", "log.ticks=false")
"""What is logged of no run, and would cost solves."""

LARGEST_SEED = 2**63 - 1
"""Larger ones do not fit the file."""


def load_monte_carlo(reference: str, changes: tuple[str, ...], runs: int) -> MonteCarlo:
    """Return the study of a task.

    Raises:
        SpecError: The task does not hold.
        InputError: Nothing of it is random, or its seed leaves no room for others.
    """
    loaded = load_task(reference, [*changes, *LIGHT])
    if not loaded.spec.uncertainty.is_random:
        raise InputError(
            f"{reference}: found nothing random below uncertainty, all runs would be alike; expected a range of mass, "
            "inertia or centre_of_mass, or noise, such as --set uncertainty.mass=0.1"
        )
    if loaded.spec.seed > LARGEST_SEED - runs:
        raise InputError(f"{reference}: found seed {loaded.spec.seed}, expected at most {LARGEST_SEED - runs}")
    settings = [word for change in changes for word in ("--set", change)]
    return MonteCarlo(loaded, runs, shlex.join(["psmpc", "simulate", reference, *settings]))


def run_monte_carlo(
    study: MonteCarlo,
    path: Path,
    calls: Calls,
    force: bool = False,
    resume: bool = False,
    watch: Callable[[SweepProgress], None] = lambda progress: None,
) -> None:
    """Make all runs of a study that wait in its file, which is made first unless the study goes on.

    Args:
        study: The study.
        path: Its file.
        calls: Makes calls in parallel.
        force: Overwrite the file.
        resume: Go on with the file; runs that crashed are tried again.
        watch: Told how far the study has come.

    Raises:
        InputError: The file exists already, cannot be written, or holds another study.
        RunError: It cannot be written any further, or the processes are ended from outside again and again.
    """
    wait, spent = np.arange(study.runs), 0.0
    if resume:
        before = resume_monte_carlo(path, study)
        wait, spent = todo(before), float(before["wall_time"])
    else:
        create_monte_carlo(path, study, force)
    began, failed = time.monotonic(), 0
    watch(SweepProgress(len(wait), 0, 0, 0.0))
    with ResultsWriter(path) as writer:
        runs = [Run(study.task, int(study.seeds[number])) for number in wait]
        for ended, (index, outcome) in enumerate(calls.each(run_once, runs, lost_cell), start=1):
            values = _run_values(outcome)
            writer.write((int(wait[index]),), values)
            elapsed = time.monotonic() - began
            writer.write((), {"wall_time": spent + elapsed})
            failed += not values["succeeded"]
            watch(SweepProgress(len(wait), ended, failed, elapsed))


def _run_values(outcome: Outcome) -> Mapping[str, np.ndarray | float | str]:
    """Return what a run left behind, the status last: a run that does not wait is complete."""
    crashed = bool(outcome.failure)
    found = {"completed": 0, "succeeded": 0} if crashed else outcome.values
    status = CRASHED if crashed else ENDED
    return {**found, "failure": outcome.failure, "run_time": outcome.wall_time, "status": status}
