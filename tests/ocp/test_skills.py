"""Residuals of the skills."""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from psmpc_cli.ocp.objective import StageCosts, stage_functions
from psmpc_cli.ocp.stage import Stage, StageShape
from psmpc_cli.robot.model import RobotModel, load_robot

from ..free_flyer import KINDS, Array

Pointing = Callable[[float, float], float]


@pytest.fixture(scope="module")
def pointing(model: RobotModel, stages: tuple[Stage, ...], costs: StageCosts) -> Pointing:
    """The angle of the first arm's axis, at a point in a direction from its end-effector and so far away."""
    frame = model.pose_rows["arm_1"]

    def angle(direction: float, distance: float) -> float:
        x, y, theta = np.asarray(model.g(np.zeros(9))).ravel()[frame]
        point = [x + distance * np.cos(theta + direction), y + distance * np.sin(theta + direction)]
        stage = replace(stages[0].with_target(np.r_[0, 0, 0, point, 1e3, 1e3]), space="point")
        return float(costs.errors(stage, np.zeros((1, 18)))[0, 3])

    return angle


@given(direction=st.floats(-3.1, 3.1), distance=st.floats(0.01, 100))
def test_an_axis_is_off_its_point_by_an_angle_at_any_distance(
    pointing: Pointing, direction: float, distance: float
) -> None:
    assert pointing(direction, distance) == pytest.approx(-direction, abs=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 3.1, np.pi])
@pytest.mark.parametrize("space", list(KINDS))
def test_derivatives_of_residuals_are_those_of_differences(space: str, angle: float) -> None:
    """At every size of the errors of base and arm, that of 180 deg included."""
    model = load_robot("free_flyer_arm")
    functions, at = stage_functions(model, StageShape(space)), np.r_[0.1, 0.2, 0.3, 0.2, -0.3, 0.1, 0.2, 0.1, -0.3]
    anchor = np.array([0.1, 0.7, -0.1, 0.7])
    anchor /= np.linalg.norm(anchor)
    found = model.charted(at, anchor).full().reshape(2, 7)
    wanted, away = found.copy(), Rotation.from_rotvec(angle * np.array([0.0, 0.6, 0.8]))
    for each in wanted:
        each[3:] = (Rotation.from_quat(each[[4, 5, 6, 3]]) * away).as_quat()[[3, 0, 1, 2]]
    wanted[:, 3:] *= np.sign((found[:, 3:] * wanted[:, 3:]).sum(axis=1, keepdims=True) + 1e-15)
    ahead = Rotation.from_quat(wanted[1, [4, 5, 6, 3]]).apply([2.0, 0.0, 0.0])
    target = {"joint": at[6:], "task": wanted[1], "point": wanted[1, :3] + ahead}
    numbers = np.r_[wanted[0], target[space], anchor, np.zeros(3)]

    def residual(Q: Array) -> Array:
        return np.asarray(functions.error.function(Q, numbers)).ravel()

    Q, step = ca.SX.sym("Q", model.n), 1e-6
    exact = ca.Function("J", [Q], [ca.jacobian(functions.error.function(Q, numbers), Q)])(at).full()
    assert np.isfinite(exact).all()
    assert np.linalg.norm(residual(at)[3:6]) == pytest.approx(angle, abs=1e-9)
    of_arm = {"joint": np.zeros(0), "task": residual(at)[9:12], "point": residual(at)[6:8]}
    assert space == "joint" or np.linalg.norm(of_arm[space]) == pytest.approx(
        angle, abs=1e-3 if space == "point" and angle > 3 else 1e-6
    )
    differences = np.column_stack(
        [(residual(at + step * e) - residual(at - step * e)) / (2 * step) for e in np.eye(model.n)]
    )
    np.testing.assert_allclose(exact, differences, atol=1e-6 * np.abs(exact).max())
