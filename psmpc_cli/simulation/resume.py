"""Goes on with a run that was killed or interrupted: the closed loop is put back where its log ends.

The last complete sample is done again. What the loop remembers before it is in the log or follows from it: the plan and
the instants stand there; multipliers come out of the last solve when it is done again from its logged guess; solves
that failed fail again; the windows solved aside are solved again from the sample on at which the first of those that
still count was. Under HTMPC the log lacks the plans of the later levels, so that all samples are decided again.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from psmpc_cli.control.controller import ControllerMemory
from psmpc_cli.control.decision import Decision
from psmpc_cli.control.offset_free import Offset
from psmpc_cli.control.shares import control_shares
from psmpc_cli.errors import LogError
from psmpc_cli.logs.read import Log
from psmpc_cli.logs.resumption import reopen_log
from psmpc_cli.logs.write import LogWriter
from psmpc_cli.ocp.plan import Plan, resting_plan, shift
from psmpc_cli.simulation.checkpoint import Checkpoint, first_checkpoint, take_checkpoint
from psmpc_cli.simulation.delays import Delays
from psmpc_cli.simulation.logged_window import (
    LoggedSequence,
    logged_sequences,
    logged_solve,
    logged_state,
    true_state,
)
from psmpc_cli.simulation.loop import Ending, command
from psmpc_cli.simulation.measures import Balance
from psmpc_cli.simulation.run import Progress, header, judge, new_clock, write_records
from psmpc_cli.simulation.setup import Experiment, build_experiment
from psmpc_cli.simulation.stage_times import StageClock
from psmpc_cli.simulation.summary import task_of
from psmpc_cli.solvers import Outcome, Solution
from psmpc_cli.specs.load import Task

logger = logging.getLogger(__name__)

REPEATED = 1e-6
"""By how much the plan of the last solve may differ when it is solved again before that is worth a warning."""


def unfinished(log: Log) -> Task:
    """Return the task of a log whose run can go on.

    Raises:
        LogError: Its run has ended, or the log lacks what is needed to go on.
    """
    if np.isfinite(log.final["time"]):
        raise LogError(
            f"{log.path}: this run has ended ({log.attributes['end_reason']}), so there is nothing to continue"
        )
    if not log.plans:
        raise LogError(
            f"{log.path}: holds no plans, so its run cannot be continued; expected a log of a task with "
            "log: {plans: true}"
        )
    return task_of(log)


def continue_run(log: Log, watch: Callable[[Progress], None] = lambda progress: None) -> Ending | None:
    """Finish the run of a log in the same file, and return how it ended; None if it was interrupted again.

    Raises:
        LogError: The run has ended, or the log lacks what is needed to go on.
        InputError: The log cannot be written, or its run still goes on.
        RunError: It could not be written any further.
    """
    loaded = unfinished(log)
    experiment = build_experiment(loaded)
    sample = max(len(log.time) - 1, 0)
    sequences = logged_sequences(log, experiment)[:sample]
    start = checkpoint_at(log, experiment, sequences) if sample else first_checkpoint(experiment)
    clock = _clock_at(log, experiment, sequences)
    about = header(experiment)
    reopen_log(log.path, about, sample)
    with LogWriter(log.path, about, goes_on=True) as writer:
        fallbacks = int(log["events/fallback"][:sample].sum())
        ending = write_records(experiment, writer, watch, clock, start, fallbacks)
    judge(loaded, log.path)
    return ending


def checkpoint_at(log: Log, experiment: Experiment, sequences: Sequence[LoggedSequence]) -> Checkpoint:
    """Return where the closed loop stood after the samples with these sequences, from the log alone.

    The experiment is left as it was built, but for what its parts remember.
    """
    sample = len(sequences)
    counts = _first_that_counts(log, sample)
    experiment.observer.started = _started(log, experiment, counts)
    uncertainty, braking_until = experiment.uncertainty, np.inf
    delays = Delays.at_start(experiment.task, experiment.x0)
    offset: Offset | None = None
    for decision in _decisions(log, experiment, sequences):
        k = round(decision.prediction.start / experiment.task.controller.sample_time)
        if k >= counts:
            _look_aside(experiment, decision, logged_state(log, k))
        braking_until = decision.plan.end if decision.exhausted else np.inf
        measured = uncertainty.measured(k, true_state(log, k))
        commanded, offset = command(experiment, decision, delays.told(measured), offset)
        _, delays = delays.after(measured, commanded, offset)
    balance = _balance_at(log, experiment, sample)
    return take_checkpoint(experiment, sample, true_state(log, sample), braking_until, balance, delays, offset)


def _first_that_counts(log: Log, sample: int) -> int:
    """Return the first sample whose windows solved aside may start one that comes after `sample`.

    Those are over stages from the current one on, and were solved when that stage was in a window with others; under
    HTMPC, whose levels look beyond the window, always.
    """
    if "levels/solved" in log.columns:
        return 0
    first, count = log["window/first"][:sample], log["window/count"][:sample]
    with_it = (count > 1) & (first + count > log["window/first"][sample])
    return int(np.argmax(with_it)) if with_it.any() else sample


def _started(log: Log, experiment: Experiment, sample: int) -> frozenset[int]:
    """Return the stages whose start had been found before a sample."""
    onset = experiment.task.onset
    reached = log["window/presence"][:sample] >= max(onset.epsilon, *onset.series)
    return frozenset(np.flatnonzero(reached.any(axis=0)).tolist())


def _look_aside(experiment: Experiment, decision: Decision, x: np.ndarray) -> None:
    """Solve what the run solved aside at a sample."""
    task, now = experiment.task, decision.prediction.start
    experiment.observer.observe(decision, x, now + np.array([0.0, task.controller.sample_time]))
    if task.log.shares:
        control_shares(experiment.aside, decision, x, now + np.array([0.0, 1 / task.plant.low_level_rate]))


def _balance_at(log: Log, experiment: Experiment, sample: int) -> Balance:
    """Return the balance before a sample: what has changed since the start less the drift that was logged."""
    uncertainty, stage = experiment.uncertainty, int(log["window/first"][sample - 1])
    before = Balance.at(*uncertainty.kept(0, experiment.x0))
    momentum, energy = before.drift(*uncertainty.kept(stage, true_state(log, sample)))
    return replace(
        before,
        impulse=momentum - log["balance/momentum"][sample - 1],
        work=energy - float(log["balance/energy"][sample - 1]),
    )


def _clock_at(log: Log, experiment: Experiment, sequences: Sequence[LoggedSequence]) -> StageClock:
    """Return when the stages ended and started, as known after the samples with these sequences."""
    clock = new_clock(experiment)
    for k, logged in enumerate(sequences):
        presence = log["window/presence"][k]
        known = {int(stage): float(presence[stage]) for stage in np.flatnonzero(np.isfinite(presence))}
        clock.note(float(log.time[k]), tuple((switch.stage, switch.time) for switch in logged.switches), known)
    return clock


def _decisions(log: Log, experiment: Experiment, sequences: Sequence[LoggedSequence]) -> Iterator[Decision]:
    """Give what was decided at each sample; when the last has been given, the controller remembers what it did then.

    What the log holds is taken from it; failed solves, and the samples of HTMPC, are decided again.
    """
    controller, again = experiment.controller, "levels/solved" in log.columns
    failed = log["events/fallback"][: len(sequences)].astype(bool)
    for k, logged in enumerate(sequences):
        now, x = float(log.time[k]), logged_state(log, k)
        if again or failed[k]:
            controller.hand_over(now, x)
            yield controller.decide(now, x)
            continue
        prediction = _prediction(controller.memory.plan, experiment, now, x)
        solve = logged_solve(log, experiment, logged.sequence, k)
        starts_another = k + 1 == len(sequences) or failed[k + 1]
        solved = _multipliers(log, experiment, solve, k) if starts_another else solve
        controller.memory = ControllerMemory(logged.sequence, solve.plan, None, solved)
        yield Decision(solve.plan, logged.sequence, solved, prediction, False, False, False, False)


def _prediction(plan: Plan | None, experiment: Experiment, now: float, x: np.ndarray) -> Plan:
    spec = experiment.task.controller
    return resting_plan(now, spec.horizon, spec.uniform_nodes, x) if plan is None else shift(plan, now, spec.horizon, x)


def _multipliers(log: Log, experiment: Experiment, solve: Solution, sample: int) -> Solution:
    """Return a logged solution with its multipliers, which come out when it is solved again from the same guess."""
    start = replace(solve, outcome=Outcome.OPTIMAL, plan=solve.guess, duals=solve.guess_duals)
    again = experiment.controller.solver.solve(solve.window, solve.guess, start if solve.warm else None)
    apart = float(np.abs(again.plan.X - solve.plan.X).max())
    if not apart <= REPEATED:
        logger.warning(
            "%s: the solve at %.2f s differs by %.1e from the logged one when it is done again; the run goes on with "
            "the logged plan, but maybe not as it would have",
            log.path,
            log.time[sample],
            apart,
        )
    return replace(again, outcome=solve.outcome, plan=solve.plan)
