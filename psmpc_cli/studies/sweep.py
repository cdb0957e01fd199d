"""Sweeps: runs over all values of any keys of a task, or over pairs of priorities. Paper section IV-B, Fig. 6."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from psmpc_cli.control.multistart import multistart_for
from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Quantity, Results
from psmpc_cli.logs.schema import SWEEP
from psmpc_cli.ocp.feasibility import load_feasible
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.measures import (
    WHOLE_RUN,
    PerCell,
    Row,
    measure_run,
    measure_second_stage,
    second_stage,
)
from psmpc_cli.studies.runner import CellOutcome, Study, Watch, changed, ignore, run_study
from psmpc_cli.studies.weights import DIMENSIONS, GRID, RATIOS, Sampling, origins

DEFAULT_TASK = "approach_capture"
"""The built-in task of Approach and Capture alone."""

WAITING, COMPUTED, SHARED, FAILED = range(4)
STATUS = ("waiting", "computed", "shared", "failed")
"""Codes of a cell's status and what they mean."""

LIGHT = ("log.shares=false", "log.plans=false", "log.ticks=false")
"""Changes of the task: what is logged but not measured, and costs solves or memory."""

MOST_RUNS = 100_000
"""Largest number of runs of a sweep; a larger one is a typing error."""


def sweep(
    task: Task | str | Path,
    values: Mapping[str, Sequence[Any]],
    path: Path | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    force: bool = False,
    resume: bool = False,
    watch: Watch = ignore,
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
        InputError: There are no values or too many, or as for `run_study`.
        SpecError: A value does not fit the task.
    """
    loaded = _light(task)
    shape = tuple(len(each) for each in values.values())
    if not shape or not 0 < np.prod(shape) <= MOST_RUNS:
        raise InputError(f"a sweep: found {np.prod(shape or 0)} runs, expected 1 to {MOST_RUNS}")
    changes = {key: [f"{key}={json.dumps(_plain(value))}" for value in each] for key, each in values.items()}
    for change in (change for each in changes.values() for change in each):
        changed(loaded, (change,))
    names = [Quantity(name, (name,), np.array(found), "1", name) for name, found in names_along(loaded).items()]
    axes = [Quantity(key, (key,), _axis(each), "1", f"value of {key}") for key, each in values.items()]
    cells = list(product(*changes.values()))
    study = Study(
        kind=SWEEP,
        task=loaded,
        cells=cells,
        shape=shape,
        coordinates=[*axes, *names],
        arrays=_arrays(WHOLE_RUN, tuple(values), shape, {name.name: len(name.values) for name in names}),
        measure=measure_run,
        entry=_entry,
        again=(FAILED,),
        identity={"keys": "; ".join(change for each in changes.values() for change in each)},
        attributes={},
        stop=None,
        origins=np.arange(len(cells)),
    )
    return run_study(study, path, jobs, dask, force, resume, watch)


def _light(task: Task | str | Path) -> Task:
    """Load a task that logs no more than is measured."""
    loaded = task if isinstance(task, Task) else load_feasible(task)
    return changed(loaded, LIGHT)


def names_along(task: Task) -> dict[str, list[str]]:
    """Return the entries of the further coordinates of a whole run's quantities, without empty ones."""
    names = {"stage": [each.name for each in task.spec.stages], "monitor": [each.name for each in task.spec.monitors]}
    return {name: found for name, found in names.items() if found}


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _axis(values: Sequence[Any]) -> np.ndarray:
    """Return the values of a key as a coordinate: numbers, or their text."""
    plain = [_plain(value) for value in values]
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in plain)
    return (
        np.array(plain, float)
        if numbers
        else np.array([each if isinstance(each, str) else json.dumps(each) for each in plain])
    )


def load_sweep_task(reference: str | Path | Task, changes: Sequence[str] = (), epsilons: Sequence[float] = ()) -> Task:
    """Load the task of a sweep over weights, with the thresholds of the actual start if there are any.

    Where the pending cost permits several basins and the task does not say from how many guesses a window is solved,
    it is solved from several.

    Raises:
        SpecError: The task does not hold.
    """
    wanted = [f"onset.series={list(epsilons)}"] if epsilons else []
    if isinstance(reference, Task):
        loaded = changed(reference, [*changes, *wanted, *LIGHT])
    else:
        loaded = load_feasible(reference, [*changes, *wanted, *LIGHT])
    return changed(loaded, [f"controller.multistart={multistart_for(loaded.spec.controller)}"])


def weight_study(task: Task, stages: tuple[int, int], sampling: Sampling, every_cell: bool = False) -> Study:
    """Build the sweep over pairs of priorities; each run ends with the second stage.

    Args:
        task: The task, from `load_sweep_task`.
        stages: Indices of the two stages in a row whose priorities vary.
        sampling: Their priorities in each cell.
        every_cell: Whether cells with equal ratios of all priorities are computed one by one, instead of sharing a run.
    """
    spec, omega, dims = task.spec, sampling.omega, DIMENSIONS[sampling.kind]
    keys = [f"stages[{stage}].priority" for stage in stages]
    cells = [tuple(f"{key}={float(each)!r}" for key, each in zip(keys, pair, strict=True)) for pair in omega]
    names = [stage.name for stage in spec.stages]
    units = "m/s^2, rad/s^2" if spec.onset.kind == "control" else "1"
    further = [
        Quantity("stage", ("stage",), np.array(names), "1", "stage"),
        Quantity("epsilon", ("epsilon",), np.array(spec.onset.series), units, "threshold of the actual start"),
    ]
    return Study(
        kind=SWEEP,
        task=task,
        cells=cells,
        shape=sampling.shape,
        coordinates=[*_weights(sampling, [names[stage] for stage in stages]), *further],
        arrays=_arrays(
            second_stage(stages[1]), dims, sampling.shape, {each.name: len(each.values) for each in further}
        ),
        measure=partial(measure_second_stage, stages[1]),
        entry=_entry,
        again=(FAILED,),
        identity={
            "stages": ",".join(str(stage + 1) for stage in stages),
            "sampling": sampling.label,
            "range": f"{omega.min():.6g} to {omega.max():.6g}",
            "every_cell": int(every_cell),
        },
        attributes={
            "first_stage": names[stages[0]],
            "second_stage": names[stages[1]],
            "horizon": spec.controller.horizon,
            "sample_time": spec.controller.sample_time,
            "nodes": spec.controller.nodes,
            "onset": spec.onset.kind,
        },
        stop=stages[1],
        origins=np.arange(len(cells)) if every_cell else origins(task, stages, omega),
    )


def _weights(sampling: Sampling, names: Sequence[str]) -> list[Quantity]:
    """Return the coordinates of the cells, and their priorities."""
    dims, omega, ratio = DIMENSIONS[sampling.kind], sampling.omega, sampling.ratio
    first, second, over = (*(f"priority of {name}" for name in names), "omega_2 / omega_1")
    if sampling.kind == GRID:
        cells = omega.reshape(*sampling.shape, 2)
        return [
            Quantity("omega_2", ("omega_2",), cells[:, 0, 1], "1", second),
            Quantity("omega_1", ("omega_1",), cells[0, :, 0], "1", first),
            Quantity("ratio", dims, ratio.reshape(sampling.shape), "1", over),
        ]
    number = Quantity("cell", dims, np.arange(len(omega)), "1", "number of the cell")
    return [
        *([] if sampling.kind == RATIOS else [number]),
        Quantity("ratio", dims, ratio, "1", over),
        Quantity("omega_1", dims, omega[:, 0], "1", first),
        Quantity("omega_2", dims, omega[:, 1], "1", second),
    ]


def _arrays(
    quantities: Sequence[PerCell], dims: tuple[str, ...], shape: tuple[int, ...], along: Mapping[str, int]
) -> list[Quantity]:
    """Return the status of the cells and everything that is measured, with nothing filled in."""
    return [
        Quantity("status", dims, np.full(shape, WAITING, "i4"), "1", "status of the cell", STATUS),
        Quantity("origin", dims, np.full(shape, -1, "i4"), "1", "flat index of the cell whose run it shares"),
        Quantity("reason", dims, np.full(shape, ""), "1", "why the cell failed"),
        Quantity(
            "cell_time", dims, np.full(shape, np.nan), "s", "wall time of the cell's run, with all that is around"
        ),
        *(each.unfilled(dims, shape, along) for each in quantities if not each.along or each.along in along),
    ]


def _entry(outcome: CellOutcome, cell: int, origin: int) -> Row:
    """Complete the row of a cell; the status is last: a cell that does not wait is complete."""
    return {
        **outcome.row,
        "cell_time": outcome.wall_time,
        "reason": outcome.failure,
        "origin": origin,
        "status": FAILED if outcome.failure else COMPUTED if cell == origin else SHARED,
    }
