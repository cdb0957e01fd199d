"""How far a state is from a stage's end condition."""

import numpy as np

from psmpc_cli.ocp.costs import StageCosts
from psmpc_cli.ocp.stages import Stage
from psmpc_cli.ocp.window import end_tolerance


def end_error(costs: StageCosts, stage: Stage, x: np.ndarray) -> float:
    """Return the largest error of a stage's end condition at x (2n,) over its tolerance; NaN without one. Eq. (18)."""
    rows = list(stage.end_rows)
    if not rows:
        return np.nan
    errors = costs.errors(stage, x[None])[0, rows]
    if stage.end_velocity is not None:
        errors = np.concatenate([errors, costs.rates(stage, x[None])[0, rows]])
    return float(np.max(np.abs(errors) / end_tolerance(stage)))
