"""Limits of positions between the nodes: a coordinate that turns round within an interval does so inside its limits.

Limits hold at the nodes (`boxes`). Over an interval of length h with a constant acceleration a coordinate whose rate
changes its sign, from v to v+, is furthest out in between, where its rate is 0; any other is so at an end. The row is

    E = Q + h / 2 v^2 / (v - v+)    where v v+ < 0,    else    E = Q + h / 2 (v + v+).

Both have the same value and the same derivatives where v+ = 0: a motion that comes to rest at a limit is no edge of
the constraint. E - Q is a square over a linear function, so a step of a program, which takes the tangent, leaves more
violation than it foresees; the next iteration takes it away. The attitude of a spatial base has no such form, explicit
Euler has straight lines between its nodes, and where limits are soft it is their nodes that cost: no rows there.

The first interval begins at the measured state, which no plan can change. Where even the strongest braking leaves a
limit, the row allows what that leaves.
"""

from collections.abc import Iterator
from functools import partial

import casadi as ca
import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, IntervalFunctions, IntervalRows, argument_of, bounds_of, entries
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.ocp.window import WindowShape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.robot import resolve_limits
from psmpc_cli.specs.task import TaskSpec

UNIT = 1e-2
"""Unit of the rows [m, rad]: plans may violate any row by 1e-4 (`solvers.base.FEASIBLE`), so positions by 1e-6."""

NO_LIMIT = 1e12
"""Stands for an infinite limit among the arguments of functions [m, rad, m/s^2, rad/s^2]."""


def numbers(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
    """Return which positions are limited in a stage and by what; None where none is.

    The argument is their limits and those of their accelerations, low then high of either.
    """
    limits = resolve_limits(model.spec, task.limits, task.skills[task.stages[stage].skill].limits)
    is_limited = np.isfinite(limits.position_low) | np.isfinite(limits.position_high)
    if model.space.has_quaternion:
        is_limited[model.space.rotation] = False
    if not is_limited.any():
        return None
    low = limits.position_low[is_limited]
    high = limits.position_high[is_limited]
    accelerations = (limits.acceleration_low[is_limited], limits.acceleration_high[is_limited])
    return ConstraintNumbers(
        structure=tuple(np.flatnonzero(is_limited).tolist()),
        argument=np.clip(np.concatenate([low, high, *accelerations]), -NO_LIMIT, NO_LIMIT),
        low=low / UNIT,
        high=high / UNIT,
    )


def rows(model: RobotModel, shape: WindowShape) -> Iterator[IntervalRows]:
    """Yield the rows of the stages that have limited positions; those of the very first interval have own functions."""
    if shape.soft or shape.discretization == "euler":
        return
    first_node = Grid(model.n, shape.nodes).first_node
    for s, name, coordinates in entries("turns", shape):
        of_stage = range(int(first_node[s]), int(first_node[s + 1]))
        for intervals, is_first in ((of_stage[:1], True), (of_stage[1:], False)) if s == 0 else ((of_stage, False),):
            if len(intervals):
                yield IntervalRows(
                    name=name,
                    intervals=intervals,
                    functions=model.cached(
                        (functions, coordinates, is_first), partial(functions, model, coordinates, is_first)
                    ),
                    argument=argument_of(name, s),
                    bounds=bounds_of(name, s),
                    over_time=False,
                    rarely_active=True,
                )


def functions(model: RobotModel, coordinates: tuple[int, ...], is_first: bool) -> IntervalFunctions:
    """Return E of some coordinates over an interval, or over the first, less what the measured state cannot avoid."""
    n = model.n
    x = ca.SX.sym("x", 2 * n)
    dv = ca.SX.sym("dv", n)
    h = ca.SX.sym("h")
    argument = ca.SX.sym("argument", model.space.n_anchor + 4 * len(coordinates))
    limits = ca.vertsplit(argument[model.space.n_anchor :], len(coordinates))
    low, high, acceleration_low, acceleration_high = limits
    Q = x[:n][list(coordinates)]
    v = x[n:][list(coordinates)]
    v_next = v + dv[list(coordinates)]
    turns_round = v * v_next < 0
    by_end = ca.if_else(turns_round, v**2 / ca.if_else(turns_round, v - v_next, 1), v + v_next)
    extreme = Q + h / 2 * by_end
    if is_first:
        extreme += _unavoidable(low - Q, -v, acceleration_high, h) - _unavoidable(Q - high, v, -acceleration_low, h)
    return IntervalFunctions(x, dv, h, argument, extreme / UNIT, ends=(0,))


def _unavoidable(beyond: ca.SX, v: ca.SX, strongest: ca.SX, h: ca.SX) -> ca.SX:
    """Return how far beyond a limit a coordinate gets even if it brakes.

    Args:
        beyond: By how much it is beyond the limit already, negative inside.
        v: Its rate towards the outside.
        strongest: The strongest acceleration against that. Where it has no limit a coordinate can stop at once; one
            that is outside already may take the interval to do so.
        h: Length of the interval [s].
    """
    outwards = ca.fmax(v, 0)
    braking = ca.fmax(outwards**2 / (2 * strongest), ca.if_else(beyond > 0, h / 2 * outwards, 0))
    return ca.SX(ca.fmax(beyond + braking, 0))


CONSTRAINT = Constraint(rows, numbers)
