"""What a constraint is: rows of the states of a window, kept between low and high.

Rows at nodes are g(x, a), rows over intervals g(x, x+, h, a) with the states at both ends and the length h. A
constraint says what it has of every stage of a task, and yields its rows for a robot and a window shape. Every back-end
takes them from there: `sqp` the values, Jacobians and, at nodes, curvatures of their functions, IPOPT and fatrop their
expressions. The curvatures are those by Q alone: a bound that is curved in the velocities, such as one on |v|, is
better written as planes about it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from psmpc_cli.ocp.loads import Load
from psmpc_cli.ocp.objective import ChangeFunctions, ConstraintFunctions, IntervalFunctions, RateFunctions
from psmpc_cli.ocp.plan import Grid
from psmpc_cli.ocp.stage import ArgumentAtSample, ConstraintNumbers, SampleContext
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
    "entries",
    "is_entry_of",
    "load_at_sample",
    "named_for_stage",
    "rows_at_nodes",
    "rows_over_intervals",
    "sampled_load",
]


@dataclass(frozen=True, eq=False)
class NodeRows:
    """Rows of one constraint at some nodes of the windows of a shape: the same functions, argument and bounds at each.

    Attributes:
        name: Of the constraint.
        nodes: The nodes, ascending.
        functions: x, a -> the rows, their Jacobian and curvature; the same object wherever the rows are the same.
        argument: Parameters of a window, numbers or symbols -> a, (numbers,), or one at each of the nodes, a row each.
        bounds: Window -> low and high (rows,); where they are equal the rows are equations.
        soft: They may be violated at a cost, see `boxes.PENALTY`.
        activation_distance: Rows further from their bounds than this are not part of a program; infinite: all are.
    """

    name: str
    nodes: Sequence[int]
    functions: ConstraintFunctions
    argument: Callable[[Parameters[Any]], Any]
    bounds: Callable[[Window], tuple[np.ndarray, np.ndarray]]
    soft: bool = False
    activation_distance: float = np.inf

    def expression(self, k: int, x: Any, p: Parameters[Any]) -> Any:
        """Return the rows (rows,) at one of the nodes, whose state is x (2n,)."""
        a = self.argument(p)
        function = self.functions.value.function
        is_same_everywhere = a.shape[0] == function.size1_in(1) and (len(a.shape) == 1 or a.shape[1] == 1)
        return function(x, a if is_same_everywhere else a[self.nodes.index(k), :].T)

    def argument_from_first(self, p: Parameters[np.ndarray]) -> np.ndarray:
        """Return the argument at the first node of the window and at the nodes, (numbers,) or (1 + nodes, numbers).

        At the first node, which has no rows, it is taken as at the first of the nodes.
        """
        a = np.asarray(self.argument(p))
        return a if a.ndim == 1 else np.vstack([a[:1], a])


@dataclass(frozen=True, eq=False)
class IntervalRows:
    """Rows of one constraint over some intervals of the windows of a shape, with functions, argument and bounds alike.

    Attributes:
        name: Of the constraint.
        intervals: The intervals, ascending.
        functions: The rows and their Jacobian; the same object wherever the rows are the same.
        argument: Parameters of a window, numbers or symbols -> a.
        bounds: Window -> low and high (rows,), infinite where there is none; the widest where they differ by interval.
        weights: Parameters -> what the squares of the rows cost (rows,), of rows that are residuals; else None.
        permanent: All rows are part of every program: they are equations, or depend on few numbers.
        over_time: The rows are integrals over the interval: their bounds are those of the rows over h.
        rarely_active: The bounds of states say the same of most motions: a program has the rows that a solution without
            them violates. With all of them fatrop does not converge.
        varying_bounds: Window, switch times (S,) [s] -> low and high over each of the intervals, a row each; None
            where they are `bounds`.
    """

    name: str
    intervals: Sequence[int]
    functions: ChangeFunctions | IntervalFunctions | RateFunctions
    argument: Callable[[Parameters[Any]], Any]
    bounds: Callable[[Window], tuple[np.ndarray, np.ndarray]]
    weights: Callable[[Parameters[Any]], Any] | None = None
    permanent: bool = False
    over_time: bool = True
    rarely_active: bool = False
    varying_bounds: Callable[[Window, np.ndarray], tuple[np.ndarray, np.ndarray] | None] = lambda window, times: None

    @property
    def is_permanent(self) -> bool:
        """Whether the rows are part of every program, however far from their bounds: residuals of the cost are."""
        return self.permanent or self.weights is not None

    def bounds_by_interval(self, window: Window, switch_times: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return low and high of the rows over each of the intervals, (intervals, rows) each.

        Without switch times they are the widest.
        """
        shape = len(self.intervals), self.functions.count
        varying = None if switch_times is None else self.varying_bounds(window, switch_times)
        low, high = self.bounds(window) if varying is None else varying
        return np.broadcast_to(low, shape), np.broadcast_to(high, shape)


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
            under its name; several by names of their own, which are added to it. None where it does not concern the
            stage, or has no numbers but those of the stage itself.
    """

    rows: RowsOfShape
    numbers: Callable[[TaskSpec, RobotModel, int], ConstraintNumbers | Mapping[str, ConstraintNumbers] | None] = (
        _no_numbers
    )


def numbers_by_name(
    name: str, entries_of_stage: ConstraintNumbers | Mapping[str, ConstraintNumbers] | None
) -> dict[str, ConstraintNumbers]:
    """Return what a constraint has of a stage by the names under which the stage holds it."""
    if entries_of_stage is None:
        return {}
    if isinstance(entries_of_stage, ConstraintNumbers):
        return {name: entries_of_stage}
    return {f"{name} {entry}": constraint for entry, constraint in entries_of_stage.items()}


def is_entry_of(name: str, entry_name: str) -> bool:
    """Tell whether the entry `entry_name` of a stage belongs to the constraint `name`, which may have several of them.

    An entry is what a stage holds of a constraint under one name: its structure, numbers and bounds.
    """
    return entry_name == name or entry_name.startswith(f"{name} ")


def rows_at_nodes(
    name: str,
    functions: Callable[[RobotModel, Any], ConstraintFunctions],
    soft: Callable[[Any], bool] = lambda structure: False,
    activation_distance: float = np.inf,
) -> RowsOfShape:
    """Return the `rows` function of a constraint whose rows are functions of the state at single nodes.

    A file of a constraint gives it to its `Constraint`. An entry is what a stage holds of a constraint under one name;
    stages that the constraint does not concern have none. Rows are at the nodes of a stage after its first, up to the
    switch that ends it. The first node of a window is its measured state, which no plan can change: it has no rows.

    Args:
        name: Name of the constraint in the table `CONSTRAINTS`.
        functions: Called with the robot and the structure of an entry; returns the rows as functions of the state x and
            of [anchor of the chart; argument]. The structure is what decides their expressions beside the robot; all
            numbers are in the argument.
        soft: Called with the structure; tells whether the rows may be violated at a cost.
        activation_distance: Rows further from their bounds than this are left out of a quadratic program.

    Returns:
        Function of the robot and the shape of windows that yields one `NodeRows` for each entry of the constraint.
    """

    def rows(model: RobotModel, shape: WindowShape) -> Iterator[NodeRows]:
        first_node = Grid(model.n, shape.nodes).first_node
        for s, entry_name, structure in entries(name, shape):
            yield NodeRows(
                name=entry_name,
                nodes=range(int(first_node[s]) + 1, int(first_node[s + 1]) + 1),
                functions=model.cached((functions, structure), partial(functions, model, structure)),
                argument=argument_of(entry_name, s),
                bounds=bounds_of(entry_name, s),
                soft=soft(structure),
                activation_distance=activation_distance,
            )

    return rows


def rows_over_intervals(
    name: str,
    functions: Callable[[RobotModel, Any], ChangeFunctions | IntervalFunctions | RateFunctions],
    permanent: bool = False,
    over_time: bool = True,
) -> RowsOfShape:
    """Return the `rows` function of a constraint whose rows are functions of the states at both ends of an interval.

    A file of a constraint gives it to its `Constraint`. An entry is what a stage holds of a constraint under one name;
    stages that the constraint does not concern have none.

    Args:
        name: Name of the constraint in the table `CONSTRAINTS`.
        functions: Called with the robot and the structure of an entry; returns the rows, whose argument is [anchor of
            the chart; argument]. The structure is what decides their expressions beside the robot; all numbers are in
            the argument.
        permanent: All rows are part of every program, see `IntervalRows`.
        over_time: The rows are integrals over the interval: their bounds hold for the rows divided by its length.

    Returns:
        Function of the robot and the shape of windows that yields one `IntervalRows` for each entry of the constraint.
    """

    def rows(model: RobotModel, shape: WindowShape) -> Iterator[IntervalRows]:
        first_node = Grid(model.n, shape.nodes).first_node
        for s, entry_name, structure in entries(name, shape):
            yield IntervalRows(
                name=entry_name,
                intervals=range(int(first_node[s]), int(first_node[s + 1])),
                functions=model.cached((functions, structure), partial(functions, model, structure)),
                argument=argument_of(entry_name, s),
                bounds=bounds_of(entry_name, s),
                varying_bounds=partial(_varying_bounds, entry_name, s),
                permanent=permanent,
                over_time=over_time,
            )

    return rows


def entries(name: str, shape: WindowShape) -> Iterator[tuple[int, str, Any]]:
    """Yield the entries of a constraint in the stages of windows of a shape: number of the stage, name, structure."""
    for s, stage in enumerate(shape.stages):
        yield from (
            (s, entry_name, structure) for entry_name, structure in stage.constraints if is_entry_of(name, entry_name)
        )


def argument_of(name: str, s: int) -> Callable[[Parameters[Any]], Any]:
    """Return how the argument of a constraint's functions is read from parameters: [anchor; argument] of stage s."""
    return partial(_argument, name, s)


def bounds_of(name: str, s: int) -> Callable[[Window], tuple[np.ndarray, np.ndarray]]:
    """Return how the bounds of a constraint are read from windows: those of stage s."""
    return partial(_bounds, name, s)


def _argument(name: str, s: int, p: Parameters[Any]) -> Any:
    return p.constraints[s][name]


def _bounds(name: str, s: int, window: Window) -> tuple[np.ndarray, np.ndarray]:
    constraint = window.stages[s].constraints[name]
    return constraint.low, constraint.high


def _varying_bounds(
    name: str, s: int, window: Window, switch_times: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    constraint = window.stages[s].constraints[name]
    if constraint.over_intervals is None:
        return None
    first = sum(window.nodes[:s])
    since = window.times(switch_times)[first : first + window.nodes[s] + 1] - window.start
    return constraint.over_intervals(constraint.of_bounds, since)


def sampled_load(load: Load) -> ArgumentAtSample | None:
    """Return how samples set the numbers of a load: where mass and moments are found out, or wheels store something.

    None of any other.
    """
    return partial(load_at_sample, load) if load.is_estimated or load.stores else None


def load_at_sample(load: Load, model: RobotModel, sample: SampleContext) -> np.ndarray:
    """Return the numbers of a load (numbers,) at a sample."""
    numbers = load.sampled(sample.load).numbers
    if load.stores and sample.stored is not None:
        numbers = np.concatenate([numbers[: -len(sample.stored)], sample.stored])
    return numbers


def named_for_stage(
    stage: int, load: Load, constraint: ConstraintNumbers
) -> ConstraintNumbers | Mapping[str, ConstraintNumbers]:
    """Return what a constraint has of a stage, by a name of its own where samples set it for this stage alone.

    That is what wheels store in it, and numbers of its bounds.
    """
    return {str(stage + 1): constraint} if load.stores or constraint.for_bounds else constraint
