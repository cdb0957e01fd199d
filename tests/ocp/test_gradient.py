import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.gradient import Rollout
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.model import RobotModel

from .transport_windows import moving, window_over


@pytest.mark.parametrize("trajectories", [False, True], ids=["still", "moving"])
@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), shares=st.tuples(*[st.floats(0.2, 1.0)] * 3))
def test_adjoint_equals_differentiation_and_differences(
    model: RobotModel, stages: tuple[Stage, ...], trajectories: bool, seed: int, shares: tuple[float, ...]
) -> None:
    """Three stages, two switch times, any controls. Paper eq. (25), with U fixed on the mesh."""
    of = (stages[0], moving(stages[1]), moving(stages[2], 2)) if trajectories else stages[:3]
    rollout = Rollout(model, window_over(of, terminal_cost=0.5), np.array([2.0, 3.0]))
    tau = 4.0 * np.array(shares) / sum(shares)
    U = list(np.random.default_rng(seed).standard_normal((3, 4, 9)))
    adjoint = rollout.by_adjoint(tau, U)
    scale = np.abs(adjoint).max()
    np.testing.assert_allclose(adjoint, rollout.by_differentiation(tau, U), atol=1e-8 * scale)
    np.testing.assert_allclose(adjoint, rollout.by_differences(tau, U), atol=1e-6 * scale)
