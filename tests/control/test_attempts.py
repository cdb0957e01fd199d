"""Windows that a sample tries one after another."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from time import perf_counter

import numpy as np
import pytest

from psmpc_cli.control import Controller
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window
from psmpc_cli.simulation.run import Experiment, build_experiment, closed_loop
from psmpc_cli.solvers import Outcome, Solution, Solver
from psmpc_cli.specs.load import load_task

from .short_transports import SHORT, run, with_failures

Build = Callable[..., Experiment]


def test_an_append_that_cannot_be_solved_is_postponed(experiment_of: Build) -> None:
    fails = with_failures(experiment_of(*SHORT), lambda window: len(window.stages) > 1 and window.start < 0.95)
    samples, ending = run(fails)
    postponed = [s.command for s in samples if "postponed" in s.command.events and s.command.time < 0.95]
    assert postponed
    assert all(command.outcome.usable and len(command.switch_times) == 0 for command in postponed)
    assert ending.completed


def test_an_append_whose_solve_ran_out_of_iterations_goes_on_from_its_iterate(experiment_of: Build) -> None:
    changes = (*SHORT, "solver.kind=sqp")
    usual = next(s for s in closed_loop(experiment_of(*changes)) if "appended" in s.command.events).command
    limited = with_failures(experiment_of(*changes), lambda w: len(w.stages) > 1 and w.start < usual.time + 0.25)
    resumed = next(s for s in closed_loop(limited) if "appended" in s.command.events).command
    assert resumed.time == pytest.approx(usual.time + 0.3)
    assert resumed.solution.iterations < usual.solution.iterations


def test_a_first_window_that_ran_out_of_iterations_goes_on_at_the_next_sample() -> None:
    changes = {"solver.max_iterations": 2, "solver.entry_iterations": None, "controller.nodes": 12, "log.shares": False}
    commands = [s.command for s in islice(closed_loop(build_experiment(load_task("thrust_and_reach", changes))), 4)]
    assert [command.outcome for command in commands] == [Outcome.ITERATION_LIMIT, *3 * [Outcome.FEASIBLE]]


def test_entering_stages_are_solved_over_several_samples_where_their_iterations_are_limited(
    experiment_of: Build,
) -> None:
    changes = (*SHORT, "solver.kind=sqp")
    usual = next(s for s in closed_loop(experiment_of(*changes)) if "appended" in s.command.events).command
    assert usual.solution.iterations > 1
    experiment = experiment_of(*changes, "solver.entry_iterations=1")
    windows = list[Solution]()
    samples, ending = run(replace(experiment, controller=Controller(experiment.problem, Noting(experiment, windows))))
    entered = next(s for s in samples if "appended" in s.command.events).command
    began = [solution.window.start for solution in windows if len(solution.window.stages) > 1]
    tried = [solution for solution in windows if usual.time - 1e-9 <= solution.window.start <= entered.time + 1e-9]
    assert usual.time <= entered.time <= usual.time + 0.1 * usual.solution.iterations + 1e-9
    assert began[0] == pytest.approx(usual.time)
    assert {solution.iterations for solution in tried if not solution.warm} == {1}
    assert all(command.outcome.usable for command in (sample.command for sample in samples))
    assert ending.completed


def test_a_planned_end_whose_solve_ran_out_of_iterations_goes_on_from_its_iterate(experiment_of: Build) -> None:
    """Guesses of windows over one stage before and after its end are told from those without the end."""
    changes = (*SHORT, "solver.kind=sqp", "controller.kind=hard", "controller.one_stage=free_end")
    usual = next(s for s in closed_loop(experiment_of(*changes)) if len(s.command.switch_times)).command
    limited = with_failures(experiment_of(*changes), lambda w: len(w.stages) > 1 and w.start < usual.time + 0.25)
    commands = [sample.command for sample in islice(closed_loop(limited), 20)]
    resumed = next(command for command in commands if len(command.switch_times))
    assert resumed.time == pytest.approx(usual.time + 0.3)
    assert resumed.solution.iterations < usual.solution.iterations
    assert all(command.outcome.usable for command in commands)


class Noting(Solver):
    """The solver of an experiment that notes its solutions."""

    def __init__(self, experiment: Experiment, solutions: list[Solution]) -> None:
        self.solver = experiment.controller.law.solver
        self.solutions = solutions

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        solver = self.solver.stopping(np.inf, self._most_iterations)
        self.solutions.append(solver.solve(window, guess, previous, within))
        return self.solutions[-1]


class OnlyCold(Solver):
    """A solver that finds no solution of warm windows with a planned end, and notes when they began."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self.without = list[float]()

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        solution = self.solver.solve(window, guess, previous, within)
        if not solution.warm or len(window.stages) == 1:
            return solution
        self.without.append(window.start)
        return replace(solution, outcome=Outcome.INFEASIBLE)


def test_a_warm_window_without_a_solution_is_solved_once_more_as_a_cold_one(experiment_of: Build) -> None:
    usual = experiment_of(*SHORT, "solver.kind=sqp")
    solver = OnlyCold(usual.controller.law.solver)
    samples, ending = run(replace(usual, controller=Controller(usual.problem, solver)))
    again = [sample.command for sample in samples if sample.command.time in solver.without]
    assert ending.completed
    assert again
    assert all(len(command.switch_times) for command in again)
    sample_time = usual.controller.problem.spec.controller.sample_time
    # where a switch is imminent the plan in force makes it
    solved = [each.solution for each in again if each.switch_times[0] > each.time + sample_time]
    assert solved
    assert all(solution.outcome.usable and not solution.warm for solution in solved)


class Clocked(Solver):
    """A solver that records when each solve has to stop, by the beginning of its window."""

    deadline = 0.03

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self.stops = defaultdict[float, list[float]](list)

    def _solve(self, window: Window, guess: Plan, previous: Solution | None, within: float) -> Solution:
        self.stops[window.start].append(self.stop_time(perf_counter()))
        return self.solver.solve(window, guess, previous, within)


def test_all_solves_of_a_sample_share_its_deadline(experiment_of: Build) -> None:
    fails = with_failures(experiment_of(*SHORT), lambda window: len(window.stages) > 1 and window.start < 0.95)
    clocked = Clocked(fails.controller.law.solver)
    list(closed_loop(replace(fails, controller=Controller(fails.problem, clocked))))
    several = [stops for stops in clocked.stops.values() if len(stops) > 1]
    assert several
    for window_with, *windows_without in several:  # which are left a share of it
        assert len(set(windows_without)) == 1
        assert 0 < windows_without[0] - window_with < Clocked.deadline
    lasts = [stops[-1] for stops in clocked.stops.values()]
    assert len(set(lasts)) == len(lasts)  # each sample has a deadline of its own
