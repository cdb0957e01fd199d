"""Agreement with an independent rigid-body library on random robots."""

import mujoco
import numpy as np
from hypothesis import given

from psmpc_cli.robot.mujoco_model import mujoco_spec
from psmpc_cli.specs.robot import RobotSpec

from .differences import Array
from .strategies import State, laws, moving_robots


class Engine:
    """The robot in MuJoCo, at a state."""

    def __init__(self, spec: RobotSpec, Q: Array, Qdot: Array) -> None:
        self.model = mujoco_spec(spec).compile()
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:], self.data.qvel[:] = Q, Qdot
        mujoco.mj_forward(self.model, self.data)

    def inertia(self) -> Array:
        columns = np.zeros((self.model.nv, self.model.nv))
        for column, unit in zip(columns, np.eye(self.model.nv), strict=True):
            mujoco.mj_mulM(self.model, self.data, column, unit)
        return columns.T

    def bias(self) -> Array:
        return np.array(self.data.qfrc_bias)

    def inverse(self, Qddot: Array) -> Array:
        self.data.qacc[:] = Qddot
        mujoco.mj_inverse(self.model, self.data)
        return np.array(self.data.qfrc_inverse)

    def forward(self, F: Array) -> Array:
        self.data.qfrc_applied[:] = F
        mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.qacc)


@given(moving_robots())
@laws
def test_dynamics_agree(state: State) -> None:
    model, Q, Qdot, third = state
    engine = Engine(model.spec, Q, Qdot)
    np.testing.assert_allclose(model.mass_matrix(Q), engine.inertia(), atol=1e-9)
    np.testing.assert_allclose(model.bias(Q, Qdot), engine.bias(), atol=1e-9)
    np.testing.assert_allclose(model.inverse_dynamics(Q, Qdot, third), engine.inverse(third), atol=1e-9)
    np.testing.assert_allclose(model.forward_dynamics(Q, Qdot, third), engine.forward(third), atol=1e-9)


@given(moving_robots())
@laws
def test_poses_agree(state: State) -> None:
    model, Q, Qdot, _ = state
    engine = Engine(model.spec, Q, Qdot)
    for frame, (x, y, angle) in zip(model.pose_rows, model.poses(Q), strict=True):
        site = engine.data.site(frame)
        np.testing.assert_allclose(site.xpos, [x, y, 0], atol=1e-9)
        np.testing.assert_allclose(site.xmat.reshape(3, 3)[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-9)


def test_joints_are_named_by_part_and_coordinate(planar_dual_arm: RobotSpec) -> None:
    engine = mujoco_spec(planar_dual_arm).compile()
    names = [engine.joint(i).name for i in range(engine.njnt)]
    arms = [f"arm_{arm}.{joint}" for arm in (1, 2) for joint in (1, 2, 3)]
    assert names == ["base.x", "base.y", "base.angle", *arms]
