"""Time-dependent switching: stages that end at a given time, and windows whose switch times are held."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control import Command
from psmpc_cli.logs.schema import Sample
from psmpc_cli.simulation.recorder import Ending
from psmpc_cli.simulation.run import Experiment
from psmpc_cli.solvers import Solver

from .short_transports import SHORT, run

Build = Callable[..., Experiment]


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
    return experiment_of("controller.nodes=20", "solver.kind=fatrop").controller.law.solver


@pytest.mark.parametrize("guess", [0.2, 0.9, 3.9])
def test_the_optimal_switch_time_does_not_depend_on_the_guess(
    solver: Solver, decisions: list[Command], guess: float
) -> None:
    """The pending cost makes it the earliest at which the condition can be met."""
    command = next(d for d in decisions if len(d.switch_times) == 1 and d.switch_times[0] - d.time < 1.4)
    guessed = replace(command.prediction, switch_times=np.array([command.time + guess]))
    solved = solver.solve(command.solution.window, guessed)
    assert solved.outcome.usable
    assert solved.plan.switch_times[0] == pytest.approx(command.switch_times[0], abs=1e-3)


@pytest.mark.slow
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
        known = np.array(times)[command.stage.index :][: len(command.switch_times)]
        np.testing.assert_allclose(command.switch_times, known, atol=1e-6)


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
