"""Sweeps: runs over all values of any keys of a task, or over pairs of priorities. Paper section IV-B, Fig. 6."""

import json
from collections.abc import Mapping, Sequence
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
    CELL_COLUMNS,
    FAILED,
    REDUCED_LOG,
    WAITING,
    Study,
    Watch,
    documents_of,
    names_along,
    run_study,
    task_in,
    with_changes,
)
from psmpc_cli.studies.sampling import MOST_CELLS, SAMPLINGS, Sampling

Array = np.ndarray

THRESHOLD_UNITS = {"control": "m/s^2, rad/s^2", "closeness": "1"}
"""Units of the thresholds of the actual start, by what the task's `onset` compares with them."""

RATIO_DECIMALS = 9
"""Decimals of the logarithm of a ratio of priorities to which two are equal."""

COMPLETION_TOLERANCE = 0.05
"""Part of the earliest completion by which a recommended ratio may complete later."""

ALLOWED_ERROR = 1.0
"""Final error that the end condition itself allows [tolerances]."""


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
    relative = np.round(np.log10(priorities / priorities.max(axis=1, keepdims=True)), RATIO_DECIMALS)
    _, first, inverse = np.unique(relative, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()])


class SweepCells:
    """The cells of a sweep over weights one after another, complete or not.

    Attributes:
        results: The content of its file.
        task: The task; in the cells the priorities of the studied stages are others.
        names: Names of the two studied stages.
        sampling: How the cells were chosen.
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
        try:
            self.sampling = SAMPLINGS[results.quantities["status"].dims]
            self.task = task_in(results)
            first, second = parse_stages(str(results.attributes["stages"]), self.task)
        except (KeyError, InputError) as error:
            raise LogError(f"{results.path}: expected a file of psmpc sweep-weights, but it lacks {error}") from None
        dims = self.sampling.dims
        names = [stage.name for stage in self.task.spec.stages]
        weights = [Column(name, "1", name) for name in self.sampling.columns]
        check_columns(results, (*CELL_COLUMNS, *second_stage(second), *weights), dims)
        scales = (*self.sampling.scales, "epsilon")
        check_columns(results, [Column(name, "1", name, dims=(name,)) for name in scales])
        check_columns(results, [Column("stage", "1", "stage", dtype="text", dims=("stage",))])
        if results["stage"].tolist() != names:
            raise LogError(f"{results.path}: /stage: found {', '.join(results['stage'])}, expected {', '.join(names)}")
        self.results = results
        self.names = self.task.spec.stages[first].name, self.task.spec.stages[second].name
        self.omega = self.sampling.omega_in(results)
        self.ratio = results["ratio"].ravel()
        self.own_ratio = float(self.task.spec.stages[second].priority / self.task.spec.stages[first].priority)
        self.epsilons = results["epsilon"]
        status = results["status"].ravel()
        self.failed = status == FAILED
        self.waiting = status == WAITING
        self.ended = ~(self.failed | self.waiting)
        own = np.flatnonzero(self.ended & (self.of("origin") == np.arange(len(self.ratio))))
        self.runs = own[np.argsort(np.round(np.log10(self.ratio[own]), RATIO_DECIMALS), kind="stable")]
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
        _, first, inverse = np.unique(np.round(np.log10(ratio), RATIO_DECIMALS), return_index=True, return_inverse=True)
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
    early = completion.highest <= (1 + COMPLETION_TOLERANCE) * earliest
    failing = np.isclose(completion.ratio[:, None], cells.ratio[cells.failed], rtol=1e-8).any(axis=1)
    raised = error.highest > max(ALLOWED_ERROR, np.nan_to_num(error.highest[0]))
    good = early & ~raised & ~failing
    tolerated = f"within {COMPLETION_TOLERANCE:.0%} of the earliest"
    if good.any():
        best = int(np.argmax(good))
        ratio = float(completion.ratio[best])
        final = error.highest[best]
        allowed = "" if np.isnan(final) else f", and its final error is {final:.2f} of the tolerance"
        return Recommendation(
            ratio,
            f"recommended omega_2/omega_1{' so far' if cells.waiting.any() else ''}: {ratio:.4g}, the smallest that "
            f"completes {tolerated}: at {completion.highest[best]:.2f} s, earliest "
            f"{earliest:.2f} s{allowed}; control effort {effort.middle[best]:.2f}, of {effort.lowest.min():.2f} to "
            f"{effort.highest.max():.2f} over all ratios",
        )
    kept = f"of the {early.sum()} ratios that complete {tolerated} completion, {earliest:.2f} s,"
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
    loaded = with_changes(task, REDUCED_LOG)
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
    loaded = with_changes(reference, [*changes, *wanted, *REDUCED_LOG])
    return with_changes(loaded, [f"controller.multistart={multistart_for(loaded.spec.controller)}"])


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
    thresholds = np.array(spec.onset.series)
    units = THRESHOLD_UNITS[spec.onset.kind]
    epsilon = Quantity("epsilon", ("epsilon",), thresholds, units, "threshold of the actual start")
    stage_names = Quantity("stage", ("stage",), np.array(names), "1", "stage")
    return Study(
        kind=SWEEP,
        task=task,
        cells=[tuple(f"{key}={float(each)!r}" for key, each in zip(keys, pair, strict=True)) for pair in omega],
        dims=sampling.dims,
        coordinates=[*sampling.coordinates([names[stage] for stage in stages]), stage_names, epsilon],
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
