"""Shapes as they are seen from a camera: boxes with shaded faces, capsules, half-spaces within the view."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from psmpc_cli.figures.scene import PLAN, Camera, box_corners, capsule_ends, half_edges, in_inertial_frame
from psmpc_cli.specs.geometry import Shape

DEPTH_ORDER = 100.0
"""How much later a body is drawn for every metre that it is nearer to the viewer, as drawing order [1/m]."""

BELOW_ALL = -1e4
ABOVE_ALL = 1e4
"""Drawing orders (Matplotlib's zorder) of what is under all bodies of a spatial scene, and of what is over them."""

FLOOR_ORDER = 2 * BELOW_ALL
SHADOW_ORDER = 1.5 * BELOW_ALL
"""Drawing orders of the squares below a spatial scene, and of the shadows on them."""

EDGE_ON_ORDER = 0.5
SHAPE_ORDER = 1.0
BASE_ORDER = 2.0
LINK_ORDER = 3.0
JOINT_ORDER = 3.1
COVER_ORDER = 3.2
ADVICE_ORDER = 3.3
"""Drawing orders at depth 0: half-spaces seen edge-on; object and obstacles; the base of a robot, its links and joints;
the capsules that cover its bodies; advised postures of its arms."""

SHADOW_COLOR = "#EFEFEF"
"""Colour of the shadow on the floor of a scene."""

CIRCLE = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
"""Angles of the points that stand for a circle [rad]."""

WALL_OPACITY = 0.25
"""Opacity of the wall that bounds a half-space, through which a spatial scene is seen."""


def draw_shape(
    axes: Axes, camera: Camera, shape: Shape, frame: np.ndarray, extent: np.ndarray, look: Mapping[str, Any]
) -> None:
    """Draw a shape in a frame (4, 4); of a half-space what is in the view of points (., 3)."""
    if shape.kind == "box":
        draw_box(axes, camera, frame, half_edges(shape.edges), look)
    elif shape.kind == "capsule":
        ends = in_inertial_frame(frame, capsule_ends(shape))
        order = SHAPE_ORDER + DEPTH_ORDER * camera.depth(ends)
        axes.add_patch(Polygon(capsule_outline(camera, ends, shape.size[0]), **{**look, "zorder": order}))
    else:
        _draw_half_space(axes, camera, frame[:3, :3] @ shape.size, frame[:3, 3], extent, look)


def draw_box(
    axes: Axes,
    camera: Camera,
    frame: np.ndarray,
    half: np.ndarray,
    look: Mapping[str, Any],
    zorder: float = SHAPE_ORDER,
) -> None:
    """Draw the faces of a box that are turned to the viewer, those that are seen at an angle darker.

    Args:
        axes: The panel.
        camera: From where the box is seen.
        frame: Frame of the box, with its centre as origin (4, 4) [m].
        half: Half its edges (3,) [m].
        look: Colours and label of the faces.
        zorder: Drawing order of a face at depth 0.
    """
    towards = frame[:3, :3].T @ camera.axes[2]  # the direction to the viewer in the frame of the box
    for axis in np.argsort(-np.abs(towards)).tolist():  # the legend has the brightest face
        if abs(towards[axis]) > 1e-6 and np.delete(half, axis).min() > 0:
            signs = np.insert([[1, 1], [-1, 1], [-1, -1], [1, -1]], axis, np.sign(towards[axis]), axis=1)
            points = in_inertial_frame(frame, signs * half)
            face = look["facecolor"]
            shaded = face if face == "none" else np.array(to_rgb(face)) * (0.7 + 0.3 * abs(towards[axis]))
            order = zorder + DEPTH_ORDER * camera.depth(points)
            axes.add_patch(Polygon(camera.project(points), **{**look, "facecolor": shaded, "zorder": order}))


def capsule_outline(camera: Camera, ends: np.ndarray, radius: float) -> np.ndarray:
    """Return the outline (., 2) of a capsule about a segment (2, 3) as it is seen, closed."""
    seen = camera.project(_silhouette_points(camera, ends, radius))
    around = ConvexHull(seen).vertices
    return np.asarray(seen[[*around, around[0]]])


def _silhouette_points(camera: Camera, ends: np.ndarray, radius: float) -> np.ndarray:
    """Return points (., 3) on a capsule whose hull is its outline as it is seen."""
    circle = radius * np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE)]) @ camera.axes[:2]
    return np.asarray((ends[:, None] + circle).reshape(-1, 3))


def draw_shadow(axes: Axes, camera: Camera, shape: Shape, frame: np.ndarray, floor: float) -> None:
    """Draw the shadow of a shape from straight above on a floor at a height [m]; a half-space has none."""
    if shape.kind == "half_space":
        return
    if shape.kind == "box":
        points = box_corners(frame, half_edges(shape.edges))
    else:
        points = _silhouette_points(PLAN, in_inertial_frame(frame, capsule_ends(shape)), shape.size[0])
    points = points[ConvexHull(points[:, :2]).vertices]
    points[:, 2] = floor
    axes.add_patch(Polygon(camera.project(points), facecolor=SHADOW_COLOR, zorder=SHADOW_ORDER))


def _draw_half_space(
    axes: Axes, camera: Camera, normal: np.ndarray, origin: np.ndarray, extent: np.ndarray, look: Mapping[str, Any]
) -> None:
    """Draw the part of a half-space (a wall) that is in a view.

    Where the face is seen edge-on, as always in the plane, this is the area of the view that the half-space covers.
    Elsewhere it is the transparent face: drawn behind all else if its outside is turned to the viewer, before all else
    if not, since everything is outside of the half-space.

    Args:
        axes: The panel.
        camera: From where the scene is seen.
        normal: Outward unit normal of the face (3,).
        origin: A point of the face (3,) [m].
        extent: Points (., 3) in the view [m].
        look: Colours and label of the patch.
    """
    if abs(normal @ camera.axes[2]) < 1e-6:
        (x0, y0), (x1, y1) = camera.view(extent).get_points()
        view_corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        # the view as a rectangle in space (4, 3), through the origin, and of it what is in the half-space
        area = _clip_to_half_space(view_corners @ camera.axes[:2], normal, origin)
        order = EDGE_ON_ORDER
        alpha = 1.0
    else:
        low = extent.min(axis=0)
        high = extent.max(axis=0)
        # the last two right singular vectors span the face; a square in it is cut to the box of all points
        _, _, in_face = np.linalg.svd(normal[None])
        middle_of_face = (low + high) / 2
        middle_of_face = middle_of_face - ((middle_of_face - origin) @ normal) * normal
        reach = 2 * float(np.linalg.norm(high - low))  # beyond all points of the view
        area = middle_of_face + reach * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ in_face[1:]
        for axis in np.eye(3):
            area = _clip_to_half_space(area, axis, high)
            area = _clip_to_half_space(area, -axis, low)
        is_behind = normal @ camera.axes[2] > 0  # its outside, with all bodies, is turned to the viewer
        order = 1.2 * BELOW_ALL if is_behind else ABOVE_ALL
        alpha = WALL_OPACITY
    if len(area) > 2:  # else nothing of it is in the view
        axes.add_patch(Polygon(camera.project(area), **{**look, "zorder": order, "alpha": alpha}))


def _clip_to_half_space(polygon: np.ndarray, normal: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return the part of a convex polygon (., 3) in the half-space with an outward normal at an origin.

    A step of the algorithm of Sutherland and Hodgman. The part is (0, 3) if nothing of the polygon is in there.
    """
    beyond = (polygon - origin) @ normal  # how far each corner is outside; negative inside
    kept = list[np.ndarray]()
    for i, point in enumerate(polygon):
        before = beyond[i - 1]
        if (before > 0) != (beyond[i] > 0):
            kept.append(polygon[i - 1] + before / (before - beyond[i]) * (point - polygon[i - 1]))
        if beyond[i] <= 0:
            kept.append(point)
    return np.reshape(kept, (-1, 3))
