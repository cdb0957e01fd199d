"""Which stages the applied control is a combination of. Paper Fig. 1."""

import numpy as np

from psmpc_cli.control.aside import WindowsAside
from psmpc_cli.control.decision import Decision
from psmpc_cli.control.sequence import Sequence

DISTINCT = 1e-3
"""Controls of stages nearer to each other than this are the same, and none has a share [m/s^2, rad/s^2]."""


def control_shares(aside: WindowsAside, decision: Decision, x: np.ndarray, edges: np.ndarray) -> dict[int, float]:
    """Return by stage index its share in the control of the first tick (edges (2,) [s]).

    Every stage in the window, or every level, is solved for alone from the measured state x (2n,). The shares are the
    weights, nonnegative and with sum 1, of the combination of their controls that comes nearest to the applied one.
    There are none where the stages agree, where one has no solution, or where the robot brakes without a plan.
    """
    sequence, now = decision.sequence, decision.prediction.start
    count = len(decision.levels) or sequence.count
    stages = list(range(sequence.first, sequence.first + count))
    if decision.exhausted:
        return {}
    if len(stages) == 1:
        return {stages[0]: 1.0}
    controls = []
    for stage in stages:
        entered = sequence.entered if stage == sequence.first else now
        plan, solved = aside.plan(Sequence(stage, np.zeros(0), entered), decision, x)
        if not solved:
            return {}
        controls.append(plan.mean_control(edges)[0])
    u = np.array(controls)
    if np.ptp(u, axis=0).max() < DISTINCT:
        return {}
    return dict(zip(stages, combination(u, decision.plan.mean_control(edges)[0]), strict=True))


def combination(u: np.ndarray, applied: np.ndarray) -> np.ndarray:
    """Return the weights (S,) of the convex combination of controls u (S, n) that is nearest to the applied (n,).

    Active set: the weights that would be negative are dropped, the most negative first.
    """
    weights, kept = np.zeros(len(u)), np.arange(len(u))
    while len(kept) > 1:
        base, rest = u[kept[0]], u[kept[1:]]
        found = np.linalg.lstsq((rest - base).T, applied - base, rcond=None)[0]
        found = np.r_[1.0 - found.sum(), found]
        if found.min() >= 0:
            weights[kept] = found
            return weights
        kept = np.delete(kept, int(np.argmin(found)))
    weights[kept] = 1.0
    return weights
