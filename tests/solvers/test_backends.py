from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.ocp.transcription import transcribe

from psmpc_cli.control import Command
from psmpc_cli.ocp.problem import StageCosts
from psmpc_cli.ocp.window import bounds, window_shape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Guess, Outcome, build_solver
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import SolverSpec

BACKENDS = ("fatrop", "ipopt")


def window_with(decisions: list[Command], stages: int) -> Command:
    """A sample in the midst of a series of windows over that many stages."""
    chosen = [d for d in decisions if len(d.solution.window.stages) == stages]
    return chosen[len(chosen) // 2]


def solve(model: RobotModel, decision: Command, spec: SolverSpec, **bounds_changes: np.ndarray):
    window = decision.solution.window
    nlp = transcribe(model, window_shape(window.stages, (20,) * len(window.stages), "exact"))
    limits = replace(bounds(nlp, window), **bounds_changes)
    solution = build_solver(nlp, spec).solve(Guess(decision.solution.guess.z), decision.solution.parameters, limits)
    return nlp, solution


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_both_backends_reach_the_same_optimum(model: RobotModel, decisions: list[Command], stages: int) -> None:
    decision = window_with(decisions, stages)
    solved = [solve(model, decision, SolverSpec(kind=kind)) for kind in BACKENDS]
    (nlp, one), (_, other) = solved
    assert one.outcome is other.outcome is Outcome.OPTIMAL
    assert one.objective == pytest.approx(other.objective, rel=1e-5)
    instants = np.cumsum(one.z[nlp.layout.duration_index[0]]) - np.cumsum(other.z[nlp.layout.duration_index[0]])
    assert np.abs(instants).max(initial=0) < 1e-3


@pytest.mark.parametrize("kind", BACKENDS)
def test_a_window_that_cannot_be_solved_says_so_with_advice(
    model: RobotModel, decisions: list[Command], kind: str
) -> None:
    """An end condition 10 m away in a 4 s horizon."""
    decision = window_with(decisions, 2)
    nlp = transcribe(model, window_shape(decision.solution.window.stages, decision.solution.window.nodes, "exact"))
    limits = bounds(nlp, decision.solution.window)
    lbg, ubg = limits.lbg.copy(), limits.ubg.copy()
    lbg[nlp.end_rows[0]], ubg[nlp.end_rows[0]] = 10.0, 10.1
    _, solution = solve(model, decision, SolverSpec(kind=kind, max_iterations=80), lbg=lbg, ubg=ubg)
    assert not solution.outcome.usable
    assert ":" in solution.outcome.value


@pytest.mark.parametrize("kind", BACKENDS)
def test_too_few_iterations_are_reported_as_such(model: RobotModel, decisions: list[Command], kind: str) -> None:
    _, solution = solve(model, window_with(decisions, 2), SolverSpec(kind=kind, max_iterations=1))
    assert solution.outcome is Outcome.ITERATION_LIMIT
    assert "max_iterations" in solution.outcome.value


def test_plan_keeps_every_limit_at_its_nodes(decisions: list[Command], transport: Task) -> None:
    high = np.r_[np.full(3, 0.2), np.full(6, 0.15)]
    worst = max(float((np.abs(d.plan.X[1:, 9:]) - high).max()) for d in decisions)
    assert worst < 1e-6


def test_plan_meets_every_end_condition_in_its_window(decisions: list[Command], costs: StageCosts) -> None:
    for decision in decisions:
        for stage, instant in zip(decision.solution.window.stages, decision.plan.instants, strict=False):
            assert costs.met(stage, decision.plan.states_at(np.array([instant])))[0]
