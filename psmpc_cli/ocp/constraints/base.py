"""What a constraint is: rows g(x, a) of the state at nodes of a window, kept between low and high.

A constraint is a function of robot and window shape that yields its rows node by node. Every back-end takes them from
there: `sqp` the values, Jacobians and curvatures of their functions, IPOPT and fatrop their expressions.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from psmpc_cli.ocp.objective import ConstraintFunctions
from psmpc_cli.ocp.window import Parameters, Window, WindowShape
from psmpc_cli.robot.model import RobotModel

__all__ = ["Constraint", "ConstraintFunctions", "NodeRows"]


@dataclass(frozen=True, eq=False)
class NodeRows:
    """Rows of one constraint at some nodes of the windows of a shape: the same functions, argument and bounds at each.

    Attributes:
        name: Of the constraint.
        nodes: The nodes, ascending.
        functions: x, a -> the rows, their Jacobian and curvature; the same object wherever the rows are the same.
        argument: Parameters of a window, numbers or symbols -> a.
        bounds: Window -> low and high (rows,); where they are equal the rows are equations.
        soft: They may be violated at a cost, see `boxes.PENALTY`.
    """

    name: str
    nodes: Sequence[int]
    functions: ConstraintFunctions
    argument: Callable[[Parameters[Any]], Any]
    bounds: Callable[[Window], tuple[np.ndarray, np.ndarray]]
    soft: bool = False


Constraint: TypeAlias = Callable[[RobotModel, WindowShape], Iterator[NodeRows]]
