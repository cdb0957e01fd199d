"""The points that sequential quadratic programming goes through, and which step from one to the next counts."""

from dataclasses import dataclass

import numpy as np

from psmpc_cli.ocp.velocity_form import Point, Residuals
from psmpc_cli.solvers.base import FEASIBLE
from psmpc_cli.solvers.qp_solution import QpSolution
from psmpc_cli.solvers.sqp_limits import Violation

DECREASE = 1e-4
"""Share of the predicted decrease of the merit function that a step must bring (Armijo)."""

NOISE = 1e-9
"""Relative rise of the objective that is taken for rounding."""


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point with what holds there, and the step that led to it.

    Attributes:
        step: Largest component of the program's full step [m, rad, m/s, rad/s, s].
        share: How much of that step was taken; 0 if no share of it counted.
        qp: The program's solution, None at the guess.
    """

    point: Point
    at: Residuals
    violation: Violation
    step: float = np.inf
    share: float = 0.0
    qp: QpSolution | None = None


def counts(found: Iterate, before: Iterate, slope: float, penalty: float) -> bool:
    """Tell whether a step brings enough: worst violation, objective or merit.

    The merit function alone would cut the long steps of a cold start: it adds up the gaps that a longer stage leaves at
    each of its nodes, each of them a second-order term that the next iteration closes.

    Args:
        found: After the step.
        before: Before it.
        slope: Change of the objective that its gradient predicts for the step, penalties of soft limits included.
        penalty: Weight of the violation in the merit function, above every multiplier.
    """
    noise = NOISE * (1 + abs(before.at.objective))
    rise = found.at.objective - before.at.objective
    if found.violation.worst <= before.violation.worst / 2 and before.violation.worst > FEASIBLE:
        return True
    if found.violation.worst <= FEASIBLE and rise <= DECREASE * slope + noise:
        return True
    predicted = slope - penalty * found.share * before.violation.total
    return rise + penalty * (found.violation.total - before.violation.total) <= DECREASE * predicted + noise
