"""The priorities that a task's paired comparisons stand for, in place of numbers at its stages."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.specs.task import PrioritiesSpec, TaskSpec

Vector = NDArray[np.float64]
Pair = tuple[int, int]

ACCEPTABLE = 0.1
"""Largest consistency ratio of comparisons that still agree well enough. Saaty's rule."""

LARGEST_INDEX = {3: 0.31, 4: 0.35}
"""Geometric consistency index at which the ratio is `ACCEPTABLE`, by the number of things compared."""

LARGEST_INDEX_OF_MORE = 0.37
"""The same for more than four."""


@dataclass(frozen=True, eq=False)
class Weighing:
    """What paired comparisons amount to.

    Attributes:
        logarithms: Logarithms of the weights (n,), the first 0.
        surplus: Number of comparisons beyond the n - 1 that determine the weights.
        ratio: Consistency ratio; 0 if they agree, or if there is no surplus.
        implied: For each comparison the logarithm of the ratio that the others imply (K,); NaN where they imply none.
        worst: The comparison without which the others agree best; None if there is no surplus.
    """

    logarithms: Vector
    surplus: int
    ratio: float
    implied: Vector
    worst: int | None


def weigh(count: int, pairs: Sequence[Pair], ratios: Sequence[float]) -> Weighing:
    """Return the weights w (n,) that fit log(w_a / w_b) = log(r) best, and how well the comparisons agree.

    For a complete set these are the geometric means of the rows of the comparison matrix (Crawford and Williams, A note
    on the analysis of subjective judgment matrices, J. Math. Psychology 29, 1985); an incomplete set determines them
    as long as it connects everything (Bozoki, Fulop and Ronyai, On optimal completions of incomplete pairwise
    comparison matrices, Math. and Computer Modelling 52, 2010).

    Args:
        count: How many things are compared, n.
        pairs: Which two, connected.
        ratios: How many times the first weighs more than the second, each positive.
    """
    incidence, logs = np.zeros((len(pairs), count)), np.log(ratios)
    for row, (a, b) in enumerate(pairs):
        incidence[row, a], incidence[row, b] = 1.0, -1.0
    inverse = np.linalg.pinv(incidence[:, 1:])
    logarithms = np.r_[0.0, inverse @ logs]
    residual = logs - incidence @ logarithms
    free = np.maximum(1.0 - np.diag(incidence[:, 1:] @ inverse), 0.0)  # 0: nothing else connects the two
    alone = free < 1e-9
    implied = np.where(alone, np.nan, logs - residual / np.where(alone, 1.0, free))
    surplus = len(pairs) - count + 1
    relieved = np.where(alone, 0.0, residual**2 / np.where(alone, 1.0, free))
    return Weighing(
        logarithms=logarithms,
        surplus=surplus,
        ratio=_consistency_ratio(count, surplus, residual),
        implied=implied,
        worst=_last_largest(relieved) if surplus > 0 else None,
    )


def groups(count: int, pairs: Sequence[Pair]) -> list[list[int]]:
    """Return what comparisons connect: groups of indices, each sorted, in the order of their first."""
    group = list(range(count))
    for a, b in pairs:
        old, new = max(group[a], group[b]), min(group[a], group[b])
        group = [new if member == old else member for member in group]
    return [[i for i in range(count) if group[i] == name] for name in sorted(set(group))]


def _consistency_ratio(count: int, surplus: int, residual: Vector) -> float:
    """Return the geometric consistency index over its threshold, on Saaty's scale, where 0.1 is acceptable.

    The index is the variance of the logarithmic residuals per degree of freedom, the surplus: for a complete set
    2 / ((n - 1) (n - 2)) sum log^2 e (Aguaron and Moreno-Jimenez, The geometric consistency index: approximated
    thresholds, Europ. J. Operational Research 147, 2003), whose thresholds these are. Dividing by the degrees of
    freedom makes it mean the same for an incomplete set.
    """
    if surplus <= 0:
        return 0.0
    index = float(residual @ residual) / surplus
    return ACCEPTABLE * index / LARGEST_INDEX.get(count, LARGEST_INDEX_OF_MORE)


def _last_largest(values: Vector) -> int:
    """Return the index of the largest value; of equal ones the last, which came to contradict those before it."""
    return int(np.flatnonzero(values >= values.max() * (1 - 1e-9))[-1])


DIGITS = 12
"""Significant digits of a resolved priority: [a, b, 100] gives 100."""


def weigh_stages(priorities: PrioritiesSpec, stages: list[str]) -> Weighing:
    """Return what comparisons of stages, all known and connected, amount to; the weights in the order of `stages`."""
    pairs = [(stages.index(a), stages.index(b)) for a, b, _ in priorities.compare]
    return weigh(len(stages), pairs, [ratio for _, _, ratio in priorities.compare])


def prioritize(task: TaskSpec) -> TaskSpec:
    """Return a valid task with every stage's priority from its comparisons, or as it is if it has none."""
    if task.priorities is None:
        return task
    omega = np.exp(weigh_stages(task.priorities, [stage.name for stage in task.stages]).logarithms)
    stages = tuple(
        stage.model_copy(update={"priority": float(f"{weight:.{DIGITS}g}")})
        for stage, weight in zip(task.stages, omega, strict=True)
    )
    return task.model_copy(update={"stages": stages})
