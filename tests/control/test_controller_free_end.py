"""Windows over one stage with its end condition at a free instant."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from psmpc_cli.logs.run import Run
from psmpc_cli.ocp.problem import build_problem
from psmpc_cli.simulation.replay import logged_solve, replay
from psmpc_cli.simulation.run import Experiment, simulate
from psmpc_cli.solvers import build_solver
from psmpc_cli.specs.controller import SolverSpec
from psmpc_cli.specs.load import load_task

from .short_transports import SHORT, run, with_failures

Build = Callable[..., Experiment]

FREE_END = ("controller.kind=hard", "controller.one_stage=free_end")

KEYS_OF_PSMPC = (
    "skills.move.weights.control=4",
    "skills.reach.weights.control=4",
    "stages.approach.ends_when.tolerance=2e-3",
    "stages.capture.ends_when.tolerance=1.1e-3",
    "stages.transport.ends_when.tolerance=2e-3",
    "stages.release.ends_when.tolerance=0.012",
)


@cache
def transport_with(*changes: str) -> Run:
    """Return a run of the transport task with 25 nodes a stage."""
    return simulate(load_task("transport", ["controller.nodes=25", *changes]))


def samples_with_an_end(log: Run) -> np.ndarray:
    """Return the samples whose windows have a planned end."""
    return np.flatnonzero(np.isfinite(log["window/instants"]).any(axis=1))


def test_without_the_key_windows_have_no_end(experiment_of: Build) -> None:
    samples, _ = run(experiment_of(*SHORT, "controller.kind=hard"))
    assert not any(len(sample.command.switch_times) for sample in samples)


def test_the_window_holds_one_stage_before_and_after_its_planned_end(experiment_of: Build) -> None:
    samples, ending = run(experiment_of(*SHORT, *FREE_END))
    assert ending.completed
    planned = [sample.command for sample in samples if len(sample.command.switch_times)]
    assert {command.stage.index for command in planned} == {0, 1, 2}
    for command in planned:
        first, again = command.solution.window.stages
        assert first.index == again.index == command.sequence.first
        assert command.events.isdisjoint({"appended", "postponed"})
    assert not any(sample.metrics["window/presence"] for sample in samples)


def test_a_stage_ends_when_its_plan_has_it_end(experiment_of: Build) -> None:
    """On 8 nodes a later end would pay, since the intervals before it are finer than those after it."""
    experiment = experiment_of(*SHORT, *FREE_END, "controller.nodes=25")
    samples, _ = run(experiment)
    costs = experiment.problem.costs
    planned = {sample.command.stage.index: sample for sample in samples if len(sample.command.switch_times)}
    switches = dict(switch for sample in samples for switch in sample.command.switches)
    for stage, last in planned.items():
        command = last.command
        assert switches[stage] == command.switch_times[0] < command.edges[-1] + 1e-3
        error = costs.end_error(command.stage, command.plan.states_at(command.switch_times)[0])
        assert error == pytest.approx(1.0, abs=1e-3)  # the pending cost has it end as soon as it may


@pytest.mark.slow
@pytest.mark.parametrize(("keys", "sooner"), [((), 0.5), (KEYS_OF_PSMPC, 14.0)], ids=["own keys", "keys of psmpc"])
def test_stages_end_sooner_than_those_that_creep_up_to_their_targets(keys: tuple[str, ...], sooner: float) -> None:
    """The last stage has no planned end; the keys of the task for hard switching are such that it hardly creeps."""
    published = transport_with("controller.kind=hard", *keys)
    log = transport_with(*FREE_END, *keys)
    assert log.summary().succeeded
    assert published.summary().duration - log.summary().duration >= sooner
    gained = published.stages["switch_time"] - log.stages["switch_time"]
    assert (np.diff(gained)[:2] > -0.1).all()


@pytest.mark.slow
def test_the_log_claims_no_other_stage_in_the_window() -> None:
    log = transport_with(*FREE_END)
    samples = samples_with_an_end(log)
    first = log["window/first"]
    assert len(samples) > 100
    assert (log["window/count"] == 1).all()
    for name in ("instants", "cost", "nodes", "share"):
        others = log[f"window/{name}"][samples].copy()
        others[np.arange(len(samples)), first[samples]] = np.nan
        assert np.isnan(others).all(), name
    assert (log["window/share"][np.arange(len(first)), first] == 1).all()
    assert np.isnan(log["window/presence"]).all()
    assert not any(stage.early for stage in log.summary().stages)
    assert not log["events/appended"].any()
    assert (log["window/nodes_after_end"] == np.where(np.isin(np.arange(len(first)), samples), 25, 0)).all()
    assert log.summary().switching_solves.count == len(samples)


@pytest.mark.slow
def test_the_solves_of_such_windows_are_repeated_from_the_log() -> None:
    log = transport_with(*FREE_END)
    for sample in samples_with_an_end(log)[::20].tolist():
        again = replay(log, sample)
        assert len(again.logged.window.stages) == 2
        assert again.largest == 0.0


@pytest.mark.slow
def test_sqp_finds_the_optimum_that_ipopt_finds_from_its_plan() -> None:
    log = transport_with(*FREE_END)
    logged = logged_solve(log, int(samples_with_an_end(log)[10]))
    problem = build_problem(log.task)
    window = logged.window.about(logged.plan)
    found = build_solver(problem, SolverSpec(kind="sqp", iterations=50)).solve(window, logged.guess)
    reference = build_solver(problem, SolverSpec(kind="ipopt")).solve(window, found.plan)
    assert found.outcome.usable
    assert reference.outcome.usable
    assert found.objective == pytest.approx(reference.objective, rel=1e-6)
    assert found.plan.switch_times == pytest.approx(reference.plan.switch_times, abs=1e-4)
    np.testing.assert_allclose(found.plan.X, reference.plan.X, atol=1e-3)


@pytest.mark.slow
def test_a_stage_that_ends_at_a_time_ends_then(experiment_of: Build) -> None:
    changes = ("stages.approach.ends_when=null", "stages.approach.at=2.034")
    samples, _ = run(experiment_of(*SHORT, *FREE_END, *changes, "time_limit=2.5"))
    switches = dict(switch for sample in samples for switch in sample.command.switches)
    assert switches[0] == pytest.approx(2.034, abs=1e-6)


def test_a_trajectory_does_not_begin_again_after_the_planned_end(experiment_of: Build) -> None:
    changes = (*FREE_END, "controller.nodes=8", "plant.kind=ideal", "log.shares=false")
    experiment = experiment_of(*changes, task="tracking")
    samples, ending = run(experiment)
    assert ending.completed
    moving = {stage.index for stage in experiment.problem.stages[:-1] if stage.reference.moves}
    planned = [sample.command for sample in samples if len(sample.command.switch_times)]
    windows = [command.solution.window for command in planned if command.stage.index in moving]
    assert windows
    for window in windows:
        assert [stage.reference.moves for stage in window.stages] == [True, False]
        np.testing.assert_array_equal(window.stages[1].target, window.stages[0].target)


def test_the_planned_end_may_have_no_solution(experiment_of: Build) -> None:
    """Then the window is the one without it, as it is published."""
    changes = (*SHORT, "time_limit=1.5", "controller.kind=hard")
    hard, _ = run(experiment_of(*changes))
    failing = with_failures(experiment_of(*changes, FREE_END[1]), lambda window: len(window.stages) > 1)
    free, _ = run(failing)
    for one, other in zip(hard, free, strict=True):
        np.testing.assert_array_equal(one.command.u, other.command.u)
        assert len(other.command.switch_times) == 0
