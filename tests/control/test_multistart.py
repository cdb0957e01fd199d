"""Several guesses of the planned switch times: which basin wins, what that costs, and where there is but one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.control import Command
from psmpc_cli.control.multistart import even_shares, multistart_for, solve_from_several
from psmpc_cli.ocp.end import AtTime
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.run import Experiment, closed_loop
from psmpc_cli.solvers import Outcome, Solution, Solver
from psmpc_cli.specs.controller import ControllerSpec

from .short_transports import Unreliable, run, states

COARSE = (
    "controller.nodes=20",
    "controller.zeta=1e-3",
    "skills.move.weights.control=0.03",
    "skills.reach.weights.control=0.03",
    "stages.capture.ends_when.tolerance=2e-3",
    "onset={kind: control}",
    "solver.kind=fatrop",
    "plant.kind=ideal",
    "log.plans=false",
    "log.shares=false",
)

Build = Callable[..., Experiment]


class Counting(Solver):
    """Keeps what it solves."""

    def __init__(self, solver: Solver) -> None:
        self.solver, self.solved = solver, list[Solution]()

    def solve(self, window: Window, guess: Plan, previous: Solution | None = None, within: float = np.inf) -> Solution:
        self.solved.append(self.solver.solve(window, guess, previous, within))
        return self.solved[-1]

    _solve = solve


@pytest.fixture
def counting(experiment_of: Build) -> Counting:
    return Counting(experiment_of(*COARSE).controller.law.solver)


@pytest.fixture(scope="module")
def switching(decisions: list[Command]) -> Command:
    """A command with a switch planned, after the sample of its detection."""
    return next(d for d in decisions if len(d.plan.switch_times) == 1 and "appended" not in d.events)


def decided(experiment: Experiment, until: float) -> Command:
    """Return the command of a run at a time [s]."""
    return next(s.command for s in closed_loop(experiment) if s.command.time > until - 1e-9)


def ahead(solution: Solution) -> float:
    """Return how far ahead the first switch lies [s]."""
    return float(solution.plan.switch_times[0]) - solution.plan.start


@pytest.mark.slow
@pytest.mark.parametrize("starts", [2, 3])
def test_an_earlier_switch_that_costs_less_is_found(experiment_of: Build, starts: int) -> None:
    """With a small pending cost the last plan waits until the end of the horizon, in the worse of two basins."""
    experiment = experiment_of(*COARSE, "controller.pending_cost=0.1", task="approach_capture")
    waiting = decided(experiment, 7.3)
    assert ahead(waiting.solution) > 3.99
    solver, window = experiment.controller.law.solver, waiting.solution.window
    best = solve_from_several(solver, window, waiting.prediction, None, starts)
    assert best.basin == 1
    assert ahead(best) < 3.0
    assert best.objective < 0.9 * waiting.solution.objective


@pytest.mark.slow
def test_the_better_basin_is_kept_once_it_is_found(experiment_of: Build) -> None:
    """One change, not one a sample; and what waiting had cost is gone."""
    task = (*COARSE, "controller.pending_cost=0.1")
    _, once = run(experiment_of(*task, task="approach_capture"))
    samples, ending = run(experiment_of(*task, "controller.multistart=2", task="approach_capture"))
    assert once.completed
    assert ending.completed
    assert ending.time < once.time - 3.0
    basins = [sample.command.solution.basin for sample in samples]
    assert [basin for basin in basins if basin > 0] == [1]


@pytest.mark.slow
def test_with_the_whole_pending_cost_nothing_changes(experiment_of: Build) -> None:
    coarser = (*COARSE, "controller.nodes=12")
    one, ending = run(experiment_of(*coarser, task="approach_capture"))
    several, same = run(experiment_of(*coarser, "controller.multistart=3", task="approach_capture"))
    assert ending.time == same.time
    np.testing.assert_array_equal(states(one), states(several))
    assert {sample.command.solution.basin for sample in one} == {-1}
    basins = [sample.command.solution.basin for sample in several if len(sample.command.switch_times)]
    assert set(basins) <= {0, -1}
    assert basins.count(0) > 30


@pytest.mark.parametrize("starts", [2, 4])
def test_time_and_iterations_count_every_solve(counting: Counting, switching: Command, starts: int) -> None:
    best = solve_from_several(counting, switching.solution.window, switching.prediction, None, starts)
    assert len(counting.solved) >= starts
    assert best.iterations == sum(one.iterations for one in counting.solved)
    assert best.wall_time == sum(one.wall_time for one in counting.solved)
    assert best.basin == 0


@pytest.mark.slow
def test_several_switches_are_guessed_in_their_order(counting: Counting, decisions: list[Command]) -> None:
    command = next(d for d in decisions if len(d.plan.switch_times) == 2 and "appended" not in d.events)
    window = replace(command.solution.window, pending_cost=0.0)
    best = solve_from_several(counting, window, command.prediction, None, 4)
    assert best.objective <= counting.solved[0].objective
    for solved in counting.solved:
        assert np.all(np.diff(solved.plan.switch_times) > 0)
        if solved.outcome.usable and solved.window.pending_cost == 0:
            assert best.objective <= solved.objective * (1 + 2e-4)


def test_a_window_without_a_solution_is_solved_once(counting: Counting, switching: Command) -> None:
    failing = Counting(Unreliable(counting.solver, lambda window: True))
    best = solve_from_several(failing, switching.solution.window, switching.prediction, None, 3)
    assert (best.basin, best.outcome, len(failing.solved)) == (-1, Outcome.ITERATION_LIMIT, 1)


def test_a_fixed_time_leaves_nothing_to_guess(counting: Counting, switching: Command) -> None:
    first, second = switching.solution.window.stages
    timed = replace(
        switching.solution.window, stages=(replace(first, end=AtTime(at=float(switching.plan.switch_times[0]))), second)
    )
    solve_from_several(counting, timed, switching.prediction, None, 3)
    assert len(counting.solved) == 1


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
def test_a_sweep_guesses_more_than_once_where_basins_are_expected(controller: ControllerSpec, starts: int) -> None:
    assert multistart_for(controller) == starts
