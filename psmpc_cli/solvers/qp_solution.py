"""What a quadratic program of a window came to, whichever method solved it."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from psmpc_cli.ocp.velocity_form import Point
from psmpc_cli.solvers.sqp_limits import QpShape


class QpStatus(Enum):
    """How a quadratic program ended."""

    SOLVED = "solved"
    INFEASIBLE = "no step meets the linearized constraints"
    FAILED = "not solved"


@dataclass(frozen=True, eq=False)
class QpSolution:
    """A program's step and multipliers.

    Attributes:
        status: How it ended.
        shape: Which rows it has.
        step: The step; that of x_0 is 0.
        gaps: Multipliers of the gaps, (K, n).
        until: Of given sums of durations, in the order of `QpShape.tied`.
        fixed: Of given durations, in the order of `QpShape.fixed`.
        together: Of the last stage's shortest duration.
        ends: Of the end rows by stage.
        inputs: Of the limits on acceleration, as multipliers of `Qdot+ - Qdot - h u`, (K, n).
        X: Of the limits of x_1 .. x_K, (K, 2n).
        tau: Of those of the durations, (S,).
        iterations: Interior-point iterations.
    """

    status: QpStatus
    shape: QpShape
    step: Point
    gaps: np.ndarray
    until: np.ndarray
    fixed: np.ndarray
    together: float
    ends: dict[int, np.ndarray]
    inputs: np.ndarray
    X: np.ndarray
    tau: np.ndarray
    iterations: int

    @property
    def largest(self) -> float:
        """The largest multiplier of what must hold; soft limits need not."""
        pieces = [self.gaps, self.until, self.fixed, np.array([self.together]), *self.ends.values()]
        pieces += [self.inputs, self.tau] if self.shape.soft else [self.inputs, self.tau, self.X]
        return float(max(np.abs(piece).max(initial=0.0) for piece in pieces))
