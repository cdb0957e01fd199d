"""HTMPC: strict levels, none at an earlier one's expense."""

from collections.abc import Callable
from itertools import islice

import numpy as np
import pytest
from scipy.integrate import trapezoid

from psmpc_cli.control.htmpc import LEAST_COST
from psmpc_cli.logs.summary import LEVEL_ACCURACY
from psmpc_cli.ocp.window import window_shape
from psmpc_cli.simulation.run import Experiment, closed_loop, simulate
from psmpc_cli.solvers import NlpSolver, Solution
from psmpc_cli.specs.load import load_task

from .short_transports import SHORT, run, states

HTMPC = (*SHORT, "controller.kind=htmpc")
EXACT = 1e-6
"""What a solve may leave of its constraints, of a cost relative to it."""

Build = Callable[..., Experiment]


def test_one_level_is_hard_switching_exactly(experiment_of: Build) -> None:
    hard, _ = run(experiment_of(*SHORT, "time_limit=3", "controller.kind=hard"))
    htmpc, _ = run(experiment_of(*HTMPC, "time_limit=3", "controller.htmpc.depth=1"))
    np.testing.assert_array_equal(states(hard), states(htmpc))


@pytest.mark.slow
@pytest.mark.parametrize("changes", [[], ["controller.htmpc.tolerance=0.05"], ["controller.normalization=range"]])
def test_no_earlier_level_gets_worse_by_more_than_the_tolerance(changes: list[str]) -> None:
    task = load_task("transport", [*HTMPC, *changes, "time_limit=4"])
    log = simulate(task)
    objective, cost, solved = (log[f"levels/{name}"] for name in ("objective", "cost", "solved"))
    current = log["window/first"]
    assert np.all(np.isfinite(cost) == (solved == 1))
    assert np.all(solved[np.arange(len(current)), current] == 1)
    assert np.sum(solved[current < 3] == 1) > 2 * np.sum(current < 3)  # it looks beyond the current stage
    rise = (cost - objective)[solved == 1] / np.maximum(objective[solved == 1], LEAST_COST)
    tolerance = task.spec.controller.htmpc.tolerance
    assert np.mean(rise <= tolerance + LEVEL_ACCURACY) > 0.95
    assert rise.max() > 0.9 * tolerance  # and makes use of what it may
    np.testing.assert_allclose(
        log["levels/rise"][solved == 1], ((cost - objective) / objective)[solved == 1], atol=1e-12
    )
    summary = log.summary()
    assert summary.level_rise == pytest.approx(np.nanmax(log["levels/rise"]))
    assert summary.raised_levels == np.sum(log["levels/rise"] > tolerance + LEVEL_ACCURACY)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "stage", "samples"), [("transport", 0, 15), ("tracking", 1, 70)], ids=["still", "along a trajectory"]
)
def test_no_earlier_error_gets_worse_by_more_than_the_tolerance(
    experiment_of: Build, task: str, stage: int, samples: int
) -> None:
    tolerance, compared = 2e-3, 0
    changes = ("controller.kind=htmpc", "controller.htmpc.constraint=error", f"controller.htmpc.tolerance={tolerance}")
    short = SHORT if task == "transport" else ("controller.nodes=8", "plant.kind=ideal", "log.shares=false")
    experiment = experiment_of(*short, *changes, task=task)
    for sample in islice(closed_loop(experiment), samples):
        levels, sequence = sample.command.levels, sample.command.sequence
        if sequence.first == stage and len(levels) > 1 and levels[1].outcome.usable:
            first, second = (level.plan for level in levels[:2])
            since = first.times[1:] - sequence.progress.entered
            sizes = [
                np.abs(experiment.problem.costs.errors(experiment.problem.stages[stage], p.X[1:], since))
                for p in (first, second)
            ]
            assert np.all(sizes[1] <= sizes[0] + tolerance + EXACT)
            compared += 1
    assert compared > 4


@pytest.mark.slow
def test_all_levels_are_within_the_constraints_of_the_current_stage(experiment_of: Build) -> None:
    """While an object is caught, the levels of the stages that hold it ask for the force of a robot without it."""
    short = ("controller.nodes=8", "controller.horizon=2", "controller.kind=htmpc", "log.shares=false")
    command = next(closed_loop(experiment_of(*short, task="catch_drifting"))).command
    first, *later = (level.window.stages[0] for level in command.levels)
    assert later and "forces" in first.constraints
    assert all(stage.constraints == first.constraints for stage in later)
    assert command.levels[1].outcome.usable


def test_later_levels_lower_their_own_cost(experiment_of: Build) -> None:
    """What is left free after the first level goes to the next: its cost falls below that along the first plan."""
    experiment = experiment_of(*HTMPC, "controller.htmpc.tolerance=0.05")
    command = next(closed_loop(experiment)).command
    first, second = command.levels[:2]
    stage, costs = experiment.problem.stages[1], experiment.problem.costs
    assert second.outcome.usable
    plans = [(plan, np.vstack([plan.u, plan.u[-1:]])) for plan in (first.plan, second.plan)]
    along = [trapezoid(costs.at(stage, plan.X, u), plan.times) for plan, u in plans]
    assert along[1] < along[0]
    assert np.abs(command.u[0] - first.plan.u[0]).max() > 1e-3


def test_a_level_without_solution_leaves_the_plan_of_the_one_before(experiment_of: Build) -> None:
    """IPOPT solves the levels; one iteration is enough for none of them, while sqp solves the first."""
    once = (*HTMPC, "solver={kind: sqp, max_iterations: 1}")
    log = simulate(load_task("transport", [*once, "time_limit=0.1"]))
    assert log["levels/solved"][0].tolist() == [1, 0, -1, -1]
    assert np.isfinite(log["levels/cost"][0, 0])
    assert np.isnan(log["levels/cost"][0, 1:]).all()
    assert log["solver/status"][0] == "iteration_limit"
    assert log["solver/wall_time"][0] == pytest.approx(np.nansum(log["levels/wall_time"][0]))
    alone = next(closed_loop(experiment_of(*once, "controller.htmpc.depth=1")))
    np.testing.assert_array_equal(log["control/u"][0], alone.command.u[0])


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["cost", "error"])
def test_later_levels_keep_the_planned_end_of_the_current_stage(experiment_of: Build, constraint: str) -> None:
    changes = (*HTMPC, "controller.one_stage=free_end", f"controller.htmpc.constraint={constraint}")
    experiment = experiment_of(*changes)
    tolerance = experiment.problem.spec.controller.htmpc.tolerance
    compared = 0
    for sample in islice(closed_loop(experiment), 16):
        command = sample.command
        first, *later = command.levels
        if not len(command.switch_times):
            continue
        assert first.window.count == 1
        for level in (level for level in later if level.outcome.usable):
            compared += 1
            np.testing.assert_array_equal(level.plan.times, first.plan.times)
            at_end = level.plan.states_at(command.switch_times)[0]
            assert experiment.problem.costs.end_error(command.stage, at_end) <= 1 + 1e-3
            if constraint == "cost":
                assert level.costs_of_stages[0] <= first.costs_of_stages[-1] * (1 + tolerance + LEVEL_ACCURACY)
            else:
                since = first.plan.times[1:] - command.sequence.progress.entered
                errors = [
                    np.abs(experiment.problem.costs.errors(command.stage, solved.plan.X[1:], since))
                    for solved in (first, level)
                ]
                assert (errors[1] <= errors[0] + tolerance + EXACT).all()
        assert np.abs(command.plan.u - first.plan.u).max() > 1e-3  # and make use of what is left free
    assert compared > 10


@pytest.mark.slow
def test_a_planned_end_ends_stages_sooner() -> None:
    changes = (*HTMPC, "log.shares=true", "time_limit=2.5")
    published, log = (
        simulate(load_task("transport", [*changes, *more])) for more in ((), ("controller.one_stage=free_end",))
    )
    assert log.stages["switch_time"][0] < published.stages["switch_time"][0]
    solved = log["levels/solved"] == 1
    planned = np.isfinite(log["window/instants"]).any(axis=1)
    assert (solved[planned].sum(axis=1) > 1).any()
    cost, objective = log["levels/cost"], log["levels/objective"]
    assert (cost <= objective * (1 + log.task.spec.controller.htmpc.tolerance + LEVEL_ACCURACY))[solved].all()
    assert np.nansum(log["window/share"], axis=1) == pytest.approx(
        np.where(np.isnan(log["window/share"]).all(axis=1), 0, 1)
    )


@pytest.mark.slow
@pytest.mark.parametrize("end", ["as_published", "free_end"])
def test_levels_start_from_the_multipliers_of_the_sample_before(experiment_of: Build, end: str) -> None:
    """Windows of one shape do, and take fewer iterations to the optimum that others find, too; the rest start cold."""
    experiment = experiment_of(*HTMPC, f"controller.one_stage={end}")
    problem = experiment.problem
    spec = problem.spec.solver
    cold_solver, other = (NlpSolver(problem, each) for each in (spec.of_levels(), spec.to_optimum()))
    iterations = list[tuple[int, int]]()
    compared = 0
    before: tuple[Solution, ...] = ()
    for sample in islice(closed_loop(experiment), 6):
        levels = sample.command.levels
        shapes = {window_shape(level.window) for level in before if level.outcome.usable}
        for level, base in zip(levels[1:], levels, strict=False):
            assert (len(level.guess_duals) > 0) == (window_shape(level.window) in shapes)
            if len(level.guess_duals) and level.outcome.usable:
                cold = cold_solver.solve(level.window, base.plan, level, within=0.0)
                by_other = other.solve(level.window, base.plan, level, within=0.0)
                assert not len(cold.guess_duals) and not len(by_other.guess_duals)
                iterations.append((level.iterations, cold.iterations))
                for found in (found for found in (cold, by_other) if found.outcome.usable):
                    assert level.objective == pytest.approx(found.objective, rel=1e-5)
                    compared += 1
        before = levels
    taken, cold_taken = np.sum(iterations, axis=0)
    assert compared > 1.5 * len(iterations) > 8
    assert taken < 0.7 * cold_taken


def test_a_deadline_stops_the_levels_too() -> None:
    """Those of `sqp` are IPOPT's, which can stop early."""
    log = simulate(load_task("transport", [*HTMPC, "solver={kind: sqp, deadline: 1e-4}", "time_limit=0.1"]))
    assert log["levels/solved"][0].tolist() == [1, 0, -1, -1]
    assert log["solver/status"][0] == "deadline"
