"""Signed distances between shapes, as CasADi expressions or numbers, and the points where they are nearest.

The first shape is a capsule. Its distances to spheres, capsules, half-spaces, and as a sphere to boxes, are exact;
against a box a longer capsule is covered by spheres, see `excess`. A distance is negative where shapes overlap: minus
how deep, where one of the two is a half-space or the first a sphere; of capsules, and of a capsule's spheres, minus how
deep the nearest points of their axes say. Gradients are finite everywhere.
"""

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca

from psmpc_cli.robot.kinematics import SpatialFrame
from psmpc_cli.robot.rotations import add, conjugate, dot, minus, plus, product, rotate, scaled, times
from psmpc_cli.specs.geometry import DEEP, Shape

Vector = Sequence[Any]

TINY = 1e-15
"""Added to a squared distance [m^2], so that its root has a gradient at 0: less than 1e-9 m beyond 1e-6 m."""

PARALLEL = 1e-13
"""Least squared sine between two axes that their nearest points are computed with.

At smaller angles the axes are closer to parallel than it matters: with half lengths h their distance d is at most
PARALLEL h^2 / d too large.
"""

MOST_SPHERES = 9
"""Spheres that cover a capsule against boxes."""

LARGEST_EXCESS = 0.05
"""How much larger their radius is than the capsule's, as long as so many spheres suffice."""


def distance(first: Shape, at_first: SpatialFrame, second: Shape, at_second: SpatialFrame) -> Any:
    """Compute the signed distance of two shapes [m].

    Args:
        first: A capsule.
        at_first: Its frame, of expressions or numbers.
        second: A capsule, box or half-space.
        at_second: Its frame.
    """
    nearest, *others = distances(first, at_first, second, at_second)
    for other in others:
        nearest = ca.fmin(nearest, other)
    return nearest


def distances(first: Shape, at_first: SpatialFrame, second: Shape, at_second: SpatialFrame) -> list[Any]:
    """Compute the signed distances of parts of the first shape to the second [m]; the least one is that of the shapes.

    Parts are the two ends of a capsule against a half-space, and the spheres that cover it against a box. Against
    another capsule there is one part. Constraints bound each part's distance, since its gradient is smooth, while that
    of the least one jumps where another part comes nearest.

    Args:
        first: A capsule, a sphere if its length is 0.
        at_first: Its frame, of expressions or numbers.
        second: A capsule, box or half-space.
        at_second: Its frame.
    """
    radius, length = first.size
    if second.kind == "half_space":
        normal = rotate(at_second.quaternion, second.size)  # the size of a half-space is its outward normal
        middle = dot(normal, add(at_first.position, scaled(at_second.position, -1))) - radius
        end = length / 2 * dot(normal, _axis(at_first)) if length else 0.0
        return [middle - end, middle + end] if length else [middle]
    if second.kind == "capsule":
        on_first, on_second = _nearest_on_axes(first, at_first, second, at_second)
        return [_norm(add(on_first, scaled(on_second, -1))) - (radius + second.size[0])]
    centres, covering = _spheres_in_box_frame(first, at_first, at_second)
    return [_to_box(second, centre) - covering for centre in centres]


def part_count(first: Shape, second: Shape) -> int:
    """Return how many `distances` two shapes have."""
    if second.kind == "box":
        return len(_covering_spheres(first)[0])
    return 2 if second.kind == "half_space" and first.size[1] else 1


def witnesses(
    first: Shape, at_first: SpatialFrame, second: Shape, at_second: SpatialFrame
) -> tuple[list[Any], list[Any]]:
    """Compute the points of both surfaces that are nearest to each other, or deepest in the other shape.

    They are as far apart as `distance` says. For a capsule against a box, the first point is on one of the spheres that
    cover the capsule. For two capsules whose axes cross, both points are where they cross, since no direction leads
    them apart.

    Args:
        first: A capsule.
        at_first: Its frame, of expressions or numbers.
        second: A capsule, box or half-space.
        at_second: Its frame.

    Returns:
        The point of the first shape and that of the second, (3,) each [m], in the frame in which both are placed.
    """
    radius, length = first.size
    if second.kind == "half_space":
        normal = rotate(at_second.quaternion, second.size)  # the size of a half-space is its outward normal
        axis = _axis(at_first)
        # the end of the capsule's axis that is deepest, or its middle if both are as deep
        end = add(at_first.position, scaled(axis, -length / 2 * ca.sign(dot(normal, axis))))
        height = dot(normal, add(end, scaled(at_second.position, -1)))
        return add(end, scaled(normal, -radius)), add(end, scaled(normal, -height))
    if second.kind == "capsule":
        on_first, on_second = _nearest_on_axes(first, at_first, second, at_second)
        difference = add(on_second, scaled(on_first, -1))
        towards_second = scaled(difference, 1 / _norm(difference))
        return add(on_first, scaled(towards_second, radius)), add(on_second, scaled(towards_second, -second.size[0]))
    # the nearest of the spheres that cover the capsule; its centre, as a choice that CasADi can express
    centres, covering = _spheres_in_box_frame(first, at_first, at_second)
    centre = centres[0]
    nearest = _to_box(second, centre)
    for other in centres[1:]:
        distance_of_other = _to_box(second, other)
        centre = [ca.if_else(distance_of_other < nearest, new, old) for new, old in zip(other, centre, strict=True)]
        nearest = ca.fmin(nearest, distance_of_other)
    outward = _out_of_box(second, centre)
    points = (add(centre, scaled(outward, -covering)), add(centre, scaled(outward, -nearest)))
    on_first, on_second = (add(at_second.position, rotate(at_second.quaternion, point)) for point in points)
    return on_first, on_second


def excess(shape: Shape) -> float:
    """Return how far at most the distance of a capsule to a box is too small [m]; never too large.

    N spheres with centres L / (N - 1) apart cover the capsule of radius r and length L if their radius is
    R = sqrt(r^2 + (L / (N - 1))^2 / 4). R - r is returned: at most LARGEST_EXCESS r where L is up to 5 r, beyond that
    MOST_SPHERES leave more. It is 0 of a sphere.
    """
    _, covering = _covering_spheres(shape)
    return covering - shape.size[0]


def _covering_spheres(shape: Shape) -> tuple[list[float], float]:
    """Return where along its axis a capsule has the spheres that cover it, and their radius [m]."""
    radius, length = shape.size
    if not length:
        return [0.0], radius
    widest = 2 * radius * math.sqrt((1 + LARGEST_EXCESS) ** 2 - 1)
    gaps = min(math.ceil(length / widest), MOST_SPHERES - 1)
    return [length * (i / gaps - 0.5) for i in range(gaps + 1)], math.hypot(radius, length / gaps / 2)


def _axis(frame: SpatialFrame) -> list[Any]:
    """Compute the x axis of a frame (3,)."""
    w, x, y, z = frame.quaternion
    along = minus(1, times(2, plus(times(y, y), times(z, z))))
    return [along, times(2, plus(times(x, y), times(w, z))), times(2, minus(times(x, z), times(w, y)))]


def _norm(vector: Vector) -> Any:
    """Compute the length of a vector with a gradient at 0, see `TINY`."""
    return ca.sqrt(dot(vector, vector) + TINY)


def _within(value: Any, half: float) -> Any:
    """Compute the nearest number to a value that is between -half and half."""
    return ca.fmax(-half, ca.fmin(value, half))


def _nearest_on_axes(
    first: Shape, at_first: SpatialFrame, second: Shape, at_second: SpatialFrame
) -> tuple[list[Any], list[Any]]:
    """Compute the points of two capsules' axes that are nearest to each other.

    Points of the axes are p + s a and q + t b, with the centres p and q, unit vectors a and b, and s and t between the
    ends. With w = p - q, the squared distance |w + s a - t b|^2 is least where s = t (a b) - a w and t = s (a b) + b w.
    First s is computed without regard to t, and clipped at its ends; then t from s, clipped too; then s from t.
    Ericson: Real-time collision detection (2005), section 5.1.9.

    Args:
        first: A capsule, a sphere if its length is 0; its axis is then its centre.
        at_first: Its frame, of expressions or numbers.
        second: Another capsule.
        at_second: Its frame.

    Returns:
        The point on the first axis and that on the second, (3,) each [m].
    """
    p = at_first.position
    q = at_second.position
    half = first.size[1] / 2
    other_half = second.size[1] / 2
    w = add(p, scaled(q, -1)) if half or other_half else []
    if half and other_half:
        a = _axis(at_first)
        b = _axis(at_second)
        along = dot(a, b)
        a_w = dot(a, w)
        b_w = dot(b, w)
        s = _within((along * b_w - a_w) / ca.fmax(1 - along * along, PARALLEL), half)
        t = _within(s * along + b_w, other_half)
        s = _within(t * along - a_w, half)
        p = add(p, scaled(a, s))
        q = add(q, scaled(b, t))
    elif half:
        a = _axis(at_first)
        p = add(p, scaled(a, _within(-dot(a, w), half)))
    elif other_half:
        b = _axis(at_second)
        q = add(q, scaled(b, _within(dot(b, w), other_half)))
    return list(p), list(q)


def _spheres_in_box_frame(first: Shape, at_first: SpatialFrame, at_box: SpatialFrame) -> tuple[list[list[Any]], float]:
    """Return the centres (3,) of the spheres that cover a capsule, in the frame of a box, and their radius [m]."""
    places, covering = _covering_spheres(first)
    inverse = conjugate(at_box.quaternion)
    centre = rotate(inverse, add(at_first.position, scaled(at_box.position, -1)))
    if places == [0.0]:
        return [centre], covering
    axis = _axis(SpatialFrame(centre, product(inverse, at_first.quaternion)))
    return [add(centre, scaled(axis, place)) for place in places], covering


def _beyond_faces(box: Shape, point: Vector) -> list[Any]:
    """Compute by how much a point in a box's frame is beyond its faces, along every axis that has any (2,) or (3,)."""
    return [ca.fabs(x) - edge / 2 for x, edge in zip(point, box.size, strict=True) if edge < DEEP]


def _largest(values: Vector) -> Any:
    most = values[0]
    for value in values[1:]:
        most = ca.fmax(most, value)
    return most


def _to_box(box: Shape, point: Vector) -> Any:
    """Compute the signed distance of a point in a box's frame to the box [m]."""
    beyond = _beyond_faces(box, point)
    return _norm([ca.fmax(value, 0.0) for value in beyond]) + ca.fmin(_largest(beyond), 0.0)


def _out_of_box(box: Shape, point: Vector) -> list[Any]:
    """Compute the unit vector out of a box (3,) at the nearest point of its surface, in its frame."""
    beyond = _beyond_faces(box, point)
    most = _largest(beyond)
    outside = [ca.fmax(value, 0.0) for value in beyond]
    length = _norm(outside)
    taken: Any = 0.0
    outward = []
    for value, out, x in zip(beyond, outside, point, strict=False):
        is_nearest = ca.if_else(value >= most, 1 - taken, 0.0)
        taken = taken + is_nearest
        outward.append(ca.if_else(x < 0, -1.0, 1.0) * ca.if_else(most > 0, out / length, is_nearest))
    return [*outward, 0.0, 0.0][:3]
