"""The constraints on states of a window by the name of their file here, in which each is a `CONSTRAINT`.

Limits on positions, velocities and accelerations are bounds of single numbers and keep a path of their own, `boxes`.
"""

from pkgutil import resolve_name

import numpy as np

from psmpc_cli.ocp.constraints.base import (
    Constraint,
    ConstraintFunctions,
    IntervalFunctions,
    IntervalRows,
    NodeRows,
    rows_at_nodes,
)
from psmpc_cli.ocp.constraints.boxes import PENALTY, scaled_violations
from psmpc_cli.ocp.objective import Intervals
from psmpc_cli.ocp.plan import Plan
from psmpc_cli.ocp.window import Window, WindowShape, window_numbers, window_shape
from psmpc_cli.robot.model import RobotModel

__all__ = [
    "CONSTRAINTS",
    "Constraint",
    "ConstraintFunctions",
    "IntervalFunctions",
    "IntervalRows",
    "NodeRows",
    "interval_rows",
    "missing_row_violation",
    "node_rows",
    "rows_at_nodes",
    "soft_row_violations",
]

NAMES = (
    "mobility",
    "mount",
    "end",
    "kept",
    "hands",
    "turns",
    "forces",
    "wheels",
    "jerk",
    "clearance",
    "cones",
)

CONSTRAINTS: dict[str, Constraint] = {name: resolve_name(f"{__name__}.{name}:CONSTRAINT") for name in NAMES}
"""They are read in this order, in which windows have their numbers too."""


def node_rows(model: RobotModel, shape: WindowShape) -> list[NodeRows]:
    """Return the rows at nodes of all constraints on windows of a shape."""
    return [rows for rows in _rows(model, shape) if isinstance(rows, NodeRows)]


def interval_rows(model: RobotModel, shape: WindowShape) -> list[IntervalRows]:
    """Return the rows over intervals of all constraints on windows of a shape."""
    return [rows for rows in _rows(model, shape) if isinstance(rows, IntervalRows)]


def _rows(model: RobotModel, shape: WindowShape) -> tuple[NodeRows | IntervalRows, ...]:
    def yielded() -> tuple[NodeRows | IntervalRows, ...]:
        return tuple(rows for constraint in CONSTRAINTS.values() for rows in constraint.rows(model, shape))

    return model.cached(("rows", shape), yielded)


def missing_row_violation(model: RobotModel, window: Window, plan: Plan) -> float:
    """Return by how much a plan on the mesh of a window violates rows that are rarely active, at worst; 0 if none."""
    p = window_numbers(window, plan.switch_times)
    h = np.diff(plan.times)[:, None]
    worst = 0.0
    for rows in interval_rows(model, window_shape(window)):
        if rows.rarely_active:
            k = np.array(rows.intervals)
            values = rows.functions.values(Intervals(plan.X, h, p.before, k), rows.argument(p))
            worst = max(worst, float(scaled_violations(values, *rows.bounds(window)).max()) / PENALTY)
    return worst


def soft_row_violations(model: RobotModel, window: Window, plan: Plan) -> tuple[float, float]:
    """Return by how much a plan violates soft constraints at worst, so that the controller can refuse it.

    What the measured state violates already is returned apart: no plan can change it. Limits on single states are not
    among these constraints, see `boxes`. Violations have the units of their rows, m, rad, m/s or rad/s; the largest
    number counts, whatever its unit, as in the penalty.

    Args:
        model: The robot.
        window: The window.
        plan: A plan whose nodes are those of the window.

    Returns:
        The largest violation at the nodes after the first, and the largest at the first node, the measured state. 0
        where there is none.
    """
    soft = [rows for rows in node_rows(model, window_shape(window)) if rows.soft]
    if not soft:
        return 0.0, 0.0
    p = window_numbers(window, plan.switch_times)
    # the largest violation of each constraint; 0 for none
    at_later_nodes = [0.0]
    at_first_node = [0.0]
    for rows in soft:
        X = plan.X[[0, *rows.nodes]]  # the first node has no rows in a program, but counts here
        values = rows.functions.value(X, rows.argument_from_first(p), rows=len(X))[0]
        violations = scaled_violations(values, *rows.bounds(window)).max(axis=1) / PENALTY  # by node
        at_first_node.append(float(violations[0]))
        at_later_nodes.append(float(violations[1:].max()))
    return max(at_later_nodes), max(at_first_node)
