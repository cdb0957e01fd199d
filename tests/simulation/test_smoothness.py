from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from psmpc_cli.simulation.smoothness import total_variation

CONTROLS = arrays(float, (6, 5), elements=st.floats(-9, 9))


class Controls:
    """As much of a log as is asked for."""

    coordinates = ("base.x", "base.y", "base.theta", "arm_1.1", "arm_1.2")

    def __init__(self, u: np.ndarray) -> None:
        self.u = u

    def __getitem__(self, path: str) -> np.ndarray:
        assert path == "control/u"
        return self.u


def variation(u: np.ndarray) -> np.ndarray:
    return np.array(astuple(total_variation(Controls(u))))


def test_steps_are_added_up_by_group() -> None:
    u = np.zeros((4, 5))
    u[1] = [1, -2, 3, 4, -5]
    np.testing.assert_array_equal(variation(u), [6, 6, 18])


@given(CONTROLS, st.floats(0.1, 10), arrays(float, 5, elements=st.floats(-9, 9)))
def test_it_scales_with_the_control_and_knows_no_constant(u: np.ndarray, by: float, constant: np.ndarray) -> None:
    np.testing.assert_allclose(variation(by * u + constant), by * variation(u), atol=1e-9)


@given(CONTROLS)
def test_no_way_between_two_values_is_smoother_than_a_monotone_one(u: np.ndarray) -> None:
    straight = np.linspace(u[0], u[-1], len(u))
    assert np.all(variation(straight) <= variation(u) + 1e-9)


@pytest.mark.parametrize("samples", [0, 1])
def test_a_run_that_has_hardly_begun_has_none(samples: int) -> None:
    np.testing.assert_array_equal(variation(np.ones((samples, 5))), 0.0)
