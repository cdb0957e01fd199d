"""One cell of a sweep: a closed loop under its own priorities, up to the end of the studied stage."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import build_experiment
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.tally import Tally, Values

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Cell:
    """What a cell's run needs.

    Attributes:
        task: The task with the cell's priorities.
        studied: Index of the stage after the studied switch.
    """

    task: Task
    studied: int


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a cell.

    Attributes:
        values: Its numbers, by the names of `CELL_QUANTITIES`.
        failure: Why it failed; empty if it did not.
        wall_time: Of the whole call [s].
    """

    values: Values
    failure: str
    wall_time: float


def run_cell(cell: Cell) -> Outcome:
    """Run a cell; whatever goes wrong in it is its outcome."""
    return outcome_of(partial(_run, cell))


def outcome_of(run: Callable[[], tuple[Values, str]]) -> Outcome:
    """Make a run, which returns its numbers and why it failed; whatever goes wrong in it is its outcome."""
    began = time.perf_counter()
    try:
        values, failure = run()
    except Exception as error:  # one run never ends a study
        logger.exception("a run failed")
        values, failure = {}, f"{type(error).__name__}: {error}"
    return Outcome(values, failure, time.perf_counter() - began)


def lost_cell(cell: object) -> Outcome:
    """Return the outcome of a cell that ends the process it runs in."""
    return Outcome({}, "its process was ended from outside every time, for want of memory perhaps", np.nan)


def _run(cell: Cell) -> tuple[Values, str]:
    """Return the numbers of a cell's closed loop, and why it did not come to its end, empty if it did."""
    experiment = build_experiment(cell.task)
    onset = experiment.task.onset
    tally = Tally(len(experiment.stages), cell.studied, onset.epsilon, onset.series, experiment.model.n)
    samples = closed_loop(experiment)
    try:
        while not tally.over:
            tally.take(next(samples))
    except StopIteration as stop:
        tally.end(stop.value)
    return tally.values(experiment), tally.failure
