"""Soft limits in closed loop: they give way to a measured state, never to an end condition."""

from collections.abc import Callable

import numpy as np
import pytest

from psmpc_cli.control import State
from psmpc_cli.ocp.constraints.boxes import initial_violations
from psmpc_cli.simulation.run import Experiment

from .short_transports import run

COARSE = ("controller.nodes=12", "plant.kind=ideal", "solver.kind=sqp", "log.shares=false")
NEAR = "limits={base: {position: [[-5, 5], [-0.01, 5], [-180 deg, 180 deg]]}}"
"""A limit 1 cm below where the base begins."""

Build = Callable[..., Experiment]


@pytest.mark.slow
def test_stages_are_seen_postponed_and_ended_as_with_hard_limits(experiment_of: Build) -> None:
    """What hard limits prove infeasible, an append too early, soft ones would meet by going faster than allowed."""
    light = ("skills.move.weights.control=0.03", "skills.reach.weights.control=0.03", "controller.zeta=1e-3")
    tight = ("stages.capture.ends_when.tolerance=2e-3",)
    changes = [(*COARSE, *light, *tight, f"controller.soft_limits={kind}") for kind in ("false", "true")]
    hard, soft = (run(experiment_of(*each))[0] for each in changes)
    assert any("postponed" in sample.command.events for sample in hard)
    for one, other in zip(hard, soft, strict=True):
        assert one.command.events == other.command.events
        assert one.command.sequence.first == other.command.sequence.first
        assert np.abs(one.command.plan.switch_times - other.command.plan.switch_times).max(initial=0.0) < 1e-3
        assert (other.command.solution.violations < 1e-6).all()


@pytest.mark.parametrize("kind", ["psmpc", "htmpc"])
@pytest.mark.slow
def test_a_state_measured_far_beyond_a_limit_is_led_back(experiment_of: Build, kind: str) -> None:
    """15 cm beyond it: hard limits leave no window a solution."""
    changes = (*COARSE, NEAR, f"controller.kind={kind}", "controller.htmpc.depth=2")
    x = experiment_of(*changes).initial_state.copy()
    x[1] = -0.15
    hard, soft = (experiment_of(*changes, f"controller.soft_limits={kind}").controller for kind in ("false", "true"))
    assert "solve_failed" in hard.step(0.0, State.of(x)).events
    command = soft.step(0.0, State.of(x))
    assert "solve_failed" not in command.events
    assert all(level.outcome.usable for level in command.levels)
    y = command.plan.X[:, 1]
    assert (np.diff(y[y < -0.01]) > 0).all()
    assert (command.solution.violations <= initial_violations(x, command.solution.window.stages) + 1e-6).all()


def test_limits_are_soft_where_measurements_are_noisy_unless_the_task_says_otherwise(experiment_of: Build) -> None:
    noisy = "uncertainty.noise.position=1e-3"
    assert not experiment_of(*COARSE).problem.limits_are_soft
    assert experiment_of(*COARSE, noisy).problem.limits_are_soft
    assert not experiment_of(*COARSE, noisy, "controller.soft_limits=false").problem.limits_are_soft
    assert experiment_of(*COARSE, "controller.soft_limits=true").problem.limits_are_soft
