"""Priorities from paired comparisons: logarithmic least squares, and how far the comparisons contradict each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from psmpc_cli.specs.document import LARGEST, quoted, shortened
from psmpc_cli.specs.fields import Fields, RuleErrors, expected

Vector = NDArray[np.float64]
PairwiseComparison = tuple[str, str, float]
"""Stage a, stage b, and how many times as important a is as b."""

ACCEPTABLE = 0.1
"""Largest consistency ratio of comparisons that still agree well enough. Saaty's rule."""

LARGEST_INDEX = {3: 0.31, 4: 0.35}
"""Geometric consistency index at which the ratio is `ACCEPTABLE`, by the number of stages compared."""

LARGEST_INDEX_OF_MORE = 0.37
"""The same of more stages."""


@dataclass(frozen=True, eq=False)
class Weighing:
    """The weights that fit paired comparisons, and how well the comparisons agree.

    Attributes:
        logarithms: Logarithms of the weights (n,), the first 0.
        residuals: Of the logarithm of each comparison's ratio (K,).
        surplus: Number of comparisons beyond the n - 1 that determine the weights.
        ratio: Consistency ratio on Saaty's scale; 0 if there is no surplus.
    """

    logarithms: Vector
    residuals: Vector
    surplus: int
    ratio: float


def weigh(compare: Sequence[PairwiseComparison], stages: Sequence[str]) -> Weighing:
    """Compute the weights w (n,) that fit log(w_a / w_b) = log(r) best, and how well the comparisons agree.

    A task may compare its stages in pairs, "a is r times as important as b", instead of giving priorities; these
    weights are then its priorities. The fit is by least squares.

    For a complete set these are the geometric means of the rows of the comparison matrix (Crawford and Williams, A note
    on the analysis of subjective judgment matrices, J. Math. Psychology 29, 1985); an incomplete set determines them
    as long as it connects everything (Bozoki, Fulop and Ronyai, On optimal completions of incomplete pairwise
    comparison matrices, Math. and Computer Modelling 52, 2010). The consistency index is the variance of the
    logarithmic residuals per degree of freedom, so that it means the same for an incomplete set: for a complete one
    2 / ((n - 1) (n - 2)) sum log^2 e (Aguaron and Moreno-Jimenez, The geometric consistency index: approximated
    thresholds, Europ. J. Operational Research 147, 2003).

    Args:
        compare: The comparisons, each of two of the stages; they connect all.
        stages: What is compared, n names.
    """
    incidence = _incidence_matrix(compare, stages)
    logs = np.log([ratio for _, _, ratio in compare])
    logarithms = np.r_[0.0, np.linalg.pinv(incidence[:, 1:]) @ logs]  # only ratios are known: the first weight is 1
    residuals = logs - incidence @ logarithms
    surplus = len(compare) - len(stages) + 1
    index = float(residuals @ residuals) / surplus if surplus > 0 else 0.0
    ratio = ACCEPTABLE * index / LARGEST_INDEX.get(len(stages), LARGEST_INDEX_OF_MORE)
    return Weighing(logarithms, residuals, surplus, ratio)


def _incidence_matrix(compare: Sequence[PairwiseComparison], stages: Sequence[str]) -> Vector:
    """Return a row for each comparison (K, n): 1 at its first stage, -1 at its second."""
    return np.array([[(stage == a) - (stage == b) for stage in stages] for a, b, _ in compare], dtype=np.float64)


def priorities_of(compare: Sequence[PairwiseComparison], stages: Sequence[str]) -> list[float]:
    """Return the priority of each stage by comparisons of all of them, to 12 digits: [a, b, 100] gives 100."""
    return [float(f"{weight:.12g}") for weight in np.exp(weigh(compare, stages).logarithms)]


def comparison_faults(priorities: Any, earlier_fields: Fields, context: Any) -> RuleErrors:
    """Yield errors of the paired comparisons from which a task's priorities are computed.

    The comparisons have to connect all stages; they must not contradict each other by more than the consistency ratio
    `ACCEPTABLE`, of which the comparison with the largest residual is the error; and the weights that they lead to must
    stay within 1 / `LARGEST` and `LARGEST` of that of the first stage.

    Args:
        priorities: The valid key `priorities` of a task.
        earlier_fields: The valid keys of the task before it, stages among them.
        context: The rest of the description, which this rule does not need.

    Yields:
        Path of the value from `priorities` on, and its error.
    """
    from scipy.sparse.csgraph import connected_components

    stages = [stage.name for stage in earlier_fields.get("stages", ())]
    if not stages:
        return
    compare = priorities.compare
    incidence = _incidence_matrix(compare, stages)
    laplacian = incidence.T @ incidence  # not 0 between two stages that are compared
    number, labels = connected_components(laplacian, directed=False)
    if number > 1:
        islands = [[shortened(stages[i]) for i in np.flatnonzero(labels == island)] for island in range(number)]
        found = f"nothing that compares {' with '.join(map(', '.join, islands))}"
        yield ("compare",), expected("comparisons that connect all stages", found, at_key=True)
        return
    weighing = weigh(compare, stages)
    if weighing.ratio > ACCEPTABLE:
        worst = int(np.abs(weighing.residuals).argmax())
        a, b, ratio = compare[worst]
        measure = f"consistency ratio {weighing.ratio:.3g}, acceptable up to {ACCEPTABLE:g}"
        found = f"{quoted(a)} to be {ratio:g} times as important as {quoted(b)}"
        fitted = np.exp(np.log(ratio) - weighing.residuals[worst])
        wanted = f"nearer to {fitted:.3g}, which fits all comparisons best ({measure})"
        yield ("compare", worst, 2), expected(wanted, found)
    sizes = np.abs(weighing.logarithms)
    if sizes.max() > np.log(LARGEST):
        extreme = quoted(stages[int(sizes.argmax())])
        found = f"comparisons that make {extreme} far more or less important than {quoted(stages[0])}"
        yield ("compare",), expected(f"a ratio from {1 / LARGEST:g} to {LARGEST:g}", found, at_key=True)
