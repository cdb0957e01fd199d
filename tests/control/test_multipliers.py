from dataclasses import replace

import numpy as np
import pytest
from psmpc_cli.control.multipliers import Before, shift_multipliers
from psmpc_cli.control.window_solver import SolvedWindow, WindowSolver

from psmpc_cli.ocp.problem import StageCosts
from psmpc_cli.ocp.window import pack_guess
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.solvers import Guess, Outcome
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import SolverSpec


@pytest.fixture(scope="module")
def windows(transport: Task, model: RobotModel, costs: StageCosts) -> WindowSolver:
    return WindowSolver(transport.spec.model_copy(update={"solver": SolverSpec(kind="ipopt")}), model, costs)


@pytest.fixture(scope="module")
def solved(windows: WindowSolver, decisions: list[Command]) -> SolvedWindow:
    """A window over two stages at its optimum, on a mesh of 6 and 4 intervals."""
    decision = next(d for d in decisions if len(d.solution.window.stages) == 2 and "appended" not in d.events)
    window = replace(decision.solution.window, nodes=(6, 4))
    return windows.solve(window, decision.solution.plan, decision.solution.plan.instants)


def moved(windows: WindowSolver, solved: SolvedWindow, nodes: tuple[int, ...]) -> Guess:
    """The guess that follows a solution on another mesh, at the same time."""
    window = replace(solved.window, nodes=nodes)
    (nlp, _), (before, _) = (windows.compiled_for(one) for one in (window, solved.window))
    z = pack_guess(nlp, window, solved.plan, solved.plan.instants, windows.costs)
    return shift_multipliers(nlp, z, window, Before(before, solved.window, solved.solution))


def test_without_a_move_they_stay_what_they_are(windows: WindowSolver, solved: SolvedWindow) -> None:
    guess = moved(windows, solved, solved.window.nodes)
    assert guess.warm
    np.testing.assert_array_equal(guess.lam_g, solved.solution.lam_g)
    nlp, _ = windows.compiled_for(solved.window)
    states = np.hstack([nlp.layout.state_index, nlp.layout.duration_index])
    assert guess.lam_x is not None
    np.testing.assert_array_equal(guess.lam_x[states], solved.solution.lam_x[states])


def test_on_a_finer_mesh_bounds_keep_what_they_cost(windows: WindowSolver, solved: SolvedWindow) -> None:
    """Twice the nodes, half the multiplier at each; those of gaps are prices of a state and stay."""
    guess = moved(windows, solved, (12, 8))
    assert guess.lam_x is not None
    assert guess.lam_g is not None
    assert np.abs(guess.lam_x).sum() == pytest.approx(np.abs(solved.solution.lam_x).sum(), rel=0.3)
    assert np.abs(guess.lam_g).max() == pytest.approx(np.abs(solved.solution.lam_g).max())


def test_other_stages_and_failed_solves_start_cold(windows: WindowSolver, solved: SolvedWindow) -> None:
    window = solved.window
    nlp, _ = windows.compiled_for(window)
    failed = replace(solved.solution, outcome=Outcome.FAILED)
    fewer = replace(window, stages=window.stages[:1])
    for before in (Before(nlp, window, failed), Before(nlp, fewer, solved.solution)):
        guess = shift_multipliers(nlp, solved.solution.z, window, before)
        assert not guess.warm
        assert guess.lam_g is None
