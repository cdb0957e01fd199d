import numpy as np
import pytest

from psmpc_cli.control.controller import Estimator, State
from psmpc_cli.specs.load import load_task

T, TICKS = 0.1, 5


def estimator(gain: float = 0.3, delay: int = 0, n: int = 2, offset_free: bool = True) -> Estimator:
    changes = [f"controller.offset_free={offset_free}", f"controller.known_delay={delay}", f"uncertainty.delay={delay}"]
    spec = load_task("transport", changes).spec.controller.model_copy(update={"offset_gain": gain})
    return Estimator(spec, T / TICKS, n)


def follow(true: np.ndarray, gain: float, samples: int, noise: float = 0.0, delay: int = 0) -> np.ndarray:
    """Estimate a disturbance (n,) of a double integrator; (samples, n)."""
    random, estimating = np.random.default_rng(4), estimator(gain, delay)
    v, old, found = np.zeros(2), [np.zeros(2)] * delay, []
    for k in range(samples):
        old.append(v + noise * random.standard_normal(2))
        u = estimating.command(np.tile([np.sin(k), np.cos(k)], (TICKS, 1)), old.pop(0))
        v = v + T * (u.mean(axis=0) + true)
        found.append(estimating.d)
    return np.array(found)


@pytest.mark.parametrize("delay", [0, 1, 10])
@pytest.mark.parametrize("gain", [0.1, 0.3, 1.0])
def test_a_constant_disturbance_is_found_at_the_filter_s_pace_however_old_measurements_are(
    gain: float, delay: int
) -> None:
    true = np.array([0.2, -0.5])
    left = 1 - follow(true, gain, 30 + delay, delay=delay)[delay:] / true
    expected = (1 - gain) ** np.arange(30)
    np.testing.assert_allclose(left, np.tile(expected[:, None], 2), atol=1e-12)


def test_a_smaller_gain_lets_less_noise_through() -> None:
    quiet, loud = (follow(np.zeros(2), gain, 2000, 1e-3).std() for gain in (0.1, 1.0))
    assert quiet < 0.3 * loud


def test_a_measurement_that_is_not_finite_changes_no_estimate() -> None:
    estimating, u = estimator(0.5), np.zeros((TICKS, 2))
    estimating.command(u, np.zeros(2))
    estimating.command(u, np.array([np.nan, 1.0]))
    np.testing.assert_allclose(estimating.d, [0.0, 5.0])


def test_without_a_delay_the_measured_state_is_the_one_to_decide_from() -> None:
    state = State(np.zeros(2), np.ones(2))
    assert estimator().foreseen(state) is state


def test_the_foreseen_state_follows_what_was_planned_since_the_measurement() -> None:
    """Two samples of 0.1 s under 1 and 2 m/s^2 from rest at 7: 7 + 0.005 + 0.01 + 0.01 m, and 0.3 m/s."""
    estimating, state = estimator(delay=2, offset_free=False), State(np.full(2, 7.0), np.zeros(2))
    np.testing.assert_allclose(estimating.foreseen(state).x, state.x)
    for u in (1.0, 2.0):
        estimating.command(np.full((TICKS, 2), u), np.zeros(2))
    np.testing.assert_allclose(estimating.foreseen(state).x, [7.025, 7.025, 0.3, 0.3], atol=1e-12)
