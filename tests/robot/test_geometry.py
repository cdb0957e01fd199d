"""The capsules of robots, and the pairs of them that are to keep apart."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.distances import distance
from psmpc_cli.robot.geometry import Piece, own_pairs, pieces_of
from psmpc_cli.robot.kinematics import place
from psmpc_cli.robot.model import RobotModel, load_robot
from psmpc_cli.specs.geometry import Shape
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import load_task
from psmpc_cli.specs.robots.robot import Attachment, PlanarRobot, SpatialRobot, resolve_limits, stack

Array = NDArray[np.float64]

ROBOTS = tuple(built_ins("robot"))


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> RobotModel:
    return load_robot(request.param)


def depth_in(pieces: Sequence[Piece], points: Array) -> Array:
    """How deep points (K, 3) in a body's frame are in its pieces, negative outside (K,)."""
    found = []
    for piece in pieces:
        radius, length = piece.shape.size
        local = Rotation.from_rotvec(piece.at.rotation).inv().apply(points - np.array(piece.at.position))
        local[:, 0] -= np.clip(local[:, 0], -length / 2, length / 2)
        found.append(radius - np.linalg.norm(local, axis=1))
    return np.max(found, axis=0)


def own_distances(model: RobotModel, pieces: Sequence[Piece], pairs: Sequence[tuple[int, int]]) -> ca.Function:
    """Distances of pairs by the joints' coordinates."""
    joints = ca.SX.sym("joints", len(model.spec.joints))
    bodies, _ = place(model.spec, model.space.base_frame(ca.SX(model.neutral)), joints)
    frames = [piece.frame(bodies) for piece in pieces]
    found = [distance(pieces[i].shape, frames[i], pieces[j].shape, frames[j]) for i, j in pairs]
    return ca.Function("own", [joints], [ca.vertcat(*found)])


def test_a_robot_without_geometry_is_covered_as_it_is_drawn(robot: RobotModel) -> None:
    pieces = pieces_of(robot.spec)
    shape = robot.shape
    assert [piece.body for piece in pieces] == sorted(piece.body for piece in pieces)
    assert all(piece.part == robot.spec.bodies[piece.body].name for piece in pieces)
    of_bodies = [[piece for piece in pieces if piece.body == i] for i in range(len(robot.spec.bodies))]
    corners = shape.box * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    if robot.dimension == 2:
        corners[:, 2] = 0
    placed = corners @ shape.box_frame[:3, :3].T + shape.box_frame[:3, 3]
    assert depth_in(of_bodies[0], placed).min() > -1e-9
    for own, ends in zip(of_bodies, shape.capsules, strict=True):
        if len(ends):
            np.testing.assert_array_less(shape.radius - 1e-9, depth_in(own, ends.reshape(-1, 3)))
            np.testing.assert_array_less(shape.radius - 1e-9, depth_in(own, ends.mean(axis=1)))
    for arm, outline in shape.grippers.items():
        assert depth_in(of_bodies[robot.spec.tools[arm].body], outline).min() > -1e-9


def test_pieces_are_carried_by_their_bodies(robot: RobotModel) -> None:
    """Their frames are those of the bodies that the model computes."""
    rng = np.random.default_rng(0)
    joints = rng.uniform(-1, 1, len(robot.spec.joints))
    Q = robot.neutral
    Q[-len(joints) :] = joints
    bodies, _ = place(robot.spec, robot.space.base_frame(ca.SX(Q)), ca.SX(joints))
    for piece in pieces_of(robot.spec):
        frame = piece.frame(bodies)
        body = robot.body_frames(Q)[piece.body]
        position = np.ravel([float(x) for x in frame.position])
        np.testing.assert_allclose(position, body[:3, :3] @ piece.at.position + body[:3, 3], atol=1e-12)
        turned = Rotation.from_quat([float(x) for x in frame.quaternion], scalar_first=True).as_matrix()
        expected = body[:3, :3] @ Rotation.from_rotvec(piece.at.rotation).as_matrix()
        np.testing.assert_allclose(turned, expected, atol=1e-12)
        if robot.dimension == 2:
            assert position[2] == turned[2, 0] == 0


def test_pairs_to_keep_apart_are_no_neighbours_and_always_the_same(robot: RobotModel) -> None:
    pieces = pieces_of(robot.spec)
    pairs = own_pairs(robot, pieces)
    assert pairs and pairs == own_pairs(load_robot(robot.spec.name), pieces)
    neighbours = {(joint.at.body, number) for number, joint in enumerate(robot.spec.joints, start=1)}
    for i, j in pairs:
        bodies = pieces[i].body, pieces[j].body
        assert i < j and bodies[0] != bodies[1] and bodies not in neighbours


def test_pairs_that_are_left_out_are_always_together_or_apart(robot: RobotModel) -> None:
    """In other random postures than those that decided it."""
    pieces = pieces_of(robot.spec)
    kept = set(own_pairs(robot, pieces))
    neighbours = {(joint.at.body, number) for number, joint in enumerate(robot.spec.joints, start=1)}
    out = [
        (i, j)
        for i in range(len(pieces))
        for j in range(i + 1, len(pieces))
        if (i, j) not in kept
        and pieces[i].body != pieces[j].body
        and (pieces[i].body, pieces[j].body) not in neighbours
    ]
    limits = resolve_limits(robot.spec)
    count = len(robot.spec.joints)
    low = np.maximum(limits.position_low[-count:], -np.pi)
    high = np.minimum(limits.position_high[-count:], np.pi)
    postures = np.random.default_rng(7).uniform(low, high, (2000, count))
    found = own_distances(robot, pieces, out).map(len(postures))(postures.T).full()
    reach = robot.shape.reach
    for row in found:
        assert row.min() > 0 or np.mean(row < 0.03 * reach) > 0.9


def test_the_arms_of_the_planar_robot_keep_apart_from_each_other_and_the_base() -> None:
    """Their first links are 0.6 m apart, and the second ones reach to within 3 cm of the other arm's first."""
    model = load_robot("planar_dual_arm")
    pieces = pieces_of(model.spec)
    assert {(pieces[i].part, pieces[j].part) for i, j in own_pairs(model, pieces)} == {
        *(("base", f"{arm}.{i}") for arm in ("arm_1", "arm_2") for i in (2, 3)),
        *((f"{arm}.1", f"{arm}.3") for arm in ("arm_1", "arm_2")),
        *((f"arm_1.{i}", f"arm_2.{j}") for i in (1, 2, 3) for j in (1, 2, 3) if i + j > 2),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", built_ins("task"))
def test_no_pair_overlaps_where_the_built_in_tasks_start(name: str) -> None:
    task = load_task(name)
    model = RobotModel(task.robot)
    pieces = pieces_of(task.robot)
    pairs = own_pairs(model, pieces)
    Q = stack(task.spec.initial, task.robot, "joint")
    assert float(own_distances(model, pieces, pairs)(Q[-len(task.robot.joints) :]).full().min()) > 0.01


PLANAR = {
    "name": "r",
    "base": {"mass": 30, "inertia": 1},
    "arms": {"arm": {"mount": {"position": [0.3, 0]}, "links": [{"mass": 4, "inertia": 0.3, "a": 0.2, "b": 0.2}] * 2}},
}


def test_a_robot_with_geometry_has_its_shapes_alone() -> None:
    shapes = {
        "base": [{"shape": {"box": [0.6, 0.3]}, "pose": [0.1, 0.2, np.pi / 2]}],
        "arm.2": [{"shape": {"capsule": [0.05, 0.4]}, "pose": [0.2, 0, 0]}, {"shape": {"sphere": 0.1}}],
    }
    robot = PlanarRobot.model_validate({**PLANAR, "geometry": shapes})
    pieces = pieces_of(robot)
    base = [piece for piece in pieces if piece.part == "base"]
    local = np.array([[0.3, 0.15, 0], [-0.3, 0.15, 0], [0.3, -0.15, 0], [0, 0, 0]])
    turned = np.column_stack([-local[:, 1] + 0.1, local[:, 0] + 0.2, local[:, 2]])
    assert depth_in(base, turned).min() > -1e-9
    assert depth_in(base, np.array([[0.4, 0.2, 0]]))[0] < 0  # not along x
    assert pieces[len(base) :] == (
        Piece("arm.2", Attachment(2, (0.2, 0, 0), (0, 0, 0)), Shape("capsule", (0.05, 0.4))),
        Piece("arm.2", Attachment(2, (0, 0, 0), (0, 0, 0)), Shape("capsule", (0.1, 0.0))),
    )


def test_shapes_in_space_are_turned_as_their_pose_says() -> None:
    half = np.sqrt(0.5)
    placed = {"shape": {"capsule": [0.1, 1.0]}, "pose": [1, 2, 3, half, 0, half, 0]}  # x is turned to -z
    given = {"base": {"mass": 10, "inertia": (0.2, 0.2, 0.2)}, "geometry": {"base": [placed]}}
    robot = SpatialRobot.model_validate({"name": "r", **given})
    pieces = pieces_of(robot)
    ends = np.array([[1, 2, 3.59], [1, 2, 2.41], [1.09, 2, 3]])
    assert depth_in(pieces, ends).min() > 0
    assert depth_in(pieces, np.array([[1, 2, 3.61], [1.11, 2, 3]])).max() < 0


def test_a_robot_of_one_body_has_no_pairs() -> None:
    robot = SpatialRobot.model_validate({"name": "r", "base": {"mass": 10, "inertia": (0.2, 0.2, 0.2)}})
    assert own_pairs(RobotModel(robot), pieces_of(robot)) == ()
