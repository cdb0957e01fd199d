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


def end_condition_rows(model: RobotModel, shape: WindowShape) -> Iterator[NodeRows]:
    """Yield the end conditions of a window as rows at nodes: where a stage ends, its errors are within tolerances.

    They hold at the last node of each stage that ends in the window. HTMPC, which solves for one stage after the other,
    also has kept stages in a window: earlier ones whose cost must not get worse. They are numbered behind the stages of
    the window, and if one ends, it does so at the first switch.

    Args:
        model: The robot.
        shape: The structure of the windows: stages, kept stages, numbers of intervals.

    Yields:
        Rows at a single node, for each stage whose end imposes anything.
    """
    last_nodes = Grid(model.n, shape.nodes).first_node[1:]
    stages = [*shape.stages, *shape.kept]
    end_nodes = [*last_nodes, *(last_nodes[0] for _ in shape.kept)]
    for s, (stage, node) in enumerate(zip(stages, end_nodes, strict=True)):
        functions = stage_functions(model, end_shape(stage))
        if functions.end_rows:
            yield NodeRows(
                name="end condition",
                nodes=(int(node),),
                functions=functions.end,
                argument=partial(_target_of_stage, s),
                bounds=partial(_bounds, s),
            )


def _target_of_stage(s: int, p: Parameters[Any]) -> Any:
    return p.targets[s]


def _bounds(s: int, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return the tolerances about 0, or about the rate that a moving target gives its error."""
    end = [*window.stages, *(earlier.stage for earlier in window.kept)][s].end
    return end.centers - end.half_widths, end.centers + end.half_widths


CONSTRAINT = Constraint(end_condition_rows)
