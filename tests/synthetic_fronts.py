"""Pareto studies as if they had been made: the same file, made-up numbers."""

from pathlib import Path

import numpy as np

from psmpc_cli.logs.results import Quantity, Results
from psmpc_cli.studies.pareto import STATUS, ParetoSettings, join_samples

QUESTION = ParetoSettings("1,2", (), 7, "weighted-sum", False)

T_S, T_H = 10.0, 4.0

RISING, FALLING = (-1.0, 1.0), (1.0, -0.2)
"""How a front moves from sample to sample, in J_2 and in J_1: to the upper left, and to the lower right."""


def synthetic_fronts(
    path: Path, drift: tuple[float, float] = FALLING, samples: int = 3, failed: tuple[int, ...] = ()
) -> Results:
    """A study of weighted sums in which all points of these samples failed."""
    attributes = {"task_name": "made_up", "horizon": T_H, "method": "weighted-sum", "stages": "1,2"}
    cells = [_sample(i, drift, i in failed) for i in range(samples)]
    return join_samples(path, attributes, ("approach", "capture"), QUESTION, cells)


def _sample(i: int, drift: tuple[float, float], failed: bool) -> list[Quantity]:
    along = np.linspace(0.1, 1.0, QUESTION.points)
    J_1, J_2 = 1.0 + along**2 + i * drift[1], 4.0 + (1.0 - along) ** 2 + i * drift[0]
    if failed:
        J_1, J_2 = np.full((2, QUESTION.points), np.nan)
    status = STATUS.index("infeasible" if failed else "optimal")
    numbers = {"instant": 6.5 + i, "t_s": T_S, "chosen_ratio": 100.0, "chosen_J_1": J_1[5], "chosen_J_2": J_2[5]}
    points = {"J_1": J_1, "J_2": J_2, "wait": np.full(QUESTION.points, T_S - 6.5 - i), "objective": J_1 + J_2}
    return [
        *(Quantity(name, (), np.array(value), "1", "") for name, value in numbers.items()),
        Quantity("scale", ("stage",), np.ones(2), "1", ""),
        *(Quantity(f"weighted_{name}", ("ratio",), values, "1", "") for name, values in points.items()),
        Quantity("weighted_status", ("ratio",), np.full(QUESTION.points, status, "i1"), "1", "", STATUS),
    ]
