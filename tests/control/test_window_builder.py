"""Windows that a sequence of stages and a prediction give."""

from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control.window_builder import WindowBuilder, priorities_in_force
from psmpc_cli.ocp.plan import resting_plan
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.ocp.reference import Trajectory
from psmpc_cli.ocp.window import COUNTS
from psmpc_cli.solvers import Outcome, Solution
from psmpc_cli.specs.load import load_task

from ..ocp.transport_windows import sequence_of

SEQUENCE = sequence_of(1, [3.0], 0.5)
"""Capture, which began at 0.5 s, and Transport, planned to begin at 3 s."""


def test_a_window_has_the_stages_of_its_sequence_and_the_numbers_of_its_task() -> None:
    problem = build_problem(load_task("transport", ["controller.nodes=7", "controller.horizon=5"]))
    x0 = np.linspace(-0.4, 0.4, 18)
    stages = [stage.unplaced_copy() for stage in problem.stages]
    window = WindowBuilder(problem).build(SEQUENCE, stages, resting_plan(2.0, 5.0, 1, x0))
    assert [stage.name for stage in window.stages] == ["capture", "transport"]
    assert (window.start, window.elapsed, window.horizon) == (2.0, 1.5, 5.0)
    assert window.nodes == (7, 7)
    np.testing.assert_array_equal(window.x0, x0)
    np.testing.assert_array_equal(window.omega, [stage.priority for stage in problem.stages[1:3]])
    assert (window.scale > 0).all()


@pytest.mark.parametrize(("kind", "known"), [("psmpc", True), ("hard", True), ("smpc", False)])
def test_priorities_count_where_the_controller_has_them(kind: str, known: bool) -> None:
    problem = build_problem(load_task("transport", [f"controller.kind={kind}"]))
    found = priorities_in_force(problem.spec.controller, problem.stages)
    np.testing.assert_array_equal(found, [stage.priority if known else 1.0 for stage in problem.stages])


def test_an_automatic_mesh_is_for_the_prediction_where_that_comes_from_a_solve() -> None:
    problem = build_problem(load_task("transport", ["controller.nodes=auto"]))
    prediction = resting_plan(2.0, 4.0, 1, np.linspace(-0.4, 0.4, 18))
    builder = WindowBuilder(problem)
    stages = [stage.unplaced_copy() for stage in problem.stages]
    first = builder.build(SEQUENCE, stages, prediction)
    guess = replace(prediction, switch_times=SEQUENCE.switch_times)
    solved = Solution(Outcome.OPTIMAL, guess, 1.0, 1, 0.0, first, guess)
    later = builder.build(SEQUENCE, stages, prediction, solved)
    assert set(first.nodes) | set(later.nodes) <= set(COUNTS)
    assert sum(later.nodes) <= sum(first.nodes)


def test_a_stage_that_continues_has_one_scale_and_meshes_of_its_own_before_and_after_its_end() -> None:
    problem = build_problem(load_task("transport", ["controller.nodes=auto"]))
    stages = [stage.unplaced_copy() for stage in problem.stages]
    moving = replace(stages[1], reference=Trajectory(np.array([0.0, 1.0]), np.array([stages[1].target] * 2)))
    stages[1] = moving
    builder = WindowBuilder(problem)
    prediction = resting_plan(2.0, 4.0, 1, np.linspace(-0.4, 0.4, 18))
    sequence = replace(SEQUENCE, segments=(1, 1), switch_times=np.array([2.5]))
    window = builder.build(sequence, stages, prediction)
    before, after = window.stages
    assert (before.name, after.name, window.count) == ("capture", "capture", 1)
    assert before.reference is moving.reference
    assert not after.reference.moves
    np.testing.assert_array_equal(window.omega, [100, 100])
    assert window.scale[0] == window.scale[1] == builder.build(sequence.current_only, stages, prediction).scale[0]
    assert window.nodes[0] < window.nodes[1]

    guess = replace(prediction, switch_times=sequence.switch_times)
    solved = Solution(Outcome.OPTIMAL, guess, 1.0, 1, 0.0, window, guess)
    needed = builder.build(sequence, stages, prediction, replace(solved, window=builder.build(SEQUENCE, stages, guess)))
    finer = tuple(COUNTS[COUNTS.index(count) + 1] for count in needed.nodes)
    kept = builder.build(sequence, stages, prediction, replace(solved, window=replace(window, nodes=finer)))
    assert kept.nodes == finer
