"""The closed loop: a generator of samples."""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.decision import Command
from psmpc_cli.control.offset_free import Offset
from psmpc_cli.control.sequence import Switch
from psmpc_cli.control.shares import control_shares
from psmpc_cli.logs.schema import Sample
from psmpc_cli.plant import Ticks
from psmpc_cli.simulation.delays import Delays
from psmpc_cli.simulation.measures import Balance, Observed, measure
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
        switches: Stages that ended since the last sample, the last stage among them.
        stuck: The run could not go on.
    """

    completed: bool
    reason: str
    time: float
    x: np.ndarray
    true: np.ndarray
    switches: tuple[Switch, ...] = ()
    stuck: bool = False


def closed_loop(experiment: Experiment) -> Generator[Sample, None, Ending]:
    """Run the closed loop of an experiment, which is built for this run, and return how it ended."""
    controller, uncertainty, task = experiment.controller, experiment.uncertainty, experiment.task
    x, braking_until, number = experiment.x0, np.inf, 0
    balance = Balance.at(*uncertainty.kept(0, x))
    delays, offset = Delays.at_start(task, x), None
    while True:
        now, before = number * task.controller.sample_time, controller.sequence.first
        measured = uncertainty.measured(number, x)
        seen = delays.foreseen(measured)
        switches = controller.hand_over(now, seen)
        if (ending := _ending(experiment, now, seen, x, braking_until, switches)) is not None:
            return ending
        stage = controller.sequence.first
        contact = uncertainty.contact(x, before, stage)
        decision = controller.decide(now, seen)
        braking_until = decision.plan.end if decision.exhausted else np.inf
        edges = tick_edges(experiment, now)
        commanded, offset = _commanded(experiment, decision.plan.mean_control(edges), delays.told(measured), offset)
        command = Command.of(decision, commanded, switches, np.zeros(len(x) // 2) if offset is None else offset.d)
        u, delays = delays.after(measured, commanded, offset)
        presence = experiment.observer.observe(decision, decision.x, edges[[0, -1]])
        shares = control_shares(experiment.aside, decision, decision.x, edges[:2]) if task.log.shares else {}
        ticks = uncertainty.advance(experiment.plant, number, now, contact.x, u, stage)
        if not _is_bounded(ticks):
            why = "the motion diverged, faster than it can be simulated"
            return Ending(False, why, now, seen, x, switches, stuck=True)
        balance = balance.after(contact).after(ticks)
        yield measure(experiment, command, ticks, Observed(number, x, u, presence, shares, balance, contact.work))
        x, number = ticks.X[-1], number + 1


def _commanded(
    experiment: Experiment, planned: np.ndarray, told: np.ndarray, offset: Offset | None
) -> tuple[np.ndarray, Offset | None]:
    """Return the accelerations (M, n) commanded in a sample, and what is known then of the disturbance, if anything.

    Args:
        experiment: The experiment.
        planned: Accelerations of the plan (M, n).
        told: The measured state behind it (2n,).
        offset: What was known a sample earlier; None at the first.
    """
    spec, Qdot = experiment.task.controller, told[experiment.model.n :]
    if not spec.offset_free:
        return planned, None
    known = Offset.unknown(Qdot, spec.known_delay)
    known = known if offset is None else offset.after(Qdot, spec.sample_time, spec.offset_gain)
    return planned - known.d, known.commanding(planned - known.d)


def tick_edges(experiment: Experiment, now: float) -> np.ndarray:
    """Return the beginnings of the low-level ticks in the sample at time now [s], and its end."""
    rate = experiment.task.plant.low_level_rate
    return np.asarray(now + np.arange(round(experiment.task.controller.sample_time * rate) + 1) / rate)


def _is_bounded(ticks: Ticks) -> bool:
    """Tell whether a motion can be simulated and logged: numbers that are finite, and whose squares have a meaning."""
    return bool((np.abs(ticks.X) < BOUND).all() and (np.abs(ticks.F) < BOUND).all())


def _ending(
    experiment: Experiment,
    now: float,
    x: np.ndarray,
    true: np.ndarray,
    braking_until: float,
    switches: tuple[Switch, ...],
) -> Ending | None:
    """Return the ending if the run is over: last stage at its target, time limit, or at rest without a plan.

    The target counts as reached when the state x (2n,) that the controller sees meets the end condition, as at the end
    of every stage.
    """
    sequence, last = experiment.controller.sequence, experiment.stages[-1]
    dwelt = now - sequence.entered >= last.dwell - 1e-9
    if sequence.first == last.index and dwelt and experiment.costs.met(last, x[None])[0]:
        met = (*switches, Switch(last.index, now))
        return Ending(True, f"{last.name} met its end condition", now, x, true, met)
    if now >= braking_until - 1e-9:
        why = "no window could be solved" if np.isfinite(x).all() else "the state was not measured"
        why = f"{why} and the plan was used up; the robot braked to rest"
        return Ending(False, why, now, x, true, switches, stuck=True)
    if now >= experiment.task.time_limit - 1e-9:
        return Ending(False, f"time limit of {experiment.task.time_limit:g} s reached", now, x, true, switches)
    return None
