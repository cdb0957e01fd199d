"""How a front moves with the ratio of the weights, and from sample to sample. Paper section IV-B, on Fig. 7.

J_2 lies to the right and J_1 up, so that more weight on the second stage should lead to the upper left.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Results
from psmpc_cli.studies.fronts import CLEARLY, extents
from psmpc_cli.studies.pareto_file import WEIGHTED, costs_of

Vector = np.ndarray

Measure = Literal["normalized", "per second", "own extent"]

MEASURES: tuple[Measure, ...] = ("normalized", "per second", "own extent")
"""What a front is followed in: costs as the windows have them, normalized by (12) at each sample anew; their means over
the stages' parts of the horizon, as sums over N_s nodes each would be; and each front over its own extent."""

WORDS: dict[Measure, str] = {
    "normalized": "in costs normalized as in (12)",
    "per second": "in their means over each stage's part of the horizon",
    "own extent": "with every front over its own extent",
}


@dataclass(frozen=True)
class Step:
    """How a front moves from one sample to the next; every ratio's point is followed.

    Attributes:
        before, after: The sampling instants [s].
        right, up: Mean change of J_2 and of J_1 over the ratios.
        share: Part of the ratios whose point moves neither to the right nor down.
    """

    before: float
    after: float
    right: float
    up: float
    share: float

    @property
    def direction(self) -> str:
        """Where the points move on average, such as upper left; unknown where no ratio has a point at both samples."""
        if not np.isfinite([self.right, self.up]).all():
            return "unknown"
        return f"{'upper' if self.up > 0 else 'lower'} {'left' if self.right < 0 else 'right'}"

    @property
    def upper_left(self) -> bool:
        """Whether they move to the upper left on average."""
        return self.up > 0 and self.right < 0


@dataclass(frozen=True)
class FrontMovement:
    """How the fronts of a study move.

    Attributes:
        instants: Sampling instants [s].
        against: The largest step of each front against the upper left, as the ratio grows, over its extent.
        moves: Whether the optimum moves at all between the smallest and the largest ratio, in both costs.
        steps: From sample to sample, in each measure.
        first_part, second_part: What the two stages have of the horizon at each sample [s].
    """

    instants: tuple[float, ...]
    against: tuple[float, ...]
    moves: tuple[bool, ...]
    steps: dict[Measure, tuple[Step, ...]]
    first_part: tuple[float, ...]
    second_part: tuple[float, ...]

    @property
    def with_ratio(self) -> bool:
        """Whether every front moves to the upper left, and never back, as the ratio grows."""
        return self.moving == len(self.instants)

    @property
    def moving(self) -> int:
        """At how many samples the optimum moves to the upper left, and never back, as the ratio grows."""
        return sum(moves and step <= CLEARLY for moves, step in zip(self.moves, self.against, strict=True))

    def with_time(self, measure: Measure = "normalized") -> bool:
        """Whether the front moves to the upper left from every sample to the next."""
        return all(step.upper_left for step in self.steps[measure])

    def directions(self, measure: Measure = "normalized") -> str:
        """Return where the front moves from sample to sample, and how often, such as upper left (4 of 4)."""
        counts = Counter(step.direction for step in self.steps[measure]).most_common()
        return " and ".join(f"{direction} ({count} of {len(self.steps[measure])})" for direction, count in counts)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is found, in words."""
        return (self.said_of_ratio, *self.said_of_time)

    @property
    def said_of_ratio(self) -> str:
        """What is found as the ratio grows, in words."""
        return (
            f"with growing omega_2/omega_1 the optimum moves to the upper left at {self.moving} of {len(self.against)} "
            f"instants (against it at most {max(self.against):.1g} of a front)"
        )

    @property
    def said_of_time(self) -> tuple[str, ...]:
        """What is found from sample to sample, in words; nothing of a single one."""
        return tuple(self._say_of_time()) if len(self.instants) > 1 else ()

    def _say_of_time(self) -> Iterator[str]:
        for measure in self.steps:
            yield f"from sample to sample, {WORDS[measure]}, the front moves to the {self.directions(measure)}"
        yield (
            f"meanwhile the first stage's part of the horizon goes from {self.first_part[0]:.2f} to "
            f"{self.first_part[-1]:.2f} s, the second's from {self.second_part[0]:.2f} to "
            f"{self.second_part[-1]:.2f} s, and J_1 and J_2 are integrals over them"
        )


def front_movement(results: Results) -> FrontMovement:
    """Return how the fronts of the weighted sums move, the instant held at the run's optimum.

    Raises:
        InputError: The study has no weighted sums.
    """
    if f"{WEIGHTED}_J_1" not in results.quantities:
        raise InputError(f"{results.path}: holds no weighted sums, whose ratios alone can be followed")
    instants, J = results["instant"], costs_of(results, WEIGHTED)
    first = results["t_s"] - instants
    parts = np.column_stack([first, float(np.asarray(results.attributes["horizon"])) - first])
    followed: dict[Measure, Vector] = {
        "normalized": J,
        "per second": J / parts[:, None, :],
        "own extent": np.array([front / extents(front) for front in J]) - _lows(J),
    }
    return FrontMovement(
        instants=tuple(map(float, instants)),
        against=tuple(_against(front) for front in J),
        moves=tuple(_moves(front) for front in J),
        steps={measure: tuple(_steps(instants, values)) for measure, values in followed.items()},
        first_part=tuple(map(float, parts[:, 0])),
        second_part=tuple(map(float, parts[:, 1])),
    )


def _lows(J: Vector) -> Vector:
    """Return the smallest costs of each front over its extent, (instants, 1, 2)."""
    return np.array([np.nanmin(front, axis=0, initial=np.inf) / extents(front) for front in J])[:, None, :]


def _against(front: Vector) -> float:
    """Return the largest rise of J_2 or fall of J_1 along a front (N, 2), over its extent."""
    known = front[np.isfinite(front).all(axis=1)] / extents(front)
    steps = np.diff(known, axis=0)
    return float(np.max(np.column_stack([-steps[:, 0], steps[:, 1]]), initial=0.0))


def _moves(front: Vector) -> bool:
    """Return whether the known points of a front (N, 2) differ in both costs."""
    known = front[np.isfinite(front).all(axis=1)]
    return bool(len(known)) and bool(np.all(np.ptp(known, axis=0) > 0))


def _steps(instants: Vector, values: Vector) -> Iterator[Step]:
    """Give how the points (instants, N, 2) move from each instant to the next."""
    for (before, one), (after, other) in pairwise(zip(instants, values, strict=True)):
        change = other - one
        change = change[np.isfinite(change).all(axis=1)]
        least = CLEARLY * extents(np.vstack([one, other]))
        fitting = (change[:, 0] >= -least[0]) & (change[:, 1] <= least[1])
        mean = change.mean(axis=0) if len(change) else np.full(2, np.nan)
        share = float(fitting.mean()) if len(change) else 0.0
        yield Step(float(before), float(after), float(mean[1]), float(mean[0]), share)
