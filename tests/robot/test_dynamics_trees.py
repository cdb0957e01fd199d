"""Mass matrix, force and its derivatives as tapes evaluate them, on random trees with up to 40 joints and loads."""

import pytest

from .random_trees import differences


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_rigid_body_functions_are_casadis_and_pinocchios(seed: int) -> None:
    """To 1e-12 and 1e-10 of the largest entry; `python -m tests.robot.random_trees` has more trees."""
    for from_casadi, from_pinocchio in differences(seed).values():
        assert from_casadi < 1e-12
        assert from_pinocchio < 1e-10
