"""The closed loop: a generator of samples."""

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.controller import Command, State
from psmpc_cli.control.sequence import Switch
from psmpc_cli.logs.schema import Sample
from psmpc_cli.plant import Ticks
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


def closed_loop(experiment: Experiment, until: int | None = None) -> Generator[Sample, None, Ending]:
    """Run the closed loop of an experiment, which is built for this run, and return how it ended.

    Args:
        experiment: The experiment.
        until: Index of the stage at whose end the loop stops; by default that of the task.
    """
    controller, uncertainty, task = experiment.controller, experiment.uncertainty, experiment.task
    x, braking_until, number, stage = experiment.x0, np.inf, 0, 0
    balance, link = Balance.at(*uncertainty.kept(0, x)), _Link(experiment)
    while True:
        now = number * task.controller.sample_time
        command = controller.step(now, State.of(link.measured(uncertainty.measured(number, x))))
        if (ending := _ending(experiment, command, x, braking_until)) is not None:
            return ending
        if any(switch.stage == until for switch in command.switches):
            return Ending(False, "stopped at the end of a stage", now, command.x, x, command.switches)
        braking_until = command.plan.end if "braking" in command.events else np.inf
        before, stage = stage, command.sequence.first
        contact, u = uncertainty.contact(x, before, stage), link.commanded(command.u)
        edges = controller.edges(now)
        presence = experiment.counterfactuals.presence(command, edges[[0, -1]])
        shares = experiment.counterfactuals.shares(command, edges[:2]) if task.log.shares else {}
        ticks = uncertainty.advance(experiment.plant, number, now, contact.x, u, stage)
        if not _is_bounded(ticks):
            why = "the motion diverged, faster than it can be simulated"
            return Ending(False, why, now, command.x, x, command.switches, stuck=True)
        balance = balance.after(contact).after(ticks)
        yield measure(experiment, command, ticks, Observed(number, x, u, presence, shares, balance, contact.work))
        x, number = ticks.X[-1], number + 1


class _Link:
    """The delays between controller and robot.

    Time is that at which a control acts. The controller knows of c samples: what it decides at sample k was measured at
    k - c. The rest of the delay it does not know of: controls reach the robot late by so many samples.
    """

    def __init__(self, experiment: Experiment) -> None:
        """Start with a robot that drifts into its initial state, and with controls under way that are zero."""
        task, x0, n = experiment.task, experiment.x0, experiment.model.n
        known, drift = task.controller.known_delay, task.controller.sample_time * np.r_[x0[n:], np.zeros(n)]
        none = np.zeros((round(task.controller.sample_time * task.plant.low_level_rate), n))
        self._measured: deque[np.ndarray] = deque(x0 - back * drift for back in range(known, 0, -1))
        self._commanded: deque[np.ndarray] = deque([none] * (task.uncertainty.delay - known))

    def measured(self, x: np.ndarray) -> np.ndarray:
        """Return the state that reaches the controller where x (2n,) is measured now."""
        self._measured.append(x)
        return self._measured.popleft()

    def commanded(self, u: np.ndarray) -> np.ndarray:
        """Return the accelerations (M, n) that reach the robot where u (M, n) are commanded now."""
        self._commanded.append(u)
        return self._commanded.popleft()


def _is_bounded(ticks: Ticks) -> bool:
    """Tell whether a motion can be simulated and logged: numbers that are finite, and whose squares have a meaning."""
    return bool((np.abs(ticks.X) < BOUND).all() and (np.abs(ticks.F) < BOUND).all())


def _ending(experiment: Experiment, command: Command, x: np.ndarray, braking_until: float) -> Ending | None:
    """Return the ending if the run is over: last stage at its target, time limit, or at rest without a plan."""
    now, seen, switches = command.time, command.x, command.switches
    if experiment.controller.done:
        return Ending(True, f"{experiment.stages[-1].name} met its end condition", now, seen, x, switches)
    if now >= braking_until - 1e-9:
        why = "the state was not measured" if "unmeasured" in command.events else "no window could be solved"
        why = f"{why} and the plan was used up; the robot braked to rest"
        return Ending(False, why, now, seen, x, switches, stuck=True)
    if now >= experiment.task.time_limit - 1e-9:
        return Ending(False, f"time limit of {experiment.task.time_limit:g} s reached", now, seen, x, switches)
    return None
