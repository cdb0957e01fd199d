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
from psmpc_cli.specs.robots.robot import resolve_limits
from psmpc_cli.specs.task import TaskSpec

UNIT = 1e-2
"""Unit of the rows [m, rad]: plans may violate any row by 1e-4 (`solvers.base.FEASIBLE`), so positions by 1e-6."""

NO_LIMIT = 1e12
"""Stands for an infinite limit among the arguments of functions [m, rad, m/s^2, rad/s^2]."""


def position_limits(task: TaskSpec, model: RobotModel, stage: int) -> ConstraintNumbers | None:
    """Return the limits of positions between nodes in a stage as a constraint; None where no position is limited.

    Bounds at nodes do not keep a coordinate inside that turns round within an interval, between two nodes; these rows
    do. The attitude of a spatial base has no such row. The argument is low and high of the limited positions, then low
    and high of their accelerations. Positions and their bounds are in units of `UNIT`.

    Args:
        task: The task.
        model: The robot.
        stage: Index of the stage.
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
        argument=np.clip(np.concatenate([low, high, *accelerations]), -NO_LIMIT, NO_LIMIT),  # finite for functions
        low=low / UNIT,
        high=high / UNIT,
    )


def extreme_position_rows(model: RobotModel, shape: WindowShape) -> Iterator[IntervalRows]:
    """Yield the rows that keep limited positions inside between nodes, over the intervals of every stage of a window.

    A coordinate whose rate changes its sign within an interval turns round there, further out than at both nodes. The
    very first interval of a window has functions of its own: it begins at the measured state, which no plan can change,
    so its rows allow what even the strongest braking cannot avoid. There are no rows where limits are soft, or where
    the integration is by explicit Euler, whose motion is straight between nodes.

    Args:
        model: The robot.
        shape: The structure of the windows.

    Yields:
        For each stage with limited positions, rows over the window's first interval, then over the other intervals.
    """
    if shape.soft or shape.discretization == "euler":
        return
    first_node = Grid(model.n, shape.nodes).first_node
    for s, name, coordinates in entries("turns", shape):
        stage_intervals = range(int(first_node[s]), int(first_node[s + 1]))
        first_count = 1 if s == 0 else 0  # only the first stage has the window's first interval
        for intervals, is_first in ((stage_intervals[:first_count], True), (stage_intervals[first_count:], False)):
            if len(intervals):
                key = (extreme_positions, coordinates, is_first)
                yield IntervalRows(
                    name=name,
                    intervals=intervals,
                    functions=model.cached(key, partial(extreme_positions, model, coordinates, is_first)),
                    argument=argument_of(name, s),
                    bounds=bounds_of(name, s),
                    over_time=False,
                    rarely_active=True,
                )


def extreme_positions(model: RobotModel, coordinates: tuple[int, ...], is_first: bool) -> IntervalFunctions:
    """Return the extreme position E of some coordinates over an interval of constant acceleration, in units of `UNIT`.

    With the position Q at its beginning, its length h, and the rates v and v+ at its ends,

        E = Q + h / 2 v^2 / (v - v+)    where v and v+ have different signs: E is where the rate is 0;
        E = Q + h / 2 (v + v+)          elsewhere: the position at the end of the interval.

    Args:
        model: The robot.
        coordinates: Which coordinates are limited.
        is_first: It is the first interval of a window. How far the measured state must go beyond a limit, even if the
            coordinate brakes as hard as it can, is then taken off E, so that a plan can meet the limit.

    Returns:
        Functions of x, dv = v+ - v, h and [anchor; low, high; low, high of the accelerations], see `position_limits`.
    """
    n = model.n
    x = ca.SX.sym("x", 2 * n)
    dv = ca.SX.sym("dv", n)
    h = ca.SX.sym("h")
    argument = ca.SX.sym("argument", model.space.n_anchor + 4 * len(coordinates))
    low, high, acceleration_low, acceleration_high = ca.vertsplit(argument[model.space.n_anchor :], len(coordinates))
    Q = x[:n][list(coordinates)]
    v = x[n:][list(coordinates)]
    v_next = v + dv[list(coordinates)]
    turns_round = v * v_next < 0
    # CasADi evaluates both branches: the 1 keeps 0 / 0 out of the one that does not count.
    twice_mean_rate = ca.if_else(turns_round, v**2 / ca.if_else(turns_round, v - v_next, 1), v + v_next)
    extreme = Q + h / 2 * twice_mean_rate
    if is_first:  # how far beyond low and high it gets even if it brakes
        extreme += _unavoidable_excess(low - Q, -v, acceleration_high, h) - _unavoidable_excess(
            Q - high, v, -acceleration_low, h
        )
    return IntervalFunctions(x, dv, h, argument, extreme / UNIT, ends=(0,))


def _unavoidable_excess(beyond: ca.SX, v: ca.SX, strongest: ca.SX, h: ca.SX) -> ca.SX:
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


CONSTRAINT = Constraint(extreme_position_rows, position_limits)
