"""Rerun: a run repeated from its log, and how far the two differ."""

import os
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import LogError
from psmpc_cli.logs.differences import Comparison, compare_logs
from psmpc_cli.logs.read import Log
from psmpc_cli.simulation.run import Progress, run
from psmpc_cli.simulation.summary import task_of


def rerun(
    log: Log, path: Path, force: bool = False, watch: Callable[[Progress], None] = lambda progress: None
) -> Comparison | None:
    """Repeat a run, up to where its log ends, and compare every dataset but the wall times; None if interrupted.

    Raises:
        LogError: The log holds no samples, or does not describe a run of this version.
        InputError: The new log exists already or cannot be written.
        RunError: It could not be written any further.
    """
    ended, samples, reached = bool(np.isfinite(log.final["time"])), len(log.time), 0
    if not samples:
        raise LogError(f"{log.path}: holds no samples, so there is nothing to compare a run with")
    reason = str(log.attributes["end_reason"]) or "as far as the log goes"

    def watch_samples(progress: Progress) -> None:
        nonlocal reached
        reached += 1
        watch(progress)
        if not ended and reached == samples:
            raise KeyboardInterrupt(reason)

    ending = run(task_of(log), path, force, watch_samples)
    if ending is None and (ended or reached < samples):
        return None
    if ended:
        return compare_logs(log.path, path)
    # a killed run has judged no monitor, and may have noted no hand-over of its last sample
    return compare_logs(log.path, path, samples, () if log.attributes["end_reason"] else ("stages/", "monitors/"))


def unequal_conditions(log: Log) -> tuple[str, ...]:
    """Return what makes it pointless to expect equal numbers: other versions, several threads, a deadline."""
    here = {
        "psmpc_version": __version__,
        "casadi_version": version("casadi"),
        "numpy_version": np.__version__,
    }
    found = [
        f"{name.removesuffix('_version')} {log.attributes.get(name, 'unknown')} wrote the log, this is {running}"
        for name, running in here.items()
        if str(log.attributes.get(name)) != running
    ]
    if os.environ.get("OMP_NUM_THREADS") != "1" and (os.cpu_count() or 1) > 1:
        found.append("OMP_NUM_THREADS is not 1: sums over several threads may be rounded otherwise")
    if (deadline := task_of(log).spec.solver.deadline) is not None:
        found.append(f"solves have a deadline of {deadline:g} s: how far they come depends on the machine")
    return tuple(found)
