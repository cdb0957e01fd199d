"""The one finite-difference checker of all derivatives."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def jacobian_by_differences(function: Callable[[Array], Array], x: Array) -> Array:
    """Jacobian (m, n) of `function` (n,) -> (m,) at x by central differences of fourth order."""
    step = 1e-3
    columns = []
    for unit in np.eye(x.size):
        near, far = ((function(x + k * step * unit) - function(x - k * step * unit)) / (2 * k * step) for k in (1, 2))
        columns.append((4 * near - far) / 3)
    return np.column_stack(columns)


def assert_close_to_differences(actual: Array, differences: Array) -> None:
    """Equal up to what differences of fourth order can tell, relative to the largest entry."""
    np.testing.assert_allclose(actual, differences, rtol=0, atol=1e-8 * (1 + np.abs(differences).max()))
