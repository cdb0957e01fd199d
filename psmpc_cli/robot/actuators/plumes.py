"""Plumes of thrusters: cones from their nozzles, and which of them reach a body.

The plume of a thruster is what is nearer to its nozzle than its length and within its angle of its axis, which points
against the force: a convex set. So the distance to it is convex along the segment of a capsule.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.robot.kinematics import SpatialFrame
from psmpc_cli.robot.rotations import add, conjugate, rotate, scaled
from psmpc_cli.specs.geometry import Shape
from psmpc_cli.specs.robots.actuators import Thruster

Vector = NDArray[np.float64]

GOLDEN = (5**0.5 - 1) / 2
STEPS = 25
"""Golden sections of a segment in search of its point that is nearest to a plume, to 6e-6 of its length."""


@dataclass(frozen=True, eq=False)
class Plumes:
    """The plumes of a base's T thrusters, in the base frame, with z = 0 in the plane.

    Attributes:
        nozzles: Where they begin (T, 3) [m].
        axes: Unit vectors along which they leave (T, 3).
        angles: Between axis and edge (T,) [rad].
        lengths: How far they reach (T,) [m]; NaN of a thruster without one, which reaches nothing.
    """

    nozzles: Vector
    axes: Vector
    angles: Vector
    lengths: Vector

    @classmethod
    def of(cls, thrusters: Sequence[Thruster]) -> "Plumes":
        """Return those that a robot's file describes."""
        nozzles = np.array([[*thruster.position, 0.0][:3] for thruster in thrusters]).reshape(-1, 3)
        pushed = np.array([[*thruster.direction, 0.0][:3] for thruster in thrusters]).reshape(-1, 3)
        given = [thruster.plume for thruster in thrusters]
        return cls(
            nozzles=nozzles,
            axes=-pushed / np.linalg.norm(pushed, axis=1, keepdims=True),
            angles=np.array([0.0 if plume is None else plume.angle for plume in given]),
            lengths=np.array([np.nan if plume is None else plume.length for plume in given]),
        )

    def reach(self, base: SpatialFrame, shape: Shape, at: SpatialFrame) -> NDArray[np.bool_]:
        """Tell which plumes reach a shape, for N placements of base and shape at once.

        A thruster whose plume reaches a body that it must not blow at is kept shut.

        Args:
            base: The base's frame; each component of its position and its quaternion is an array (N,).
            shape: A capsule or a half-space.
            at: The frame of the shape, likewise.

        Returns:
            Whether the plume of each of the T thrusters reaches it, (N, T).
        """
        to_base_axes = conjugate(base.quaternion)
        place = _stacked(rotate(to_base_axes, add(at.position, scaled(base.position, -1))))
        if shape.kind == "half_space":
            normal = _stacked(rotate(to_base_axes, rotate(at.quaternion, shape.size)))  # its size is its normal
            return self._reach_half_spaces(normal, place)
        radius, length = shape.size
        along = _stacked(rotate(to_base_axes, rotate(at.quaternion, (length, 0.0, 0.0))))
        # distances are only computed where the capsule is within the sphere that all plumes lie in
        is_near = np.linalg.norm(place, axis=1) <= self._reach_of_all + length / 2 + radius
        reached = np.zeros((len(place), len(self.axes)), bool)
        if is_near.any():
            start = (place - along / 2)[is_near]
            with np.errstate(invalid="ignore"):  # a thruster without a plume has the length NaN, and reaches nothing
                reached[is_near] = self._distances_to_segments(start, along[is_near]) <= radius
        return reached

    @cached_property
    def _reach_of_all(self) -> float:
        """How far from the base's origin plumes reach at most [m]."""
        return float(np.nanmax(np.linalg.norm(self.nozzles, axis=1) + self.lengths, initial=0.0))

    def _reach_half_spaces(self, normal: Vector, place: Vector) -> NDArray[np.bool_]:
        """Tell which reach below planes through places (N, 3) with normals (N, 3), see `reach`.

        The lowest point of a plume is its nozzle, or on its edge, or straight below the nozzle.
        """
        off_axis = np.arccos(np.clip(-normal @ self.axes.T, -1.0, 1.0))
        deepest = self.lengths * np.maximum(np.cos(np.maximum(off_axis - self.angles, 0.0)), 0.0)
        height = np.einsum("nk,ntk->nt", normal, self.nozzles - place[:, None])
        with np.errstate(invalid="ignore"):
            return np.asarray(height <= deepest)

    def _distances_to_segments(self, start: Vector, along: Vector) -> Vector:
        """Compute the distances between N segments and the T plumes, by a golden section search along each segment.

        The distance to a plume, a convex set, is convex along a segment: so the search finds the least one. It follows
        from two numbers of a point: how far it is ahead of the nozzle along the plume's axis, which is linear along the
        segment, and the square of its distance from the nozzle, which is quadratic.

        Args:
            start: Where the segments begin, in the frame of the base (N, 3) [m].
            along: From there to their ends (N, 3) [m].

        Returns:
            The distances (N, T) [m]; 0 where a segment meets a plume.
        """
        from_nozzle = start[:, None] - self.nozzles
        ahead = np.einsum("ntk,tk->nt", from_nozzle, self.axes)
        rate = along @ self.axes.T
        squared = np.einsum("ntk,ntk->nt", from_nozzle, from_nozzle)
        slope = 2 * np.einsum("ntk,nk->nt", from_nozzle, along)
        curvature = np.einsum("nk,nk->n", along, along)[:, None]

        def distance_at(share: Vector) -> Vector:
            return self._distances_to_points(ahead + share * rate, squared + share * (slope + share * curvature))

        low = np.zeros_like(ahead)
        if not along.any():
            return distance_at(low)  # the segments are points
        high = np.ones_like(low)
        inner = 1 - GOLDEN + low
        outer = GOLDEN + low
        at_inner = distance_at(inner)
        at_outer = distance_at(outer)
        for _ in range(STEPS):
            is_lower = at_inner <= at_outer  # the least is before `outer`
            low = np.where(is_lower, low, inner)
            high = np.where(is_lower, outer, high)
            new = np.where(is_lower, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
            at_new = distance_at(new)
            kept = np.where(is_lower, inner, outer)
            at_kept = np.where(is_lower, at_inner, at_outer)
            inner = np.where(is_lower, new, kept)
            outer = np.where(is_lower, kept, new)
            at_inner = np.where(is_lower, at_new, at_kept)
            at_outer = np.where(is_lower, at_kept, at_new)
        return np.minimum(at_inner, at_outer)

    def _distances_to_points(self, ahead: Vector, squared: Vector) -> Vector:
        """Compute the distances to each plume (N, T) [m] of points so far ahead of its nozzle, and from it, squared."""
        sine = np.sin(self.angles)
        cosine = np.cos(self.angles)
        aside = np.sqrt(np.maximum(squared - ahead**2, 0.0))
        on_edge = np.clip(ahead * cosine + aside * sine, 0.0, self.lengths)
        to_edge = np.hypot(ahead - on_edge * cosine, aside - on_edge * sine)
        to_end = np.maximum(np.sqrt(np.maximum(squared, 0.0)) - self.lengths, 0.0)
        return np.asarray(np.where(aside * cosine <= ahead * sine, to_end, to_edge))


def _stacked(components: Sequence[Vector]) -> Vector:
    """Return vectors of components (N,) each as rows (N, 3)."""
    return np.stack(np.broadcast_arrays(*components), axis=-1)
