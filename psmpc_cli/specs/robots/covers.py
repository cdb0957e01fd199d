"""Capsules that together cover a body, and how far they reach beyond it: boxes, and convex hulls of meshes."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import LARGEST, quoted, read_regular

logger = logging.getLogger(__name__)

Array = NDArray[np.float64]

MOST_CAPSULES = 4
"""Capsules that cover a box."""

COVER_EXCESS = 0.15
"""Excess of a cover, in lengths of its longest edge, that needs no more capsules."""

MESH_ENDINGS = (".stl", ".obj")
"""Endings of the files of meshes that are read."""

LARGEST_MESH = 2**25
MOST_VERTICES = 200_000
"""Bytes and vertices of a mesh."""

MANY_VERTICES = 20_000
"""Vertices of a mesh that take seconds, which the library's logger says."""

MOST_POINTS = 1000
DIRECTIONS = 250
"""Points of a hull up to which all of them count, and the directions whose outermost points stand for more."""

WIDER = (1.0, 1.02, 1.05, 1.1, 1.2, 1.35, 1.5, 1.75)
"""Radii of a capsule about a mesh that are tried, in its least one: a wider one may be shorter."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Capsules of one radius.

    Attributes:
        ends: Both ends of the segments that they are about (capsules, 2, 3) [m].
        radius: [m].
        excess: Largest distance of a point of them to the body, or a bound of it [m].
    """

    ends: Array
    radius: float
    excess: float

    def moved(self, frame: Array) -> Self:
        """Return the capsules of a body whose frame is at a frame (4, 4)."""
        return replace(self, ends=self.ends @ frame[:3, :3].T + frame[:3, 3])


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh: its vertices (., 3) [m], and whether its surface is closed."""

    vertices: Array
    is_closed: bool


def cover_box(edges: Sequence[float]) -> Cover:
    """Cover a box about the origin, with the least number of capsules whose excess is small.

    The capsules are along the longest edge, a of them beside each other along the second and b along the third one, so
    that each has a share of half edges u and v across. With m the smaller of the two, its segment ends m before the end
    of the box, its radius is sqrt(u^2 + v^2 + m^2), which reaches the corners, and the excess is radius - m. Of
    a b = 1 to MOST_CAPSULES the least number is taken whose excess is at most COVER_EXCESS times the longest edge, and
    if there is none the one with the least excess. In the plane there is no third edge: v is 0, and m is u.

    Args:
        edges: Lengths along x and y, and in space z [m].
    """
    return _best_cover(list(_covers_of_box(np.array(edges, dtype=float))), max(edges))


def _best_cover(covers: Sequence[Cover], longest: float) -> Cover:
    """Return the cover with the fewest capsules of those with a small excess, or if there are none the least excess."""
    least = min(cover.excess for cover in covers)
    small = [cover for cover in covers if cover.excess <= max(COVER_EXCESS * longest, least) * (1 + 1e-9)]
    return min(small, key=lambda cover: (len(cover.ends), cover.excess))


def _covers_of_box(edges: Array) -> Iterator[Cover]:
    """Yield the covers of a box by up to MOST_CAPSULES capsules along its longest edge, see `cover_box`."""
    along, *across = (int(axis) for axis in np.argsort(-edges, kind="stable"))
    for shares in _grids(len(across)):
        halves = edges[across] / shares / 2
        inset = float(halves.min())
        radius = float(np.sqrt((halves**2).sum() + inset**2))
        middles = [(2 * np.arange(share) + 1 - share) * half for share, half in zip(shares, halves, strict=True)]
        rows = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, len(across))
        ends = np.zeros((len(rows), 2, 3))
        ends[:, :, across] = rows[:, None]
        ends[:, :, along] = (edges[along] / 2 - inset) * np.array([-1.0, 1.0])
        yield Cover(ends, radius, radius - inset)


def _grids(dimension: int) -> list[tuple[int, ...]]:
    """Return how many capsules may be beside each other along the other edges of a box."""
    counts = range(1, MOST_CAPSULES + 1)
    if dimension == 1:
        return [(a,) for a in counts]
    return [(a, b) for a in counts for b in counts if a * b <= MOST_CAPSULES]


def read_mesh(path: Path) -> Mesh:
    """Read the mesh of an STL or OBJ file, which collision shapes of a URDF refer to.

    Vertices at the same place are merged, since STL has three of each triangle. Vertices are read even if the surface
    is not closed.

    Raises:
        SpecError: It is missing, no such file, too large, or has no triangles; the message says what was found.
    """
    import trimesh  # takes a while, and only robots with meshes need it

    wanted = f"expected a mesh, {' or '.join(MESH_ENDINGS)}"
    try:
        if path.suffix.lower() not in MESH_ENDINGS:
            raise SpecError(f"found {quoted(path.name)}, {wanted}")
        content = read_regular(path, LARGEST_MESH, f"a mesh file {quoted(path.name)}")
    except OSError as error:
        raise SpecError(f"found no readable file {quoted(path.name)} ({error.strerror}), {wanted}") from None
    try:
        kind = path.suffix.lower()[1:]
        loaded = trimesh.load_mesh(BytesIO(content), file_type=kind, skip_materials=True, process=False)
        largest = float(np.abs(loaded.vertices).max(initial=0.0))  # NaN if any is; processing drops what is not finite
        scale = 1.0
        if largest <= LARGEST:
            # beyond coordinates of 1e6 trimesh merges vertices that are apart; a power of 2 does not round them
            scale = 2.0 ** max(0, np.ceil(np.log2(max(largest, 1.0) / 1e6)))
            loaded.vertices /= scale
            loaded.merge_vertices()
        vertices = scale * np.array(loaded.vertices, dtype=float)
        is_closed = largest <= LARGEST and bool(loaded.is_watertight)
    except Exception as error:  # whatever its readers stumble over
        raise SpecError(f"found no mesh in {quoted(path.name)} ({type(error).__name__}), {wanted}") from None
    if not len(vertices):
        raise SpecError(f"found no triangles in {quoted(path.name)}, {wanted}")
    if not largest <= LARGEST:
        found = f"found a vertex at {largest:g} in {quoted(path.name)}"
        raise SpecError(f"{found}, {wanted} with coordinates of at most {LARGEST:g} in magnitude")
    if len(vertices) > MOST_VERTICES:
        raise SpecError(f"found {len(vertices)} vertices in {quoted(path.name)}, {wanted} of at most {MOST_VERTICES}")
    if np.linalg.matrix_rank(vertices - vertices[0]) < 2:
        raise SpecError(f"found triangles without an area in {quoted(path.name)}, {wanted}")
    return Mesh(vertices, is_closed)


def cover_mesh(vertices: Array) -> Cover:
    """Cover the convex hull of a mesh by few capsules, by which distances of the body are computed.

    Two boxes about the hull are tried: along the axes of the mesh, and the one of the least volume. Each gives covers
    by several capsules, as `cover_box` makes them, and covers by one capsule along an axis of the box. Of all covers
    whose excess is at most COVER_EXCESS times the longest edge the one with the fewest capsules is taken, and if there
    is none the cover with the least excess.

    The excess is how far the capsules reach beyond the convex hull. The distance to the hull is a convex function, so
    it
    is largest on the spheres about the ends of the capsules: radius + (signed distance of an end to the hull). This is
    exact for ends inside the hull, and an upper bound for ends outside.

    Args:
        vertices: Points (., 3) [m] that are not all in one line.
    """
    if len(vertices) > MANY_VERTICES:
        logger.info("covering the convex hull of %d vertices by capsules", len(vertices))
    hull = _Hull(vertices)
    covers = []
    longest = np.inf
    for frame in hull.frames():
        points = hull.points @ frame  # along the axes of the box
        middle = (points.max(axis=0) + points.min(axis=0)) / 2
        edges = np.ptp(points, axis=0)
        longest = min(longest, float(edges.max()))
        covers_in_box = [*_covers_of_box(edges), *_capsules_around(points - middle)]
        pose_of_box = np.eye(4)
        pose_of_box[:3, :3] = frame
        pose_of_box[:3, 3] = frame @ middle
        covers += [cover.moved(pose_of_box) for cover in covers_in_box]
    # the excesses so far are those beyond the boxes
    excesses = [cover.radius + max(map(hull.signed_distance, cover.ends.reshape(-1, 3))) for cover in covers]
    covers = [replace(cover, excess=max(excess, 0.0)) for cover, excess in zip(covers, excesses, strict=True)]
    return _best_cover(covers, longest)


def _capsules_around(points: Array) -> Iterator[Cover]:
    """Yield covers of points by one capsule about each axis through the origin, each as short as its radius allows.

    A capsule of radius r about an axis contains a point at x along and d across the axis if its segment comes within
    sqrt(r^2 - d^2) of x. A wider capsule may be shorter, so several radii are tried, `WIDER`.

    Args:
        points: The points (., 3) [m]; the middle of a box about them is the origin.

    Yields:
        Covers whose excess is not known yet, and is 0.
    """
    for axis in range(3):
        along = points[:, axis]
        across = np.linalg.norm(np.delete(points, axis, axis=1), axis=1)
        for factor in WIDER:
            radius = factor * float(across.max())
            reach = np.sqrt(np.maximum(radius**2 - across**2, 0))
            start = float((along + reach).min())
            end = float((along - reach).max())
            if end < start:  # a sphere anywhere between them is enough
                start = (start + end) / 2
                end = start
            ends = np.zeros((1, 2, 3))
            ends[0, :, axis] = start, end
            yield Cover(ends, radius, 0.0)


class _Hull:
    """The convex hull of points.

    Attributes:
        points: Those that matter (., 3).
        planes: Outward normals and minus offsets of its facets (., 4); none if it is flat.
        outermost: Of many points those that are the outermost in some direction, of few ones all (., 3). Their hull is
            inside the whole one, so that distances to it are upper bounds.
    """

    def __init__(self, points: Array) -> None:
        from scipy.spatial import ConvexHull, QhullError

        try:
            hull = ConvexHull(points)
            self.points = points[hull.vertices]
            self.planes = hull.equations
        except (QhullError, ValueError):
            self.points = np.unique(points, axis=0)
            self.planes = np.zeros((0, 4))
        self.outermost = _outermost(self.points) if len(self.points) > MOST_POINTS else self.points

    def frames(self) -> Iterator[Array]:
        """Yield axes of boxes about it, as columns (3, 3): its own, and those of the box with the least volume."""
        from trimesh.bounds import oriented_bounds

        yield np.eye(3)
        if len(self.planes):
            size = np.ptp(self.points, axis=0).max()  # it takes all that is small in metres for flat
            try:
                with np.errstate(all="ignore"):
                    to_box, _ = oriented_bounds(self.outermost / size)
            except Exception:  # it finds no box about what is much thinner than wide; the first one has to do
                return
            yield np.asarray(to_box)[:3, :3].T

    def signed_distance(self, point: Array) -> float:
        """Return the signed distance of a point to the hull [m]: negative inside, 0 on its surface.

        Inside it is exact. Outside it is that to the hull of `outermost`, which may be a little too large.

        Args:
            point: The point (3,) [m].
        """
        from scipy.optimize import nnls

        if len(self.planes):
            depth = float((self.planes[:, :3] @ point + self.planes[:, 3]).max())
            if depth <= 0:
                return depth
        # The nearest point is a mean of the hull's points p_i, sum_i s_i p_i with s_i >= 0 and sum_i s_i = 1. Least
        # squares minimize |sum_i s_i (p_i - point)|^2 + (weight (sum_i s_i - 1))^2, with a large weight of the sum.
        apart = self.outermost - point
        weight = 1e3 * float(np.abs(apart).max())
        try:
            shares, _ = nnls(np.vstack([apart.T, np.full(len(apart), weight)]), [0, 0, 0, weight])
        except RuntimeError:  # of a body a million times as long as wide it may not converge
            return float(np.linalg.norm(apart, axis=1).min())
        return float(np.linalg.norm(shares @ apart / shares.sum()))


def _outermost(points: Array) -> Array:
    """Return the points (., 3) that are the outermost of many in some of `DIRECTIONS` directions, evenly spread."""
    number = np.arange(DIRECTIONS) + 0.5
    height = 1 - 2 * number / DIRECTIONS
    turn = np.pi * (1 + np.sqrt(5)) * number  # a spiral by the golden angle
    across = np.sqrt(1 - height**2)
    directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
    directions = np.vstack([directions, np.eye(3), -np.eye(3)])
    spread = np.ptp(points, axis=0)
    scaled = (points - points.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    farthest = [(scaled @ some.T).argmax(axis=0) for some in np.array_split(directions, 16)]
    return np.asarray(points[np.unique(np.concatenate(farthest))])
