"""Several guesses of the instants: which basin wins, what that costs, and where there is but one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from psmpc_cli.control.window_solver import SolvedWindow, WindowSolver

from psmpc_cli.control import Command
from psmpc_cli.control.multistart import even_shares, multistart_for, solve_from_several
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Outcome
from psmpc_cli.specs.task import ControllerSpec
from psmpc_cli.studies.one_window import OneWindow, instant_grid, scan_instants, with_priorities

from ..conftest import Recorder
from .test_controller import SHORT, Unreliable, run

COARSE = ("controller.nodes=20", "solver.kind=fatrop", "plant.kind=ideal", "log.plans=false", "log.shares=false")

Runs = Callable[..., tuple[Experiment, list[Command]]]


@pytest.fixture(scope="module")
def decided(experiment_of: Callable[..., Experiment]) -> Runs:
    """Decisions of Approach and Capture up to a time, on a coarse mesh."""

    def decided(until: float, *changes: str) -> tuple[Experiment, list[Command]]:
        experiment = experiment_of(*COARSE, *changes, task="approach_capture")
        recorder = Recorder(experiment.controller)
        for record in closed_loop(replace(experiment, controller=recorder)):
            if record.command.time > until - 1e-9:
                break
        return experiment, recorder.decided

    return decided


def again(experiment: Experiment, decision: Command, starts: int) -> SolvedWindow:
    """Solve a decision's window again from several guesses."""
    windows, prediction = experiment.controller.windows, decision.prediction
    return solve_from_several(windows, decision.solution.window, prediction, prediction.instants, None, starts)


def ahead(solved: SolvedWindow) -> float:
    """Return how far ahead the first instant lies [s]."""
    return float(solved.plan.instants[0]) - solved.plan.start


@pytest.mark.parametrize("starts", [2, 3])
def test_an_earlier_instant_that_costs_less_is_found(decided: Runs, starts: int) -> None:
    """With a small pending cost the last plan waits until the end of the horizon, in the worse of two basins."""
    experiment, decisions = decided(7.3, "controller.pending_cost=0.1")
    waiting = decisions[-1]
    assert ahead(waiting.solved) > 3.99
    best = again(experiment, waiting, starts)
    assert best.basin == 1
    assert ahead(best) < 3.0
    assert best.solution.objective < 0.9 * waiting.solved.solution.objective


def test_a_later_instant_that_costs_less_is_found(decided: Runs) -> None:
    """As printed, J may fall with the instant; the last plan does not see it."""
    experiment, decisions = decided(9.3, "controller.pending_cost=0", "stages.capture.priority=0.01")
    early = decisions[-1]
    assert ahead(early.solved) < 1.0
    best = again(experiment, early, 3)
    assert best.basin == 2
    assert ahead(best) > 3.99
    assert best.solution.objective < 0.9 * early.solved.solution.objective


def test_the_better_basin_is_kept_once_it_is_found(experiment_of: Callable[..., Experiment]) -> None:
    """One change, not one a sample; and what waiting had cost is gone."""
    task = (*COARSE, "controller.pending_cost=0.1")
    _, once = run(experiment_of(*task, task="approach_capture"))
    records, ending = run(experiment_of(*task, "controller.multistart=2", task="approach_capture"))
    assert once.completed
    assert ending.completed
    assert ending.time < once.time - 3.0
    assert [record.command.solution.basin for record in records if record.command.solution.basin > 0] == [1]


def test_with_the_whole_pending_cost_nothing_changes(experiment_of: Callable[..., Experiment]) -> None:
    one, ending = run(experiment_of(*COARSE, task="approach_capture"))
    several, same = run(experiment_of(*COARSE, "controller.multistart=3", task="approach_capture"))
    assert ending.time == same.time
    for before, after in zip(one, several, strict=True):
        np.testing.assert_array_equal(before.instants, after.instants)
        np.testing.assert_array_equal(before.Q, after.Q)
    assert {record.command.solution.basin for record in one} == {-1}
    assert {record.command.solution.basin for record in several if len(record.command.instants)} <= {0, -1}
    assert sum(record.command.solution.basin == 0 for record in several) > 30


@pytest.mark.parametrize("priority", [0.01, 1, 100])
def test_with_the_whole_pending_cost_no_instant_is_better_than_the_solvers(decided: Runs, priority: float) -> None:
    """Instants on a dense grid, denser about the solver's own, each held while all else is optimized."""
    experiment, decisions = decided(9.4, f"stages.capture.priority={priority}")
    for decision in [d for d in decisions if len(d.plan.instants) == 1][4::8]:
        solved = decision.solution
        one = OneWindow("", experiment, solved.window, solved.plan)
        near = ahead(solved) + np.array([-0.05, -0.01, 0.0, 0.002, 0.01, 0.05])
        scan = scan_instants(one, np.union1d(instant_grid(one.window.horizon, 15), near))
        assert len(scan.instants) > 8
        assert scan.with_pending(1.0).min() == pytest.approx(solved.solution.objective, rel=1e-6)


def test_other_priorities_than_those_that_led_to_a_state_may_leave_a_second_basin(decided: Runs) -> None:
    """Even with the whole pending cost, at the end of the horizon; it is the worse one, and a plan in it is left."""
    experiment, decisions = decided(9.3)
    one = with_priorities(OneWindow("", experiment, decisions[-1].solved.window, decisions[-1].plan), (1.0, 1.0))
    scan = scan_instants(one, instant_grid(one.window.horizon, 15)).with_pending(1.0)
    assert scan[-1] < scan[-2]
    assert int(np.argmin(scan)) == 0
    windows, late = experiment.controller.windows, np.array([one.window.start + 3.95])
    waiting = windows.solve(one.window, one.plan, late, None, 0.049)
    assert waiting.solution.objective > 2 * scan[0]
    best = solve_from_several(windows, one.window, waiting.plan, waiting.plan.instants, None, 3)
    assert best.solution.objective <= scan[0] * (1 + 1e-6)
    assert ahead(best) < 1.0


class Counting(WindowSolver):
    """Keeps what it solves."""

    def __init__(self, windows: WindowSolver) -> None:
        super().__init__(windows.task, windows.model, windows.costs)
        self._compiled, self.solved = windows._compiled, list[SolvedWindow]()

    def solve(self, window: Window, *rest: object):
        self.solved.append(super().solve(window, *rest))
        return self.solved[-1]


@pytest.mark.parametrize("starts", [1, 2, 4])
def test_time_and_iterations_count_every_solve(
    experiment_of: Callable[..., Experiment], decisions: list[Command], starts: int
) -> None:
    decision = next(d for d in decisions if len(d.plan.instants) == 1 and "appended" not in d.events)
    windows, instants = Counting(experiment_of(*COARSE).controller.windows), decision.prediction.instants
    best = solve_from_several(windows, decision.solution.window, decision.prediction, instants, None, starts)
    assert len(windows.solved) >= starts
    assert best.solution.iterations == sum(one.solution.iterations for one in windows.solved)
    assert best.solution.wall_time == sum(one.solution.wall_time for one in windows.solved)
    assert best.basin == (-1 if starts == 1 else 0)


def test_several_switches_are_guessed_in_their_order(
    experiment_of: Callable[..., Experiment], decisions: list[Command]
) -> None:
    decision = next(d for d in decisions if len(d.plan.instants) == 2 and "appended" not in d.events)
    windows, instants = Counting(experiment_of(*COARSE).controller.windows), decision.prediction.instants
    window = replace(decision.solution.window, pending_cost=0.0)
    best = solve_from_several(windows, window, decision.prediction, instants, None, 4)
    own = windows.solved[0]
    assert best.solution.objective <= own.solution.objective
    for solved in windows.solved:
        assert np.all(np.diff(solved.plan.instants) > 0)
        if solved.solution.outcome.usable and solved.window.pending_cost == 0:
            assert best.solution.objective <= solved.solution.objective * (1 + 2e-4)


def test_a_window_without_a_solution_is_not_scanned(
    experiment_of: Callable[..., Experiment], decisions: list[Command]
) -> None:
    decision = next(d for d in decisions if len(d.plan.instants) == 1 and "appended" not in d.events)
    windows = Unreliable(experiment_of(*COARSE).controller.windows, lambda now: True)
    instants = decision.prediction.instants
    best = solve_from_several(windows, decision.solution.window, decision.prediction, instants, None, 3)
    assert best.basin == -1
    assert best.solution.outcome is Outcome.ITERATION_LIMIT


def test_a_fixed_time_leaves_nothing_to_guess(
    experiment_of: Callable[..., Experiment], decisions: list[Command]
) -> None:
    decision = next(d for d in decisions if len(d.plan.instants) == 1 and "appended" not in d.events)
    first, second = decision.solution.window.stages
    timed = replace(decision.solution.window, stages=(replace(first, at=float(decision.plan.instants[0])), second))
    windows = Counting(experiment_of(*COARSE).controller.windows)
    solve_from_several(windows, timed, decision.prediction, decision.prediction.instants, None, 3)
    assert len(windows.solved) == 1


def test_hard_switching_has_no_instant_to_guess(experiment_of: Callable[..., Experiment]) -> None:
    records, ending = run(experiment_of(*SHORT, "controller.kind=hard", "controller.multistart=3"))
    assert ending.completed
    assert {record.command.solution.basin for record in records} == {-1}


@given(switches=st.integers(1, 4), count=st.integers(1, 20))
def test_guesses_are_in_order_from_the_earliest_to_the_latest(switches: int, count: int) -> None:
    shares, half_step = even_shares(switches, count)
    assert shares.shape == (count, switches)
    assert np.all(np.diff(shares, axis=1) >= 0)
    assert len({tuple(row) for row in shares}) == count
    assert np.all(shares[0] == 0)
    assert count == 1 or np.all(shares[-1] == 1)
    assert 0 < half_step <= 0.5


@pytest.mark.parametrize(
    ("controller", "starts"),
    [
        (ControllerSpec(), 1),
        (ControllerSpec(pending_cost=0.99), 3),
        (ControllerSpec(pending_cost=0.0, multistart=1), 1),
        (ControllerSpec(multistart=5), 5),
    ],
)
def test_a_sweep_guesses_more_than_once_where_basins_are_to_be_expected(
    controller: ControllerSpec, starts: int
) -> None:
    assert multistart_for(controller) == starts
