"""The weight study: the closed loop under many pairs of priorities. Paper section IV-B, Fig. 6."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from psmpc_cli.control.multistart import multistart_for
from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import ResultsWriter
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.cell import Cell, Outcome, lost_cell, run_cell
from psmpc_cli.studies.parallel import Calls
from psmpc_cli.studies.sweep_file import COMPUTED, FAILED, SHARED, WAITING, Sweep, create_sweep, resume_sweep

DEFAULT_TASK = "approach_capture"
"""The built-in task of Approach and Capture alone."""


SAME = 9
"""Decimals of the logarithm of a priority to which two are the same."""


@dataclass(frozen=True)
class SweepProgress:
    """What a watcher is told whenever runs have ended.

    Attributes:
        runs: Runs that are needed for the cells that waited.
        ended: Runs that have ended.
        failed: Cells that failed, shared ones among them.
        elapsed: Time since the sweep began [s].
    """

    runs: int
    ended: int
    failed: int
    elapsed: float


def load_sweep_task(reference: str, changes: tuple[str, ...], epsilons: tuple[float, ...]) -> Task:
    """Return the task of a sweep: no shares, which cost solves and are not kept, and the thresholds asked for.

    Where the pending cost allows of several basins and the task does not say from how many guesses a window is solved,
    it is solved from several.

    Raises:
        SpecError: The task does not hold.
    """
    wanted = [f"onset.series={list(epsilons)}"] if epsilons else []
    given = [*changes, "log.shares=false", "log.ticks=false", *wanted]
    controller = load_task(reference, given).spec.controller
    return load_task(reference, [*given, f"controller.multistart={multistart_for(controller)}"])


def parse_stages(text: str, task: Task) -> tuple[int, int]:
    """Return the indices of two stages in a row from their numbers or names, such as 1,2.

    Raises:
        InputError: They are not two stages in a row of the task, or the controller knows no priorities.
    """
    names = [stage.name for stage in task.spec.stages]
    if task.spec.controller.kind != "psmpc":
        raise InputError(
            f"found controller.kind {task.spec.controller.kind}, which knows no priorities; expected psmpc"
        )
    given = [part.strip() for part in text.split(",")]
    found = [names.index(part) if part in names else int(part) - 1 if part.isdigit() else -1 for part in given]
    if len(found) != 2 or not 0 <= found[0] < len(names) or found[1] != found[0] + 1 or found[1] >= len(names):
        listed = ", ".join(f"{i + 1} {name}" for i, name in enumerate(names))
        raise InputError(f"--stages: found '{text}', expected two in a row such as 1,2 of the task's stages: {listed}")
    return found[0], found[1]


def run_sweep(
    sweep: Sweep,
    path: Path,
    calls: Calls,
    force: bool = False,
    resume: bool = False,
    watch: Callable[[SweepProgress], None] = lambda progress: None,
) -> None:
    """Run all cells of a sweep that wait in its file, which is made first unless the sweep goes on.

    Args:
        sweep: The sweep.
        path: Its file.
        calls: Makes calls in parallel.
        force: Overwrite the file.
        resume: Go on with the file; cells that failed are tried again.
        watch: Told how far the sweep has come.

    Raises:
        InputError: The file exists already, cannot be written, or holds another sweep.
        RunError: It cannot be written any further, or the processes are ended from outside again and again.
    """
    status, spent = np.full(len(sweep.sampling.omega), WAITING), 0.0
    if resume:
        before = resume_sweep(path, sweep)
        status, spent = before["status"].ravel(), float(before["wall_time"])
    else:
        create_sweep(path, sweep, force)
    began, sharing = time.monotonic(), origins(sweep)
    wait = np.flatnonzero((status == WAITING) | (status == FAILED))
    needed = np.unique(sharing[wait])
    progress = SweepProgress(len(needed), 0, 0, 0.0)
    watch(progress)
    with ResultsWriter(path) as writer:
        for origin, outcome in _outcomes(sweep, needed, calls):
            alike = np.flatnonzero(sharing == origin)
            for cell in map(int, alike):
                writer.write(sweep.sampling.index(cell), _cell_values(outcome, cell, origin))
            elapsed = time.monotonic() - began
            writer.write((), {"wall_time": spent + elapsed})
            failed = progress.failed + len(alike) * bool(outcome.failure)
            progress = SweepProgress(len(needed), progress.ended + 1, failed, elapsed)
            watch(progress)


def origins(sweep: Sweep) -> np.ndarray:
    """Return for each cell the one whose run it shares (cells,), itself if none.

    Scaling all omega leaves the optimum unchanged, so what counts are the priorities over the largest one.
    """
    cells = len(sweep.sampling.omega)
    if sweep.every_cell:
        return np.arange(cells)
    priorities = np.tile([stage.priority for stage in sweep.task.spec.stages], (cells, 1))
    priorities[:, list(sweep.stages)] = sweep.sampling.omega
    relative = np.round(np.log10(priorities / priorities.max(axis=1, keepdims=True)), SAME)
    _, first, inverse = np.unique(relative, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()])


def _outcomes(sweep: Sweep, needed: np.ndarray, calls: Calls) -> Iterator[tuple[int, Outcome]]:
    """Run the cells that are needed and give each with its outcome, as they end."""
    if not len(needed):
        return
    cells = [Cell(_with_priorities(sweep, int(origin)), sweep.stages[1]) for origin in needed]
    for number, outcome in calls.each(run_cell, cells, lost_cell):
        yield int(needed[number]), outcome


def _with_priorities(sweep: Sweep, cell: int) -> Task:
    """Return the task with the priorities of a cell."""
    spec = sweep.task.spec
    stages = list(spec.stages)
    for stage, omega in zip(sweep.stages, sweep.sampling.omega[cell], strict=True):
        stages[stage] = stages[stage].model_copy(update={"priority": float(omega)})
    return replace(sweep.task, spec=spec.model_copy(update={"stages": tuple(stages)}))


def _cell_values(outcome: Outcome, cell: int, origin: int) -> dict[str, np.ndarray | float | str]:
    """Return what a cell's run left behind, the status last: a cell that does not wait is complete."""
    status = FAILED if outcome.failure else COMPUTED if cell == origin else SHARED
    return {
        **outcome.values,
        "cell_time": outcome.wall_time,
        "reason": outcome.failure,
        "origin": origin,
        "status": status,
    }
