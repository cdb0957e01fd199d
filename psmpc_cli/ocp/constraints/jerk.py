"""Limits of the jerk, the rate at which the acceleration changes from interval to interval.

From the middle of an interval of length h- to the middle of the next, of length h, the acceleration changes from u- to
u in d = (h- + h) / 2. The rows are

    h low <= h (u - u-) / d <= h high,

changes of acceleration, which have no 1 / h where the intervals of a stage become short together. Before the first
interval of a window stands what was commanded last, over a tick of the low-level loop. At a switch the limits are those
of the stage that begins. What is commanded is ramped between the middles (`Plan.ramped_rates`).
"""

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, rows_over_intervals
from psmpc_cli.ocp.objective import RateFunctions
from psmpc_cli.ocp.stage import JERK, ConstraintNumbers
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robots.robot import resolve_limits
from psmpc_cli.specs.task import TaskSpec


def jerk_limits(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
    """Return which coordinates have a limited jerk in a stage, and their limits; None where none has."""
    limits = resolve_limits(model.spec, task.limits, task.skills[task.stages[stage].skill].limits)
    limited = np.isfinite(limits.jerk_low) | np.isfinite(limits.jerk_high)
    if not limited.any():
        return None
    return ConstraintNumbers(
        structure=tuple(np.flatnonzero(limited).tolist()),
        argument=np.zeros(0),
        low=limits.jerk_low[limited],
        high=limits.jerk_high[limited],
    )


def jerk_rows(model: RobotModel, coordinates: tuple[int, ...]) -> RateFunctions:
    """Return the rows h (u - u-) / d [m/s^2, rad/s^2] of some coordinates."""
    return RateFunctions(coordinates, _row)


def _row(u_before: ca.SX, u: ca.SX, h_before: ca.SX, h: ca.SX) -> ca.SX:
    return h * (u - u_before) / ((h_before + h) / 2)


CONSTRAINT = Constraint(rows_over_intervals(JERK, jerk_rows, permanent=True), jerk_limits)
