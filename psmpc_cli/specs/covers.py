"""Capsules that together cover a body, and how far they reach beyond it: boxes, and convex hulls of meshes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.errors import SpecError
from psmpc_cli.specs.document import quoted, read_regular

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
    return _chosen(list(_covers_of_box(np.array(edges, dtype=float))), max(edges))


def _chosen(covers: Sequence[Cover], longest: float) -> Cover:
    """Return the cover with the fewest capsules of those with a small excess, or if there are none the least excess."""
    least = min(cover.excess for cover in covers)
    small = [cover for cover in covers if cover.excess <= max(COVER_EXCESS * longest, least) * (1 + 1e-9)]
    return min(small, key=lambda cover: (len(cover.ends), cover.excess))


def _covers_of_box(edges: Array) -> Iterator[Cover]:
    """Give the covers of a box by up to MOST_CAPSULES capsules along its longest edge, see `cover_box`."""
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
    """Read the mesh of an STL or OBJ file.

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
        loaded = trimesh.load_mesh(BytesIO(content), file_type=path.suffix.lower()[1:], skip_materials=True)
        vertices = np.array(loaded.vertices, dtype=float)
        is_closed = bool(loaded.is_watertight)
    except Exception as error:  # whatever its readers stumble over
        raise SpecError(f"found no mesh in {quoted(path.name)} ({type(error).__name__}), {wanted}") from None
    if not len(vertices):
        raise SpecError(f"found no triangles in {quoted(path.name)}, {wanted}")
    if len(vertices) > MOST_VERTICES:
        raise SpecError(f"found {len(vertices)} vertices in {quoted(path.name)}, {wanted} of at most {MOST_VERTICES}")
    if not np.isfinite(vertices).all() or np.linalg.matrix_rank(vertices - vertices[0]) < 2:
        raise SpecError(f"found triangles without an area in {quoted(path.name)}, {wanted}")
    return Mesh(vertices, is_closed)


def cover_mesh(vertices: Array) -> Cover:
    """Cover the convex hull of points (., 3) that are not in a line, as a box or by one capsule.

    A box about them, along the axes or the one of the least volume, is covered as `cover_box` does, or one capsule is
    along a principal axis of such a box. Of all of them the least number of capsules is taken whose excess is at most
    COVER_EXCESS times the box's longest edge, and if there is none the cover with the least excess.

    The excess is that beyond the convex hull. The distance to it is convex, so it is largest on the spheres about the
    ends of the capsules: radius + (signed distance of an end to the hull), which is exact inside the hull, and of ends
    outside an upper bound.
    """
    hull = _Hull(vertices)
    covers = []
    longest = np.inf
    for frame in hull.frames():
        inside = hull.points @ frame
        middle = (inside.max(axis=0) + inside.min(axis=0)) / 2
        edges = np.ptp(inside, axis=0)
        longest = min(longest, float(edges.max()))
        found = [*_covers_of_box(edges), *_capsules_about(inside - middle)]
        placed = np.eye(4)
        placed[:3, :3] = frame
        placed[:3, 3] = frame @ middle
        covers += [cover.moved(placed) for cover in found]
    beyond = [cover.radius + max(map(hull.signed_distance, cover.ends.reshape(-1, 3))) for cover in covers]
    judged = [replace(cover, excess=max(far, 0.0)) for cover, far in zip(covers, beyond, strict=True)]
    return _chosen(judged, longest)


def _capsules_about(points: Array) -> Iterator[Cover]:
    """Give capsules about points (., 3) along each axis, as short as they can be with some radii."""
    for axis in range(3):
        along = points[:, axis]
        across = np.linalg.norm(np.delete(points, axis, axis=1), axis=1)
        for wider in WIDER:
            radius = wider * float(across.max())
            reach = np.sqrt(np.maximum(radius**2 - across**2, 0))
            start = float((along + reach).min())
            end = float((along - reach).max())
            if end < start:  # a sphere is enough
                start = end = (start + end) / 2
            ends = np.zeros((1, 2, 3))
            ends[0, :, axis] = start, end
            yield Cover(ends, radius, 0.0)


class _Hull:
    """The convex hull of points.

    Attributes:
        points: Those that matter (., 3).
        planes: Outward normals and minus offsets of its facets (., 4); none if it is flat.
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

    def frames(self) -> Iterator[Array]:
        """Give axes of boxes about it, as columns (3, 3): its own, and those of the box with the least volume."""
        from trimesh.bounds import oriented_bounds

        yield np.eye(3)
        if len(self.planes):
            to_box, _ = oriented_bounds(self.points)
            yield np.asarray(to_box)[:3, :3].T

    def signed_distance(self, point: Array) -> float:
        """Return the distance of a point (3,), negative inside; outside perhaps a little too large."""
        from scipy.optimize import nnls

        if len(self.planes):
            depth = float((self.planes[:, :3] @ point + self.planes[:, 3]).max())
            if depth <= 0:
                return depth
        # the nearest point as a mean of the hull's points, whose shares are at least 0 and add up to 1
        heavy = 1e3 * float(np.abs(self.points - point).max())
        shares, _ = nnls(np.vstack([(self.points - point).T, np.full(len(self.points), heavy)]), [0, 0, 0, heavy])
        return float(np.linalg.norm(shares @ (self.points - point) / shares.sum()))
