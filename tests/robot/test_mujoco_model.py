"""Agreement with an independent rigid-body library on random robots."""

import mujoco
import numpy as np
import pytest
from hypothesis import given

from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.mujoco_model import mujoco_spec
from psmpc_cli.specs.load import load_robot
from psmpc_cli.specs.robots.robot import RobotSpec

from .strategies import Array, State, laws, moving_robots


def engine_at(spec: RobotSpec, Q: Array, v: Array) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot in MuJoCo, at a state."""
    model = mujoco_spec(spec).compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = Q, v
    mujoco.mj_forward(model, data)
    return model, data


@given(moving_robots())
@laws
def test_dynamics_agree(state: State) -> None:
    model, Q, v, third = state
    engine, data = engine_at(model.spec, Q, v)
    H = np.zeros((model.n, model.n))
    for column, unit in zip(H, np.eye(model.n), strict=True):
        mujoco.mj_mulM(engine, data, column, unit)
    np.testing.assert_allclose(model.mass_matrix(Q), H, rtol=0, atol=1e-10 * max(1.0, np.abs(H).max()))
    np.testing.assert_allclose(model.bias(Q, v), data.qfrc_bias, atol=1e-9)
    data.qacc[:] = third
    mujoco.mj_inverse(engine, data)
    np.testing.assert_allclose(model.inverse_dynamics(Q, v, third), data.qfrc_inverse, atol=1e-9)
    data.qfrc_applied[:] = third
    mujoco.mj_forward(engine, data)
    np.testing.assert_allclose(model.forward_dynamics(Q, v, third), data.qacc, atol=1e-9)


@given(moving_robots())
@laws
def test_poses_agree(state: State) -> None:
    model, Q, Qdot, _ = state
    _, data = engine_at(model.spec, Q, Qdot)
    for frame, (x, y, angle) in zip(model.pose_rows, model.poses(Q), strict=True):
        site = data.site(frame)
        np.testing.assert_allclose(site.xpos, [x, y, 0], atol=1e-9)
        np.testing.assert_allclose(site.xmat.reshape(3, 3)[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-9)


@pytest.mark.parametrize("robot", ["planar_dual_arm", "free_flyer_arm"])
def test_a_fixed_base_needs_no_mass(robot: str) -> None:
    """Joints feel none of it, neither here nor in MuJoCo."""
    spec = load_robot(robot).model_copy(update={"mobility": "fixed"})
    no_mass = {"mass": 0.0, "inertia": tuple(np.zeros_like(spec.base.inertia)) if spec.dimension == 3 else 0.0}
    massless = spec.model_copy(update={"base": spec.base.model_copy(update=no_mass)})
    found = []
    for each in (spec, massless):
        model = RobotModel(each)
        Q = model.neutral
        Q[model.space.joint_coordinates] = 0.3
        joints = model.space.joint_rates
        engine, data = engine_at(each, Q[model.space.joint_coordinates], np.zeros(model.n)[joints])
        H = np.zeros((engine.nv, engine.nv))
        for column, unit in zip(H, np.eye(engine.nv), strict=True):
            mujoco.mj_mulM(engine, data, column, unit)
        np.testing.assert_allclose(model.mass_matrix(Q)[joints, joints], H, atol=1e-9)
        found.append(H)
    np.testing.assert_array_equal(*found)
