"""The points of a Pareto study as its figures show them."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.figures.style import readable
from psmpc_cli.logs.results import Results

MARKERS = ("o", "s", "D", "p", "X", "h", "8")
"""Of the instants, one after another; none looks like an arrow."""

DOMINATED = "#A0A0A0"
"""Colour of the cross on a dominated point."""

METHODS = ("weighted", "constrained")
"""How the arrays of the methods begin, in the order in which they are drawn."""


@dataclass(frozen=True, eq=False)
class Points:
    """The points of one method at one instant.

    Attributes:
        J: J_1 and J_2 (P, 2).
        dominated: Which are dominated (P,).
    """

    J: np.ndarray
    dominated: np.ndarray


def in_plane(results: Results) -> list[list[Points]]:
    """Return the points with the instant held at the run's optimum, by sample, then by method."""
    methods = [method for method in METHODS if f"{method}_J_1" in results.quantities]
    return [[held(results, method, i, 0) for method in methods] for i in range(len(results["instant"]))]


def held(results: Results, method: str, sample: int, later: int) -> Points:
    """Return a method's points at a sample with the instant held so much later than the run's optimum."""
    where = (sample, later) if "later" in results.quantities[f"{method}_J_1"].dims else (sample,)
    J = np.column_stack([results[f"{method}_{name}"][where] for name in ("J_1", "J_2")])
    return Points(J, results[f"{method}_dominated"][where].astype(bool))


def stage_words(results: Results) -> tuple[str, str]:
    """Return the names of both stages as words."""
    first, second = (readable(str(name)) for name in results["stage"])
    return first, second


def chosen_label(results: Results) -> str:
    """Return how the legend names the run's own weights."""
    ratio = results["chosen_ratio"]
    return f"$ω_2/ω_1$ = {ratio[0]:g}" if np.ptp(ratio) <= 1e-9 * ratio[0] else "weights of the run"
