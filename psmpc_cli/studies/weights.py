"""Pairs of priorities of two stages in a row: which ones a sweep tries, what its cells came to, which it recommends."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from psmpc_cli.errors import InputError, LogError, SpecError
from psmpc_cli.logs.results import Results
from psmpc_cli.specs.load import Task, parse_task

Array = np.ndarray

GRID, RATIOS, RANDOM = "grid", "ratios", "random"
"""Samplings of a sweep."""

DIMENSIONS = {GRID: ("omega_2", "omega_1"), RATIOS: ("ratio",), RANDOM: ("cell",)}
"""The dimensions of the cells of each sampling."""

MOST_CELLS = 100_000
"""Largest number of cells; a larger one is a typing error."""

SAME = 9
"""Decimals of the logarithm of a ratio of priorities to which two are equal."""

WITHIN = 0.05
"""Part of the earliest completion by which a recommended ratio may complete later."""

ALLOWED = 1.0
"""Final error that the end condition itself allows [tolerances]."""


@dataclass(frozen=True, eq=False)
class Sampling:
    """The pairs of priorities that a sweep tries.

    Attributes:
        kind: A grid over both priorities, ratios with the geometric mean of both at 1, or random draws.
        label: As the user wrote it, such as 25x25, 49 or random:40.
        omega: Priorities of the two stages in each cell, (cells, 2).
        shape: Of the results' arrays: (omega_2, omega_1) of a grid, (cells,) of the others.
    """

    kind: Literal["grid", "ratios", "random"]
    label: str
    omega: Array
    shape: tuple[int, ...]

    @property
    def ratio(self) -> Array:
        """omega_2 / omega_1 of each cell (cells,)."""
        return np.asarray(self.omega[:, 1] / self.omega[:, 0])


def parse_range(text: str) -> tuple[float, float]:
    """Parse the bounds of a range such as 1e-3:1e3.

    Raises:
        InputError: It is none, or its numbers are not positive and rising.
    """
    low, colon, high = text.partition(":")
    try:
        bounds = float(low), float(high)
    except ValueError:
        bounds = (np.nan, np.nan)
    if not colon or not 0 < bounds[0] < bounds[1] < np.inf:
        raise InputError(f"--range: found '{text}', expected LOW:HIGH with 0 < LOW < HIGH, such as 1e-3:1e3")
    return bounds


def parse_numbers(option: str, text: str, expected: str, above: float = -np.inf) -> tuple[float, ...]:
    """Parse the numbers of a list such as 1e-3,1e-2, and sort them, each once.

    Raises:
        InputError: One is no finite number above the smallest.
    """
    try:
        found = sorted({float(part) for part in text.split(",")})
    except ValueError:
        found = [np.nan]
    if not all(above < number < np.inf for number in found):
        raise InputError(f"{option}: found '{text}', expected {expected}")
    return tuple(found)


def is_grid(text: str) -> bool:
    """Return whether a text is meant as a grid or a number of ratios, and not as a task."""
    return re.match(r"\s*[-+]?\d", text) is not None and not text.endswith((".yaml", ".yml")) and "/" not in text


def grid_sampling(text: str, bounds: tuple[float, float]) -> Sampling:
    """Build the cells of a grid such as 25x25 (omega_1 by omega_2), or of a number of ratios such as 49.

    Raises:
        InputError: The text is neither.
    """
    match = re.fullmatch(r"(\d+)(?:x(\d+))?", text.strip())
    sizes = [int(size) for size in match.groups() if size] if match else []
    if not sizes or min(sizes) < 2:
        raise InputError(
            f"the grid: found '{text}', expected two sizes of at least 2 such as 25x25 (omega_1 by omega_2), or a "
            "number of ratios such as 49"
        )
    _ensure_few(text, int(np.prod(sizes)))
    low, high = np.log10(bounds)
    if len(sizes) == 1:
        half = np.linspace(low - high, high - low, sizes[0]) / 2
        return Sampling("ratios", text.strip(), 10.0 ** np.column_stack([-half, half]), (sizes[0],))
    axes = [10.0 ** np.linspace(low, high, size) for size in sizes]
    omega_2, omega_1 = np.meshgrid(axes[1], axes[0], indexing="ij")
    omega = np.column_stack([omega_1.ravel(), omega_2.ravel()])
    return Sampling("grid", text.strip(), omega, (sizes[1], sizes[0]))


def random_sampling(text: str, bounds: tuple[float, float], seed: int) -> Sampling:
    """Build the cells of a sampling such as random:40: log-uniform draws from the box.

    Raises:
        InputError: The text is none.
    """
    match = re.fullmatch(r"random:(\d+)", text.strip())
    if match is None or int(match[1]) < 1:
        raise InputError(f"--sampling: found '{text}', expected random:N with N of at least 1, such as random:100")
    _ensure_few(text, int(match[1]))
    low, high = np.log10(bounds)
    draws = np.random.default_rng(seed).uniform(low, high, (int(match[1]), 2))
    return Sampling("random", text.strip(), 10.0**draws, (len(draws),))


def _ensure_few(text: str, cells: int) -> None:
    if cells > MOST_CELLS:
        raise InputError(f"found '{text}' with {cells} cells, expected at most {MOST_CELLS}")


def parse_stages(text: str, task: Task) -> tuple[int, int]:
    """Return the indices of two stages in a row from their numbers or names, such as 1,2.

    Raises:
        InputError: They are not two stages in a row of the task, or its controller has no priorities.
    """
    names = [stage.name for stage in task.spec.stages]
    if task.spec.controller.kind != "psmpc":
        raise InputError(f"found controller.kind {task.spec.controller.kind}, which has no priorities; expected psmpc")
    given = [part.strip() for part in text.split(",")]
    found = [names.index(part) if part in names else int(part) - 1 if part.isdigit() else -1 for part in given]
    if len(found) != 2 or not 0 <= found[0] < len(names) or found[1] != found[0] + 1 or found[1] >= len(names):
        listed = ", ".join(f"{i + 1} {name}" for i, name in enumerate(names))
        raise InputError(f"--stages: found '{text}', expected two in a row such as 1,2 of the task's stages: {listed}")
    return found[0], found[1]


def origins(task: Task, stages: tuple[int, int], omega: Array) -> Array:
    """Return for each cell the first one with the same run (cells,).

    Scaling all omega leaves the optimum unchanged, so runs are equal if all priorities over the largest one are.

    Args:
        task: The task.
        stages: The two stages whose priorities vary.
        omega: Their priorities in each cell (cells, 2).
    """
    priorities = np.tile([stage.priority for stage in task.spec.stages], (len(omega), 1))
    priorities[:, list(stages)] = omega
    relative = np.round(np.log10(priorities / priorities.max(axis=1, keepdims=True)), SAME)
    _, first, inverse = np.unique(relative, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()])


@dataclass(frozen=True, eq=False)
class SweepCells:
    """The cells of a sweep over weights one after another, complete or not.

    Attributes:
        results: The content of its file.
        task: The task; in the cells the priorities of the studied stages are others.
        stages: Indices of the two studied stages.
        sampling: GRID, RATIOS or RANDOM.
    """

    results: Results
    task: Task
    stages: tuple[int, int]
    sampling: str

    def of(self, name: str) -> Array:
        """Return a quantity of the cells (cells, ...)."""
        values = self.results[name]
        return values.reshape(-1, *values.shape[self.results["status"].ndim :])

    @property
    def names(self) -> tuple[str, str]:
        """Names of the studied stages."""
        first, second = (self.task.spec.stages[stage].name for stage in self.stages)
        return first, second

    @cached_property
    def omega(self) -> Array:
        """Priorities of the two studied stages (cells, 2)."""
        if self.sampling == GRID:
            omega_2, omega_1 = np.meshgrid(self.results["omega_2"], self.results["omega_1"], indexing="ij")
            return np.column_stack([omega_1.ravel(), omega_2.ravel()])
        return np.column_stack([self.results["omega_1"], self.results["omega_2"]])

    @property
    def ratio(self) -> Array:
        """omega_2 / omega_1 (cells,)."""
        return np.asarray(self.omega[:, 1] / self.omega[:, 0])

    @property
    def own_ratio(self) -> float:
        """omega_2 / omega_1 of the task itself."""
        first, second = (self.task.spec.stages[stage].priority for stage in self.stages)
        return float(second / first)

    @property
    def failed(self) -> Array:
        """Which cells failed (cells,)."""
        return self._is("failed")

    @property
    def waiting(self) -> Array:
        """Which cells have not been run (cells,)."""
        return self._is("waiting")

    @property
    def ended(self) -> Array:
        """Which cells came to their end (cells,)."""
        return np.asarray(~(self.failed | self.waiting))

    def _is(self, meaning: str) -> Array:
        return np.asarray(self.of("status") == self.results.quantities["status"].meanings.index(meaning))

    def count(self, name: str) -> int:
        """Sum up a number over the runs; a run that several cells share counts once."""
        own = self.of("origin") == np.arange(len(self.ratio))
        return int(np.maximum(self.of(name)[own], 0).sum())

    @property
    def groups(self) -> list[Array]:
        """The cells that ended, those with the same run together, from the smallest ratio to the largest."""
        which = np.flatnonzero(self.ended)
        same = origins(self.task, self.stages, self.omega)[which]
        first = sorted(np.unique(same), key=lambda cell: (round(float(np.log10(self.ratio[cell])), SAME), cell))
        return [which[same == cell] for cell in first]

    @property
    def epsilons(self) -> Array:
        """Thresholds of the actual start (epsilons,)."""
        return self.results["epsilon"]

    @property
    def chosen(self) -> int:
        """Index of the threshold to show where only one is shown: the task's own, the largest if that is missing."""
        own = np.flatnonzero(np.isclose(self.epsilons, self.task.spec.onset.epsilon))
        return int(own[0]) if len(own) else int(np.argmax(self.epsilons))

    @property
    def instant(self) -> Array:
        """t_s: the instant that ended the first studied stage (cells,) [s]."""
        return np.asarray(self.of("switch_time")[:, self.stages[0]])

    @property
    def floor(self) -> Array:
        """t_s - T_h, before which the second stage is in no window (cells,) [s]."""
        return np.asarray(self.instant - self.task.spec.controller.horizon)


def sweep_cells(results: Results) -> SweepCells:
    """Return the cells of a sweep over weights.

    Raises:
        LogError: The file is another one, or the task in it does not hold in this version.
    """
    samplings = {dims: sampling for sampling, dims in DIMENSIONS.items()}
    try:
        attributes = results.attributes
        texts = (str(attributes[key]) for key in ("task_yaml", "robot_yaml", "task_name"))
        first, second = (int(number) - 1 for number in str(attributes["stages"]).split(","))
        return SweepCells(results, parse_task(*texts), (first, second), samplings[results.quantities["status"].dims])
    except (KeyError, ValueError) as error:
        raise LogError(f"{results.path}: expected a file of psmpc sweep-weights, but it lacks {error}") from None
    except SpecError as error:
        raise LogError(f"{results.path}: the task or robot in it does not hold in this version:\n{error}") from None


@dataclass(frozen=True, eq=False)
class AlongRatio:
    """A quantity of the cells that ended, by their ratio: all (ratios,), from the smallest ratio to the largest.

    Cells of one ratio differ by no more than the solver's tolerance, unless other stages are in the window as well.
    """

    ratio: Array
    middle: Array
    lowest: Array
    highest: Array


def along_ratio(cells: SweepCells, values: Array) -> AlongRatio:
    """Return a quantity (cells,) by ratio."""
    which = np.flatnonzero(cells.ended)
    ratio, kept = cells.ratio[which], values[which]
    _, first, inverse = np.unique(np.round(np.log10(ratio), SAME), return_index=True, return_inverse=True)
    groups = [kept[inverse == k] for k in range(len(first))]
    middle, lowest, highest = (np.array([of(group) for group in groups]) for of in (np.median, np.min, np.max))
    return AlongRatio(ratio[first], middle, lowest, highest)


@dataclass(frozen=True)
class Recommendation:
    """The recommended ratio and what it is compared with.

    Attributes:
        ratio: omega_2 / omega_1.
        completion, error, effort: At this ratio: completion [s], final error [tolerances] (NaN of a stage without end
            condition) and control effort.
        earliest: Earliest completion at any ratio [s].
        efforts: Smallest and largest effort at any ratio.
        preliminary: Cells wait, so that it may change.
    """

    ratio: float
    completion: float
    error: float
    effort: float
    earliest: float
    efforts: tuple[float, float]
    preliminary: bool

    def __str__(self) -> str:
        allowed = "" if np.isnan(self.error) else f", and its final error is {self.error:.2f} of the tolerance"
        return (
            f"recommended omega_2/omega_1{' so far' if self.preliminary else ''}: {self.ratio:.4g}, the smallest that "
            f"completes within {WITHIN:.0%} of the earliest: at {self.completion:.2f} s, earliest {self.earliest:.2f} s"
            f"{allowed}; control effort {self.effort:.2f}, of {self.efforts[0]:.2f} to {self.efforts[1]:.2f} over all "
            "ratios"
        )


def recommend(cells: SweepCells) -> Recommendation | None:
    """Recommend the smallest ratio that completes within 5 % of the earliest completion and raises no error, if any.

    The final error is the largest error of the second stage's end condition when the stage ends, over its tolerance. A
    stage that ends by its condition does so at the first sample that meets it: its final error lies between 1 and what
    one sample takes off it, and says when within that sample the condition was met, not how well. Differences below 1
    are therefore no gain and no loss. The error counts as raised above 1, the end condition's own tolerance: the stage
    then ended at a planned switch time at which the plant did not meet it. Where it is above 1 at the smallest ratio
    already, at which the second stage has the least weight, it counts as raised above that value.

    Of several cells with one ratio the latest completion and the largest error count, and a ratio of which one failed
    is not recommended.
    """
    judged = _judge_ratios(cells)
    good = np.flatnonzero(judged.early & ~judged.raised & ~judged.failing)
    if not len(good):
        return None
    best, effort = int(good[0]), along_ratio(cells, cells.of("control_effort"))
    return Recommendation(
        ratio=float(judged.completion.ratio[best]),
        completion=float(judged.completion.highest[best]),
        error=float(judged.error.highest[best]),
        effort=float(effort.middle[best]),
        earliest=float(judged.completion.lowest.min()),
        efforts=(float(effort.lowest.min()), float(effort.highest.max())),
        preliminary=bool(cells.waiting.any()),
    )


def guidance(cells: SweepCells) -> str:
    """Say which ratio is recommended, or why there is none."""
    if (best := recommend(cells)) is not None:
        return str(best)
    judged = _judge_ratios(cells)
    if not len(judged.early):
        return "no ratio is recommended: no cell has come to its end"
    within = f"within {WITHIN:.0%} of the earliest completion, {judged.completion.lowest.min():.2f} s"
    if not judged.early.any():
        return f"no ratio is recommended: none completes {within} in all its cells, whose other priorities differ"
    found = [
        f"{np.sum(judged.early & which)} {words}"
        for which, words in (
            (judged.failing, "had a cell that failed"),
            (judged.raised & ~judged.failing, "raised the final error"),
        )
        if np.any(judged.early & which)
    ]
    return f"no ratio is recommended: of the {judged.early.sum()} that complete {within}, {' and '.join(found)}"


@dataclass(frozen=True, eq=False)
class _JudgedRatios:
    """The ratios of a sweep, and which of them complete early, raise the final error, or have a failed cell."""

    completion: AlongRatio
    error: AlongRatio
    early: Array
    raised: Array
    failing: Array


def _judge_ratios(cells: SweepCells) -> _JudgedRatios:
    completion, error = (along_ratio(cells, cells.of(name)) for name in ("completion_time", "final_error"))
    early = completion.highest <= (1 + WITHIN) * completion.lowest.min(initial=np.inf)
    failing = np.isclose(completion.ratio[:, None], cells.ratio[cells.failed], rtol=1e-8).any(axis=1)
    raised = error.highest > max(ALLOWED, np.nan_to_num(error.highest[0] if len(error.highest) else 0.0))
    return _JudgedRatios(completion, error, early, raised, failing)
