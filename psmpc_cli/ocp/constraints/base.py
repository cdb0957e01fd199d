"""What a constraint is: rows of the states of a window, kept between low and high.

Rows at nodes are g(x, a), rows over intervals g(x, x+, h, a) with the states at both ends and the length h. A
constraint says what it has of every stage of a task, and yields its rows for a robot and a window shape. Every back-end
takes them from there: `sqp` the values, Jacobians and, at nodes, curvatures of their functions, IPOPT and fatrop their
expressions. The curvatures are those by Q alone: a bound that is curved in the velocities, such as one on |v|, is
better written as planes about it.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from psmpc_cli.ocp.objective import ConstraintFunctions, IntervalFunctions
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.stage import ConstraintNumbers
from psmpc_cli.ocp.window import Parameters, Window, WindowShape
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.task import TaskSpec

__all__ = [
    "Constraint",
    "ConstraintFunctions",
    "IntervalFunctions",
    "IntervalRows",
    "NodeRows",
    "argument_of",
    "bounds_of",
    "rows_at_nodes",
    "rows_over_intervals",
]


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
        functions: The rows and their Jacobian; the same object wherever the rows are the same.
        argument: Parameters of a window, numbers or symbols -> a.
        bounds: Window -> low and high (rows,), of the rows over h; infinite where there is none.
        weights: Parameters -> what the squares of the rows cost (rows,), of rows that are residuals; else None.
    """

    name: str
    intervals: Sequence[int]
    functions: IntervalFunctions
    argument: Callable[[Parameters[Any]], Any]
    bounds: Callable[[Window], tuple[np.ndarray, np.ndarray]]
    weights: Callable[[Parameters[Any]], Any] | None = None


RowsOfShape: TypeAlias = Callable[[RobotModel, WindowShape], Iterator[NodeRows | IntervalRows]]
"""Robot, shape of windows -> the rows of a constraint on these windows."""


def _no_numbers(task: TaskSpec, model: RobotModel, stage: int) -> None:
    """Return nothing: the constraint has no numbers of its own."""


@dataclass(frozen=True)
class Constraint:
    """One constraint of the table.

    Attributes:
        rows: Its rows on windows of a shape.
        numbers: Task, robot, index of a stage -> what it has of the stage, which windows and their records then hold
            under its name; None where it does not concern the stage, or has no numbers but those of the stage itself.
    """

    rows: RowsOfShape
    numbers: Callable[[TaskSpec, RobotModel, int], ConstraintNumbers | None] = _no_numbers


def rows_at_nodes(
    name: str,
    functions: Callable[[RobotModel, Any], ConstraintFunctions],
    soft: bool | Callable[[RobotModel, Any], Sequence[bool]] = False,
) -> RowsOfShape:
    """Return how a constraint yields its rows at the nodes of the stages that it concerns.

    At a switch those of the stage before count. The first node of a window is its measured state, which has none.

    Args:
        name: Of the constraint in the table.
        functions: Robot, structure -> x, [anchor of the chart; argument] -> the rows.
        soft: They may be violated at a cost; where that is not the same for all, robot, structure -> whether each may.
    """

    def rows(model: RobotModel, shape: WindowShape) -> Iterator[NodeRows]:
        first_node = Grid(model.n, shape.nodes).first_node
        for s, stage in enumerate(shape.stages):
            for structure in (structure for of, structure in stage.constraints if of == name):
                all_rows = NodeRows(
                    name=name,
                    nodes=range(int(first_node[s]) + 1, int(first_node[s + 1]) + 1),
                    functions=model.owned((functions, structure), partial(functions, model, structure)),
                    argument=argument_of(name, s),
                    bounds=bounds_of(name, s),
                )
                if isinstance(soft, bool):
                    yield replace(all_rows, soft=soft)
                else:
                    yield from _by_softness(model, (functions, structure), all_rows, soft(model, structure))

    return rows


def _by_softness(model: RobotModel, key: Hashable, all_rows: NodeRows, soft: Sequence[bool]) -> Iterator[NodeRows]:
    """Yield the soft ones of some rows and the hard ones, which share their argument.

    Args:
        model: The robot.
        key: Under which it owns the functions of all rows.
        all_rows: All of them.
        soft: Which of them are soft.
    """
    for kind in (True, False):
        chosen = [row for row, is_soft in enumerate(soft) if is_soft is kind]
        if chosen:
            of_kind = model.owned((key, kind), partial(all_rows.functions.only, chosen))
            bounds = partial(_bounds_of_some, chosen, all_rows.bounds)
            yield replace(all_rows, functions=of_kind, bounds=bounds, soft=kind)


def rows_over_intervals(name: str, functions: Callable[[RobotModel, Any], IntervalFunctions]) -> RowsOfShape:
    """Return how a constraint yields its rows over the intervals of the stages that it concerns.

    Args:
        name: Of the constraint in the table.
        functions: Robot, structure -> the rows, their argument [anchor of the chart; argument].
    """

    def rows(model: RobotModel, shape: WindowShape) -> Iterator[IntervalRows]:
        first_node = Grid(model.n, shape.nodes).first_node
        for s, stage in enumerate(shape.stages):
            for structure in (structure for of, structure in stage.constraints if of == name):
                yield IntervalRows(
                    name=name,
                    intervals=range(int(first_node[s]), int(first_node[s + 1])),
                    functions=model.owned((functions, structure), partial(functions, model, structure)),
                    argument=argument_of(name, s),
                    bounds=bounds_of(name, s),
                )

    return rows


def argument_of(name: str, s: int) -> Callable[[Parameters[Any]], Any]:
    """Return how the argument of a constraint's functions is read from parameters: [anchor; argument] of stage s."""
    return partial(_argument, name, s)


def bounds_of(name: str, s: int) -> Callable[[Window], tuple[np.ndarray, np.ndarray]]:
    """Return how the bounds of a constraint are read from windows: those of stage s."""
    return partial(_bounds, name, s)


def _argument(name: str, s: int, p: Parameters[Any]) -> Any:
    return p.constraints[s][name]


def _bounds(name: str, s: int, window: Window) -> tuple[np.ndarray, np.ndarray]:
    numbers = window.stages[s].constraints[name]
    return numbers.low, numbers.high


def _bounds_of_some(
    chosen: Sequence[int], bounds: Callable[[Window], tuple[np.ndarray, np.ndarray]], window: Window
) -> tuple[np.ndarray, np.ndarray]:
    low, high = bounds(window)
    return low[chosen], high[chosen]
