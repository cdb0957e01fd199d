"""What a constraint is: rows g(x, a) of the state at nodes of a window, kept between low and high.

A constraint is a function of robot and window shape that yields its rows node by node. Every back-end takes them from
there: `sqp` the values, Jacobians and curvatures of their functions, IPOPT and fatrop their expressions.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from psmpc_cli.ocp.objective import ConstraintFunctions
from psmpc_cli.ocp.window import Parameters, Window, WindowShape
from psmpc_cli.robot.model import RobotModel

__all__ = ["Constraint", "ConstraintFunctions", "NodeRows"]


@dataclass(frozen=True, eq=False)
class NodeRows:
    """Rows of one constraint at one node of the windows of a shape.

    Attributes:
        name: Of the constraint.
        node: The node.
        functions: x, a -> the rows, their Jacobian and curvature; the same object wherever the rows are the same.
        argument: Parameters of a window, numbers or symbols -> a.
        bounds: Window -> low and high (rows,); where they are equal the rows are equations.
    """

    name: str
    node: int
    functions: ConstraintFunctions
    argument: Callable[[Parameters[Any]], Any]
    bounds: Callable[[Window], tuple[np.ndarray, np.ndarray]]


Constraint: TypeAlias = Callable[[RobotModel, WindowShape], Iterator[NodeRows]]
