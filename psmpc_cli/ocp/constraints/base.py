"""What a constraint is: rows of the states of a window, kept between low and high.

Rows at nodes are g(x, a), rows over intervals g(x, x+, h, a) with the states at both ends and the length h. A
constraint is a function of robot and window shape that yields its rows. Every back-end takes them from there: `sqp` the
values, Jacobians and, at nodes, curvatures of their functions, IPOPT and fatrop their expressions.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from psmpc_cli.ocp.objective import ConstraintFunctions, IntervalFunctions
from psmpc_cli.ocp.window import Parameters, Window, WindowShape
from psmpc_cli.robot.model import RobotModel

__all__ = ["Constraint", "ConstraintFunctions", "IntervalFunctions", "IntervalRows", "NodeRows"]


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


@dataclass(frozen=True, eq=False)
class IntervalRows:
    """Rows of one constraint over some intervals of the windows of a shape, with functions, argument and bounds alike.

    Attributes:
        name: Of the constraint.
        intervals: The intervals, ascending.
        functions: x, x+, h, a -> the rows and their Jacobian; the same object wherever the rows are the same.
        argument: Parameters of a window, numbers or symbols -> a.
        bounds: Window -> low and high (rows,), of the rows over h; infinite where there is none.
    """

    name: str
    intervals: Sequence[int]
    functions: IntervalFunctions
    argument: Callable[[Parameters[Any]], Any]
    bounds: Callable[[Window], tuple[np.ndarray, np.ndarray]]


Constraint: TypeAlias = Callable[[RobotModel, WindowShape], Iterator[NodeRows | IntervalRows]]
