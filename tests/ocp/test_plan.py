import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from psmpc_cli.ocp.plan import Plan, braking_plan, mesh, resting_plan, shift


@st.composite
def plans(draw: st.DrawFn) -> Plan:
    """Plans of two coordinates whose states follow exactly from their controls."""
    steps = draw(arrays(float, st.integers(1, 8), elements=st.floats(1e-3, 0.5)))
    u = draw(arrays(float, (len(steps), 2), elements=st.floats(-2, 2)))
    x = draw(arrays(float, 4, elements=st.floats(-1, 1)))
    times, X = draw(st.floats(0, 20)) + np.r_[0, np.cumsum(steps)], [x]
    for h, a in zip(steps, u, strict=True):
        Q, Qdot = X[-1][:2], X[-1][2:]
        X.append(np.r_[Q + h * Qdot + h**2 / 2 * a, Qdot + h * a])
    return Plan(times, np.array(X), u, np.array([times[0] + steps.sum() / 2]))


@given(st.lists(st.tuples(st.integers(1, 9), st.floats(1e-3, 3)), min_size=1, max_size=4), st.floats(0, 20))
def test_a_mesh_divides_each_stage_into_equal_intervals(stages: list[tuple[int, float]], start: float) -> None:
    """Paper (19): N_s intervals of stage s, each as long as the stage over N_s."""
    nodes, tau = zip(*stages, strict=True)
    ends = start + np.cumsum((0.0, *tau))
    times = mesh(ends, nodes)
    np.testing.assert_allclose(times[np.cumsum((0, *nodes))], ends, rtol=1e-12)
    np.testing.assert_allclose(np.diff(times), np.repeat(np.divide(tau, nodes), nodes), atol=1e-11)


@given(plans())
def test_states_between_nodes_continue_the_node_before_them(plan: Plan) -> None:
    middle = (plan.times[:-1] + plan.times[1:]) / 2
    half = (np.diff(plan.times) / 2)[:, None]
    X = plan.states_at(middle)
    np.testing.assert_allclose(X[:, 2:], plan.X[:-1, 2:] + half * plan.u, atol=1e-9)
    np.testing.assert_allclose(X[:, :2], plan.X[:-1, :2] + half * plan.X[:-1, 2:] + half**2 / 2 * plan.u, atol=1e-9)


@given(plans(), st.integers(1, 60))
def test_mean_control_over_ticks_gives_the_plans_velocities_at_the_ticks(plan: Plan, ticks: int) -> None:
    edges = np.linspace(plan.start, plan.end, ticks + 1)
    u = plan.mean_control(edges)
    Qdot = plan.X[0, 2:] + np.cumsum(np.diff(edges)[:, None] * u, axis=0)
    np.testing.assert_allclose(Qdot, plan.states_at(edges[1:])[:, 2:], atol=1e-8)


@given(plans(), st.floats(0, 1))
def test_shifted_plan_agrees_with_the_plan_where_both_are(plan: Plan, share: float) -> None:
    now = plan.start + share * (plan.end - plan.start)
    shifted = shift(plan, now, 3.0, plan.states_at(np.array([now]))[0])
    later = np.linspace(now, min(plan.end, shifted.end), 7)
    np.testing.assert_allclose(shifted.states_at(later), plan.states_at(later), atol=1e-8)
    assert shifted.start == now
    assert shifted.end == now + 3.0
    assert np.all(shifted.switch_times > now)


def test_a_shifted_plan_coasts_past_the_end_of_the_old_one() -> None:
    plan = resting_plan(0.0, 1.0, 4, np.array([1.0, 0.5]))
    np.testing.assert_allclose(shift(plan, 0.5, 1.0, np.array([1.25, 0.5])).X[-1], [1.75, 0.5])


@pytest.mark.parametrize(("horizon", "end"), [(0.0, 2.5), (4.0, 6.0)])
def test_braking_plan_ends_at_rest(horizon: float, end: float) -> None:
    plan = braking_plan(2.0, np.array([1.0, -1.0, 0.2, -0.1]), 0.5, horizon)
    assert plan.end == end
    np.testing.assert_allclose(plan.states_at(np.array([2.5, 3.0])), [[1.05, -1.025, 0, 0]] * 2, atol=1e-12)
