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
from psmpc_cli.logs.schema import KEY_SWEEP, SWEEP, Column
from psmpc_cli.progress import Watch
from psmpc_cli.specs.arguments import rejected, require, require_callable, require_options
from psmpc_cli.specs.document import plain
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.measures import WHOLE_RUN, check_columns, over_weights, why_ended
from psmpc_cli.studies.runner import (
    CELL_COLUMNS,
    FAILED,
    REDUCED_LOG,
    REFERENCE,
    WAITING,
    Study,
    documents_of,
    names_along,
    of_reference,
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

ALLOWED_ERROR = 1.05
"""Largest end error of a recommended run [tolerances].

A stage that ends at its planned switch time is planned to end exactly at its tolerance. What the plant then deviates
from the plan comes on top: in the built-in tasks up to 0.03 with 12 nodes.
"""

EFFORT_DECIMALS = 3
"""Decimals of efforts, over that with the task's own priorities, to which two runs that end together are equal."""


def parse_stages(text: str, task: Task) -> tuple[int, int]:
    """Find the two stages whose priorities a study varies, from how the user names them, such as 1,2.

    Args:
        text: Two numbers of stages, counted from 1, or names of stages, with a comma between.
        task: The task.

    Returns:
        Indices of both stages, counted from 0.

    Raises:
        InputError: They are not two stages of the task that follow each other, or its controller has no priorities.
    """
    names = [stage.name for stage in task.spec.stages]
    if task.spec.controller.kind != "psmpc":
        raise InputError(f"found controller.kind {task.spec.controller.kind}, which has no priorities; expected psmpc")
    indices = [_stage_index(number_or_name.strip(), names) for number_or_name in text.split(",")]
    in_a_row = [[first, first + 1] for first in range(len(names) - 1)]
    if indices not in in_a_row:
        listed = ", ".join(f"{i + 1} {name}" for i, name in enumerate(names))
        raise InputError(f"--stages: found '{text}', expected two in a row such as 1,2 of the task's stages: {listed}")
    return indices[0], indices[1]


def _stage_index(number_or_name: str, names: Sequence[str]) -> int:
    """Return the index of a stage that is given by its name or its number, from 1; -1 if it is neither."""
    if number_or_name in names:
        return names.index(number_or_name)
    return int(number_or_name) - 1 if number_or_name.isdigit() else -1


def first_equal_runs(task: Task, stages: tuple[int, int], omega: Array) -> Array:
    """Return for each run the index of the first run with the same result, so that this is computed only once (runs,).

    To scale the priorities of all stages by one factor leaves the optimum unchanged. So runs are equal if their
    priorities over the largest one are equal.

    Args:
        task: The task, which gives the priorities of the other stages.
        stages: Indices of the two stages whose priorities vary.
        omega: Priorities of these two in each run (runs, 2).
    """
    priorities = np.tile([stage.priority for stage in task.spec.stages], (len(omega), 1))
    priorities[:, list(stages)] = omega
    # logarithms are rounded so that priorities which differ in their last digits count as equal
    log_ratios = np.round(np.log10(priorities / priorities.max(axis=1, keepdims=True)), RATIO_DECIMALS)
    _, first_runs, group_of_run = np.unique(log_ratios, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first_runs[group_of_run.ravel()])


def largest_end_errors(end_error: Array, final_error: Array) -> Array:
    """Return the largest error of any end condition at the end of its stage [tolerances]; NaN where there is none.

    Args:
        end_error: Errors of the stages but the last one (runs, stages).
        final_error: Errors of the last stage (runs,).
    """
    return np.asarray(np.fmax(np.fmax.reduce(end_error, axis=1), final_error))


class SweepCells:
    """The cells of a sweep over weights one after another, complete or not.

    Attributes:
        results: The content of its file.
        task: The task; in the cells the priorities of the studied stages are others.
        names: Names of the two studied stages.
        sampling: How the cells were chosen.
        omega: Their priorities in each cell (cells, 2).
        ratio: omega_2 / omega_1 of each cell (cells,).
        own_omega: Priorities of the two stages in the task itself (2,).
        own_ratio: omega_2 / omega_1 of the task itself.
        epsilons: Thresholds of the actual start (epsilons,).
        failed, waiting, ended: Which cells failed, have not been run, or ended the second stage (cells,).
        succeeded: In which cells the whole mission succeeded (cells,).
        mission_end: End of the mission (cells,) [s]; NaN where it was not completed.
        end_error: Largest error of any end condition at the end of its stage (cells,) [tolerances].
        with_own_run: Indices of the cells that ended or failed in a run of their own, which they do not share with an
            earlier cell (runs,).
        run_by_ratio: The same indices by rising ratio (runs,).
        ended_by_ratio: Those of them that ended the second stage, by rising ratio (ended runs,).
        first_switch: t_s, which ended the first studied stage (cells,) [s].
        earliest_start: t_s - T_h, before which the second stage is in no window (cells,) [s].

    Raises:
        LogError: The file is another one, or the task in it does not hold in this version.
    """

    def __init__(self, results: Results) -> None:
        """Read a sweep over the priorities of two stages from its results, and check that no array is missing.

        A cell of the sweep is one pair of priorities (omega_1, omega_2), with the run that has them.

        Args:
            results: The content of a results file; cells may still wait for their runs.

        Raises:
            LogError: The results are those of another study, or of an earlier version of this one.
        """
        try:
            self.sampling = SAMPLINGS[results.quantities["status"].dims]
            self.task = task_in(results)
            first, second = parse_stages(str(results.attributes["stages"]), self.task)
        except (KeyError, InputError) as error:
            raise LogError(f"{results.path}: expected a file of psmpc sweep-weights, but it lacks {error}") from None
        if f"{REFERENCE}status" not in results.quantities:
            raise LogError(
                f"{results.path}: found a sweep whose runs stop with the second stage, as earlier versions made it, "
                "expected whole missions: run the sweep again"
            )
        cell_dims = self.sampling.dims
        stage_names = [stage.name for stage in self.task.spec.stages]
        weight_columns = [Column(name, "1", name) for name in self.sampling.columns]
        # arrays of the cells, of the reference run with the task's own priorities, and coordinates
        columns = (*CELL_COLUMNS, *over_weights(second))
        check_columns(results, (*columns, *weight_columns), cell_dims)
        check_columns(results, of_reference(columns))
        scales = (*self.sampling.scales, "epsilon")
        check_columns(results, [Column(name, "1", name, dims=(name,)) for name in scales])
        check_columns(results, [Column("stage", "1", "stage", dtype="text", dims=("stage",))])
        if results["stage"].tolist() != stage_names:
            raise LogError(
                f"{results.path}: /stage: found {', '.join(results['stage'])}, expected {', '.join(stage_names)}"
            )

        self.results = results
        self.names = self.task.spec.stages[first].name, self.task.spec.stages[second].name
        self.omega = self.sampling.omega_in(results)
        self.ratio = results["ratio"].ravel()
        self.own_omega = np.array([self.task.spec.stages[stage].priority for stage in (first, second)])
        self.own_ratio = float(self.own_omega[1] / self.own_omega[0])
        self.epsilons = results["epsilon"]
        status = results["status"].ravel()
        self.failed = status == FAILED
        self.waiting = status == WAITING
        self.ended = ~(self.failed | self.waiting)
        self.succeeded = self.quantity("succeeded") == 1
        self.mission_end = self.quantity("switch_time")[:, -1]
        self.end_error = largest_end_errors(self.quantity("end_error"), self.quantity("final_error"))
        # a cell whose priorities are in the same ratios as those of an earlier one shares its run (`origin`)
        self.with_own_run = np.flatnonzero(~self.waiting & (self.quantity("origin") == np.arange(len(self.ratio))))
        by_rising_ratio = np.argsort(np.round(np.log10(self.ratio[self.with_own_run]), RATIO_DECIMALS), kind="stable")
        self.run_by_ratio = self.with_own_run[by_rising_ratio]
        self.ended_by_ratio = self.run_by_ratio[self.ended[self.run_by_ratio]]
        # the second stage enters a window at most a horizon before the first one ends
        self.first_switch = self.quantity("switch_time")[:, first]
        self.earliest_start = self.first_switch - self.task.spec.controller.horizon

    def quantity(self, name: str) -> Array:
        """Return a quantity of the cells (cells, ...)."""
        values = self.results[name]
        return values.reshape(-1, *values.shape[self.results["status"].ndim :])

    def why(self, cell: int) -> str:
        """Say why a cell or its mission failed; empty where it succeeded or has not been run."""
        if self.waiting[cell] or self.succeeded[cell]:
            return ""
        margins = self.quantity("monitor_margin")[cell] if "monitor_margin" in self.results.quantities else ()
        names = self.results["monitor"].tolist() if len(margins) else ()
        return why_ended(str(self.quantity("reason")[cell]), names, margins)

    def reference(self, name: str) -> Array:
        """Return a quantity of the run with the task's own priorities (...)."""
        return self.results[REFERENCE + name]

    def count(self, name: str) -> int:
        """Sum up a number over the runs; a run that several cells share counts once."""
        own = self.quantity("origin") == np.arange(len(self.ratio))
        return int(np.maximum(self.quantity(name)[own], 0).sum())

    @property
    def shown_threshold(self) -> int:
        """Index of the threshold to show where only one is shown: the task's own, the largest if that is missing."""
        own = np.flatnonzero(np.isclose(self.epsilons, self.task.spec.onset.epsilon))
        return int(own[0]) if len(own) else int(np.argmax(self.epsilons))


class QuantityByRatio:
    """A quantity of the cells of a sweep over the ratio of priorities omega_2 / omega_1.

    Cells of one ratio differ by no more than the solver's tolerance, unless other stages are in the window as well.

    Attributes:
        ratio: The ratios of the cells that ended the second stage, each once and rising (ratios,).
        middle, lowest, highest: Median, smallest and largest value of the cells with each ratio (ratios,).
    """

    def __init__(self, cells: SweepCells, values: Array) -> None:
        """Group the values (cells,) of a quantity by the ratio of the cells, without cells that have not ended."""
        ratio = cells.ratio[cells.ended]
        kept = values[cells.ended]
        _, first, inverse = np.unique(np.round(np.log10(ratio), RATIO_DECIMALS), return_index=True, return_inverse=True)
        groups = [kept[inverse == k] for k in range(len(first))]
        self.ratio = ratio[first]
        self.middle, self.lowest, self.highest = (
            np.array([of(group) for group in groups]) for of in (np.median, np.min, np.max)
        )


class Recommendation(NamedTuple):
    """The recommended omega_2 / omega_1, if any.

    Attributes:
        ratio: The ratio.
        headline: What is recommended, or that nothing is.
        reason: What speaks for it, or why there is none.
        omega: The two priorities of the recommended run.
    """

    ratio: float | None
    headline: str
    reason: str
    omega: tuple[float, float] | None = None

    @property
    def sentence(self) -> str:
        """What is recommended, and what speaks for it."""
        return f"{self.headline}: {self.reason}"


def recommend(cells: SweepCells) -> Recommendation:
    """Recommend the pair of priorities whose mission ends first at no more cost than with the task's own priorities.

    The run with the task's own priorities is the reference. A run is eligible if its whole mission succeeds, its
    control effort and its peak force on the base are no larger than those of the reference, and every stage ends within
    `ALLOWED_ERROR`. Of the eligible runs, the reference among them, the one is recommended whose mission ends first,
    and of several that end at one sample the one with the least control effort.

    If the mission of the reference fails, nothing is recommended: what an abandoned mission has cost is no measure for
    a whole one.

    Returns:
        The recommended ratio and priorities with the reason as text; or None for both, and why there are none.
    """
    if cells.reference("status") == WAITING:
        return Recommendation(None, NO_RECOMMENDATION, "the task's own priorities have not been run yet")
    other_cells = cells.with_own_run[cells.with_own_run != cells.reference("origin")]

    def of_reference_and_others(name: str) -> Array:
        """Return a quantity of the reference, then of the other runs (1 + others, ...)."""
        return np.concatenate([cells.reference(name)[None], cells.quantity(name)[other_cells]])

    succeeded = of_reference_and_others("succeeded") == 1
    end = of_reference_and_others("switch_time")[:, -1]
    effort = of_reference_and_others("control_effort")
    force = of_reference_and_others("peak_base_force")
    error = largest_end_errors(of_reference_and_others("end_error"), of_reference_and_others("final_error"))
    ratio = np.append(cells.own_ratio, cells.ratio[other_cells])
    # index 0 is the reference, the run with the task's own priorities
    if not succeeded[0]:
        return Recommendation(
            None, NO_RECOMMENDATION, _why_without_reference(cells, ratio[succeeded], end[succeeded], len(other_cells))
        )
    runs_with_fault = {
        "failed": ~succeeded,
        "took more control effort": succeeded & (effort > effort[0]),
        "had a larger peak force on the base": succeeded & (force > force[0]),
        f"ended a stage at more than {ALLOWED_ERROR:g} tolerances": succeeded & (error > ALLOWED_ERROR),
    }
    eligible = ~np.any(list(runs_with_fault.values()), axis=0)
    # the earliest end first, infinite for those that are not eligible; then the least effort
    best = int(np.lexsort((np.round(effort / effort[0], EFFORT_DECIMALS), np.where(eligible, end, np.inf)))[0])
    so_far = " so far" if cells.waiting.any() else ""
    # texts for the user
    of_best = _describe_outcome(end[best], effort[best], force[best], error[best])
    of_own = _describe_outcome(end[0], effort[0], force[0], error[0])
    counts = ", ".join(
        f"{np.sum(has_fault)} {fault}" for fault, has_fault in runs_with_fault.items() if has_fault.any()
    )
    if not eligible[best]:
        reason = f"of {len(end)} runs {counts}; with the task's own priorities the mission {of_own}"
        return Recommendation(None, f"{NO_RECOMMENDATION}{so_far}", reason)
    if best == 0:
        headline = f"recommended omega_2/omega_1{so_far}: {ratio[0]:.4g}, the task's own"
        why = f"; of the {len(other_cells)} other runs {counts}" if counts else ""
        reason = f"the mission {of_own}, and no other run is faster at no more effort and force{why}"
        return Recommendation(float(ratio[0]), headline, reason, _pair(cells.own_omega))
    omegas = [cells.omega[other_cells[best - 1]], cells.own_omega]  # index 0 of the runs is the reference
    pairs = [f"{omega[1] / omega[0]:.4g} (omega_1 = {omega[0]:.4g}, omega_2 = {omega[1]:.4g})" for omega in omegas]
    return Recommendation(
        float(ratio[best]),
        f"recommended omega_2/omega_1{so_far}: {pairs[0]}, the fastest mission at no more effort and force than with "
        f"the task's own {pairs[1]}",
        f"it {of_best}; with the task's own it {of_own}",
        _pair(omegas[0]),
    )


NO_RECOMMENDATION = "no ratio is recommended"
"""What is said where nothing is recommended."""


def _pair(omega: Array) -> tuple[float, float]:
    return float(omega[0]), float(omega[1])


def _describe_outcome(end: float, effort: float, force: float, error: float) -> str:
    """Write the end of a mission [s], its control effort, its peak force on the base [N] and its end error, if any."""
    ends = f" and end errors up to {error:.2f} of the tolerance" if np.isfinite(error) else ""
    return f"ends at {end:.2f} s with control effort {effort:.4g}, peak force on the base {force:.4g} N{ends}"


def _why_without_reference(cells: SweepCells, ratios: Array, ends: Array, others: int) -> str:
    """Say why no ratio omega_2 / omega_1 is recommended if the mission fails with the task's own priorities.

    A recommended run must need no more effort and force than the reference, the run with the task's own priorities. A
    failed reference sets no such bound.

    Args:
        cells: The runs of the sweep, each with its ratio.
        ratios: Ratios of the other runs that succeed (succeeded,).
        ends: Ends of their missions (succeeded,) [s].
        others: Number of the other runs made so far, succeeded or not.

    Returns:
        A sentence with the reason of the failure and, of the other runs that succeed, their number and the fastest.
    """
    completed_all_stages = cells.reference("completed") == 1
    # on record is why the run ended; if it ended with its last stage, this does not say why the mission failed
    broken = "a monitor broke, or the object was not delivered"
    reason = broken if completed_all_stages else str(cells.reference("reason"))
    fastest = f", the fastest that of ratio {ratios[np.argmin(ends)]:.4g}, at {ends.min():.2f} s" if len(ends) else ""
    return (
        f"the mission fails with the task's own priorities ({reason}), so that there is no "
        f"whole mission whose effort and force bound those of others; {len(ends)} of {others} others succeed{fastest}"
    )


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
    """Run a task with every combination of values of some of its keys, and measure each run.

    Args:
        task: The task, its file or the name of a built-in one.
        values: The values of each key, such as {"stages.capture.priority": [1, 10, 100]}.
        path: File of the results; None for results in memory alone.
        jobs: Number of processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to compute on instead.
        force: Whether an existing file is overwritten.
        resume: Whether to go on with the sweep in an existing file: its runs that were not made or failed are made.
        watch: Called with the progress at the beginning and after every run.

    Returns:
        What was measured of the runs, as arrays with one dimension for each key, named as the key.

    Raises:
        InputError: An argument is of another type, there are no values or too many, or as for `run_study`.
        SpecError: A value does not fit the task.
    """
    wanted = 'a mapping of keys to lists of values, such as {"stages.capture.priority": [1, 10]}'
    require("values", values, Mapping, wanted)
    for key, values_of_key in values.items():
        is_list = isinstance(values_of_key, Sequence | np.ndarray) and not isinstance(values_of_key, str)
        if not (isinstance(key, str) and is_list):
            raise rejected("values", {key: values_of_key}, wanted)
    require_callable("watch", watch, "the progress")
    path = require_options(path, jobs, force, resume, dask)
    loaded = with_changes(task, REDUCED_LOG)
    runs = int(np.prod([len(values_of_key) for values_of_key in values.values()])) if values else 0
    if not 0 < runs <= MOST_CELLS:
        raise InputError(f"a sweep: found {runs} runs, expected 1 to {MOST_CELLS}")
    changes = {key: [f"{key}={_json_text(value)}" for value in values_of_key] for key, values_of_key in values.items()}
    all_changes = [change for values_of_key in changes.values() for change in values_of_key]
    documents = documents_of(loaded)
    for change in all_changes:
        documents.changed((change,))  # raises before any run if the task cannot have the value
    axes = [
        Quantity(key, (key,), _key_coordinate(values_of_key), "1", f"value of {key}")
        for key, values_of_key in values.items()
    ]
    study = Study(
        kind=KEY_SWEEP,
        task=loaded,
        cells=list(product(*changes.values())),
        dims=tuple(values),
        coordinates=[*axes, *names_along(loaded)],
        quantities=WHOLE_RUN,
        identity={"keys": "; ".join(all_changes)},
    )
    return run_study(study, path, jobs, dask, force, resume, watch)


def _json_text(value: Any) -> str:
    """Write the value of a key as JSON, which is valid in a YAML file."""
    return json.dumps(plain(value))


def _key_coordinate(values: Sequence[Any]) -> np.ndarray:
    """Return the values of a key as a coordinate: numbers, or their text."""
    if all(isinstance(value, int | float | np.number) and not isinstance(value, bool) for value in values):
        return np.array(values, float)
    return np.array([each if isinstance(each, str) else _json_text(each) for each in values])


def load_sweep_task(reference: str | Path | Task, changes: Sequence[str] = (), epsilons: Sequence[float] = ()) -> Task:
    """Load the task of a sweep over weights, with the thresholds of the actual start if there are any.

    Where the pending cost permits several basins and the task does not say from how many guesses a window is solved,
    it is solved from several.

    Raises:
        SpecError: The task does not hold.
    """
    wanted = [f"onset.series={list(epsilons)}"] if epsilons else []
    loaded = with_changes(reference, [*changes, *wanted, *REDUCED_LOG])
    return documents_of(loaded).changed([f"controller.multistart={multistart_for(loaded.spec.controller)}"])


def weight_study(task: Task, stages: tuple[int, int], sampling: Sampling, every_cell: bool = False) -> Study:
    """Describe the sweep over pairs of priorities of two stages; `run_study` then computes it.

    There is a run for each pair, and a reference run with the task's own priorities to compare the others with.

    Args:
        task: The task, from `load_sweep_task`.
        stages: Indices of the two stages, one after the other, whose priorities vary.
        sampling: The pairs of priorities, one for each cell of the study.
        every_cell: Whether each cell has a run of its own; otherwise cells share one if the priorities of all stages
            are in the same ratios, for which the results are equal.
    """
    spec = task.spec
    omega = sampling.omega
    own_priorities = [spec.stages[stage].priority for stage in stages]
    keys = [f"stages[{stage}].priority" for stage in stages]
    stage_names = [stage.name for stage in spec.stages]
    thresholds = np.array(spec.onset.series)
    units = THRESHOLD_UNITS[spec.onset.kind]
    epsilon = Quantity("epsilon", ("epsilon",), thresholds, units, "threshold of the actual start")
    return Study(
        kind=SWEEP,
        task=task,
        cells=[tuple(f"{key}={float(priority)!r}" for key, priority in zip(keys, pair, strict=True)) for pair in omega],
        dims=sampling.dims,
        coordinates=[*sampling.coordinates([stage_names[stage] for stage in stages]), *names_along(task), epsilon],
        quantities=over_weights(stages[1]),
        identity={
            "stages": ",".join(str(stage + 1) for stage in stages),
            "sampling": sampling.label,
            "range": f"{omega.min():.6g} to {omega.max():.6g}",
            "every_cell": int(every_cell),
        },
        required_stage=stages[1],
        reference=True,
        first_equal_runs=None if every_cell else first_equal_runs(task, stages, np.vstack([omega, own_priorities])),
    )
