"""The closed loop: a generator of records."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np

from psmpc_cli.control.sequence import Switch
from psmpc_cli.control.shares import control_shares
from psmpc_cli.experiment.checkpoint import Checkpoint, first_checkpoint, restore, take_checkpoint
from psmpc_cli.experiment.measures import measure
from psmpc_cli.experiment.setup import Experiment
from psmpc_cli.logs.record import Record


@dataclass(frozen=True, eq=False)
class Ending:
    """How a run ended.

    Attributes:
        completed: The last stage met its end condition.
        reason: Why the run stopped.
        time: When [s].
        x: In which state (2n,).
        switches: Hand-overs since the last record, the end of the last stage among them.
        stuck: The run could not go on.
    """

    completed: bool
    reason: str
    time: float
    x: np.ndarray
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
    controller, plant, task = experiment.controller, experiment.plant, experiment.task
    start = first_checkpoint(experiment) if start is None else start
    restore(experiment, start)
    sample, x, braking_until, balance = start.sample, start.x, start.braking_until, start.balance
    while True:
        mark(take_checkpoint(experiment, sample, x, braking_until, balance))
        now = sample * task.controller.sample_time
        switches = controller.hand_over(now, x)
        if (ending := _ending(experiment, now, x, braking_until)) is not None:
            return replace(ending, switches=(*switches, *ending.switches))
        decision = controller.decide(now, x)
        braking_until = decision.plan.end if decision.exhausted else np.inf
        edges = now + np.arange(_ticks(experiment) + 1) / task.plant.low_level_rate
        u = decision.plan.mean_control(edges)
        presence = experiment.observer.observe(decision, x, edges[[0, -1]])
        shares = control_shares(experiment.aside, decision, x, edges[:2]) if task.log.shares else {}
        ticks = plant.advance(now, x, u)
        balance = balance.after(ticks)
        yield measure(experiment, decision, switches, presence, shares, u, ticks, balance)
        x, sample = ticks.X[-1], sample + 1


def _ticks(experiment: Experiment) -> int:
    """Return the number of low-level ticks in a sample."""
    return round(experiment.task.controller.sample_time * experiment.task.plant.low_level_rate)


def _ending(experiment: Experiment, now: float, x: np.ndarray, braking_until: float) -> Ending | None:
    """Return the ending if the run is over: last stage at its target, time limit, or at rest without a plan."""
    sequence, last = experiment.controller.sequence, experiment.stages[-1]
    dwelt = now - sequence.entered >= last.dwell - 1e-9
    if sequence.first == last.index and dwelt and experiment.costs.met(last, x[None])[0]:
        return Ending(True, f"{last.name} met its end condition", now, x, (Switch(last.index, now),))
    if now >= braking_until - 1e-9:
        reason = "no window could be solved and the plan was used up; the robot braked to rest"
        return Ending(False, reason, now, x, stuck=True)
    if now >= experiment.task.time_limit - 1e-9:
        return Ending(False, f"time limit of {experiment.task.time_limit:g} s reached", now, x)
    return None
