from collections.abc import Iterator

import mujoco
import numpy as np
import pytest


@pytest.fixture(autouse=True)
def own_warnings() -> Iterator[None]:
    """A plant sets where MuJoCo's warnings go; restore that."""
    before = mujoco.get_mju_user_warning()
    yield
    mujoco.set_mju_user_warning(before)


@pytest.fixture
def x() -> np.ndarray:
    """A state of the planar dual arm in motion."""
    random = np.random.default_rng(3)
    return np.r_[0.3, -0.2, 0.5, 0.4 * random.standard_normal(6), 0.1 * random.standard_normal(9)]
