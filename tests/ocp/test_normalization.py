import numpy as np
import pytest

from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.problem import Stage, StageCosts
from psmpc_cli.ocp.window import normalization

STEP = 0.1


def moving_plan(nodes: int) -> Plan:
    """A plan that moves the base at 0.2 m/s; the same motion on any mesh."""
    times = np.linspace(0, 4, nodes + 1)
    X = np.zeros((nodes + 1, 18))
    X[:, 0], X[:, 9] = -0.2 * times, -0.2
    return Plan(times, X, np.zeros((nodes, 9)), np.zeros(0))


def test_nadir_is_the_largest_cost_of_the_prediction(stages: tuple[Stage, ...], costs: StageCosts) -> None:
    plan = moving_plan(40)
    offset, scale = normalization("nadir", 1e-3, stages[:2], np.zeros(2), costs, plan, STEP)
    largest = [costs.along(stage, plan.X, plan.u).max() for stage in stages[:2]]
    np.testing.assert_allclose(scale, np.array(largest) + 1e-3, rtol=1e-9)
    assert not offset.any()


def test_range_subtracts_the_smallest_cost(stages: tuple[Stage, ...], costs: StageCosts) -> None:
    plan = moving_plan(40)
    offset, scale = normalization("range", 1e-3, stages[:2], np.zeros(2), costs, plan, STEP)
    over_nodes = [costs.along(stage, plan.X, plan.u) for stage in stages[:2]]
    np.testing.assert_allclose(offset, [values.min() for values in over_nodes], rtol=1e-9)
    np.testing.assert_allclose(scale, [np.ptp(values) + 1e-3 for values in over_nodes], rtol=1e-9)


def test_none_leaves_the_cost_as_it_is(stages: tuple[Stage, ...], costs: StageCosts) -> None:
    offset, scale = normalization("none", 1e-3, stages[:2], np.zeros(2), costs, moving_plan(4), STEP)
    assert offset.tolist() == [0, 0]
    assert scale.tolist() == [1, 1]


@pytest.mark.parametrize("width", [1e-2, 1e-4])
def test_a_short_tall_control_counts_by_what_it_does_to_the_velocity(
    stages: tuple[Stage, ...], costs: StageCosts, width: float
) -> None:
    """Intervals shrink to nothing before a switch; the scale must not follow the height of one control there."""
    times = np.array([0.0, 1.02, 1.02 + width, 4.0])
    u = np.zeros((3, 9))
    u[1, 3] = 0.1 / width
    X = np.zeros((4, 18))
    X[2:, 12] = 0.1
    X[3, 3] = 0.1 * (4 - 1.02 - width)
    _, scale = normalization("nadir", 1e-3, stages[:1], np.zeros(1), costs, Plan(times, X, u, np.zeros(0)), STEP)
    at_start = costs.along(stages[0], X[:1], u[:1])[0]
    assert scale[0] < at_start + 100 * 0.3**2 + 1.0 + 1.0
