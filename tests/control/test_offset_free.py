import numpy as np
import pytest

from psmpc_cli.control.offset_free import Offset, estimate

T = 0.1


def follow(true: np.ndarray, gain: float, samples: int, noise: float = 0.0) -> np.ndarray:
    """Estimate a disturbance (n,) of a double integrator whose control takes the estimate off; (samples, n)."""
    random = np.random.default_rng(4)
    Qdot, before, found = np.zeros(2), None, []
    for k in range(samples):
        seen = Qdot + noise * random.standard_normal(2)
        d = estimate(before, seen, T, gain)
        u = np.array([np.sin(k), np.cos(k)]) - d
        before, Qdot = Offset(d, seen, u), Qdot + T * (u + true)
        found.append(d)
    return np.array(found)


def test_nothing_is_estimated_at_first_and_where_there_is_nothing() -> None:
    np.testing.assert_array_equal(estimate(None, np.ones(3), T, 0.3), np.zeros(3))
    np.testing.assert_allclose(follow(np.zeros(2), 0.3, 20), 0, atol=1e-14)


@pytest.mark.parametrize("gain", [0.1, 0.3, 1.0])
def test_a_constant_disturbance_is_found_at_the_filter_s_pace(gain: float) -> None:
    true = np.array([0.2, -0.5])
    left = 1 - follow(true, gain, 30) / true
    expected = (1 - gain) ** np.arange(30)
    np.testing.assert_allclose(left, np.tile(expected[:, None], 2), atol=1e-12)


def test_a_smaller_gain_lets_less_noise_through() -> None:
    quiet, loud = (follow(np.zeros(2), gain, 2000, 1e-3).std() for gain in (0.1, 1.0))
    assert quiet < 0.3 * loud
