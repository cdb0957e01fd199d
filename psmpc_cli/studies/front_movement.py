"""How a Pareto front moves with the ratio of the weights, and from sample to sample. Paper section IV-B, on Fig. 7.

J_2 is to the right and J_1 up, so that more weight on the second stage leads to the upper left.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Results
from psmpc_cli.studies.fronts import CLEARLY, WEIGHTED, costs_of, extents

Vector = np.ndarray

Measure = Literal["normalized", "per second", "own extent"]

WORDS: dict[Measure, str] = {
    "normalized": "in costs normalized as in (12)",
    "per second": "in their means over each stage's part of the horizon",
    "own extent": "with every front over its own extent",
}
"""The measures of a front: costs as in the windows, normalized by (12) at each sample; their means over the parts of
the horizon that the stages have; and each front over its own extent."""


@dataclass(frozen=True)
class Step:
    """How a front moves from one sample to the next: mean change of J_2 and of J_1 over the points of equal ratio."""

    right: float
    up: float

    @property
    def direction(self) -> str:
        """Where the points move on average, such as upper left; unknown if no ratio has a point at both samples."""
        if not np.isfinite([self.right, self.up]).all():
            return "unknown"
        return f"{'upper' if self.up > 0 else 'lower'} {'left' if self.right < 0 else 'right'}"


@dataclass(frozen=True)
class FrontMovement:
    """How the fronts of a study move.

    Attributes:
        instants: Sampling instants [s].
        against: The largest step of each front against the upper left, as the ratio grows, over its extent.
        moves: Whether the optimum moves at all between the smallest and the largest ratio, in both costs.
        steps: From sample to sample, in each measure.
        parts: The two stages' parts of the horizon at each sample (instants, 2) [s].
    """

    instants: tuple[float, ...]
    against: tuple[float, ...]
    moves: tuple[bool, ...]
    steps: dict[Measure, tuple[Step, ...]]
    parts: Vector

    @property
    def moving(self) -> int:
        """Number of samples at which the optimum moves to the upper left, and never back, as the ratio grows."""
        return sum(moves and step <= CLEARLY for moves, step in zip(self.moves, self.against, strict=True))

    @property
    def with_time(self) -> bool:
        """Whether the front moves to the upper left from every sample to the next, in normalized costs."""
        return all(step.direction == "upper left" for step in self.steps["normalized"])

    def directions(self, measure: Measure = "normalized") -> str:
        """Return where the front moves from sample to sample, and how often, such as upper left (4 of 4)."""
        counts = Counter(step.direction for step in self.steps[measure]).most_common()
        return " and ".join(f"{direction} ({count} of {len(self.steps[measure])})" for direction, count in counts)

    @property
    def over_ratio(self) -> str:
        """The movement as the ratio grows, as a sentence."""
        return (
            f"with growing omega_2/omega_1 the optimum moves to the upper left at {self.moving} of {len(self.against)} "
            f"instants (against it at most {max(self.against):.1g} of a front)"
        )

    @property
    def over_time(self) -> tuple[str, ...]:
        """The movement from sample to sample, as sentences; empty for a single sample."""
        if len(self.instants) < 2:
            return ()
        (first, second), (first_end, second_end) = self.parts[0], self.parts[-1]
        return (
            *(
                f"from sample to sample, {words}, the front moves to the {self.directions(measure)}"
                for measure, words in WORDS.items()
            ),
            f"meanwhile the first stage's part of the horizon goes from {first:.2f} to {first_end:.2f} s, the second's "
            f"from {second:.2f} to {second_end:.2f} s, and J_1 and J_2 are integrals over them",
        )


def front_movement(results: Results) -> FrontMovement:
    """Return how the fronts of the weighted sums move, the switch time held at the run's optimum.

    Raises:
        InputError: The study has no weighted sums.
    """
    if f"{WEIGHTED}_J_1" not in results.quantities:
        raise InputError(f"{results.path}: found no weighted sums, expected a study with them: only they have a ratio")
    instants, J = results["instant"], costs_of(results, WEIGHTED)
    first = results["t_s"] - instants
    parts = np.column_stack([first, float(np.asarray(results.attributes["horizon"])) - first])
    lows = np.array([np.nanmin(front, axis=0, initial=np.inf) / extents(front) for front in J])[:, None, :]
    followed: dict[Measure, Vector] = {
        "normalized": J,
        "per second": J / parts[:, None, :],
        "own extent": np.array([front / extents(front) for front in J]) - lows,
    }
    known = [front[np.isfinite(front).all(axis=1)] for front in J]
    return FrontMovement(
        instants=tuple(map(float, instants)),
        against=tuple(_against(points / extents(points)) for points in known),
        moves=tuple(bool(len(points)) and bool(np.all(np.ptp(points, axis=0) > 0)) for points in known),
        steps={measure: tuple(_step(*pair) for pair in pairwise(values)) for measure, values in followed.items()},
        parts=parts,
    )


def _against(points: Vector) -> float:
    """Return the largest rise of J_2 or fall of J_1 along the points of a front (N, 2)."""
    steps = np.diff(points, axis=0)
    return float(np.max(np.column_stack([-steps[:, 0], steps[:, 1]]), initial=0.0))


def _step(one: Vector, other: Vector) -> Step:
    """Return how points (N, 2) move from one sample to the next."""
    change = other - one
    change = change[np.isfinite(change).all(axis=1)]
    up, right = change.mean(axis=0) if len(change) else np.full(2, np.nan)
    return Step(float(right), float(up))
