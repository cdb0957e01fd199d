"""A checkpoint: everything a closed loop needs to go on from the beginning of a sample."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.control.aside import AsideMemory
from psmpc_cli.control.controller import ControllerMemory
from psmpc_cli.control.offset_free import Offset
from psmpc_cli.simulation.delays import Delays
from psmpc_cli.simulation.measures import Balance
from psmpc_cli.simulation.setup import Experiment


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Where a closed loop stands before a sample; any experiment of the same robot and stages can go on from it.

    Attributes:
        sample: Number of the sample that comes next.
        x: True state (2n,).
        braking_until: When the robot will have come to rest without a plan [s]; infinite as long as there is one.
        controller: What the controller remembers.
        aside: What the windows solved aside remember.
        started: Stages whose start has been found.
        balance: Impulse and work so far, with momentum and energy at the start.
        delays: What is under way between controller and robot.
        offset: What is known of the disturbance, under offset-free control.
    """

    sample: int
    x: np.ndarray
    braking_until: float
    controller: ControllerMemory
    aside: AsideMemory
    started: frozenset[int]
    balance: Balance
    delays: Delays
    offset: Offset | None = None


def take_checkpoint(
    experiment: Experiment,
    sample: int,
    x: np.ndarray,
    braking_until: float,
    balance: Balance,
    delays: Delays,
    offset: Offset | None = None,
) -> Checkpoint:
    """Return where the closed loop of an experiment stands."""
    return Checkpoint(
        sample=sample,
        x=x,
        braking_until=braking_until,
        controller=experiment.controller.memory,
        aside=experiment.aside.memory,
        started=experiment.observer.started,
        balance=balance,
        delays=delays,
        offset=offset,
    )


def first_checkpoint(experiment: Experiment) -> Checkpoint:
    """Return where an experiment stands before its first sample."""
    balance = Balance.at(*experiment.uncertainty.kept(0, experiment.x0))
    delays = Delays.at_start(experiment.task, experiment.x0)
    return take_checkpoint(experiment, 0, experiment.x0, np.inf, balance, delays)


def restore(experiment: Experiment, checkpoint: Checkpoint) -> None:
    """Give the parts of an experiment what they remember at a checkpoint."""
    experiment.controller.memory = checkpoint.controller
    experiment.aside.memory = checkpoint.aside
    experiment.observer.started = checkpoint.started
