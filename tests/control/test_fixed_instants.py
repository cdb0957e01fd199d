"""Time-dependent switching: stages that end at a given time, and windows whose switch times are held."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control import Command
from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.loop import Ending
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.solvers import Solution, Solver

from .runs import SHORT, run

Build = Callable[..., Experiment]

LATER = 0.3
"""Where a solve with a fixed time starts: the states of a guess whose switch is so much later [s]."""


def timed(**at: float) -> tuple[str, ...]:
    """Return changes that give stages a fixed end."""
    return tuple(
        change for name, time in at.items() for change in (f"stages.{name}.ends_when=null", f"stages.{name}.at={time}")
    )


def ends(samples: list[Sample], ending: Ending) -> dict[int, float]:
    """Return the switch times by stage index."""
    return {stage: time for s in samples for stage, time in s.command.switches} | dict(ending.switches)


@pytest.fixture(scope="module")
def solver(experiment_of: Build) -> Solver:
    return experiment_of("controller.nodes=20", "solver.kind=fatrop").controller.solver


@pytest.fixture(scope="module", params=[0, 1, 2], ids=["approach", "capture", "transport"])
def optimum(request: pytest.FixtureRequest, decisions: list[Command], solver: Solver) -> Solution:
    """The optimum half way between the detection of a switch and the switch."""
    found = [d for d in decisions if len(d.instants) == 1 and d.stage.index == request.param]
    chosen = found[len(found) // 2].solution
    return solver.solve(chosen.window, chosen.plan)


def test_a_switch_held_at_the_optimum_gives_the_optimal_cost_and_another_one_costs_more(
    solver: Solver, optimum: Solution
) -> None:
    held = solver.solve(optimum.window, optimum.plan, None, 0.0)
    assert held.plan.instants == pytest.approx(optimum.plan.instants, abs=1e-7)
    assert held.objective == pytest.approx(optimum.objective, rel=1e-6, abs=1e-6)
    later = solver.solve(optimum.window, replace(optimum.plan, instants=optimum.plan.instants + 0.1), None, 0.0)
    assert later.outcome.usable
    assert later.objective > optimum.objective + 1e-3


@pytest.mark.parametrize("with_condition", [True, False])
def test_a_fixed_time_at_the_optimum_gives_the_optimal_cost_or_less_without_its_condition(
    solver: Solver, optimum: Solution, with_condition: bool
) -> None:
    """The task files allow a time or a condition, a window both."""
    stage = replace(optimum.window.stages[0], at=float(optimum.plan.instants[0]))
    if not with_condition:
        stage = replace(stage, end_rows=(), tolerance=np.zeros(0))
    window = replace(optimum.window, stages=(stage, *optimum.window.stages[1:]))
    solved = solver.solve(window, replace(optimum.plan, instants=optimum.plan.instants + LATER))
    assert solved.outcome.usable
    assert solved.plan.instants == pytest.approx(optimum.plan.instants, abs=1e-7)
    if with_condition:
        assert solved.objective == pytest.approx(optimum.objective, rel=1e-6, abs=1e-6)
    else:
        assert solved.objective <= optimum.objective + 1e-7


@pytest.mark.parametrize("guess", [0.2, 0.9, 3.9])
def test_the_optimal_switch_time_does_not_depend_on_the_guess(
    solver: Solver, decisions: list[Command], guess: float
) -> None:
    """The pending cost makes it the earliest at which the condition can be met."""
    command = next(d for d in decisions if len(d.instants) == 1 and d.instants[0] - d.time < 1.4)
    guessed = replace(command.prediction, instants=np.array([command.time + guess]))
    solved = solver.solve(command.solution.window, guessed)
    assert solved.outcome.usable
    assert solved.plan.instants[0] == pytest.approx(command.instants[0], abs=1e-3)


@pytest.mark.parametrize("times", [(2.0, 4.0, 6.0), (1.234, 3.9995, 5.55), (2.0, 2.7, 3.1)])
def test_stages_end_at_their_fixed_times(experiment_of: Build, times: tuple[float, float, float]) -> None:
    at = dict(zip(("approach", "capture", "transport"), times, strict=True))
    samples, ending = run(experiment_of(*SHORT, *timed(**at)))
    assert ending.completed
    assert not any(sample.command.events & {"solve_failed", "braking"} for sample in samples)
    ended = ends(samples, ending)
    assert list(ended) == [0, 1, 2, 3]
    assert [ended[stage] for stage in range(3)] == pytest.approx(times, abs=1e-6)
    for command in (sample.command for sample in samples):
        known = np.array(times)[command.stage.index :][: len(command.instants)]
        np.testing.assert_allclose(command.instants, known, atol=1e-6)


def test_a_fixed_time_between_conditions(experiment_of: Build) -> None:
    """The stages around it switch by state; it does so by time, whatever the state."""
    samples, ending = run(experiment_of(*SHORT, *timed(capture=4.05)))
    ended = ends(samples, ending)
    assert ending.completed
    assert ended[0] < ended[1] < ended[2] < ended[3]
    assert ended[1] == pytest.approx(4.05, abs=1e-6)


def test_a_fixed_time_that_passed_before_its_stage_ends_it_with_the_next_sample(experiment_of: Build) -> None:
    samples, ending = run(experiment_of(*SHORT, *timed(capture=0.5)))
    ended = ends(samples, ending)
    assert ending.completed
    assert ended[0] > 0.5
    assert ended[1] - ended[0] <= 0.1 + 1e-9


def test_hard_switching_holds_a_fixed_time_to_the_sample(experiment_of: Build) -> None:
    at = {"approach": 2.0, "capture": 4.05, "transport": 6.0}
    samples, ending = run(experiment_of(*SHORT, *timed(**at), "controller.kind=hard"))
    ended = ends(samples, ending)
    assert [ended[stage] for stage in range(3)] == pytest.approx([2.0, 4.1, 6.0])
