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
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.measures import WHOLE_RUN, measure_run, measure_second_stage, second_stage
from psmpc_cli.studies.runner import LIGHT, Study, Watch, changed, ignore, names_along, run_study
from psmpc_cli.studies.weights import DIMENSIONS, GRID, MOST_CELLS, RATIOS, Sampling, origins

DEFAULT_TASK = "approach_capture"
"""The built-in task of Approach and Capture alone."""


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
    loaded = changed(task, LIGHT)
    runs = int(np.prod([len(each) for each in values.values()])) if values else 0
    if not 0 < runs <= MOST_CELLS:
        raise InputError(f"a sweep: found {runs} runs, expected 1 to {MOST_CELLS}")
    changes = {key: [f"{key}={json.dumps(_plain(value))}" for value in each] for key, each in values.items()}
    for change in (change for each in changes.values() for change in each):
        changed(loaded, (change,))
    axes = [Quantity(key, (key,), _axis(each), "1", f"value of {key}") for key, each in values.items()]
    study = Study(
        kind=SWEEP,
        task=loaded,
        cells=list(product(*changes.values())),
        dims=tuple(values),
        coordinates=[*axes, *names_along(loaded)],
        quantities=WHOLE_RUN,
        measure=measure_run,
        identity={"keys": "; ".join(change for each in changes.values() for change in each)},
    )
    return run_study(study, path, jobs, dask, force, resume, watch)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _axis(values: Sequence[Any]) -> np.ndarray:
    """Return the values of a key as a coordinate: numbers, or their text."""
    plain = [_plain(value) for value in values]
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in plain):
        return np.array(plain, float)
    return np.array([each if isinstance(each, str) else json.dumps(each) for each in plain])


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
    spec, omega = task.spec, sampling.omega
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
        measure=partial(measure_second_stage, stages[1]),
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
    dims, omega, ratio = DIMENSIONS[sampling.kind], sampling.omega, sampling.ratio
    first, second, over = (*(f"priority of {name}" for name in names), "omega_2 / omega_1")
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
