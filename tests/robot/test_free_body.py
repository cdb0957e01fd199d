"""Bodies that fly freely."""

import numpy as np
import pytest

from psmpc_cli.robot.free_body import FreeBody


def test_tumbling_body_keeps_momentum_and_energy() -> None:
    body = FreeBody(3.0, [1.0, 2.0, 2.5])
    Q, v = np.array([1, 2, 3, 0.5, 0.5, 0.5, 0.5]), np.array([0.1, -0.2, 0.3, 0.4, 0.9, -0.2])
    later = body.predicted(Q, v, 8.0)
    assert body.momentum(*later) == pytest.approx(body.momentum(Q, v), abs=1e-6)
    assert body.kinetic_energy(later[1]) == pytest.approx(body.kinetic_energy(v), abs=1e-7)
    assert body.predicted(*later, -8.0)[0] == pytest.approx(Q, abs=1e-6)


def test_several_times_are_predicted_as_one_by_one() -> None:
    body = FreeBody(3.0, [0.6, 0.4, 0.5])
    pose = [0.1, -0.2, 0.3, *np.array([0.9, 0.1, -0.3, 0.2]) / np.sqrt(0.95)]
    v = [0.01, 0.02, -0.03, 0.1, 0.2, -0.15]
    times = np.array([0.0, 0.3, 2.0, 4.0])
    poses, velocities = body.predicted(pose, v, times)
    for at, of_pose, of_velocity in zip(times, poses, velocities, strict=True):
        np.testing.assert_allclose(body.predicted(pose, v, at)[0], of_pose, atol=1e-8)
        np.testing.assert_allclose(body.predicted(pose, v, at)[1], of_velocity, atol=1e-8)
