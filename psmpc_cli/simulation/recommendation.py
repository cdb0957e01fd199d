"""Which ratio of priorities a sweep recommends."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.simulation.sweep_cells import SweepCells, along_ratio

WITHIN = 0.05
"""By this part of the earliest completion a recommended ratio may complete later."""

ALLOWED = 1.0
"""Final error that the end condition itself allows [tolerances]."""


@dataclass(frozen=True)
class Recommendation:
    """The recommended ratio and what it is held against.

    Attributes:
        ratio: omega_2 / omega_1.
        completion, error, effort: At this ratio: completion [s], final error [tolerances] (NaN of a stage without end
            condition) and control effort.
        earliest: Earliest completion at any ratio [s].
        efforts: Smallest and largest effort at any ratio.
        preliminary: Cells wait, so that it may change.
    """

    ratio: float
    completion: float
    error: float
    effort: float
    earliest: float
    efforts: tuple[float, float]
    preliminary: bool

    def __str__(self) -> str:
        allowed = "" if np.isnan(self.error) else f", and its final error is {self.error:.2f} of the tolerance"
        return (
            f"recommended omega_2/omega_1{' so far' if self.preliminary else ''}: {self.ratio:.4g}, the smallest that "
            f"completes within {WITHIN:.0%} of the earliest: at {self.completion:.2f} s, earliest {self.earliest:.2f} s"
            f"{allowed}; control effort {self.effort:.2f}, of {self.efforts[0]:.2f} to {self.efforts[1]:.2f} over all "
            "ratios"
        )


def recommend(cells: SweepCells) -> Recommendation | None:
    """Return the smallest ratio that completes within 5 % of the earliest completion and raises no error; None if none.

    The final error is the largest error of the second stage's end condition when the stage ends, over its tolerance. A
    stage that ends by its condition does so at the first sample that meets it: its final error lies between 1 and what
    one sample takes off it, and says when within that sample the condition was met, not how well. Differences below 1
    are therefore no gain and no loss. The error counts as raised above 1, the end condition's own tolerance: the stage
    then ended at an optimized instant that the plant did not meet. Where it is above 1 at the smallest ratio already,
    at which the second stage has least to say, it counts as raised above that value.

    Of several cells with one ratio the latest completion and the largest error count, and a ratio of which one failed
    is not recommended.
    """
    completion = along_ratio(cells, cells.of("completion_time"))
    error, effort = (along_ratio(cells, cells.of(name)) for name in ("final_error", "control_effort"))
    if not len(completion.ratio):
        return None
    earliest = float(completion.lowest.min())
    failing = np.isclose(completion.ratio[:, None], cells.ratio[cells.failed], rtol=1e-8).any(axis=1)
    raised = error.highest > max(ALLOWED, np.nan_to_num(error.highest[0]))
    good = np.flatnonzero((completion.highest <= (1 + WITHIN) * earliest) & ~raised & ~failing)
    if not len(good):
        return None
    best = int(good[0])
    return Recommendation(
        ratio=float(completion.ratio[best]),
        completion=float(completion.highest[best]),
        error=float(error.highest[best]),
        effort=float(effort.middle[best]),
        earliest=earliest,
        efforts=(float(effort.lowest.min()), float(effort.highest.max())),
        preliminary=bool(cells.waiting.any()),
    )
