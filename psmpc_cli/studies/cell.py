"""One cell of a sweep: a closed loop under its own priorities, up to the end of the studied stage."""

import logging
import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from functools import partial

import numpy as np

from psmpc_cli.logs.record import Record
from psmpc_cli.simulation.checkpoint import Checkpoint
from psmpc_cli.simulation.loop import simulate
from psmpc_cli.simulation.setup import Experiment, build_experiment
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.tally import Tally, Values

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Prefix:
    """What all cells have in common: the closed loop up to the sample at which priorities begin to matter.

    Attributes:
        checkpoint: Where it stands there.
        tally: What it has come to so far.
    """

    checkpoint: Checkpoint
    tally: Tally


@dataclass(frozen=True, eq=False)
class Cell:
    """What a cell's run needs.

    Attributes:
        task: The task with the cell's priorities.
        studied: Index of the stage after the studied switch.
        prefix: Where to go on from; None from the beginning.
    """

    task: Task
    studied: int
    prefix: Prefix | None


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
    prefix = cell.prefix
    tally = _new_tally(experiment, cell.studied) if prefix is None else deepcopy(prefix.tally)
    samples = simulate(experiment, None if prefix is None else prefix.checkpoint)
    try:
        while not tally.over:
            tally.take(next(samples))
    except StopIteration as stop:
        tally.end(stop.value)
    return tally.values(experiment), tally.failure


def run_prefix(task: Task, studied: int) -> Prefix | None:
    """Run what does not depend on the priorities of the stage before `studied` and of itself; None if nothing does.

    In a window over one stage J is over that stage's own priority, and a window without either of the two does not know
    them.
    """
    experiment = build_experiment(task)
    checkpoints: list[Checkpoint] = []
    tally = _new_tally(experiment, studied)
    for record in simulate(experiment, mark=checkpoints.append):
        if _matters(record, studied):
            return Prefix(checkpoints[-1], tally) if checkpoints[-1].sample else None
        tally.take(record)
    return None


def _matters(record: Record, studied: int) -> bool:
    """Return whether the priorities of the two studied stages may have changed the sample."""
    last = record.window_first + len(record.instants) + ("postponed" in record.flags)
    return last > record.window_first and last >= studied - 1


def _new_tally(experiment: Experiment, studied: int) -> Tally:
    onset = experiment.task.onset
    return Tally(len(experiment.stages), studied, onset.epsilon, onset.series, experiment.model.n)
