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
        instants: Sampling instants [s].
        against: The largest step of each front against the upper left, as the ratio grows, over its extent.
        moves: Whether the optimum moves at all between the smallest and the largest ratio, in both costs.
        moving: Number of samples at which it moves to the upper left, and never back, as the ratio grows.
        steps: By measure, the mean change of J_1 and J_2 over the points of equal ratio from sample to sample (S, 2);
            NaN if no ratio has a point at both.
        with_time: Whether the front moves to the upper left from every sample to the next, in normalized costs.
        parts: The two stages' parts of the horizon at each sample (S + 1, 2) [s].
    """

    def __init__(self, results: Results) -> None:
        """Measure in which direction the optima of weighted sums move as the ratio of weights grows and time passes.

        The paper says that both move them to the upper left of the figure: J_1, drawn upwards, rises and J_2 falls.

        Args:
            results: A Pareto study, with fronts at S + 1 samples.
        """
        instants = results["instant"]
        J = front_points(results, WEIGHTED)[0][:, 0]  # J_1 and J_2 by sample and ratio (S + 1, ratios, 2)
        first_part = results["t_s"] - instants
        horizon = float(np.asarray(results.attributes["horizon"]))
        self.instants: list[float] = instants.tolist()
        self.parts = np.column_stack([first_part, horizon - first_part])

        # as the ratio grows: positive are steps back, in which J_1 falls or J_2 rises, over the extent of the front
        relative = J / np.array([extents(front) for front in J])[:, None, :]
        fronts = [front[np.isfinite(front).all(axis=1)] for front in relative]
        backward = [np.diff(front, axis=0) * [-1.0, 1.0] for front in fronts]
        self.against = [float(np.max(steps, initial=0.0)) for steps in backward]
        self.moves = [bool(len(front)) and bool(np.all(np.ptp(front, axis=0) > 0)) for front in fronts]
        movement_by_sample = zip(self.moves, self.against, strict=True)
        self.moving = sum(moves and step <= LEAST_IMPROVEMENT for moves, step in movement_by_sample)

        # from sample to sample: mean step of the points with the same ratio
        lows = np.nanmin(relative, axis=1, keepdims=True, initial=np.inf)
        scaled_costs = {"normalized": J, "per second": J / self.parts[:, None, :], "own extent": relative - lows}
        changes = {name: np.ma.masked_invalid(np.diff(values, axis=0)) for name, values in scaled_costs.items()}
        self.steps = {name: change.mean(axis=1).filled(np.nan) for name, change in changes.items()}
        self.with_time = all(direction(step) == "upper left" for step in self.steps["normalized"])

    def directions(self, measure: str = "normalized") -> str:
        """Return where the front moves from sample to sample, and how often, such as upper left (4 of 4)."""
        counts = Counter(direction(step) for step in self.steps[measure]).most_common()
        return " and ".join(f"{where} ({count} of {len(self.steps[measure])})" for where, count in counts)

    @property
    def over_ratio(self) -> str:
        """The movement as the ratio grows, as a sentence."""
        return (
            f"with growing omega_2/omega_1 the optimum moves to the upper left at {self.moving} of {len(self.against)} "
            f"samples (largest step back {max(self.against):.1g} of a front)"
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
