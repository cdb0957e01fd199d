"""Laws of the double integrator."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from psmpc_cli.robot.configuration import PLANE
from psmpc_cli.robot.motion import (
    advanced,
    averaged_control,
    braking,
    braking_under_jerk,
    mean_control,
    over_ticks,
    ramped_control,
    rollout,
    slew_limited,
    step,
    velocity_shares,
)

K = 4
N = 3

U = arrays(float, (K, N), elements=st.floats(-3, 3))
X0 = arrays(float, 2 * N, elements=st.floats(-3, 3))
STEPS = arrays(float, K, elements=st.floats(0.01, 2))


@given(X0, U, STEPS)
def test_a_rollout_takes_step_after_step(x: np.ndarray, u: np.ndarray, steps: np.ndarray) -> None:
    X = rollout(x, u, steps)
    assert X[0] == pytest.approx(x)
    assert X[1:] == pytest.approx(advanced(X[:-1], u, steps[:, None]), abs=1e-9)


@given(X0, U, st.floats(0.01, 2), st.sampled_from(["exact", "euler"]))
def test_steps_as_expressions_have_the_shares_of_velocities_at_their_ends(
    x: np.ndarray, u: np.ndarray, h: float, discretization: str
) -> None:
    """Q+ - Q = h (a Qdot + b Qdot+)."""
    after = np.asarray(step(discretization)(ca.DM(x), ca.DM(u[0]), h)).ravel()
    a, b = velocity_shares(discretization)
    assert after[:N] - x[:N] == pytest.approx(h * (a * x[N:] + b * after[N:]), abs=1e-9)
    assert after[N:] == pytest.approx(x[N:] + h * u[0])
    if discretization == "exact":
        assert after == pytest.approx(advanced(x[None], u[:1], h)[0], abs=1e-9)


@given(X0, st.floats(0.01, 5))
def test_braking_ends_at_rest_where_it_says(x: np.ndarray, duration: float) -> None:
    u, at_rest = braking(x, duration, np.ones(len(x) // 2, bool))
    assert advanced(x[None], u[None], duration)[0] == pytest.approx(at_rest, abs=1e-9)
    assert at_rest[N:] == pytest.approx(np.zeros(N))


@given(X0, U, STEPS, st.integers(1, 9))
def test_ticks_under_the_mean_control_have_the_velocities_of_the_plan(
    x: np.ndarray, u: np.ndarray, steps: np.ndarray, count: int
) -> None:
    times = np.concatenate([[0.0], np.cumsum(steps)])
    edges = np.linspace(0.0, times[-1], count + 1)
    mean = mean_control(u, times, edges)
    tick = times[-1] / count
    _, velocities = over_ticks(PLANE, x[:N], x[N:], mean, tick)
    assert velocities[-1] == pytest.approx(rollout(x, u, steps)[-1, N:], abs=1e-9)


@given(U, STEPS, arrays(float, N, elements=st.floats(-3, 3)), st.integers(1, 30))
def test_ramps_are_no_steeper_than_the_changes_between_the_middles_of_intervals(
    u: np.ndarray, steps: np.ndarray, before: np.ndarray, count: int
) -> None:
    times = np.concatenate([[0.0], np.cumsum(steps)])
    tick = steps[0] / 7
    edges = tick * np.arange(count + 1)
    ramped = ramped_control(u, times, edges, before)
    lengths = np.concatenate([[tick], steps, steps[-1:]])
    changes = np.diff(np.vstack([before, u, np.zeros(N)]), axis=0)
    steepest = np.abs(changes / ((lengths[:-1] + lengths[1:]) / 2)[:, None]).max(axis=0)
    assert (np.abs(np.diff(ramped, axis=0, prepend=before[None])) <= tick * steepest * (1 + 1e-9) + 1e-12).all()


@given(U, STEPS, st.floats(0.1, 2))
def test_velocities_under_ramps_stay_near_those_of_the_plan(u: np.ndarray, steps: np.ndarray, jerk: float) -> None:
    """By a quarter of the steepest ramp times the square of the longest interval; ticks are sampled, not integrated."""
    h = float(steps.max())
    changes = np.clip(u, -jerk * h, jerk * h)
    changes[0] = np.clip(u[0], -jerk * h / 2, jerk * h / 2)
    u = np.cumsum(changes, axis=0)
    times = h * np.arange(K + 1)
    edges = np.linspace(0.0, times[-1] - h / 2, 2001)
    tick = edges[1]
    ramped = ramped_control(u, times, edges, np.zeros(N))
    apart = tick * np.cumsum(ramped - mean_control(u, times, edges), axis=0)
    assert np.abs(apart).max() <= jerk * h**2 / 4 * (1 + 1e-2)


@given(U, st.floats(0.01, 1), st.floats(0.01, 1))
def test_limited_slew_is_kept_and_nothing_else_changed(u: np.ndarray, down: float, up: float) -> None:
    before = np.zeros(N)
    limited = slew_limited(u, before, np.full(u.shape, -down), np.full(u.shape, up))
    changes = np.diff(limited, axis=0, prepend=before[None])
    assert (changes >= -down - 1e-12).all()
    assert (changes <= up + 1e-12).all()
    free = np.full(u.shape, np.inf)
    assert slew_limited(u, before, -free, free) is u
    np.testing.assert_array_equal(slew_limited(limited, before, np.full(u.shape, -6.1), np.full(u.shape, 6.1)), limited)


@pytest.mark.slow
@given(
    arrays(float, N, elements=st.floats(-1, 1)),
    arrays(float, N, elements=st.floats(-1, 1)),
    st.floats(0.2, 3),
    st.floats(0.2, 3),
)
def test_braking_under_jerk_ends_at_rest(v: np.ndarray, before: np.ndarray, down: float, up: float) -> None:
    """What is applied ramps to it, holds, and ramps to 0; ticks leave their length times what was applied."""
    duration = 2 * (1 / min(down, up) + np.sqrt(1.5 * (1 + 1 / min(down, up)) / min(down, up)))
    u = braking_under_jerk(v, duration, before, np.full(N, -down), np.full(N, up))
    tick = 1e-3
    holding, resting = round(duration / tick), round(20 / tick)
    wanted = np.concatenate([np.broadcast_to(u, (holding, N)), np.zeros((resting, N))])
    applied = slew_limited(wanted, before, np.full(wanted.shape, -down * tick), np.full(wanted.shape, up * tick))
    assert np.abs(v + tick * applied.sum(axis=0)).max() < 3 * tick
    np.testing.assert_array_equal(
        braking_under_jerk(v, duration, before, np.full(N, -np.inf), np.full(N, np.inf)), -v / duration
    )


def test_averaged_control_is_the_mean_about_each_tick_and_does_not_jump() -> None:
    u = np.array([[1.0], [-1.0], [0.5]])
    times = np.array([0.0, 0.25, 0.5, 1.0])
    edges = np.linspace(0.0, 0.4, 41)
    averaged = averaged_control(u, times, edges, np.zeros(1), 0.1)
    middles = (edges[:-1] + edges[1:]) / 2
    far = (middles > 0.06) & (np.abs(middles - 0.25) > 0.06)
    np.testing.assert_allclose(averaged[far, 0], np.where(middles < 0.25, 1.0, -1.0)[far], atol=1e-12)
    # 0.1 s and a tick pass from one acceleration to the other
    assert np.abs(np.diff(averaged[:, 0])).max() <= 2 * 0.01 / 0.11 + 1e-12
    assert averaged[0, 0] == pytest.approx(0.5, abs=0.06)
    assert np.all(np.abs(averaged) <= 1.0)


def test_over_no_width_averaged_control_is_the_mean_over_each_tick() -> None:
    u = np.array([[1.0], [3.0]])
    averaged = averaged_control(u, np.array([0.0, 0.15, 1.0]), np.array([0.0, 0.1, 0.2]), np.zeros(1), np.zeros(2))
    np.testing.assert_allclose(averaged, [[1.0], [2.0]])
