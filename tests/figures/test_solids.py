"""Shapes as they are seen: outlines, faces, walls and shadows against points of the shapes themselves."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.path import Path
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from psmpc_cli.figures import style
from psmpc_cli.figures.scene import OBLIQUE, PLAN, Camera
from psmpc_cli.figures.solids import BELOW_ALL, capsule_outline, draw_shadow, draw_shape
from psmpc_cli.figures.style import new_figure
from psmpc_cli.specs.geometry import DEEP, Shape

EXTENT = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
LOOK = style.look("obstacle")


def placed(seed: int, planar: bool = False) -> np.ndarray:
    """A random frame."""
    random = np.random.default_rng(seed)
    frame = np.eye(4)
    turn = [0, 0, random.uniform(-3, 3)] if planar else random.normal(size=3)
    frame[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    frame[: 2 if planar else 3, 3] = random.uniform(-0.5, 0.5, 2 if planar else 3)
    return frame


def drawn(camera: Camera, shape: Shape, frame: np.ndarray, **more: Any) -> Axes:
    axes = new_figure().add_subplot()
    draw_shape(axes, camera, shape, frame, EXTENT, {**LOOK, **more})
    return axes


def polygons(axes: Axes) -> list[np.ndarray]:
    return [np.asarray(patch.get_xy()) for patch in axes.patches if isinstance(patch, Polygon)]


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), length=st.sampled_from([0.0, 0.7]), oblique=st.booleans())
def test_the_outline_of_a_capsule_is_around_all_its_points(seed: int, length: float, oblique: bool) -> None:
    camera = OBLIQUE if oblique else PLAN
    radius = 0.2
    along = placed(seed)[:3, 0] * length
    ends = np.array([-along / 2, along / 2]) + placed(seed)[:3, 3]
    directions = np.random.default_rng(seed).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = camera.project(np.vstack([end + 0.99 * radius * directions for end in ends]))
    outline = capsule_outline(camera, ends, radius)
    assert Path(outline).contains_points(points).all()
    seen = float(np.linalg.norm(np.ptp(camera.project(ends), axis=0)))
    area = ConvexHull(outline).volume
    assert area == pytest.approx(np.pi * radius**2 + 2 * radius * seen, rel=0.005)  # of a circle with 60 corners


@given(seed=st.integers(0, 10**6))
@settings(max_examples=8)
def test_a_half_plane_is_drawn_up_to_the_edges_of_the_view(seed: int) -> None:
    frame = placed(seed, planar=True)
    (area,) = polygons(drawn(PLAN, Shape("half_space", (1.0, 0.0, 0.0)), frame))
    (other,) = polygons(drawn(PLAN, Shape("half_space", (-1.0, 0.0, 0.0)), frame))
    assert ((area - frame[:2, 3]) @ frame[:2, 0]).max() == pytest.approx(0.0, abs=1e-9)
    view = PLAN.view(EXTENT)
    assert ConvexHull(area).volume + ConvexHull(other).volume == pytest.approx(view.width * view.height)


def test_a_half_plane_beyond_the_view_is_not_drawn() -> None:
    frame = np.eye(4)
    frame[0, 3] = -2.0
    assert not polygons(drawn(PLAN, Shape("half_space", (1.0, 0.0, 0.0)), frame))


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_a_wall_is_behind_what_is_outside_of_it_where_it_faces_the_viewer(towards: float) -> None:
    normal = towards * OBLIQUE.axes[2]
    axes = drawn(OBLIQUE, Shape("half_space", tuple(normal.tolist())), np.eye(4))
    (wall,) = axes.patches
    assert np.sign(wall.get_zorder()) == -towards
    assert abs(wall.get_zorder()) >= abs(BELOW_ALL)
    assert wall.get_alpha() < 0.5
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    seen = ConvexHull(OBLIQUE.project(corners))
    (face,) = polygons(axes)
    assert (seen.equations[:, :2] @ face.T + seen.equations[:, 2:] <= 1e-9).all()


def test_a_box_of_the_plane_is_its_rectangle() -> None:
    frame = placed(3, planar=True)
    (rectangle,) = polygons(drawn(PLAN, Shape("box", (0.6, 0.4, DEEP)), frame))
    assert ConvexHull(rectangle).volume == pytest.approx(0.24)
    assert rectangle[:-1].mean(axis=0) == pytest.approx(frame[:2, 3])


@pytest.mark.parametrize("shape", [Shape("box", (0.6, 0.4, 0.2)), Shape("capsule", (0.1, 0.5))], ids=["box", "capsule"])
def test_a_shadow_is_below_its_shape(shape: Shape) -> None:
    axes = new_figure().add_subplot()
    frame = placed(5)
    draw_shadow(axes, OBLIQUE, shape, frame, -1.0)
    (shadow,) = polygons(axes)
    below = OBLIQUE.project([*frame[:2, 3], -1.0])
    assert shadow[:-1].min(axis=0) == pytest.approx(2 * below - shadow[:-1].max(axis=0), abs=1e-6)  # both symmetric
    assert Path(shadow).contains_point(below)
