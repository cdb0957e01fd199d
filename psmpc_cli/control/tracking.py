"""What the controller knows of the task's object: its free motion, and when the grippers are to be closed on it."""

from collections.abc import Sequence

import numpy as np

from psmpc_cli.control.sequence import MovingSequence
from psmpc_cli.robot.free_body import FreeBody, motion_of
from psmpc_cli.robot.model import nearest_equivalent
from psmpc_cli.robot.rotations import conjugate, exp, log, product
from psmpc_cli.specs.object import ObjectSpec

GAINS = 0.5, 1 / 6
"""alpha and beta of the filter, beta = alpha^2 / (2 - alpha): the best of its kind for a given alpha.

Benedict, Bordner: Synthesis of an optimal set of radar track-while-scan smoothing equations (1962).
"""


class Tracker:
    """Follows the free motion of the object: what the task says of it, corrected by measured poses.

    An alpha-beta filter: pose and velocity are predicted, and a part of what the measured pose differs by corrects
    both. Without measurements it predicts from what the task says.
    """

    def __init__(self, thing: ObjectSpec, body: FreeBody) -> None:
        self.body, self._time, self._seen = body, 0.0, -np.inf
        self._pose, self._v = np.array(thing.pose), motion_of(thing)

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Predict pose, (3,) or (7,), and velocity at a time [s]."""
        return self.body.predicted(self._pose, self._v, time - self._time)

    def see(self, time: float, pose: np.ndarray) -> None:
        """Take in a pose measured at a time [s]; one that is not finite is ignored."""
        if not np.isfinite(pose).all():
            return
        (alpha, beta), between = GAINS, time - self._seen
        predicted, v = self.at(time)
        if len(pose) == 3:
            pose = np.array([*pose[:2], nearest_equivalent(predicted[2], pose[2])])
            missed = pose - predicted
            predicted = predicted + alpha * missed
        else:
            back = conjugate(list(predicted[3:]))
            turned = product(back, list(pose[3:]))
            turn = log([-part for part in turned] if turned[0] < 0 else turned)
            missed = np.array([*(pose[:3] - predicted[:3]), *turn])
            attitude = product(list(predicted[3:]), exp([alpha * part for part in turn]))
            predicted = np.array([*(predicted[:3] + alpha * missed[:3]), *attitude])
        if np.isfinite(between) and between > 0:
            v = v + beta / between * missed
        self._pose, self._v, self._time, self._seen = predicted, v, time, time


def to_be_closed(thing: ObjectSpec, names: Sequence[str], sequence: MovingSequence, ticks: np.ndarray) -> np.ndarray:
    """Tell at which ticks (M,) [s] the grippers are to be closed (M,).

    From the first one at or after the planned switch time that ends `taken_by` until that of the stage before
    `let_go_by`.
    """

    def end(stage: int) -> float:
        if stage < sequence.first:
            return -np.inf
        ahead = stage - sequence.first
        return float(sequence.instants[ahead]) if ahead < len(sequence.instants) else np.inf

    taken, released = end(names.index(thing.taken_by)), end(names.index(thing.let_go_by) - 1)
    return np.asarray((ticks >= taken - ROUNDING) & (ticks < released - ROUNDING))


ROUNDING = 1e-9
"""By how much a tick may miss an instant [s]."""
