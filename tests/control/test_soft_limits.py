"""Soft limits in closed loop: they give way to a measured state, never to an end condition."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.control import Command
from psmpc_cli.ocp.window import own_violations
from psmpc_cli.simulation.loop import closed_loop
from psmpc_cli.simulation.setup import Experiment

from ..conftest import Recorder

COARSE = ("controller.nodes=12", "plant.kind=ideal", "solver.kind=sqp", "log.shares=false")
NEAR = "limits={base: {position: [[-5, 5], [-0.01, 5], [-180 deg, 180 deg]]}}"
"""A limit 1 cm below where the base begins."""


def decided(experiment: Experiment) -> list[Command]:
    recorder = Recorder(experiment.controller)
    for _ in closed_loop(replace(experiment, controller=recorder)):
        pass
    return recorder.decided


def test_stages_are_seen_postponed_and_handed_over_as_with_hard_limits(
    experiment_of: Callable[..., Experiment],
) -> None:
    """What hard limits prove infeasible, an append too early, soft ones would meet by going faster than allowed."""
    runs = [decided(experiment_of(*COARSE, f"controller.soft_limits={soft}")) for soft in ("false", "true")]
    hard, soft = (
        [(d.sequence.first, d.sequence.last, "postponed" in d.events, "solve_failed" in d.events) for d in run]
        for run in runs
    )
    assert sum(postponed for _, _, postponed, _ in hard) > 0
    assert soft == hard
    for one, other in zip(*runs, strict=True):
        assert np.abs(one.plan.instants - other.plan.instants).max(initial=0.0) < 1e-3
    assert all((d.solution.violations < 1e-6).all() for d in runs[1])


@pytest.mark.parametrize("kind", ["psmpc", "htmpc"])
def test_a_state_measured_far_beyond_a_limit_is_led_back(experiment_of: Callable[..., Experiment], kind: str) -> None:
    """15 cm beyond it: hard limits leave no window a solution."""
    changes = (*COARSE, NEAR, f"controller.kind={kind}", "controller.htmpc.depth=2")
    x = experiment_of(*changes).x0.copy()
    x[1] = -0.15
    assert experiment_of(*changes, "controller.soft_limits=false").controller.decide(0.0, x).solve_failed
    decision = experiment_of(*changes, "controller.soft_limits=true").controller.decide(0.0, x)
    assert "solve_failed" not in decision.events
    assert all(level.solved for level in decision.levels)
    y = decision.plan.X[:, 1]
    assert (np.diff(y[y < -0.01]) > 0).all()
    assert (decision.solution.violations <= own_violations(x, decision.solution.window.stages) + 1e-6).all()


def test_limits_are_soft_where_measurements_are_noisy_unless_the_task_says_otherwise(
    experiment_of: Callable[..., Experiment],
) -> None:
    noisy = "uncertainty.noise.position=1e-3"
    assert not experiment_of(*COARSE).task.limits_are_soft
    assert experiment_of(*COARSE, noisy).task.limits_are_soft
    assert not experiment_of(*COARSE, noisy, "controller.soft_limits=false").task.limits_are_soft
    assert experiment_of(*COARSE, "controller.soft_limits=true").task.limits_are_soft


def test_ipopt_starts_from_the_multipliers_of_soft_limits_too(experiment_of: Callable[..., Experiment]) -> None:
    changes = ("controller.nodes=6", "plant.kind=ideal", "solver.kind=ipopt", "log.shares=false", "time_limit=0.3")
    decisions = decided(experiment_of(*changes, "controller.soft_limits=true"))
    warm = decisions[-1].solved
    assert warm.guess.lam_g is not None
    assert warm.guess.lam_x is not None
    assert len(warm.guess.lam_g) == len(warm.solution.lam_g)
    assert warm.solution.iterations < decisions[0].solved.solution.iterations
