"""Programs whose bounds on states are soft, by our own method and by PIQP, which gets an unknown for each violation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from psmpc_cli.ocp.velocity_form import Point
from psmpc_cli.solvers.qp_solution import QpSolution, QpStatus
from psmpc_cli.solvers.sqp_limits import NARROWEST_SOFT, moved_apart

from psmpc_cli.ocp.window import PENALTY, scaled_violations, shares_of_time

from ..optimality import objective
from ..random_programs import Task, random_task, unattainable
from .both_methods import ours, piqp

SEEDS, FEATURES = st.integers(0, 2**32 - 1), st.sets(st.sampled_from(("equal", "fixed", "inputs", "tied")))
NODES = st.sampled_from([(1,), (4,), (3, 2), (2, 3, 2)])


def softened(task: Task) -> Task:
    low, high = moved_apart(task.limits.X_low, task.limits.X_high, NARROWEST_SOFT)
    return replace(task, limits=replace(task.limits, X_low=low, X_high=high, soft=True))


def moved(task: Task, rng: np.random.Generator) -> Task:
    """The same program with every third bound of a state where no step need reach it."""
    away = np.where(rng.random(task.limits.X_low.shape) < 1 / 3, rng.normal(size=task.limits.X_low.shape), 0.0)
    limits = replace(task.limits, X_low=task.limits.X_low + away, X_high=task.limits.X_high + away)
    return replace(task, limits=limits)


def shares(task: Task) -> np.ndarray:
    return shares_of_time(task.form.steps(task.point, task.horizon))[1:]


def costs_of_violations(task: Task, step: Point) -> float:
    X = (task.point.X + step.X)[1:]
    return float((shares(task) * scaled_violations(X, task.limits.X_low, task.limits.X_high)).sum())


def total(task: Task, found: QpSolution) -> float:
    return objective(task.model, found.step) + costs_of_violations(task, found.step)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, nodes=NODES, what=FEATURES)
def test_both_methods_violate_what_cannot_be_met_at_the_same_cost(
    seed: int, nodes: tuple[int, ...], what: set[str]
) -> None:
    rng = np.random.default_rng(seed)
    task = softened(moved(random_task(rng, nodes, what), rng))
    found, other = ours(task), piqp(task)
    assert found.status is QpStatus.SOLVED
    assert (np.abs(found.X) <= PENALTY * shares(task) * (1 + 1e-9)).all()
    if other.status is QpStatus.SOLVED:
        assert total(task, found) == pytest.approx(total(task, other), rel=1e-6, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, nodes=NODES, what=FEATURES)
def test_a_program_that_hard_bounds_allow_has_the_same_solution_with_soft_ones(
    seed: int, nodes: tuple[int, ...], what: set[str]
) -> None:
    task = softened(random_task(np.random.default_rng(seed), nodes, what))
    hard, soft = ours(replace(task, limits=replace(task.limits, soft=False))), ours(task)
    assert hard.status is soft.status is QpStatus.SOLVED
    if (np.abs(hard.X) < PENALTY * shares(task)).all():
        assert costs_of_violations(task, soft.step) < 1e-6
        assert objective(task.model, soft.step) == pytest.approx(objective(task.model, hard.step), rel=1e-6, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, what=FEATURES)
def test_soft_bounds_do_not_help_where_an_end_condition_cannot_be_met(seed: int, what: set[str]) -> None:
    task = softened(unattainable(random_task(np.random.default_rng(seed), (3, 2), what)))
    assert ours(task).status is QpStatus.INFEASIBLE
