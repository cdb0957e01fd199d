from dataclasses import replace

import numpy as np
import pytest

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.simulation.setup import Experiment
from psmpc_cli.studies.bench_cost import cost_over_time
from psmpc_cli.studies.bench_windows import Recorded

from .small_bench import posed, recorded_run


@pytest.fixture(scope="module")
def run() -> tuple[Experiment, list[Recorded]]:
    return recorded_run()


def halved(plan: Plan) -> Plan:
    """The same plan with twice the intervals."""
    middles = (plan.times[1:] + plan.times[:-1]) / 2
    times = np.sort(np.r_[plan.times, middles])
    return Plan(times, plan.states_at(times), np.repeat(plan.u, 2, axis=0), plan.instants)


def test_the_cost_of_a_plan_does_not_depend_on_its_mesh(run: tuple[Experiment, list[Recorded]]) -> None:
    experiment, windows = run
    for recorded in windows[1:]:
        window, plan = recorded.before.window, recorded.before.plan
        once = cost_over_time(window, plan, experiment.costs)
        finer = replace(window, nodes=tuple(2 * nodes for nodes in window.nodes))
        assert cost_over_time(finer, halved(plan), experiment.costs) == pytest.approx(once, rel=1e-6)


def test_sums_come_near_the_integral_on_finer_meshes(run: tuple[Experiment, list[Recorded]]) -> None:
    off = []
    for nodes in (5, 10):
        optimum = posed(*run, f"controller.nodes={nodes}")[2].optimum
        assert optimum is not None
        off.append(abs(optimum.objective - optimum.over_time))
    assert 0 < off[1] < 0.7 * off[0]


def test_a_terminal_cost_counts(run: tuple[Experiment, list[Recorded]]) -> None:
    experiment, windows = run
    window, plan = windows[1].before.window, windows[1].before.plan
    without, once, twice = (
        cost_over_time(replace(window, terminal_cost=kappa), plan, experiment.costs) for kappa in (0.0, 1.0, 2.0)
    )
    assert once > without
    assert twice - without == pytest.approx(2 * (once - without))
