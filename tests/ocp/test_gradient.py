import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from psmpc_cli.ocp.gradient import Rollout
from psmpc_cli.ocp.problem import Stage
from psmpc_cli.ocp.window import window_shape
from psmpc_cli.robot.model import RobotModel

from .test_transcription import window_over


@given(seed=st.integers(0, 2**32 - 1), shares=st.tuples(*[st.floats(0.2, 1.0)] * 3))
@settings(max_examples=8, deadline=None)
def test_adjoint_equals_differentiation_and_differences(
    model: RobotModel, stages: tuple[Stage, ...], seed: int, shares: tuple[float, ...]
) -> None:
    """Three stages, two instants, any controls. Paper eq. (25), with U fixed on the mesh."""
    window = window_over(stages[:3])
    rollout = Rollout(model, window_shape(stages[:3], (4,) * 3, "exact"), window, np.array([2.0, 3.0]))
    tau = 4.0 * np.array(shares) / sum(shares)
    U = list(np.random.default_rng(seed).standard_normal((3, 4, 9)))
    adjoint = rollout.by_adjoint(tau, U)
    scale = np.abs(adjoint).max()
    np.testing.assert_allclose(adjoint, rollout.by_differentiation(tau, U), atol=1e-8 * scale)
    np.testing.assert_allclose(adjoint, rollout.by_differences(tau, U), atol=1e-6 * scale)
