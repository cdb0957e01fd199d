from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.control.window_solver import SolvedWindow, WindowSolver

from psmpc_cli.control import Command
from psmpc_cli.ocp.problem import StageCosts
from psmpc_cli.ocp.window import COUNTS, Along, Window, durations, first_counts, node_counts
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import SolverSpec

TOLERANCE, STEP = 5e-3, 0.1


@pytest.fixture(scope="module")
def windows(transport: Task, model: RobotModel, costs: StageCosts) -> WindowSolver:
    """Solves to convergence."""
    spec = transport.spec.model_copy(update={"solver": SolverSpec(kind="sqp", iterations=50)})
    return WindowSolver(spec, model, costs)


def picked(decisions: list[Command]) -> list[Command]:
    """Windows of a run: before, at and after appends, with one, two and three stages, before and after hand-overs."""
    appended = [k for k, decision in enumerate(decisions) if "appended" in decision.events]
    return [decisions[k + d] for k in appended for d in (-1, 0, 1, 12)] + decisions[20::70]


def on_mesh(windows: WindowSolver, decision: Command, nodes: tuple[int, ...]) -> SolvedWindow:
    window = replace(decision.solution.window, nodes=nodes)
    return windows.solve(window, decision.solution.plan, decision.solution.plan.instants)


def counts_of(decision: Command, costs: StageCosts, before: dict[int, int]) -> tuple[int, ...]:
    along = Along(decision.solution.plan, costs, STEP)
    return node_counts(decision.solution.window, decision.solution.plan.instants, along, TOLERANCE, before)


def test_windows_of_a_run_agree_with_two_hundred_nodes(
    decisions: list[Command], windows: WindowSolver, costs: StageCosts
) -> None:
    """Instants to 20 ms, J to 1 %, with a fraction of the nodes."""
    saved = []
    for decision in picked(decisions):
        stages = len(decision.solution.window.stages)
        counts = counts_of(decision, costs, {})
        coarse, fine = on_mesh(windows, decision, counts), on_mesh(windows, decision, (200,) * stages)
        assert coarse.solution.outcome.usable
        assert fine.solution.outcome.usable
        assert coarse.solution.objective == pytest.approx(fine.solution.objective, rel=1e-2)
        assert np.abs(coarse.plan.instants - fine.plan.instants).max(initial=0.0) < 0.02
        saved.append(sum(counts) / (200 * stages))
    assert np.median(saved) < 0.5


def test_no_interval_is_longer_than_a_sample(decisions: list[Command], costs: StageCosts) -> None:
    for decision in picked(decisions):
        window, instants = decision.solution.window, decision.solution.plan.instants
        tau, counts = durations(instants, window.start, window.horizon), counts_of(decision, costs, {})
        assert np.all(tau / counts <= STEP + 1e-9)
        assert set(counts) <= set(COUNTS)


def test_a_stage_keeps_its_count_while_that_is_enough(decisions: list[Command], costs: StageCosts) -> None:
    decision = next(d for d in decisions if len(d.solution.window.stages) == 2)
    counts = counts_of(decision, costs, {})
    had = {stage.index: N for stage, N in zip(decision.solution.window.stages, counts, strict=True)}
    assert counts_of(decision, costs, had) == counts
    assert counts_of(decision, costs, dict.fromkeys(had, 3)) == counts
    assert counts_of(decision, costs, dict.fromkeys(had, 200)) == counts


def test_a_tighter_tolerance_takes_more_nodes(decisions: list[Command], costs: StageCosts) -> None:
    decision = decisions[20]
    along, instants = Along(decision.solution.plan, costs, STEP), decision.solution.plan.instants
    few, many = (node_counts(decision.solution.window, instants, along, part, {}) for part in (2e-2, 2e-3))
    assert sum(few) < sum(many)


def test_the_first_window_is_ready_for_costs_that_fall_to_nothing(decisions: list[Command]) -> None:
    window: Window = decisions[0].solution.window
    assert first_counts(window, np.zeros(0), TOLERANCE, STEP) == (128,)
