"""Thrusters on the base: which wrenches they can give, with which thrusts, and in which pulses.

A thruster i pushes the base with f_i w_i, 0 <= f_i <= F_i, where w_i is its wrench for a thrust of 1 N. What all of
them can give together is the zonotope sum_i [0, F_i] w_i. Each of its facets is spanned by d - 1 independent wrenches
(d = 3 in the plane, 6 in space). So it is the set of the wrenches w with low <= n . w <= high for the facets' normals
n, where high = sum_i F_i max(0, n . w_i), and low likewise. Ziegler, Lectures on Polytopes (1995), section 7.3.

Wrenches are about the origin of the base's frame, along its own axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.errors import InputError
from psmpc_cli.specs.robots.actuators import Thruster

Vector = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
"""By which a specific impulse in seconds is multiplied [m/s^2]."""

PARALLEL = 1e-9
"""Sine of the angle below which two directions are the same."""

MOST_FACETS = 200
"""Pairs of facets beyond which plans would take far longer."""

MOST_SETS = 200_000
"""Sets of directions that are looked at in search of facets."""

ROUNDING = 1e-9
"""By how much a number of ticks may be off a whole one and still count as it."""

NOTHING = 1e-9
"""Error below which a wrench is attained, as a part of the largest thrust."""


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """Wrenches w (d,) with low <= normals w <= high, in pairs of opposite facets.

    Attributes:
        normals: Outward normals of one facet of each pair (K, d).
        low: Least value (K,), at most 0.
        high: Largest value (K,), at least 0.
    """

    normals: Vector
    low: Vector
    high: Vector


@dataclass(frozen=True, eq=False)
class Allocation:
    """Thrusts for a wrench.

    Attributes:
        thrusts: Of each thruster (T,) [N].
        residual: Wanted wrench less what they give (d,) [N, N m]; 0 where it can be given.
    """

    thrusts: Vector
    residual: Vector


@dataclass(frozen=True, eq=False)
class Thrusters:
    """The thrusters of a base.

    Attributes:
        wrenches: For a thrust of 1 N each (d, T) [1, m].
        force: Largest thrusts (T,) [N].
        smallest_force: Smallest thrusts of a thruster that fires (T,) [N]; `force` of one that is on or off.
        shortest_pulse: Shortest times for which they fire (T,) [s].
        specific_impulse: Impulse over weight of the propellant (T,) [s]; NaN where it is not known.
    """

    wrenches: Vector
    force: Vector
    smallest_force: Vector
    shortest_pulse: Vector
    specific_impulse: Vector

    @classmethod
    def of(cls, thrusters: Sequence[Thruster]) -> "Thrusters":
        """Return those that a robot's file describes."""
        return cls(
            wrenches=np.array([thruster.wrench for thruster in thrusters]).T,
            force=np.array([thruster.force for thruster in thrusters]),
            smallest_force=np.array([thruster.smallest_force or thruster.force for thruster in thrusters]),
            shortest_pulse=np.array([thruster.shortest_pulse for thruster in thrusters]),
            specific_impulse=np.array([thruster.specific_impulse or np.nan for thruster in thrusters]),
        )

    @property
    def count(self) -> int:
        """Number of thrusters T."""
        return len(self.force)

    @cached_property
    def arm(self) -> float:
        """Root mean square of torque over force of the thrusters [m], which makes torques comparable with forces."""
        linear, angular = np.split(self.wrenches, [2 if len(self.wrenches) == 3 else 3])
        return float(np.linalg.norm(angular) / np.linalg.norm(linear)) or 1.0

    @cached_property
    def _scale(self) -> Vector:
        """Factors that make forces of wrenches (d,), those of torques being 1 / `arm`."""
        d = len(self.wrenches)
        return np.repeat([1.0, 1 / self.arm], [2, 1] if d == 3 else [3, 3])

    def along(self, direction: Vector) -> tuple[float, float]:
        """Return the least and the largest value of n . w over all attainable wrenches w, for a direction n (d,)."""
        parts = self.force * (direction @ self.wrenches)
        return float(np.minimum(parts, 0).sum()), float(np.maximum(parts, 0).sum())

    def bounds(self, normals: Vector, is_shut: NDArray[np.bool_]) -> tuple[Vector, Vector]:
        """Return the bounds of n . w over all wrenches w that thrusters give while some of them are shut.

        With the normals of `half_spaces` these bounds describe exactly what the open thrusters give. To see why, let
        the shut thrusters have a small largest thrust instead of none. The facets are then spanned by the same
        directions as with all thrusters open; and as that thrust goes to 0, both the set of wrenches and the set within
        the bounds shrink to those without these thrusters.

        Args:
            normals: The normals n (K, d), of any length.
            is_shut: Which thrusters are shut, at N times (N, T).

        Returns:
            The least and the largest values, (N, K) each.
        """
        # what n . w gets from each thruster at its largest thrust (K, T)
        parts = self.force * (normals @ self.wrenches)
        is_open = (~is_shut).astype(float)
        return is_open @ np.minimum(parts, 0).T, is_open @ np.maximum(parts, 0).T

    @cached_property
    def extent(self) -> tuple[Vector, Vector]:
        """Least and largest components of attainable wrenches, (d,) each [N, N m]."""
        low, high = zip(*map(self.along, np.eye(len(self.wrenches))), strict=True)
        return np.array(low), np.array(high)

    @cached_property
    def half_spaces(self) -> HalfSpaces:
        """The half-spaces whose intersection is the set of all wrenches that the thrusters can give together.

        They limit the force on the base in optimizations. Normals are found with torques divided by `arm`, so that all
        components are forces; the result has wrenches in N and N m.

        Raises:
            InputError: There are too many.
        """
        d = len(self.wrenches)
        directions = _distinct((self._scale[:, None] * self.wrenches).T)
        # d - 1 directions span a facet; `count` is an upper bound of the pairs of facets until they are computed
        count = comb(len(directions), d - 1)
        if count <= MOST_SETS:
            normals = _normals_of_facets(directions) * self._scale
            count = len(normals)
        if count > MOST_FACETS:
            raise InputError(
                f"thrusters: found {self.count} in {len(directions)} directions, whose wrenches have more than "
                f"{MOST_FACETS} pairs of facets, expected fewer directions: make thrusters parallel, or leave them out "
                "and limit the force of the base (limits: {base: {force: ...}})"
            )
        low, high = zip(*map(self.along, normals), strict=True)
        return HalfSpaces(normals, np.array(low), np.array(high))

    def allocate(self, wrench: Vector, is_shut: NDArray[np.bool_] | None = None) -> Allocation:
        """Return the thrusts that give a wrench with the least propellant.

        Propellant is the sum of thrusts over specific impulses; if a specific impulse is not known, the sum of thrusts
        takes its place. If the wrench cannot be given, the thrusts give the nearest one that can be. Nearest is in the
        norm in which torques are divided by `arm`.

        Args:
            wrench: Wanted force and torque on the base (d,) [N, N m], d = 3 in the plane, 6 in space.
            is_shut: Which thrusters must not fire (T,); by default all may.
        """
        from scipy.optimize import linprog, lsq_linear

        used = slice(None) if is_shut is None else np.flatnonzero(~is_shut)
        force = self.force[used]
        thrusts = np.zeros(self.count)
        if not (wrench.any() and len(force)):
            return Allocation(thrusts, wrench.copy())
        is_known = np.isfinite(self.specific_impulse).all()
        cost = 1 / (self.specific_impulse[used] if is_known else np.ones(len(force)))
        A = self._scale[:, None] * self.wrenches[:, used]
        bounds = np.column_stack([np.zeros(len(force)), force])
        options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
        b = self._scale * wrench
        solved = linprog(cost / cost.max(), A_eq=A, b_eq=b, bounds=bounds, method="highs-ds", options=options)
        if solved.status != 0:
            # the nearest wrench that can be given, then again the least propellant for it
            nearest = lsq_linear(A, b, (np.zeros(len(force)), force), method="bvls", tol=1e-12).x
            b = A @ nearest
            solved = linprog(cost / cost.max(), A_eq=A, b_eq=b, bounds=bounds, method="highs-ds", options=options)
        thrusts[used] = np.clip(nearest if solved.status != 0 else solved.x, 0.0, force)
        residual = wrench - self.wrenches @ thrusts
        is_given = np.linalg.norm(self._scale * residual) <= NOTHING * self.force.max()
        return Allocation(thrusts, np.zeros_like(wrench) if is_given else residual)

    def pulses(self, thrusts: Vector, ticks: int, tick: float) -> Vector:
        """Return pulses that give, as far as they can, the same impulses as constant thrusts over a period.

        A thruster fires at most once in the period, about the middle of it, so that at the end of the period the robot
        has moved as far as under the constant thrust. A thruster that can be throttled down to the constant thrust
        gives that. One that cannot, because the thrust is below its smallest force or because it is on or off, fires
        for a part of the period: for whole ticks, and for its shortest pulse at least.

        If the wanted pulse is shorter than half of its shortest one, a thruster does not fire. So the error is at most
        half of the shortest pulse, while a thruster that waited for the whole of it would always be late.

        Args:
            thrusts: The constant thrusts (T,), at most `force` [N].
            ticks: Number of ticks of the period, which the shortest pulses fit into.
            tick: Length of a tick [s].

        Returns:
            Thrust over each tick (ticks, T) [N].
        """
        throttles = self.smallest_force < self.force
        width = thrusts / self.smallest_force * ticks  # of the wanted pulse [ticks]
        shortest = np.maximum(np.ceil(self.shortest_pulse / tick - ROUNDING), 1.0)  # pulse [ticks]
        # one that throttles makes up for a pulse of whole ticks by its force
        whole = np.where(throttles, np.floor(width + ROUNDING), np.round(width))
        count = np.minimum(np.maximum(whole, shortest), ticks).astype(int)
        level = np.where(throttles, np.clip(thrusts * ticks / count, self.smallest_force, self.force), self.force)
        fires = width >= shortest / 2
        number = np.arange(ticks)[:, None]  # of each tick
        start = (ticks - count) // 2
        return np.where(fires & (number >= start) & (number < start + count), level, 0.0)

    def propellant(self, impulses: Vector) -> float:
        """Return the mass of propellant for impulses (T,) [N s] in kg; NaN where a specific impulse is not known."""
        return float((impulses / (STANDARD_GRAVITY * self.specific_impulse)).sum())


def no_half_spaces(d: int) -> HalfSpaces:
    """Return the half-spaces of a base whose wrench (d,) is not that of thrusters: none."""
    return HalfSpaces(np.zeros((0, d)), np.zeros(0), np.zeros(0))


def _distinct(vectors: Vector) -> Vector:
    """Return the directions of vectors (T, d), unit vectors, of which no two are parallel (m, d)."""
    chosen: list[Vector] = []
    for vector in vectors:
        unit = vector / np.linalg.norm(vector)
        if all(np.linalg.norm(unit - (unit @ other) * other) > PARALLEL for other in chosen):
            chosen.append(unit)
    return np.array(chosen)


def _normals_of_facets(directions: Vector) -> Vector:
    """Return the unit normals (K, d) of the hyperplanes that d - 1 of some directions (m, d) span, no two parallel."""
    d = directions.shape[1]
    sets = np.array(list(combinations(range(len(directions)), d - 1)))
    _, singular, V = np.linalg.svd(directions[sets])
    normals = V[singular[:, -1] > 1e-8, -1]
    # one sign for each: that of the largest component
    largest = np.take_along_axis(normals, np.abs(normals).round(9).argmax(axis=1)[:, None], axis=1)
    normals = normals * np.sign(largest)
    _, first = np.unique(normals.round(8) + 0.0, axis=0, return_index=True)
    chosen = normals[np.sort(first)]
    return np.asarray(np.where(np.abs(chosen) < 1e-12, 0.0, chosen))
