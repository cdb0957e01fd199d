"""How the fronts of a Pareto study move as the weights' ratio grows and from sample to sample. Paper Fig. 7."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from psmpc_cli.logs.results import Results
from psmpc_cli.studies.fronts import LEAST_IMPROVEMENT, WEIGHTED, Vector, extents, front_points

MEASURES: Mapping[str, str] = {
    "normalized": "in costs normalized as in (12)",
    "per second": "in their means over each stage's part of the horizon",
    "own extent": "with every front over its own extent",
}
"""What a front is followed in from sample to sample, and how a sentence says that."""


class FrontMovement:
    """How the fronts of a study's weighted sums move, the switch time held at the run's optimum.

    Attributes:
        instants: Times of the S + 1 samples [s].
        steps_back: For each sample the largest step of the optimum away from the upper left as the ratio grows, as a
            part of what the front spans; 0 if it never steps back.
        moves_at: For each sample whether both costs differ at all between the points of the front.
        n_moving: Number of samples at which the optimum moves to the upper left, and never back, as the ratio grows.
        steps: For each measure in `MEASURES` the mean change of J_1 and J_2 from each sample to the next (S, 2), over
            the points of equal ratio; NaN if no ratio has a point at both samples.
        moves_over_time: Whether the front moves to the upper left from every sample to the next, in normalized costs.
        parts: The two stages' parts of the horizon at each sample (S + 1, 2) [s].
    """

    def __init__(self, results: Results) -> None:
        """Measure in which direction the optima of weighted sums move as the ratio of weights grows and time passes.

        A front is the optima min omega_1 J_1 + omega_2 J_2 at one sample, for rising ratios omega_2 / omega_1. The
        paper says that the optima move to the upper left of the figure both as the ratio grows and from one sample to
        the next: J_1, drawn upwards, rises and J_2 falls.

        Args:
            results: A Pareto study, with fronts at S + 1 samples.
        """
        instants = results["instant"]
        points, _ = front_points(results, WEIGHTED)
        J = points[:, 0]  # J_1 and J_2 with the switch time of the run, by sample and ratio (S + 1, ratios, 2)
        first_part = results["t_s"] - instants
        horizon = float(np.asarray(results.attributes["horizon"]))
        self.instants: list[float] = instants.tolist()
        self.parts = np.column_stack([first_part, horizon - first_part])

        # as the ratio grows: steps from point to point over what the front spans, with signs so that J_1 falling and
        # J_2 rising, the steps back, are positive
        relative = J / np.array([extents(front) for front in J])[:, None, :]
        fronts = [front[np.isfinite(front).all(axis=1)] for front in relative]
        backward = [np.diff(front, axis=0) * [-1.0, 1.0] for front in fronts]
        self.steps_back = [float(np.max(steps, initial=0.0)) for steps in backward]
        self.moves_at = [bool(len(front)) and bool(np.all(np.ptp(front, axis=0) > 0)) for front in fronts]
        movement_by_sample = zip(self.moves_at, self.steps_back, strict=True)
        self.n_moving = sum(moves and step <= LEAST_IMPROVEMENT for moves, step in movement_by_sample)

        # from sample to sample: mean step of the points with the same ratio
        lows = np.nanmin(relative, axis=1, keepdims=True, initial=np.inf)
        scaled_costs = {"normalized": J, "per second": J / self.parts[:, None, :], "own extent": relative - lows}
        changes = {name: np.ma.masked_invalid(np.diff(values, axis=0)) for name, values in scaled_costs.items()}
        self.steps = {name: change.mean(axis=1).filled(np.nan) for name, change in changes.items()}
        self.moves_over_time = all(direction(step) == "upper left" for step in self.steps["normalized"])

    def directions(self, measure: str = "normalized") -> str:
        """Return where the front moves from sample to sample, and how often, such as upper left (4 of 4)."""
        counts = Counter(direction(step) for step in self.steps[measure]).most_common()
        return " and ".join(f"{where} ({count} of {len(self.steps[measure])})" for where, count in counts)

    @property
    def over_ratio(self) -> str:
        """The movement as the ratio grows, as a sentence."""
        return (
            f"with growing omega_2/omega_1 the optimum moves to the upper left at {self.n_moving} of "
            f"{len(self.steps_back)} samples (largest step back {max(self.steps_back):.1g} of a front)"
        )

    @property
    def over_time(self) -> tuple[str, ...]:
        """The movement from sample to sample, as sentences; empty for a single sample."""
        if len(self.instants) < 2:
            return ()
        first, second = self.parts[0]
        first_end, second_end = self.parts[-1]
        moves = (f"{words}, the front moves to the {self.directions(name)}" for name, words in MEASURES.items())
        return (
            *(f"from sample to sample, {words}" for words in moves),
            f"meanwhile the first stage's part of the horizon goes from {first:.2f} to {first_end:.2f} s, the second's "
            f"from {second:.2f} to {second_end:.2f} s, and J_1 and J_2 are integrals over them",
        )


def direction(step: Vector) -> str:
    """Return where a mean change of J_1 and J_2 (2,) leads, J_2 to the right and J_1 up, such as upper left."""
    up, right = step
    if not np.isfinite(step).all():
        return "unknown"
    return f"{'upper' if up > 0 else 'lower'} {'left' if right < 0 else 'right'}"
