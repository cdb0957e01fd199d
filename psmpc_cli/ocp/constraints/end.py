"""End conditions: where a stage ends, errors and their rates are within tolerances. Paper eq. (18)."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, NodeRows
from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.stage import end_shape
from psmpc_cli.ocp.window import Parameters, Window, WindowShape
from psmpc_cli.robot.model import RobotModel


def rows(model: RobotModel, shape: WindowShape) -> Iterator[NodeRows]:
    """Yield the rows of every stage that ends in the window by its end condition, at its last node.

    A kept stage is numbered behind the stages of the window. It ends at the first switch, if it does.
    """
    last_nodes = Grid(model.n, shape.nodes).first_node[1:]
    stages_and_nodes = zip(shape.stages, last_nodes, strict=True)
    kept = ((stage, last_nodes[0]) for stage in shape.kept)
    for s, (stage, node) in enumerate([*stages_and_nodes, *kept]):
        functions = stage_functions(model, end_shape(stage))
        if functions.end_rows:
            yield NodeRows(
                name="end condition",
                nodes=(int(node),),
                functions=functions.end,
                argument=partial(_target, s),
                bounds=partial(_bounds, s),
            )


def _target(s: int, p: Parameters[Any]) -> Any:
    return p.targets[s]


def _bounds(s: int, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return the tolerances about 0, or about the rate that a moving target gives its error."""
    end = [*window.stages, *(earlier.stage for earlier in window.kept)][s].end
    return end.centers - end.half_widths, end.centers + end.half_widths


CONSTRAINT = Constraint(rows)
