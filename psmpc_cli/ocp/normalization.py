"""The normalization of stage costs from the previous prediction. Paper eq. (12), departures in docs/formulation.md."""

from collections.abc import Sequence

import numpy as np

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.stages import Stage


def normalization(
    kind: str,
    zeta: float,
    stages: Sequence[Stage],
    begins: np.ndarray,
    costs: StageCosts,
    prediction: Plan,
    step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return offset and scale (S + 1,) of L = (Lbar - offset) / scale; the stages begin at `begins` (S + 1,) [s].

    The prediction is read on a uniform grid with the given step [s], its control averaged over each step: at the nodes
    the maximum would depend on the mesh, whose intervals shrink to nothing before a switch, and one tall control there
    would set the scale of the next window (docs/decisions.md).

    `nadir` divides by the maximum of the stage's cost over all nodes of the prediction, `range` is eq. (12) as printed,
    `none` leaves the cost as it is.
    """
    if kind == "none":
        return np.zeros(len(stages)), np.ones(len(stages))
    times = np.linspace(prediction.start, prediction.end, round((prediction.end - prediction.start) / step) + 1)
    X, u = prediction.states_at(times), prediction.mean_control(times)
    over_time = [costs.along(stage, X, u, times - begin) for stage, begin in zip(stages, begins, strict=True)]
    nadir = np.array([values.max() for values in over_time])
    if kind == "nadir":
        return np.zeros(len(stages)), nadir + zeta
    utopia = np.array([values.min() for values in over_time])
    return utopia, nadir - utopia + zeta
