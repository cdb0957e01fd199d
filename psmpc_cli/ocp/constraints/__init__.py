"""The constraints on states at the nodes of a window; a new one is one more file here and one line of the table.

Limits on positions, velocities and accelerations are bounds of single numbers and keep a path of their own, `boxes`.
"""

from collections.abc import Iterator

from psmpc_cli.ocp.constraints import end, kept
from psmpc_cli.ocp.constraints.base import Constraint, ConstraintFunctions, NodeRows
from psmpc_cli.ocp.window import WindowShape
from psmpc_cli.robot.model import RobotModel

__all__ = ["CONSTRAINTS", "Constraint", "ConstraintFunctions", "NodeRows", "node_rows"]

CONSTRAINTS: tuple[Constraint, ...] = (
    end.END_CONDITIONS,
    kept.KEPT_ERRORS,
)


def node_rows(model: RobotModel, shape: WindowShape) -> list[NodeRows]:
    """Return the rows of all constraints on windows of a shape, by ascending nodes."""

    def placed() -> Iterator[NodeRows]:
        for constraint in CONSTRAINTS:
            yield from constraint(model, shape)

    return sorted(placed(), key=lambda rows: rows.node)
