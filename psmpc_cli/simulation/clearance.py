"""How near bodies come to each other: the smallest distance of every pair of parts over the ticks of a sample."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from psmpc_cli.native.functions import BatchFunction
from psmpc_cli.ocp.constraints.clearance import (
    Group,
    Pairs,
    distances_on_arrays,
    groups_to_clear,
    nearest_points,
    poses_after,
)
from psmpc_cli.ocp.problem import Problem
from psmpc_cli.ocp.stage import SampleContext
from psmpc_cli.plant import Ticks
from psmpc_cli.robot.configuration import Chart
from psmpc_cli.specs.geometry import pair_name


@dataclass(frozen=True, eq=False)
class MeasuredPairs:
    """A group of pairs as it is measured: the pairs that have the same obstacle or object, or none.

    A row is one of its distances. A pair of parts may have several rows, one for each pair of primitive shapes.

    Attributes:
        group: The group.
        pairs: Its pairs, with the object at its pose in the inertial frame, held or not.
        columns: Index of each of its pairs among all pairs of the task.
        pair_of_row: Index within the group of the pair that each row is of.
        distances: x, [anchor; 0; poses] -> the distances, one a row.
        points: The same -> the nearest points of each pair of solids.
    """

    group: Group
    pairs: Pairs
    columns: np.ndarray
    pair_of_row: list[int]
    distances: BatchFunction
    points: BatchFunction


class ClearanceMeter:
    """Measures the distances of all pairs of parts that a task keeps clear.

    Attributes:
        pairs: Names of the two parts of each pair, (P, 2).
        margins: What each pair is to keep, by stage, (stages, P) [m]; NaN where it need not.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        task = problem.spec
        groups = [groups_to_clear(task, problem.model, stage) for stage in range(len(task.stages))]
        names = dict.fromkeys(
            name for of_stage in groups for measured_group in of_stage.values() for name in measured_group.pairs.names
        )
        self.pairs = list(names)
        self.margins = np.full((len(groups), len(names)), np.nan)
        self._groups_of_stage = [[self._measured(group) for group in of_stage.values()] for of_stage in groups]
        for stage, measured in enumerate(self._groups_of_stage):
            spec = task.clearance_of(stage)
            for measured_group in measured:
                self.margins[stage, measured_group.columns] = 0.0 if spec is None else spec.margin

    def _measured(self, group: Group) -> MeasuredPairs:
        model = self._problem.model
        pairs = replace(group.pairs, gripper=None)
        return MeasuredPairs(
            group=group,
            pairs=pairs,
            columns=np.array([self.pairs.index(name) for name in pairs.names]),
            pair_of_row=pairs.pair_of_row,
            distances=distances_on_arrays(model, pairs),
            points=model.cached((nearest_points, pairs), partial(nearest_points, model, pairs)),
        )

    def measure(self, stage: int, chart: Chart, ticks: Ticks) -> tuple[np.ndarray, np.ndarray]:
        """Measure how near the parts of each pair come to each other over the ticks of a sample, for the log.

        Pairs are measured in groups. A group is the pairs that have the same obstacle or object, or none: they share
        one function for their distances. A row is one of these distances; a pair of parts that are made of several
        primitive shapes has several rows.

        Args:
            stage: Index of the stage, whose groups of pairs are measured.
            chart: Local coordinates of configurations in which the distance functions are written.
            ticks: What the plant did over the sample (M ticks).

        Returns:
            The smallest distance of each of the P pairs (P,) [m], and the two nearest points then, in the inertial
            frame (P, 2, 3) [m]; NaN for pairs that are not measured in this stage.
        """
        smallest = np.full(len(self.pairs), np.inf)
        points = np.full((len(self.pairs), 2, 3), np.nan)
        X = chart.states_in_chart(ticks.states)
        for group in self._groups_of_stage[stage]:
            arguments = self._function_arguments(group, chart, ticks)
            if arguments is None:  # the object or obstacle is not there
                continue
            distances = group.distances(X, arguments, rows=len(X))[0]  # (M + 1, rows)
            closest_tick_of_row = distances.argmin(axis=0)
            smallest_of_row = distances.min(axis=0)
            # points are computed only at the ticks at which some row is smallest, mostly the first and the last
            computed_ticks, position_of_row = np.unique(closest_tick_of_row, return_inverse=True)
            points_at_ticks = group.points(X[computed_ticks], arguments[computed_ticks], rows=len(computed_ticks))[0]
            points_of_row = points_at_ticks.reshape(len(computed_ticks), -1, 2, 3)[position_of_row]
            # rows in descending order of distance, so that the smallest row of a pair is entered last and stays
            for row in np.argsort(-smallest_of_row):
                column = group.columns[group.pair_of_row[row]]
                if smallest_of_row[row] <= smallest[column]:
                    smallest[column] = smallest_of_row[row]
                    points[column] = points_of_row[row, group.pair_of_row[row]]
        smallest[np.isinf(smallest)] = np.nan
        return smallest, points

    def _function_arguments(self, measured: MeasuredPairs, chart: Chart, ticks: Ticks) -> np.ndarray | None:
        """Return what the functions of a group take besides the state, [anchor; 0; poses], at the ticks of a sample.

        Args:
            measured: The group.
            chart: Local coordinates of configurations, whose anchor the functions take.
            ticks: What the plant did over the sample (M ticks).

        Returns:
            A row for each tick and for the end (M + 1, numbers); None where the group's object or obstacle is not
            there.
        """
        count = len(ticks.time)
        parts = [np.tile(chart.anchor, (count, 1)), np.zeros((count, 1))]
        if measured.pairs.has("object"):
            if ticks.target_object is None:
                return None
            parts.append(ticks.target_object.pose)
        if measured.pairs.has("obstacle"):
            state = measured.group.state(SampleContext(float(ticks.time[0]), ticks.states[0], chart.anchor))
            if state is None:
                return None
            parts.append(poses_after(self._problem.model, *state, ticks.time - ticks.time[0]))
        return np.hstack(parts)


def clearance_header(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Return what runs along the dimensions of distances in a log."""
    pairs = ClearanceMeter(problem).pairs
    return {
        "clearance/pair": tuple(pair_name(*pair) for pair in pairs),
        "clearance/point": tuple(f"{side}.{axis}" for side in ("first", "second") for axis in "xyz"),
    }
