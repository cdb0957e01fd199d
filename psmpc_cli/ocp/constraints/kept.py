"""Errors of earlier stages that a level of HTMPC must not make worse, node by node. Paper eq. (32)."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from psmpc_cli.ocp.constraints.base import Constraint, NodeRows
from psmpc_cli.ocp.objective import stage_functions
from psmpc_cli.ocp.window import Parameters, Window, WindowShape, reference_at
from psmpc_cli.robot.model import RobotModel


def kept_error_rows(model: RobotModel, shape: WindowShape) -> Iterator[NodeRows]:
    """Yield the errors of every kept stage at every node after the first, where they are bounded node by node."""
    if not shape.kept_errors:
        return
    for number, stage in enumerate(shape.kept):
        functions = stage_functions(model, stage).error_rows
        for node in range(1, sum(shape.nodes) + 1):
            yield NodeRows(
                name="kept error",
                nodes=(node,),
                functions=functions,
                argument=partial(_wanted, len(shape.stages) + number, node),
                bounds=partial(_bounds, number, node),
            )


def _wanted(s: int, node: int, p: Parameters[Any]) -> Any:
    """Return what the cost of a stage, numbered among stages and kept ones, follows over the whole horizon."""
    return reference_at(p, s, node, p.horizon)


def _bounds(number: int, node: int, window: Window) -> tuple[np.ndarray, np.ndarray]:
    largest = window.kept[number].bound[node - 1]
    return -largest, largest


CONSTRAINT = Constraint(kept_error_rows)
