"""Covers of bodies by capsules: what they hold, and how far they reach beyond."""

from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.robots import covers
from psmpc_cli.specs.robots.covers import (
    COVER_EXCESS,
    LARGEST_MESH,
    MOST_CAPSULES,
    Cover,
    cover_box,
    cover_mesh,
    read_mesh,
)

Array = NDArray[np.float64]


def depth_in(cover: Cover, points: Array) -> Array:
    """How deep points (K, 3) are in a cover, negative outside (K,)."""
    start, end = cover.ends[:, 0], cover.ends[:, 1]
    along = end - start
    squared = np.maximum((along**2).sum(axis=1), 1e-30)
    shares = np.clip(((points[:, None] - start) * along).sum(axis=2) / squared, 0, 1)
    nearest = start + shares[:, :, None] * along
    return (cover.radius - np.linalg.norm(points[:, None] - nearest, axis=2)).max(axis=1)


def surface_of(cover: Cover, rng: np.random.Generator, count: int) -> Array:
    """Points on the capsules of a cover: on the spheres about both ends, where a convex body is farthest (., 3)."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions = np.vstack([directions, np.eye(3), -np.eye(3)])
    return (cover.ends.reshape(-1, 1, 3) + cover.radius * directions).reshape(-1, 3)


BOXES = [
    (1.0, 1.0),
    (0.6, 0.36),
    (0.2, 1.5),
    (3.0, 0.1),
    (1.0, 1.0, 1.0),
    (0.9, 0.8, 0.7),
    (0.1, 0.7, 0.2),
    (0.02, 0.5, 2.0),
]


@pytest.mark.parametrize("edges", BOXES)
def test_a_box_is_in_its_cover_which_reaches_no_further_than_it_says(edges: tuple[float, ...]) -> None:
    rng = np.random.default_rng(0)
    cover = cover_box(edges)
    assert 1 <= len(cover.ends) <= MOST_CAPSULES
    half = np.array([*edges, 0.0])[:3] / 2
    corners = half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    inside = np.vstack([corners, half * rng.uniform(-1, 1, (3000, 3))])
    assert depth_in(cover, inside).min() > -1e-9
    points = surface_of(cover, rng, 3000)
    if len(edges) == 2:
        points[:, 2] = 0  # what of them is in the plane
        points = points[depth_in(cover, points) > -1e-9]
    beyond = np.linalg.norm(np.maximum(np.abs(points) - half, 0), axis=1)
    assert 0.9 * cover.excess < beyond.max() < cover.excess + 1e-9


def test_more_capsules_are_taken_while_the_excess_is_large() -> None:
    assert len(cover_box((3.0, 0.1)).ends) == 1
    assert len(cover_box((1.0, 1.0)).ends) == 2
    assert len(cover_box((1.0, 1.0, 1.0)).ends) == 4
    for edges in BOXES:
        cover = cover_box(edges)
        assert cover.excess <= COVER_EXCESS * max(edges) or len(cover.ends) == MOST_CAPSULES


def test_a_cover_moves_with_its_body() -> None:
    rng = np.random.default_rng(1)
    cover = cover_box((0.9, 0.8, 0.7))
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix()
    frame[:3, 3] = [1, 2, 3]
    points = rng.uniform(-0.6, 0.6, (500, 3))
    moved = points @ frame[:3, :3].T + frame[:3, 3]
    np.testing.assert_allclose(depth_in(cover.moved(frame), moved), depth_in(cover, points), atol=1e-12)
    assert cover.moved(frame).excess == cover.excess


def moved_mesh(mesh: trimesh.Trimesh) -> Array:
    """The vertices of a mesh, turned and moved away from the origin."""
    turned = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
    return np.asarray(mesh.vertices) @ turned.T + [1.0, -2.0, 0.5]


def cloud(*scale: float) -> Array:
    return np.random.default_rng(3).normal(size=(60, 3)) * scale


MESHES = {
    "box": moved_mesh(trimesh.creation.box((0.4, 0.7, 0.2))),
    "sphere": moved_mesh(trimesh.creation.icosphere(2, 0.3)),
    "rod": moved_mesh(trimesh.creation.cylinder(0.05, 0.8)),
    "disc": moved_mesh(trimesh.creation.cylinder(0.5, 0.05)),
    "capsule": moved_mesh(trimesh.creation.capsule(0.6, 0.1)),
    "cone": moved_mesh(trimesh.creation.cone(0.2, 0.6)),
    "cloud": cloud(0.1, 0.2, 0.5),
    "plate": np.array([[0, 0, 0.3], [1, 0, 0.3], [1, 0.5, 0.3], [0, 0.4, 0.3]]),
    "triangle": np.array([[0, 0, 0], [1, 0.2, 0.3], [0.1, 0.5, 0.3]]),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_is_in_its_cover_which_reaches_no_further_than_it_says(name: str) -> None:
    vertices = MESHES[name]
    cover = cover_mesh(vertices)
    rng = np.random.default_rng(0)
    shares = rng.dirichlet(np.full(len(vertices), 0.2), 3000)
    assert depth_in(cover, np.vstack([vertices, shares @ vertices])).min() > -1e-9
    points = surface_of(cover, rng, 300)
    assert cover.excess > 0
    if name in ("plate", "triangle"):  # coal has no hull of them: to the nearest of many points of theirs
        far = KDTree(np.vstack([vertices, shares @ vertices])).query(points)[0]
        assert far.max() < cover.excess + 0.02
        return
    listed = coal.StdVec_Vec3s()
    listed.extend(list(vertices))
    hull = coal.Convex.convexHull(listed, False, "Qt")
    point = coal.Sphere(1e-3)
    at = coal.Transform3s.Identity()
    far = [
        coal.distance(point, coal.Transform3s(np.eye(3), each), hull, at, coal.DistanceRequest(), coal.DistanceResult())
        for each in points
    ]
    assert 0.8 * cover.excess - 1e-3 < max(far) + 1e-3 < cover.excess + 1e-5


def test_what_is_nearly_a_capsule_is_covered_by_one_and_a_box_as_boxes_are() -> None:
    for name, radius in {"capsule": 0.1, "sphere": 0.3}.items():
        cover = cover_mesh(MESHES[name])
        assert len(cover.ends) == 1
        assert cover.radius == pytest.approx(radius, rel=0.03)
        assert cover.excess < 0.03 * radius
    expected = cover_box((0.4, 0.7, 0.2))
    assert cover_mesh(MESHES["box"]).excess <= expected.excess + 1e-9


@pytest.mark.parametrize("ending", [".stl", ".obj", ".STL"])
def test_meshes_are_read_from_files(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"box{ending}"
    trimesh.creation.box((1, 2, 3)).export(path)
    mesh = read_mesh(path)
    assert mesh.is_closed
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [1, 2, 3])


def test_an_open_mesh_is_read_and_known_as_such(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 2, 3))
    box.update_faces(np.arange(len(box.faces)) > 0)
    box.export(tmp_path / "open.stl")
    assert not read_mesh(tmp_path / "open.stl").is_closed


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.stl", None, ("no readable file", "a.stl", "No such file")),
        ("a.dae", b"<COLLADA/>", ("a.dae", ".stl or .obj")),
        ("a.stl", b"", ("no triangles", "a.stl")),
        ("a.stl", b"rubbish", ("a.stl", "expected a mesh")),
        ("a.obj", b"v 0 0 zero\nf 1 1 1\n", ("a.obj", "expected a mesh")),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", ("without an area", "a.obj")),
        ("a.stl", b"\0" * (LARGEST_MESH + 1), (f"{LARGEST_MESH + 1} bytes", "at most")),
    ],
)
def test_what_is_no_mesh_is_named(tmp_path: Path, name: str, content: bytes | None, words: tuple[str, ...]) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SpecError) as caught:
        read_mesh(tmp_path / name)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mesh_of_many_vertices_is_too_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.icosphere(2).export(tmp_path / "a.stl")
    monkeypatch.setattr(covers, "MOST_VERTICES", 161)
    with pytest.raises(SpecError, match=r"162 vertices.*at most 161"):
        read_mesh(tmp_path / "a.stl")


TETRAHEDRON = "v 0 0 0\nv {0} 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


@pytest.mark.parametrize("far", ["1e300", "1e999", "-1e999", "nan", "1.1e12"])
def test_vertices_that_are_no_lengths_are_an_error(tmp_path: Path, far: str) -> None:
    """The reader of meshes would drop those that are not finite, and say nothing."""
    (tmp_path / "far.obj").write_text(TETRAHEDRON.format(far) + "v 1 1 1\nf 2 3 5\n")
    with pytest.raises(SpecError, match=r'found a vertex at .* in "far.obj", .* of at most 1e\+12'):
        read_mesh(tmp_path / "far.obj")


def test_vertices_at_the_largest_length_are_apart(tmp_path: Path) -> None:
    (tmp_path / "far.obj").write_text(TETRAHEDRON.format("1e12"))
    mesh = read_mesh(tmp_path / "far.obj")
    assert len(mesh.vertices) == 4
    assert mesh.is_closed


@pytest.mark.parametrize("shape", ["box", "plate", "ball"])
@pytest.mark.parametrize("scale", [(1e-9, 1, 1e6), (1e-3, 1e-9, 1), (2e11, 2e11, 2e11), (2e11, 1e-3, 1e6)])
def test_covers_of_any_scale_cover(shape: str, scale: tuple[float, ...]) -> None:
    meshes = {"box": (1, 1, 1), "plate": (1, 1, 1e-7)}
    mesh = trimesh.creation.box(meshes[shape]) if shape in meshes else trimesh.creation.icosphere(2, 0.5)
    vertices = np.asarray(mesh.vertices) * scale
    cover = cover_mesh(vertices)
    size = np.abs(vertices).max()
    assert depth_in(replace(cover, ends=cover.ends / size, radius=cover.radius / size), vertices / size).min() > -1e-6
    assert 0 <= cover.excess < size


def test_a_mesh_of_many_vertices_is_said_to_take_a_while_and_is_covered(caplog: pytest.LogCaptureFixture) -> None:
    """Not all of its vertices count where distances to its hull are looked for: excesses are upper bounds."""
    ball = trimesh.creation.icosphere(subdivisions=6)
    with caplog.at_level("INFO", logger="psmpc_cli"):
        cover = cover_mesh(np.asarray(ball.vertices))
    assert [record.message for record in caplog.records] == [
        f"covering the convex hull of {len(ball.vertices)} vertices by capsules"
    ]
    assert depth_in(cover, np.asarray(ball.vertices)).min() > -1e-6
    assert cover.excess < 0.01
