"""Strict levels over a stage that follows a trajectory."""

from collections.abc import Callable

import numpy as np
import pytest

from psmpc_cli.control import Command
from psmpc_cli.simulation.setup import Experiment

TOLERANCE = 1e-3


@pytest.fixture(scope="module")
def decided(experiment_of: Callable[..., Experiment]) -> tuple[Experiment, list[Command]]:
    """The first seven seconds of the tracking task, levels bounding each other's errors."""
    changes = ("controller.kind=htmpc", "controller.htmpc.constraint=error", f"controller.htmpc.tolerance={TOLERANCE}")
    experiment = experiment_of(*changes, "controller.nodes=8", "plant.kind=ideal", task="tracking")
    x, decisions = experiment.x0, []
    for now in np.arange(70) / 10:
        experiment.controller.hand_over(now, x)
        decisions.append(experiment.controller.decide(now, x))
        x = experiment.plant.advance(now, x, decisions[-1].plan.mean_control(now + np.arange(101) / 1000)).X[-1]
    return experiment, decisions


def test_later_levels_keep_the_errors_along_a_running_trajectory(decided: tuple[Experiment, list[Command]]) -> None:
    experiment, decisions = decided
    running = [decision for decision in decisions if decision.sequence.first == 1 and len(decision.levels) > 1]
    assert len(running) >= 5
    assert np.mean([decision.levels[1].solved for decision in running]) > 0.8
    for decision in running:
        first, second = (level.plan for level in decision.levels[:2])
        since = first.times[1:] - decision.sequence.entered
        sizes = [np.abs(experiment.costs.errors(experiment.stages[1], plan.X[1:], since)) for plan in (first, second)]
        assert np.all(sizes[1] <= sizes[0] + TOLERANCE + 1e-6)
