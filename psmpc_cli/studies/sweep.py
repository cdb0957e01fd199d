"""Sweeps: runs over all values of any keys of a task, or over pairs of priorities. Paper section IV-B, Fig. 6."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from psmpc_cli.control.multistart import multistart_for
from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.results import Quantity, Results
from psmpc_cli.logs.schema import SWEEP, Column
from psmpc_cli.specs.arguments import rejected, require, require_callable, require_options
from psmpc_cli.specs.document import plain
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.measures import WHOLE_RUN, check_columns, second_stage
from psmpc_cli.studies.runner import (
    FAILED,
    LIGHT,
    OF_CELL,
    WAITING,
    Study,
    Watch,
    changed,
    documents_of,
    names_along,
    run_study,
    task_in,
)

Array = np.ndarray

GRID = "grid"
RATIOS = "ratios"
RANDOM = "random"
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
        kind: GRID over both priorities, RATIOS with the geometric mean of both at 1, or RANDOM draws.
        label: As the user wrote it, such as 25x25, 49 or random:40.
        omega: Priorities of the two stages in each cell, (cells, 2); those of a grid go along omega_2, then omega_1.
    """

    kind: str
    label: str
    omega: Array

    @property
    def ratio(self) -> Array:
        """omega_2 / omega_1 of each cell (cells,)."""
        return np.asarray(self.omega[:, 1] / self.omega[:, 0])


def parse_numbers(option: str, text: str, expected: str, above: float = -np.inf, by: str = ",") -> tuple[float, ...]:
    """Parse the numbers of a list such as 1e-3,1e-2, and sort them, each once.

    Raises:
        InputError: One is no finite number above the smallest.
    """
    try:
        found = sorted({float(part) for part in text.split(by)})
    except ValueError:
        found = [np.nan]
    if not all(above < number < np.inf for number in found):
        raise InputError(f"{option}: found '{text}', expected {expected}")
    return tuple(found)


def parse_sampling(text: str, bounds: tuple[float, ...], seed: int = 0) -> Sampling:
    """Build the cells of a grid such as 25x25 (omega_1 by omega_2), of a number of ratios such as 49, or of draws.

    Args:
        text: A grid, a number of ratios, or log-uniform draws from the box such as random:40.
        bounds: The lowest and the highest priority.
        seed: Of the draws.

    Raises:
        InputError: The text is none of them, there are too many cells, or no range.
    """
    if len(bounds) != 2:
        raise InputError(f"--range: found {len(bounds)} numbers, expected two, LOW:HIGH, such as 1e-3:1e3")
    match = re.fullmatch(r"(random:)?(\d+)|(\d+)x(\d+)", text.strip())
    sizes = [int(size) for size in match.groups()[1:] if size] if match else []
    drawn = match is not None and match[1] is not None
    if not sizes or min(sizes) < (1 if drawn else 2) or np.prod(sizes) > MOST_CELLS:
        raise InputError(
            f"found '{text}', expected a grid of two sizes of at least 2 such as 25x25 (omega_1 by omega_2), a number "
            f"of ratios such as 49, or --sampling random:N such as random:100; at most {MOST_CELLS} cells"
        )
    low, high = np.log10(bounds)
    if drawn:
        exponents = np.random.default_rng(seed).uniform(low, high, (sizes[0], 2))
    elif len(sizes) == 1:
        exponents = np.outer(np.linspace(low - high, high - low, sizes[0]) / 2, [-1.0, 1.0])
    else:
        omega_2, omega_1 = np.meshgrid(*(np.linspace(low, high, size) for size in reversed(sizes)), indexing="ij")
        exponents = np.column_stack([omega_1.ravel(), omega_2.ravel()])
    return Sampling(RANDOM if drawn else RATIOS if len(sizes) == 1 else GRID, text.strip(), 10.0**exponents)


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


class SweepCells:
    """The cells of a sweep over weights one after another, complete or not.

    Attributes:
        results: The content of its file.
        task: The task; in the cells the priorities of the studied stages are others.
        names: Names of the two studied stages.
        sampling: GRID, RATIOS or RANDOM.
        omega: Their priorities in each cell (cells, 2).
        ratio: omega_2 / omega_1 of each cell (cells,).
        own_ratio: omega_2 / omega_1 of the task itself.
        epsilons: Thresholds of the actual start (epsilons,).
        failed, waiting, ended: Which cells failed, have not been run, or came to their end (cells,).
        runs: The cells that ended and share no other one's run, from the smallest ratio to the largest (runs,).
        instant: t_s, which ended the first studied stage (cells,) [s].
        floor: t_s - T_h, before which the second stage is in no window (cells,) [s].

    Raises:
        LogError: The file is another one, or the task in it does not hold in this version.
    """

    def __init__(self, results: Results) -> None:
        samplings = {dims: sampling for sampling, dims in DIMENSIONS.items()}
        try:
            self.sampling = samplings[results.quantities["status"].dims]
            self.task = task_in(results)
            first, second = parse_stages(str(results.attributes["stages"]), self.task)
        except (KeyError, InputError) as error:
            raise LogError(f"{results.path}: expected a file of psmpc sweep-weights, but it lacks {error}") from None
        dims = DIMENSIONS[self.sampling]
        names = [stage.name for stage in self.task.spec.stages]
        weights = ("ratio",) if self.sampling == GRID else ("ratio", "omega_1", "omega_2")
        check_columns(results, (*OF_CELL, *second_stage(second), *(Column(name, "1", name) for name in weights)), dims)
        coordinates = (*dims, "epsilon") if self.sampling == GRID else ("epsilon",)
        check_columns(results, [Column(name, "1", name, dims=(name,)) for name in coordinates])
        check_columns(results, [Column("stage", "1", "stage", dtype="text", dims=("stage",))])
        if results["stage"].tolist() != names:
            raise LogError(f"{results.path}: /stage: found {', '.join(results['stage'])}, expected {', '.join(names)}")
        self.results = results
        self.names = self.task.spec.stages[first].name, self.task.spec.stages[second].name
        omega_1 = results["omega_1"]
        omega_2 = results["omega_2"]
        if self.sampling == GRID:
            omega_2, omega_1 = np.meshgrid(omega_2, omega_1, indexing="ij")
        self.omega = np.column_stack([omega_1.ravel(), omega_2.ravel()])
        self.ratio = results["ratio"].ravel()
        self.own_ratio = float(self.task.spec.stages[second].priority / self.task.spec.stages[first].priority)
        self.epsilons = results["epsilon"]
        status = results["status"].ravel()
        self.failed = status == FAILED
        self.waiting = status == WAITING
        self.ended = ~(self.failed | self.waiting)
        own = np.flatnonzero(self.ended & (self.of("origin") == np.arange(len(self.ratio))))
        self.runs = own[np.argsort(np.round(np.log10(self.ratio[own]), SAME), kind="stable")]
        self.instant = self.of("switch_time")[:, first]
        self.floor = self.instant - self.task.spec.controller.horizon

    def of(self, name: str) -> Array:
        """Return a quantity of the cells (cells, ...)."""
        values = self.results[name]
        return values.reshape(-1, *values.shape[self.results["status"].ndim :])

    def count(self, name: str) -> int:
        """Sum up a number over the runs; a run that several cells share counts once."""
        own = self.of("origin") == np.arange(len(self.ratio))
        return int(np.maximum(self.of(name)[own], 0).sum())

    @property
    def chosen(self) -> int:
        """Index of the threshold to show where only one is shown: the task's own, the largest if that is missing."""
        own = np.flatnonzero(np.isclose(self.epsilons, self.task.spec.onset.epsilon))
        return int(own[0]) if len(own) else int(np.argmax(self.epsilons))


class AlongRatio:
    """A quantity (cells,) of the cells that ended, by their ratio: from the smallest to the largest, (ratios,) each.

    Cells of one ratio differ by no more than the solver's tolerance, unless other stages are in the window as well.
    """

    def __init__(self, cells: SweepCells, values: Array) -> None:
        ratio = cells.ratio[cells.ended]
        kept = values[cells.ended]
        _, first, inverse = np.unique(np.round(np.log10(ratio), SAME), return_index=True, return_inverse=True)
        groups = [kept[inverse == k] for k in range(len(first))]
        self.ratio = ratio[first]
        self.middle, self.lowest, self.highest = (
            np.array([of(group) for group in groups]) for of in (np.median, np.min, np.max)
        )


class Recommendation(NamedTuple):
    """The recommended omega_2 / omega_1, if any, and a sentence: what speaks for it, or why there is none."""

    ratio: float | None
    sentence: str


def recommend(cells: SweepCells) -> Recommendation:
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
    names = ("completion_time", "final_error", "control_effort")
    completion, error, effort = (AlongRatio(cells, cells.of(name)) for name in names)
    if not len(completion.ratio):
        return Recommendation(None, "no ratio is recommended: no cell has come to its end")
    earliest = float(completion.lowest.min())
    early = completion.highest <= (1 + WITHIN) * earliest
    failing = np.isclose(completion.ratio[:, None], cells.ratio[cells.failed], rtol=1e-8).any(axis=1)
    raised = error.highest > max(ALLOWED, np.nan_to_num(error.highest[0]))
    good = early & ~raised & ~failing
    if good.any():
        best = int(np.argmax(good))
        ratio = float(completion.ratio[best])
        final = error.highest[best]
        allowed = "" if np.isnan(final) else f", and its final error is {final:.2f} of the tolerance"
        return Recommendation(
            ratio,
            f"recommended omega_2/omega_1{' so far' if cells.waiting.any() else ''}: {ratio:.4g}, the smallest that "
            f"completes within {WITHIN:.0%} of the earliest: at {completion.highest[best]:.2f} s, earliest "
            f"{earliest:.2f} s{allowed}; control effort {effort.middle[best]:.2f}, of {effort.lowest.min():.2f} to "
            f"{effort.highest.max():.2f} over all ratios",
        )
    kept = (
        f"of the {early.sum()} ratios that complete within {WITHIN:.0%} of the earliest completion, {earliest:.2f} s,"
    )
    others = f"{np.sum(early & failing)} had a cell that failed, the others raised the final error"
    return Recommendation(None, f"no ratio is recommended: {kept} {others}")


DEFAULT_TASK = "approach_capture"
"""The built-in task of Approach and Capture alone."""


def sweep(
    task: Task | str | Path,
    values: Mapping[str, Sequence[Any]],
    path: Path | str | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    force: bool = False,
    resume: bool = False,
    watch: Watch = lambda progress: None,
) -> Results:
    """Run a task with every combination of values of some of its keys.

    Args:
        task: The task, its file or the name of a built-in one.
        values: The values of each key, such as {"stages.capture.priority": [1, 10, 100]}.
        path: File of the results; None for none that stays.
        jobs: Processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to compute on.
        force: Whether an existing file is overwritten.
        resume: Whether the cells that wait in an existing file are computed; those that failed are computed again.
        watch: Called with the progress at the beginning and after every run.

    Returns:
        What became of the runs: arrays along one dimension for each key, named as the key.

    Raises:
        InputError: An argument is of another type, there are no values or too many, or as for `run_study`.
        SpecError: A value does not fit the task.
    """
    wanted = 'a mapping of keys to lists of values, such as {"stages.capture.priority": [1, 10]}'
    require("values", values, Mapping, wanted)
    for key, each in values.items():
        if not isinstance(key, str) or isinstance(each, str) or not isinstance(each, Sequence | np.ndarray):
            raise rejected("values", {key: each}, wanted)
    require_callable("watch", watch, "the progress")
    path = require_options(path, jobs, force, resume, dask)
    loaded = changed(task, LIGHT)
    runs = int(np.prod([len(each) for each in values.values()])) if values else 0
    if not 0 < runs <= MOST_CELLS:
        raise InputError(f"a sweep: found {runs} runs, expected 1 to {MOST_CELLS}")
    changes = {key: [f"{key}={_text(value)}" for value in each] for key, each in values.items()}
    every = [change for each in changes.values() for change in each]
    documents = documents_of(loaded)
    for change in every:
        documents.changed((change,))
    axes = [Quantity(key, (key,), _axis(each), "1", f"value of {key}") for key, each in values.items()]
    study = Study(
        kind=SWEEP,
        task=loaded,
        cells=list(product(*changes.values())),
        dims=tuple(values),
        coordinates=[*axes, *names_along(loaded)],
        quantities=WHOLE_RUN,
        identity={"keys": "; ".join(every)},
    )
    return run_study(study, path, jobs, dask, force, resume, watch)


def _text(value: Any) -> str:
    return json.dumps(plain(value))


def _axis(values: Sequence[Any]) -> np.ndarray:
    """Return the values of a key as a coordinate: numbers, or their text."""
    if all(isinstance(value, int | float | np.number) and not isinstance(value, bool) for value in values):
        return np.array(values, float)
    return np.array([each if isinstance(each, str) else _text(each) for each in values])


def load_sweep_task(reference: str | Path | Task, changes: Sequence[str] = (), epsilons: Sequence[float] = ()) -> Task:
    """Load the task of a sweep over weights, with the thresholds of the actual start if there are any.

    Where the pending cost permits several basins and the task does not say from how many guesses a window is solved,
    it is solved from several.

    Raises:
        SpecError: The task does not hold.
    """
    wanted = [f"onset.series={list(epsilons)}"] if epsilons else []
    loaded = changed(reference, [*changes, *wanted, *LIGHT])
    return changed(loaded, [f"controller.multistart={multistart_for(loaded.spec.controller)}"])


def weight_study(task: Task, stages: tuple[int, int], sampling: Sampling, every_cell: bool = False) -> Study:
    """Build the sweep over pairs of priorities; each run ends with the second stage.

    Args:
        task: The task, from `load_sweep_task`.
        stages: Indices of the two stages in a row whose priorities vary.
        sampling: Their priorities in each cell.
        every_cell: Whether cells with equal ratios of all priorities are computed one by one, instead of sharing a run.
    """
    spec = task.spec
    omega = sampling.omega
    keys = [f"stages[{stage}].priority" for stage in stages]
    names = [stage.name for stage in spec.stages]
    units = "m/s^2, rad/s^2" if spec.onset.kind == "control" else "1"
    epsilon = Quantity("epsilon", ("epsilon",), np.array(spec.onset.series), units, "threshold of the actual start")
    stage_names = Quantity("stage", ("stage",), np.array(names), "1", "stage")
    return Study(
        kind=SWEEP,
        task=task,
        cells=[tuple(f"{key}={float(each)!r}" for key, each in zip(keys, pair, strict=True)) for pair in omega],
        dims=DIMENSIONS[sampling.kind],
        coordinates=[*_weights(sampling, [names[stage] for stage in stages]), stage_names, epsilon],
        quantities=second_stage(stages[1]),
        identity={
            "stages": ",".join(str(stage + 1) for stage in stages),
            "sampling": sampling.label,
            "range": f"{omega.min():.6g} to {omega.max():.6g}",
            "every_cell": int(every_cell),
        },
        stop=stages[1],
        origins=None if every_cell else origins(task, stages, omega),
    )


def _weights(sampling: Sampling, names: Sequence[str]) -> list[Quantity]:
    """Return the coordinates of the cells, and their priorities."""
    dims = DIMENSIONS[sampling.kind]
    omega = sampling.omega
    ratio = sampling.ratio
    first, second = (f"priority of {name}" for name in names)
    over = "omega_2 / omega_1"
    if sampling.kind == GRID:
        columns = np.count_nonzero(omega[:, 1] == omega[0, 1])
        return [
            Quantity("omega_2", ("omega_2",), omega[::columns, 1], "1", second),
            Quantity("omega_1", ("omega_1",), omega[:columns, 0], "1", first),
            Quantity("ratio", dims, ratio.reshape(-1, columns), "1", over),
        ]
    number = Quantity("cell", dims, np.arange(len(omega)), "1", "number of the cell")
    return [
        *([] if sampling.kind == RATIOS else [number]),
        Quantity("ratio", dims, ratio, "1", over),
        Quantity("omega_1", dims, omega[:, 0], "1", first),
        Quantity("omega_2", dims, omega[:, 1], "1", second),
    ]
