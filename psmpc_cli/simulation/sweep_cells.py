"""The cells of a sweep one after another, however they were sampled, and what those of one ratio came to."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from psmpc_cli.errors import LogError, SpecError
from psmpc_cli.logs.results import Results
from psmpc_cli.specs.load import Task, parse_task

SAME = 9
"""Decimals of the logarithm of a ratio to which two are the same."""

GRID, RATIOS, RANDOM = "grid", "ratios", "random"
"""Samplings of a sweep."""

_SAMPLINGS = {("omega_2", "omega_1"): GRID, ("ratio",): RATIOS, ("cell",): RANDOM}


@dataclass(frozen=True, eq=False)
class SweepCells:
    """The cells of a sweep, complete or not.

    Attributes:
        results: What its file holds.
        task: The task; in the cells the priorities of the studied stages are others.
        stages: Indices of the two studied stages.
        sampling: GRID, RATIOS or RANDOM.
    """

    results: Results
    task: Task
    stages: tuple[int, int]
    sampling: str

    def of(self, name: str) -> np.ndarray:
        """Return a quantity of the cells (cells, ...)."""
        values = self.results[name]
        return values.reshape(-1, *values.shape[self.results["status"].ndim :])

    @property
    def names(self) -> tuple[str, str]:
        """Names of the studied stages."""
        first, second = (self.task.spec.stages[stage].name for stage in self.stages)
        return first, second

    @cached_property
    def omega(self) -> np.ndarray:
        """Priorities of the two studied stages (cells, 2)."""
        if self.sampling == GRID:
            omega_2, omega_1 = np.meshgrid(self.results["omega_2"], self.results["omega_1"], indexing="ij")
            return np.column_stack([omega_1.ravel(), omega_2.ravel()])
        return np.column_stack([self.results["omega_1"], self.results["omega_2"]])

    @property
    def ratio(self) -> np.ndarray:
        """omega_2 / omega_1 (cells,)."""
        return np.asarray(self.omega[:, 1] / self.omega[:, 0])

    @property
    def own_ratio(self) -> float:
        """omega_2 / omega_1 of the task itself."""
        first, second = (self.task.spec.stages[stage].priority for stage in self.stages)
        return float(second / first)

    @property
    def failed(self) -> np.ndarray:
        """Which cells failed (cells,)."""
        return self._is("failed")

    @property
    def waiting(self) -> np.ndarray:
        """Which cells have not been run (cells,)."""
        return self._is("waiting")

    @property
    def ended(self) -> np.ndarray:
        """Which cells came to their end (cells,)."""
        return np.asarray(~(self.failed | self.waiting))

    def _is(self, meaning: str) -> np.ndarray:
        return np.asarray(self.of("status") == self.results.quantities["status"].meanings.index(meaning))

    def count(self, name: str) -> int:
        """Return a number summed up over the runs; what cells share counts once."""
        own = self.of("origin") == np.arange(len(self.ratio))
        return int(np.maximum(self.of(name)[own], 0).sum())

    @property
    def epsilons(self) -> np.ndarray:
        """Thresholds of the actual start (epsilons,)."""
        return self.results["epsilon"]

    @property
    def chosen(self) -> int:
        """Index of the threshold where there is room for one alone: the task's own, the largest if that is missing."""
        own = np.flatnonzero(np.isclose(self.epsilons, self.task.spec.onset.epsilon))
        return int(own[0]) if len(own) else int(np.argmax(self.epsilons))

    @property
    def instant(self) -> np.ndarray:
        """t_s: the instant that ended the first studied stage (cells,) [s]."""
        return np.asarray(self.of("switch_time")[:, self.stages[0]])

    @property
    def floor(self) -> np.ndarray:
        """t_s - T_h, before which the second stage is in no window (cells,) [s]."""
        return np.asarray(self.instant - self.task.spec.controller.horizon)


@dataclass(frozen=True, eq=False)
class AlongRatio:
    """A quantity of the cells that ended, by their ratio: all (ratios,), from the smallest ratio to the largest.

    Cells of one ratio differ in it no more than the solver's tolerance, or where stages other than the studied two
    are in the window as well.
    """

    ratio: np.ndarray
    middle: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray


def sweep_cells(results: Results) -> SweepCells:
    """Return the cells of a sweep.

    Raises:
        LogError: The file lacks what a sweep has, or the task in it does not hold in this version.
    """
    try:
        attributes = results.attributes
        texts = (str(attributes[key]) for key in ("task_yaml", "robot_yaml", "task_name"))
        first, second = (int(number) - 1 for number in str(attributes["stages"]).split(","))
        sampling = _SAMPLINGS[results.quantities["status"].dims]
        return SweepCells(results, parse_task(*texts), (first, second), sampling)
    except (KeyError, ValueError) as error:
        raise LogError(f"{results.path}: expected what psmpc sweep-weights writes, but it lacks {error}") from None
    except SpecError as error:
        raise LogError(f"{results.path}: the task or robot in it does not hold in this version:\n{error}") from None


def along_ratio(cells: SweepCells, values: np.ndarray) -> AlongRatio:
    """Return a quantity (cells,) by ratio."""
    which = np.flatnonzero(cells.ended)
    ratio, kept = cells.ratio[which], values[which]
    _, first, inverse = np.unique(np.round(np.log10(ratio), SAME), return_index=True, return_inverse=True)
    groups = [kept[inverse == k] for k in range(len(first))]
    middle, lowest, highest = (np.array([of(group) for group in groups]) for of in (np.median, np.min, np.max))
    return AlongRatio(ratio[first], middle, lowest, highest)
