"""Priorities from paired comparisons: logarithmic least squares, and how far the comparisons contradict each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.specs.document import LARGEST
from psmpc_cli.specs.fields import Flaws, flaw
from psmpc_cli.specs.messages import quoted, shortened

Vector = NDArray[np.float64]
Pair = tuple[int, int]
PairwiseComparison = tuple[str, str, float]
"""Stage a, stage b, and how many times as important a is as b."""

ACCEPTABLE = 0.1
"""Largest consistency ratio of comparisons that still agree well enough. Saaty's rule."""

LARGEST_INDEX = {3: 0.31, 4: 0.35}
"""Geometric consistency index at which the ratio is `ACCEPTABLE`, by the number of things compared."""

LARGEST_INDEX_OF_MORE = 0.37
"""The same for more than four."""

DIGITS = 12
"""Significant digits of a resolved priority: [a, b, 100] gives 100."""


@dataclass(frozen=True, eq=False)
class Weighing:
    """The weights that fit paired comparisons, and how well the comparisons agree.

    Attributes:
        logarithms: Logarithms of the weights (n,), the first 0.
        surplus: Number of comparisons beyond the n - 1 that determine the weights.
        ratio: Consistency ratio on Saaty's scale; 0 if there is no surplus.
        implied: For each comparison the logarithm of the ratio that the others imply (K,); NaN where they imply none.
        worst: The comparison without which the others agree best, the last of equal ones; None if there is no surplus.
    """

    logarithms: Vector
    surplus: int
    ratio: float
    implied: Vector
    worst: int | None


def weigh(count: int, pairs: Sequence[Pair], ratios: Sequence[float]) -> Weighing:
    """Compute the weights w (n,) that fit log(w_a / w_b) = log(r) best, and how well the comparisons agree.

    For a complete set these are the geometric means of the rows of the comparison matrix (Crawford and Williams, A note
    on the analysis of subjective judgment matrices, J. Math. Psychology 29, 1985); an incomplete set determines them
    as long as it connects everything (Bozoki, Fulop and Ronyai, On optimal completions of incomplete pairwise
    comparison matrices, Math. and Computer Modelling 52, 2010). The consistency index is the variance of the
    logarithmic residuals per degree of freedom, so that it means the same for an incomplete set: for a complete one
    2 / ((n - 1) (n - 2)) sum log^2 e (Aguaron and Moreno-Jimenez, The geometric consistency index: approximated
    thresholds, Europ. J. Operational Research 147, 2003).

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
    free = np.maximum(1.0 - np.diag(incidence[:, 1:] @ inverse), 0.0)  # 1 - leverage; 0: nothing else connects the two
    alone = free < 1e-9
    divisor = np.where(alone, 1.0, free)
    improvement = np.where(alone, 0.0, residual**2 / divisor)  # of the sum of squares without the comparison
    surplus = len(pairs) - count + 1
    index = float(residual @ residual) / surplus if surplus > 0 else 0.0
    return Weighing(
        logarithms=logarithms,
        surplus=surplus,
        ratio=ACCEPTABLE * index / LARGEST_INDEX.get(count, LARGEST_INDEX_OF_MORE),
        implied=np.where(alone, np.nan, logs - residual / divisor),
        worst=int(np.flatnonzero(improvement >= improvement.max() * (1 - 1e-9))[-1]) if surplus > 0 else None,
    )


def groups(count: int, pairs: Sequence[Pair]) -> list[list[int]]:
    """Return what comparisons connect: groups of indices, each sorted, in the order of their first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b = np.array(pairs, dtype=int).reshape(-1, 2).T
    number, labels = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False)
    return sorted(np.flatnonzero(labels == label).tolist() for label in range(number))


def weigh_stages(compare: Sequence[PairwiseComparison], stages: list[str]) -> Weighing:
    """Weigh stages by comparisons, which are of known stages and connect all; in the order of `stages`."""
    pairs = [(stages.index(a), stages.index(b)) for a, b, _ in compare]
    return weigh(len(stages), pairs, [ratio for _, _, ratio in compare])


def priorities_of(compare: Sequence[PairwiseComparison], stages: list[str]) -> list[float]:
    """Return the priority of each stage by comparisons of all of them."""
    return [float(f"{weight:.{DIGITS}g}") for weight in np.exp(weigh_stages(compare, stages).logarithms)]


def disagreements(compare: Sequence[PairwiseComparison], stages: list[str]) -> Flaws:
    """Give comparisons that leave stages unconnected, contradict each other, or lead beyond all numbers."""
    pairs = [(stages.index(a), stages.index(b)) for a, b, _ in compare]
    islands = [", ".join(shortened(stages[i]) for i in group) for group in groups(len(stages), pairs)]
    if len(islands) > 1:
        found = f"nothing that compares {' with '.join(islands)}"
        yield (), flaw(", expected comparisons that connect all stages", found, at_key=True)
        return
    weighing = weigh_stages(compare, stages)
    sizes = np.abs(weighing.logarithms)
    if weighing.worst is not None and weighing.ratio > ACCEPTABLE:
        a, b, ratio = compare[weighing.worst]
        implied = weighing.implied[weighing.worst] / np.log(10)
        wanted = f"{10**implied:.3g}" if abs(implied) < 300 else f"1e{implied:+.0f}"
        measure = f"consistency ratio {weighing.ratio:.3g}, acceptable up to {ACCEPTABLE:g}"
        found = f"{quoted(a)} to be {ratio:g} times as important as {quoted(b)}"
        others = f", expected about {wanted}, which the other comparisons imply ({measure})"
        yield (weighing.worst, 2), flaw(others, found)
    elif sizes.max() > np.log(LARGEST):
        extreme = int(sizes.argmax())
        times = f"1e{weighing.logarithms[extreme] / np.log(10):+.0f} times"
        found = f"comparisons that make {quoted(stages[extreme])} {times} as important as {quoted(stages[0])}"
        yield (), flaw(f", expected a ratio from {1 / LARGEST:g} to {LARGEST:g}", found, at_key=True)
