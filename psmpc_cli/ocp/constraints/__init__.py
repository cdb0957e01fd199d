"""The constraints on states at the nodes of a window; a new one is one more file here and one line of the table.

Limits on positions, velocities and accelerations are bounds of single numbers and keep a path of their own, `boxes`.
"""

from psmpc_cli.ocp.constraints import end, hands, kept
from psmpc_cli.ocp.constraints.base import (
    Constraint,
    ConstraintFunctions,
    IntervalFunctions,
    IntervalRows,
    NodeRows,
)
from psmpc_cli.ocp.constraints.boxes import PENALTY, scaled_violations
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
    "node_rows",
    "soft_row_violations",
]

CONSTRAINTS: tuple[Constraint, ...] = (
    end.END_CONDITIONS,
    kept.KEPT_ERRORS,
    hands.HANDS,
)


def node_rows(model: RobotModel, shape: WindowShape) -> list[NodeRows]:
    """Return the rows at nodes of all constraints on windows of a shape."""
    return [rows for rows in _rows(model, shape) if isinstance(rows, NodeRows)]


def interval_rows(model: RobotModel, shape: WindowShape) -> list[IntervalRows]:
    """Return the rows over intervals of all constraints on windows of a shape."""
    return [rows for rows in _rows(model, shape) if isinstance(rows, IntervalRows)]


def _rows(model: RobotModel, shape: WindowShape) -> tuple[NodeRows | IntervalRows, ...]:
    return model.owned(
        ("rows", shape), lambda: tuple(rows for yielded in CONSTRAINTS for rows in yielded(model, shape))
    )


def soft_row_violations(model: RobotModel, window: Window, plan: Plan) -> tuple[float, float]:
    """Return by how much soft rows are violated at worst: at the nodes of a plan after the first, and at the first.

    Different units count alike, as in the penalty.
    """
    soft = [rows for rows in node_rows(model, window_shape(window)) if rows.soft]
    p = window_numbers(window, plan.instants)
    at_nodes = [0.0]
    at_first = [0.0]
    for rows in soft:
        X = plan.X[[0, *rows.nodes]]
        values = rows.functions.value(X, rows.argument(p), rows=len(X))[0]
        violations = scaled_violations(values, *rows.bounds(window)).max(axis=1) / PENALTY
        at_first.append(float(violations[0]))
        at_nodes.append(float(violations[1:].max()))
    return max(at_nodes), max(at_first)
