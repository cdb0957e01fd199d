"""The fronts of a Pareto study in a few numbers: a row a sample, as data and as words."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.logs.results import Results
from psmpc_cli.studies.pareto_file import CONSTRAINED, FREE, STATUS, WEIGHTED

HEADINGS = (
    "T0 [s]",
    "t_s [s]",
    "omega_2/omega_1",
    "J_1 [s]",
    "J_2 [s]",
    "hypervolume",
    "points",
    "dominated",
    "failed",
)

NOTE = "t_s, J_1 and J_2: as the run optimized them with its own weights"


@dataclass(frozen=True)
class FrontRow:
    """What was found at a sample.

    Attributes:
        instant, t_s: Sampling instant T0, and the switching instant as the run optimized it [s].
        ratio, J_1, J_2: omega_2 / omega_1 of the run, and the normalized costs of its optimum [s].
        hypervolume: Measure of what the points dominate.
        points, dominated, failed: How many there are, how many of them another one dominates, how many have no optimum.
    """

    instant: float
    t_s: float
    ratio: float
    J_1: float
    J_2: float
    hypervolume: float
    points: int
    dominated: int
    failed: int


def front_rows(results: Results) -> tuple[FrontRow, ...]:
    """Return what was found at every sample, whatever it was found with."""
    return tuple(_row(results, i) for i in range(len(results["instant"])))


def front_texts(row: FrontRow) -> tuple[str, ...]:
    """Return a row as text, in the order of `HEADINGS`."""
    return (
        f"{row.instant:.2f}",
        f"{row.t_s:.2f}",
        f"{row.ratio:g}",
        f"{row.J_1:.4f}",
        f"{row.J_2:.4f}",
        f"{row.hypervolume:.3f}",
        str(row.points),
        str(row.dominated),
        str(row.failed),
    )


def _row(results: Results, i: int) -> FrontRow:
    methods = [method for method in (WEIGHTED, CONSTRAINED, FREE) if f"{method}_status" in results.quantities]
    status = np.concatenate([results[f"{method}_status"][i].ravel() for method in methods])
    return FrontRow(
        instant=float(results["instant"][i]),
        t_s=float(results["t_s"][i]),
        ratio=float(results["chosen_ratio"][i]),
        J_1=float(results["chosen_J_1"][i]),
        J_2=float(results["chosen_J_2"][i]),
        hypervolume=float(results["hypervolume"][i]),
        points=len(status),
        dominated=sum(int(results[f"{method}_dominated"][i].sum()) for method in methods),
        failed=int(np.sum(status != STATUS.index("optimal"))),
    )
