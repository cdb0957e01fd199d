from pathlib import Path

import pytest

from .floating_windows import fast_arms_in


@pytest.fixture(scope="module")
def fast_arms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot of Table I with joints of 0.6 rad/s and no other limits."""
    return fast_arms_in(tmp_path_factory.mktemp("robots"))
