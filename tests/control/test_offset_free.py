import numpy as np
import pytest

from psmpc_cli.control.offset_free import Offset

T = 0.1


def follow(true: np.ndarray, gain: float, samples: int, noise: float = 0.0, delay: int = 0) -> np.ndarray:
    """Estimate a disturbance (n,) of a double integrator whose control takes the estimate off; (samples, n)."""
    random = np.random.default_rng(4)
    Qdot, old, found = np.zeros(2), [np.zeros(2)] * delay, []
    offset: Offset | None = None
    for k in range(samples):
        old.append(Qdot + noise * random.standard_normal(2))
        seen = old.pop(0)
        offset = Offset.unknown(seen, delay) if offset is None else offset.after(seen, T, gain)
        u = np.array([np.sin(k), np.cos(k)]) - offset.d
        offset, Qdot = offset.commanding(np.tile(u, (5, 1))), Qdot + T * (u + true)
        found.append(offset.d)
    return np.array(found)


def test_nothing_is_estimated_at_first_and_where_there_is_nothing() -> None:
    np.testing.assert_array_equal(Offset.unknown(np.ones(3), 2).d, np.zeros(3))
    np.testing.assert_allclose(follow(np.zeros(2), 0.3, 20), 0, atol=1e-14)


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
    offset = Offset(np.array([0.1, 0.2]), np.zeros(2), (np.zeros(2),))
    after = offset.after(np.array([np.nan, 1.0]), T, 0.5)
    np.testing.assert_allclose(after.d, [0.1, 0.5 * (0.2 + 10.0)])
