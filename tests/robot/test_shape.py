"""The shape of robots for drawings."""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given

from psmpc_cli.robot.model import load_robot
from psmpc_cli.robot.shape import RobotShape
from psmpc_cli.specs.robots.robot import RobotSpec, SpatialRobot

from .strategies import Array, State, laws, moving_robots, moving_spatial_robots


def capsules(shape: RobotShape, spec: RobotSpec, frames: Array) -> Mapping[str, Array]:
    """Both ends of all capsules, by body, in the inertial frame (., 2, 3)."""
    names = [body.name for body in spec.bodies]
    return {
        name: ends @ frame[:3, :3].T + frame[:3, 3]
        for name, ends, frame in zip(names, shape.capsules, frames, strict=True)
    }


@given(moving_robots())
@laws
def test_capsules_of_a_planar_robot_run_from_its_shoulders_to_its_tips(state: State) -> None:
    model, Q, _, _ = state
    ends = capsules(model.shape, model.spec, model.body_frames(Q))
    c, s = np.cos(Q[2]), np.sin(Q[2])
    assert not len(ends["base"])
    for (name, arm), tip in zip(model.spec.arms.items(), model.poses(Q)[1:], strict=True):
        points = np.concatenate([ends[f"{name}.{i}"] for i in range(1, len(arm.links) + 1)]).reshape(-1, 3)
        shoulder = Q[:2] + np.array([[c, -s], [s, c]]) @ arm.mount.position
        np.testing.assert_allclose(points[[0, -1], :2], [shoulder, tip[:2]], atol=1e-12)
        np.testing.assert_allclose(points[2::2], points[1:-1:2], atol=1e-12)
        lengths = np.linalg.norm(points[1::2] - points[::2], axis=1)
        np.testing.assert_allclose(lengths, [link.a + link.b for link in arm.links], atol=1e-12)
        assert np.abs(np.array(arm.mount.position) / model.shape.box[:2]).max() <= 1 + 1e-12


@given(moving_spatial_robots())
@laws
def test_the_box_of_a_spatial_robot_has_the_inertia_of_its_base(state: State) -> None:
    model = state[0]
    base, shape = model.spec.bodies[0], model.shape
    moments = base.mass / 3 * ((shape.box**2).sum() - shape.box**2)
    R = shape.box_frame[:3, :3]
    found = R @ np.diag(moments) @ R.T
    np.testing.assert_allclose(found[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)], base.inertia, atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_array_equal(shape.box_frame[:3, 3], base.centre)


@given(moving_spatial_robots())
@laws
def test_capsules_of_a_spatial_robot_end_at_the_joints_and_tools_a_body_carries(state: State) -> None:
    model, _, _, _ = state
    Q = np.r_[0, 0, 0, 1, 0, 0, 0, np.zeros(model.n - 6)]
    ends, origins = capsules(model.shape, model.spec, model.body_frames(Q)), model.body_frames(Q)[:, :3, 3]
    tools = [tool.body for tool in model.spec.tools.values()]
    carried = {number: [pose[:3]] for number, pose in zip(tools, model.poses(Q)[1:], strict=True)}
    for joint, origin in zip(model.spec.joints, origins[1:], strict=True):
        carried.setdefault(joint.at.body, []).append(origin)
    for number, (name, found) in enumerate(ends.items()):
        np.testing.assert_allclose(found[:, 0], np.broadcast_to(origins[number], (len(found), 3)), atol=1e-12)
        reached = np.array(carried.get(number, [origins[number]]))
        for end in found[:, 1]:
            assert np.linalg.norm(reached - end, axis=1).min() < 1e-9, name


def test_the_servicer_looks_as_its_urdf_says() -> None:
    shape = load_robot("dual_arm_servicer").shape
    np.testing.assert_allclose(2 * shape.box, [0.9, 0.8, 0.7], rtol=1e-3)
    assert set(shape.grippers) == {"left", "right"}
    for gripper in shape.grippers.values():
        first, palm, other_palm, other = gripper
        np.testing.assert_allclose(first - palm, other - other_palm)
        assert (first - palm) @ (palm - other_palm) == pytest.approx(0, abs=1e-12)


def test_a_slide_has_a_rail_along_its_travel_and_a_robot_without_arms_is_a_box() -> None:
    moments = (0.1, 0.2, 0.25)
    slide = {"kind": "prismatic", "axis": (0, 1, 0), "position": (1, 0, 0), "rpy": (0, 0, np.pi / 2)}
    arm = {"links": [{"joint": slide, "mass": 1, "inertia": moments}], "tool": {"position": (0, 0, 0.5)}}
    given = {"name": "crane", "base": {"mass": 10, "inertia": moments}, "arms": {"arm": arm}}
    crane = SpatialRobot(**given, limits={"arm": {"position": [[-0.2, 0.4]]}})
    to_mount, rail = RobotShape(crane).capsules[0]
    np.testing.assert_allclose(to_mount, [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(rail, [[1.2, 0, 0], [0.6, 0, 0]], atol=1e-12)
    assert len(RobotShape(SpatialRobot(**given)).capsules[0]) == 1
    bare = RobotShape(SpatialRobot(name="bare", base={"mass": 10, "inertia": moments}))
    assert bare.reach == pytest.approx(np.linalg.norm(bare.box)) and not bare.grippers
