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
    """Find the two stages in a row that a user names by numbers or names, such as 1,2; their priorities are varied.

    Args:
        text: Numbers, from 1, or names between a comma.
        task: The task.

    Returns:
        Indices of both stages, from 0.

    Raises:
        InputError: They are not two stages in a row of the task, or its controller has no priorities.
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


def origins(task: Task, stages: tuple[int, int], omega: Array) -> Array:
    """Return for each run the index of the first one that has the same result, so as to compute it once (runs,).

    Scaling all priorities omega leaves the optimum unchanged, so runs are equal if all priorities over the largest one
    are.

    Args:
        task: The task.
        stages: Indices of the two stages whose priorities vary.
        omega: Their priorities in each run (runs, 2).
    """
    priorities = np.tile([stage.priority for stage in task.spec.stages], (len(omega), 1))
    priorities[:, list(stages)] = omega
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
        with_own_run: The cells that ended or failed in a run of their own: none is computed twice (with_own_run,).
        run_by_ratio: The same from the smallest ratio to the largest (with_own_run,).
        ended_by_ratio: Those of them that ended (runs,).
        first_switch: t_s, which ended the first studied stage (cells,) [s].
        earliest_start: t_s - T_h, before which the second stage is in no window (cells,) [s].

    Raises:
        LogError: The file is another one, or the task in it does not hold in this version.
    """

    def __init__(self, results: Results) -> None:
        """Read a sweep over the weights of two stages from its results, and check that they are complete.

        Args:
            results: The content of the file; cells may still wait for their runs.

        Raises:
            LogError: They are those of another study, or of an earlier version.
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
    """Recommend the priorities whose mission ends first at no more cost than with the task's own priorities.

    A run is eligible if its whole mission succeeds, its control effort and its peak force on the base are no larger
    than with the task's own priorities, and every stage ends within `ALLOWED_ERROR`. The recommended run is the
    eligible one whose mission ends first, and of several that end at one sample the one with the least control effort.
    The run with the task's own priorities is one of them, so that it is recommended where no other one is better.

    Where that run fails nothing is recommended: what an abandoned mission has cost is no measure for a whole one.
    """
    if cells.reference("status") == WAITING:
        return Recommendation(None, NONE, "the task's own priorities have not been run yet")
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
            None, NONE, _why_without_reference(cells, ratio[succeeded], end[succeeded], len(other_cells))
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
    of_best = _outcome(end[best], effort[best], force[best], error[best])
    of_own = _outcome(end[0], effort[0], force[0], error[0])
    counts = ", ".join(
        f"{np.sum(has_fault)} {fault}" for fault, has_fault in runs_with_fault.items() if has_fault.any()
    )
    if not eligible[best]:
        reason = f"of {len(end)} runs {counts}; with the task's own priorities the mission {of_own}"
        return Recommendation(None, f"{NONE}{so_far}", reason)
    if best == 0:
        headline = f"recommended omega_2/omega_1{so_far}: {ratio[0]:.4g}, the task's own"
        why = f"; of the {len(other_cells)} other runs {counts}" if counts else ""
        reason = f"the mission {of_own}, and no other run is faster at no more effort and force{why}"
        return Recommendation(float(ratio[0]), headline, reason, _pair(cells.own_omega))
    omegas = [cells.omega[other_cells[best - 1]], cells.own_omega]
    pairs = [f"{omega[1] / omega[0]:.4g} (omega_1 = {omega[0]:.4g}, omega_2 = {omega[1]:.4g})" for omega in omegas]
    return Recommendation(
        float(ratio[best]),
        f"recommended omega_2/omega_1{so_far}: {pairs[0]}, the fastest mission at no more effort and force than with "
        f"the task's own {pairs[1]}",
        f"it {of_best}; with the task's own it {of_own}",
        _pair(omegas[0]),
    )


NONE = "no ratio is recommended"
"""What is said where nothing is recommended."""


def _pair(omega: Array) -> tuple[float, float]:
    return float(omega[0]), float(omega[1])


def _outcome(end: float, effort: float, force: float, error: float) -> str:
    """Write the end of a mission [s], its control effort, its peak force on the base [N] and its end error, if any."""
    ends = f" and end errors up to {error:.2f} of the tolerance" if np.isfinite(error) else ""
    return f"ends at {end:.2f} s with control effort {effort:.4g}, peak force on the base {force:.4g} N{ends}"


def _why_without_reference(cells: SweepCells, ratios: Array, ends: Array, others: int) -> str:
    """Say why no ratio omega_2 / omega_1 is recommended where the mission fails with the task's own priorities.

    A recommended run must need no more effort and force than the reference, the run with the task's own priorities. A
    failed reference sets no such bound. The reason given is the recorded one or, where all stages ended, that a monitor
    broke or the object was not delivered.

    Args:
        cells: The runs of the sweep, each with its ratio.
        ratios: Ratios of the other runs that succeed (succeeded,).
        ends: Ends of their missions (succeeded,) [s].
        others: Number of the other runs made so far, succeeded or not.
    """
    completed_all_stages = cells.reference("completed") == 1
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
    changes = {key: [f"{key}={_text(value)}" for value in values_of_key] for key, values_of_key in values.items()}
    all_changes = [change for values_of_key in changes.values() for change in values_of_key]
    documents = documents_of(loaded)
    for change in all_changes:
        documents.changed((change,))
    axes = [
        Quantity(key, (key,), _axis(values_of_key), "1", f"value of {key}") for key, values_of_key in values.items()
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
    return documents_of(loaded).changed([f"controller.multistart={multistart_for(loaded.spec.controller)}"])


def weight_study(task: Task, stages: tuple[int, int], sampling: Sampling, every_cell: bool = False) -> Study:
    """Build the sweep over pairs of priorities of two stages, with the task's own pair as a reference to compare with.

    Args:
        task: The task, from `load_sweep_task`.
        stages: Indices of the two stages in a row whose priorities vary.
        sampling: Their priorities in each cell.
        every_cell: Whether cells with equal ratios of all priorities are computed one by one, instead of sharing a run.
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
        origins=None if every_cell else origins(task, stages, np.vstack([omega, own_priorities])),
    )
