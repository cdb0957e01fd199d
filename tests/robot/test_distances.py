"""Signed distances of shapes: against coal, their gradients against differences, and what they are by hand."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import coal
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from psmpc_cli.robot.distances import LARGEST_EXCESS, MOST_SPHERES, distance, excess, witnesses
from psmpc_cli.robot.kinematics import SpatialFrame
from psmpc_cli.specs.geometry import DEEP, Shape

Array = NDArray[np.float64]

SPHERE = Shape("capsule", (0.2, 0.0))
CAPSULE = Shape("capsule", (0.1, 0.5))
LONG = Shape("capsule", (0.05, 1.2))
BOX = Shape("box", (0.6, 0.4, 0.9))
HALF_SPACE = Shape("half_space", (0.6, 0.0, 0.8))

PAIRS = {
    "sphere-sphere": (SPHERE, Shape("capsule", (0.1, 0.0))),
    "sphere-capsule": (SPHERE, CAPSULE),
    "capsule-sphere": (CAPSULE, SPHERE),
    "sphere-box": (SPHERE, BOX),
    "sphere-half_space": (SPHERE, HALF_SPACE),
    "capsule-capsule": (CAPSULE, LONG),
    "capsule-half_space": (CAPSULE, HALF_SPACE),
    "capsule-box": (CAPSULE, BOX),
    "long capsule-box": (LONG, BOX),
}
COUNT = 10_000 // len(PAIRS) + 1


def function_of(first: Shape, second: Shape, of: Callable[..., Any] = distance) -> ca.Function:
    """A function of two poses (7,) each."""
    poses = [ca.SX.sym(name, 7) for name in ("first", "second")]
    frames = [SpatialFrame(ca.vertsplit(pose[:3]), ca.vertsplit(pose[3:])) for pose in poses]
    found = of(first, frames[0], second, frames[1])
    return ca.Function("f", poses, [ca.vertcat(*point) for point in found] if isinstance(found, tuple) else [found])


def random_poses(seed: int, count: int) -> tuple[Array, Array]:
    """Pairs of poses (7, count) at most some two metres apart."""
    rng = np.random.default_rng(seed)
    poses = [np.hstack([rng.uniform(-0.8, 0.8, (count, 3)), rng.normal(size=(count, 4))]).T for _ in range(2)]
    for pose in poses:
        pose[3:] /= np.linalg.norm(pose[3:], axis=0)
    return poses[0], poses[1]


def coal_shape(shape: Shape) -> tuple[Any, Array]:
    """The shape of coal, and how its frame is turned in ours: its capsules are along z."""
    if shape.kind == "box":
        return coal.Box(*shape.size), np.eye(3)
    if shape.kind == "half_space":
        return coal.Halfspace(np.array(shape.size), 0.0), np.eye(3)
    radius, length = shape.size
    capsule = coal.Capsule(radius, length) if length else coal.Sphere(radius)
    return capsule, Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix()


def by_coal(first: Shape, second: Shape, poses: tuple[Array, Array]) -> Array:
    """The distance of each pair of poses."""
    shapes = [coal_shape(shape) for shape in (first, second)]
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-9
    request.gjk_max_iterations = 1000
    rotations = [Rotation.from_quat(pose[3:].T, scalar_first=True).as_matrix() for pose in poses]
    found = []
    for i in range(poses[0].shape[1]):
        at = [
            coal.Transform3s(turned[i] @ own, pose[:3, i])
            for turned, pose, (_, own) in zip(rotations, poses, shapes, strict=True)
        ]
        found.append(coal.distance(shapes[0][0], at[0], shapes[1][0], at[1], request, coal.DistanceResult()))
    return np.array(found)


@pytest.mark.parametrize("pair", PAIRS)
def test_distances_are_those_of_coal(pair: str) -> None:
    first, second = PAIRS[pair]
    poses = random_poses(1, COUNT)
    found = function_of(first, second).map(COUNT)(*poses).full()[0]
    expected = by_coal(first, second, poses)
    assert (expected < 0).sum() > COUNT / 100 and (expected > 0.05).sum() > COUNT / 10
    if pair.endswith("capsule-box"):
        apart = expected > 1e-6
        short = expected[apart] - found[apart]
        assert short.min() > -1e-6 and short.max() < excess(first) + 1e-6
        assert short.max() > 0.3 * excess(first)
        assert (found[~apart] < 1e-6).all()
    else:
        alike = np.ones(COUNT, bool)
        if "capsule-capsule" in pair:  # ours is that of the axes: where they pass through each other there is another
            alike = expected > -(first.size[0] + second.size[0]) / 2
        np.testing.assert_allclose(found[alike], expected[alike], atol=1e-6)


@pytest.mark.parametrize("pair", PAIRS)
def test_gradients_are_those_of_differences(pair: str) -> None:
    f = function_of(*PAIRS[pair])
    poses = f.sx_in()
    stacked = ca.vertcat(*poses)
    gradient = ca.Function("gradient", poses, [ca.gradient(f(*poses), stacked)])
    count = 200
    at = random_poses(2, count)
    found = gradient.map(count)(*at).full()
    assert np.isfinite(found).all()
    h = 1e-5
    several = f.map(count)
    sides = []
    for i in range(14):
        step = np.zeros((14, 1))
        step[i] = h
        values = [several(at[0] + k * step[:7], at[1] + k * step[7:]).full()[0] for k in (-2, -1, 1, 2)]
        sides.append(values)
    far, near, close, wide = np.moveaxis(np.array(sides), 1, 0)
    centred = (close - near) / (2 * h)
    wider = (wide - far) / (4 * h)
    smooth = (np.abs(centred - wider) < 1e-6).all(axis=0)  # not on an edge, where the two differ
    assert smooth.mean() > 0.9
    np.testing.assert_allclose(found[:, smooth], centred[:, smooth], atol=1e-6)


@pytest.mark.parametrize("pair", PAIRS)
def test_the_nearest_points_are_as_far_apart_as_the_distance_says(pair: str) -> None:
    first, second = PAIRS[pair]
    count = 500
    poses = random_poses(3, count)
    far = function_of(first, second).map(count)(*poses).full()[0]
    own, other = (points.full() for points in function_of(first, second, witnesses).map(count)(*poses))
    np.testing.assert_allclose(np.linalg.norm(own - other, axis=0), np.abs(far), atol=1e-6)
    rotations = [Rotation.from_quat(pose[3:].T, scalar_first=True) for pose in poses]
    for points, pose, turned, shape in zip((own, other), poses, rotations, (first, second), strict=True):
        local = turned.inv().apply((points - pose[:3]).T)
        if shape.kind == "half_space":
            off = local @ shape.size
        elif shape.kind == "box":
            off = np.max(np.abs(local) - np.array(shape.size) / 2, axis=1)
        else:
            radius, length = shape.size
            local[:, 0] -= np.clip(local[:, 0], -length / 2, length / 2)
            off = np.linalg.norm(local, axis=1) - radius
        on_the_cover = excess(first) if shape is first and second.kind == "box" else 0.0
        assert off.max() < on_the_cover + 1e-6
        if not on_the_cover and (shape.kind != "capsule" or not shape.size[1]):
            np.testing.assert_allclose(off, 0, atol=1e-6)


def at(*position: float, turned: tuple[float, float, float] = (0, 0, 0)) -> SpatialFrame:
    return SpatialFrame(list(position), Rotation.from_rotvec(turned).as_quat(scalar_first=True).tolist())


@pytest.mark.parametrize(
    ("second", "frame", "expected"),
    [
        pytest.param(CAPSULE, at(0, 0.4, 0), 0.2, id="parallel"),
        pytest.param(CAPSULE, at(0.9, 0, 0), 0.2, id="in one line"),
        pytest.param(CAPSULE, at(0.9, 0, 0, turned=(0, 0, np.pi)), 0.2, id="in one line, opposite"),
        pytest.param(CAPSULE, at(0.2, 0.4, 0, turned=(0, 0, np.pi)), 0.2, id="parallel, opposite and shifted"),
        pytest.param(CAPSULE, at(0, 0.4, 0, turned=(0, 1e-9, 0)), 0.2, id="almost parallel"),
        pytest.param(CAPSULE, at(0, 0, 0.4, turned=(0, 0, np.pi / 2)), 0.2, id="across"),
        pytest.param(CAPSULE, at(0, 0, 0), -0.2, id="one in the other"),
        pytest.param(BOX, at(0, 0.45, 0), 0.15, id="beside a box"),
        pytest.param(Shape("box", (0.4, 0.4, DEEP)), at(0, 0.45, 0), 0.15, id="beside a box of the plane"),
    ],
)
def test_special_positions(second: Shape, frame: SpatialFrame, expected: float) -> None:
    found = distance(CAPSULE, at(0, 0, 0), second, frame)
    assert expected - excess(CAPSULE) * (second.kind == "box") - 1e-7 < float(found) < expected + 1e-7
    f = function_of(CAPSULE, second)
    gradient = ca.Function("gradient", f.sx_in(), [ca.gradient(f(*f.sx_in()), ca.vertcat(*f.sx_in()))])
    slopes = gradient([0, 0, 0, 1, 0, 0, 0], [*frame.position, *frame.quaternion]).full()
    assert np.isfinite(slopes).all() and np.abs(slopes).max() < 3


def test_a_point_in_a_box_leaves_it_by_its_nearest_face() -> None:
    point = Shape("capsule", (0.01, 0.0))
    deep = distance(point, at(0.05, -0.1, 0.2), BOX, at(0, 0, 0))
    assert float(deep) == pytest.approx(-0.1 - 0.01, abs=1e-7)
    own, other = witnesses(point, at(0.05, -0.1, 0.2), BOX, at(0, 0, 0))
    np.testing.assert_allclose(np.ravel(own), [0.05, -0.09, 0.2], atol=1e-7)
    np.testing.assert_allclose(np.ravel(other), [0.05, -0.2, 0.2], atol=1e-7)


def test_the_spheres_of_a_capsule_cover_it_within_the_stated_excess() -> None:
    assert excess(SPHERE) == 0
    for length in (0.01, 0.2, 0.5):
        assert 0 < excess(Shape("capsule", (0.1, length))) <= LARGEST_EXCESS * 0.1
    gap = 1.2 / (MOST_SPHERES - 1)
    assert excess(LONG) == pytest.approx(np.sqrt(0.05**2 + gap**2 / 4) - 0.05)


def test_capsules_that_are_almost_parallel_are_as_far_apart_as_coal_says() -> None:
    """At angles from 1e-10 to 1e-2, where nearest points of the axes are hardly determined."""
    first, second = PAIRS["capsule-capsule"]
    count = 2000
    poses = random_poses(4, count)
    rng = np.random.default_rng(5)
    small = rng.normal(size=(count, 3)) * 10 ** rng.uniform(-10, -2, (count, 1))
    turned = Rotation.from_quat(poses[0][3:].T, scalar_first=True) * Rotation.from_rotvec(small)
    poses[1][3:] = turned.as_quat(scalar_first=True).T
    expected = by_coal(first, second, poses)
    apart = expected > 1e-3
    assert apart.mean() > 0.5
    f = function_of(first, second)
    np.testing.assert_allclose(f.map(count)(*poses).full()[0][apart], expected[apart], atol=1e-6)
    gradient = ca.Function("gradient", f.sx_in(), [ca.gradient(f(*f.sx_in()), ca.vertcat(*f.sx_in()))])
    assert np.abs(gradient.map(count)(*poses).full()).max() < 5


@pytest.mark.parametrize("pair", PAIRS)
def test_gradients_are_finite_where_both_frames_are_one(pair: str) -> None:
    f = function_of(*PAIRS[pair])
    gradient = ca.Function("gradient", f.sx_in(), [ca.gradient(f(*f.sx_in()), ca.vertcat(*f.sx_in()))])
    assert np.isfinite(gradient([0, 0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0, 0]).full()).all()
