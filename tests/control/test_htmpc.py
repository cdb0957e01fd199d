from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from psmpc_cli.control import Command
from psmpc_cli.control.htmpc import HierarchicalController
from psmpc_cli.logs.read import read_log
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.run import simulate
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.specs.load import load_task

from .test_controller import SHORT

HTMPC = (*SHORT, "controller.kind=htmpc", "log.shares=false")
EXACT = 1e-6
"""What a solve may leave of its constraints, of a cost relative to it."""

Build = Callable[..., Experiment]


def decisions(experiment: Experiment) -> Iterator[tuple[Command, np.ndarray]]:
    """Every decision of the closed loop, with the applied control."""
    found: list[Command] = []

    class Recorder(HierarchicalController):
        def decide(self, now: float, x: np.ndarray) -> Command:
            found.append(super().decide(now, x))
            return found[-1]

    controller = experiment.controller
    recorder = Recorder(controller.spec, controller.spec.htmpc, controller.stages, controller.windows)
    for record in closed_loop(replace(experiment, controller=recorder)):
        yield found[-1], record.metrics.u[0]


def test_one_level_is_hard_switching_exactly(experiment_of: Build) -> None:
    hard = list(closed_loop(experiment_of(*SHORT, "controller.kind=hard")))
    htmpc = list(closed_loop(experiment_of(*HTMPC, "controller.htmpc.depth=1")))
    assert len(hard) == len(htmpc) > 20
    for one, other in zip(hard, htmpc, strict=True):
        np.testing.assert_array_equal(np.r_[one.Q, one.Qdot, one.u], np.r_[other.Q, other.Qdot, other.u])


@pytest.mark.parametrize("changes", [[], ["controller.htmpc.tolerance=0.05"], ["controller.normalization=range"]])
def test_no_earlier_level_gets_worse_by_more_than_the_tolerance(tmp_path: Path, changes: list[str]) -> None:
    task = load_task("transport", [*HTMPC, *changes, "time_limit=4"])
    simulate(task, tmp_path / "run.h5")
    log = read_log(tmp_path / "run.h5")
    objective, cost, solved = (log[f"levels/{name}"] for name in ("objective", "cost", "solved"))
    current = log["window/first"]
    assert np.all(np.isfinite(cost) == (solved == 1))
    assert np.all(solved[np.arange(len(current)), current] == 1)
    assert np.sum(solved[current < 3] == 1) > 2 * np.sum(current < 3)  # it looks beyond the current stage
    worse, size = (cost - objective)[solved == 1], np.maximum(objective[solved == 1], 1.0)
    assert np.all(worse <= task.spec.controller.htmpc.tolerance + EXACT * size)
    assert worse.max() > 1e-5  # and makes use of what it may


def test_no_earlier_error_gets_worse_by_more_than_the_tolerance(experiment_of: Build) -> None:
    experiment = experiment_of(*HTMPC, "controller.htmpc.constraint=error", "controller.htmpc.tolerance=2e-3")
    errors, compared = experiment.controller.costs.errors, 0
    for decision, _ in islice(decisions(experiment), 40):
        solved = [level for level in decision.levels if level.solved]
        for level in solved[:-1]:
            stage = experiment.stages[level.stage]
            allowed = np.abs(errors(stage, level.plan.X[1:])) + 2e-3
            assert np.all(np.abs(errors(stage, solved[-1].plan.X[1:])) <= allowed + EXACT)
            compared += 1
    assert compared > 50


def test_later_levels_lower_their_own_cost(experiment_of: Build) -> None:
    """What is left free after the first level goes to the next: its cost falls below that along the first plan."""
    experiment = experiment_of(*HTMPC, "controller.htmpc.tolerance=0.05")
    decision, u = next(decisions(experiment))
    first, second = decision.levels[:2]
    stage, costs = experiment.stages[1], experiment.controller.costs
    assert second.solved
    along = [np.trapezoid(costs.along(stage, plan.X, plan.u), plan.times) for plan in (first.plan, second.plan)]
    assert along[1] < along[0]
    assert np.abs(u - first.plan.u[0]).max() > 1e-3


def test_a_level_without_solution_leaves_the_one_before_it_standing(
    experiment_of: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = experiment_of(*HTMPC, "solver.max_iterations=200")
    controller = experiment.controller
    assert isinstance(controller, HierarchicalController)
    hopeless = experiment_of(*HTMPC, "solver.max_iterations=1")
    monkeypatch.setattr(controller, "_compile", hopeless.controller._compile)
    record = next(closed_loop(experiment))
    assert record.levels is not None
    assert list(record.levels.solved) == [1, 0, -1, -1]
    assert np.isfinite(record.levels.cost[0]) and np.all(np.isnan(record.levels.cost[1:]))
    assert record.command.outcome.name.lower() == "iteration_limit"
    assert record.command.solve_time == pytest.approx(np.nansum(record.levels.wall_time))
    alone = next(closed_loop(experiment_of(*HTMPC, "controller.htmpc.depth=1")))
    np.testing.assert_array_equal(record.metrics.u[0], alone.u)
