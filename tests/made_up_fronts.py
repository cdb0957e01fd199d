"""Pareto studies as if they had been made: the same file, made-up numbers."""

from pathlib import Path

import numpy as np

from psmpc_cli.logs.results import Results
from psmpc_cli.solvers import Outcome
from psmpc_cli.studies.fronts import WEIGHTED, Front, FrontGrid, SampleFronts, read_pareto, write_pareto

RATIOS = np.geomspace(1e-3, 1e3, 7)

T_S, T_H = 10.0, 4.0

RISING, FALLING = (-1.0, 1.0), (1.0, -0.2)
"""How a front moves from sample to sample, in J_2 and in J_1: to the upper left, and to the lower right."""


def made_up_fronts(
    path: Path, drift: tuple[float, float] = FALLING, samples: int = 3, failed: tuple[int, ...] = ()
) -> Results:
    """A study of weighted sums in which all points of these samples failed."""
    fronts = [_sample(i, drift, i in failed) for i in range(samples)]
    grid = FrontGrid(RATIOS, True, 0, np.zeros(1), False)
    attributes = {"task_name": "made_up", "horizon": T_H, "method": "weighted-sum", "stages": "1,2"}
    write_pareto(path, attributes, ("approach", "capture"), grid, fronts, False)
    return read_pareto(path)


def _sample(i: int, drift: tuple[float, float], failed: bool) -> SampleFronts:
    along = np.linspace(0.1, 1.0, len(RATIOS))
    J = np.column_stack([1.0 + along**2 + i * drift[1], 4.0 + (1.0 - along) ** 2 + i * drift[0]])
    J = np.full_like(J, np.nan) if failed else J
    wait, none = T_S - 6.5 - i, np.full(len(RATIOS), np.inf)
    outcome = np.full(len(RATIOS), list(Outcome).index(Outcome.INFEASIBLE if failed else Outcome.OPTIMAL), "i1")
    front = Front(J, np.full(len(RATIOS), wait), J @ [1.0, 1.0], RATIOS, none, outcome)
    return SampleFronts(6.5 + i, wait, J[5], 100.0, np.ones(2), {WEIGHTED: (front,)}, 0)
