"""The closed loop: a generator of records."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.decision import Decision
from psmpc_cli.control.offset_free import Offset
from psmpc_cli.control.sequence import Switch
from psmpc_cli.control.shares import control_shares
from psmpc_cli.logs.record import Record
from psmpc_cli.plant import Ticks
from psmpc_cli.simulation.checkpoint import Checkpoint, first_checkpoint, restore, take_checkpoint
from psmpc_cli.simulation.measures import Sample, measure
from psmpc_cli.simulation.setup import Experiment

BOUND = 1e9
"""Coordinates, rates and forces beyond it are those of a motion that diverged, in any unit of the SI."""


@dataclass(frozen=True, eq=False)
class Ending:
    """How a run ended.

    Attributes:
        completed: The last stage met its end condition.
        reason: Why the run stopped.
        time: When [s].
        x: In which state, as the controller saw it (2n,).
        true: In which state it was (2n,).
        switches: Hand-overs since the last record, the end of the last stage among them.
        stuck: The run could not go on.
    """

    completed: bool
    reason: str
    time: float
    x: np.ndarray
    true: np.ndarray
    switches: tuple[Switch, ...] = ()
    stuck: bool = False


def simulate(
    experiment: Experiment,
    start: Checkpoint | None = None,
    mark: Callable[[Checkpoint], None] = lambda checkpoint: None,
) -> Generator[Record, None, Ending]:
    """Run the closed loop, one record a sample, and return how it ended.

    Args:
        experiment: The experiment, built for this run.
        start: Where to go on from; by default its beginning.
        mark: Told before each sample where the loop stands.
    """
    controller, uncertainty, task = experiment.controller, experiment.uncertainty, experiment.task
    start = first_checkpoint(experiment) if start is None else start
    restore(experiment, start)
    sample, x, braking_until = start.sample, start.x, start.braking_until
    balance, delays, offset = start.balance, start.delays, start.offset
    while True:
        mark(take_checkpoint(experiment, sample, x, braking_until, balance, delays, offset))
        now, before = sample * task.controller.sample_time, controller.sequence.first
        measured = uncertainty.measured(sample, x)
        seen = delays.foreseen(measured)
        switches = controller.hand_over(now, seen)
        if (ending := _ending(experiment, now, seen, x, braking_until)) is not None:
            return replace(ending, switches=(*switches, *ending.switches))
        stage = controller.sequence.first
        contact = uncertainty.contact(x, before, stage)
        decision = controller.decide(now, seen)
        braking_until = decision.plan.end if decision.exhausted else np.inf
        edges = tick_edges(experiment, now)
        commanded, offset = command(experiment, decision, delays.told(measured), offset)
        u, delays = delays.after(measured, commanded, offset)
        presence = experiment.observer.observe(decision, decision.x, edges[[0, -1]])
        shares = control_shares(experiment.aside, decision, decision.x, edges[:2]) if task.log.shares else {}
        ticks = uncertainty.advance(experiment.plant, sample, now, contact.x, u, stage)
        if not _is_bounded(ticks):
            return Ending(
                False, "the motion diverged, faster than it can be simulated", now, seen, x, switches, stuck=True
            )
        balance = balance.after(contact).after(ticks)
        happened = Sample(x, switches, contact, presence, shares, u, ticks, balance, offset)
        yield measure(experiment, decision, happened)
        x, sample = ticks.X[-1], sample + 1


def command(
    experiment: Experiment, decision: Decision, told: np.ndarray, offset: Offset | None
) -> tuple[np.ndarray, Offset | None]:
    """Return the accelerations (M, n) commanded in a sample, and what is known then of the disturbance, if anything.

    Args:
        experiment: The experiment.
        decision: What was decided at the sample.
        told: The measured state behind it (2n,).
        offset: What was known a sample earlier; None at the first.
    """
    spec, Qdot = experiment.task.controller, told[experiment.model.n :]
    u = decision.plan.mean_control(tick_edges(experiment, decision.prediction.start))
    if not spec.offset_free:
        return u, None
    known = Offset.unknown(Qdot, spec.known_delay)
    known = known if offset is None else offset.after(Qdot, spec.sample_time, spec.offset_gain)
    return u - known.d, known.commanding(u - known.d)


def tick_edges(experiment: Experiment, now: float) -> np.ndarray:
    """Return the beginnings of the low-level ticks in the sample at time now [s], and its end."""
    rate = experiment.task.plant.low_level_rate
    return np.asarray(now + np.arange(round(experiment.task.controller.sample_time * rate) + 1) / rate)


def _is_bounded(ticks: Ticks) -> bool:
    """Tell whether a motion can be simulated and logged: numbers that are finite, and whose squares have a meaning."""
    return bool((np.abs(ticks.X) < BOUND).all() and (np.abs(ticks.F) < BOUND).all())


def _ending(experiment: Experiment, now: float, x: np.ndarray, true: np.ndarray, braking_until: float) -> Ending | None:
    """Return the ending if the run is over: last stage at its target, time limit, or at rest without a plan.

    The target counts as reached when the state x (2n,) that the controller sees meets the end condition, as in every
    hand-over.
    """
    sequence, last = experiment.controller.sequence, experiment.stages[-1]
    dwelt = now - sequence.entered >= last.dwell - 1e-9
    if sequence.first == last.index and dwelt and experiment.costs.met(last, x[None])[0]:
        return Ending(True, f"{last.name} met its end condition", now, x, true, (Switch(last.index, now),))
    if now >= braking_until - 1e-9:
        why = "no window could be solved" if np.isfinite(x).all() else "the state was not measured"
        return Ending(False, f"{why} and the plan was used up; the robot braked to rest", now, x, true, stuck=True)
    if now >= experiment.task.time_limit - 1e-9:
        return Ending(False, f"time limit of {experiment.task.time_limit:g} s reached", now, x, true)
    return None
