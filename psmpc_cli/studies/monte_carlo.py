"""Monte Carlo studies: a task many times, each with other random numbers for its uncertainty; rates and spreads."""

import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Quantity, Results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.schema import MONTE_CARLO, PEAKS, SLIDING_PEAKS, Column, Sample
from psmpc_cli.logs.summary import EXCEEDED
from psmpc_cli.progress import Watch
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.arguments import require_callable, require_options, require_whole
from psmpc_cli.specs.document import printable
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.measures import WHOLE_RUN, check_columns, why_ended
from psmpc_cli.studies.runner import (
    CELL_COLUMNS,
    FAILED,
    REDUCED_LOG,
    WAITING,
    Study,
    names_along,
    run_study,
    task_in,
    with_changes,
)
from psmpc_cli.studies.sampling import MOST_CELLS

Array = np.ndarray

STATUS = ("waiting", "ended", "shared", "crashed")
"""What the codes of a run's status mean; no run is shared."""

COORDINATES = (
    Column("run", "1", "number of the run", dtype="i8", dims=("run",)),
    Column("seed", "1", "seed of the run", dtype="i8", dims=("run",)),
    Column("stage", "1", "stage", dtype="text", dims=("stage",)),
    Column("monitor", "1", "monitor", dtype="text", dims=("monitor",)),
    Column("monitor_unit", "1", "unit of its margin", dtype="text", dims=("monitor",)),
)
"""What runs along the dimensions of the results."""

SHARES_OF_FORCES = {
    "force_utilization": "largest commanded force [% of its limit]",
    "force_saturated": "forces cut at their limits [% of the time]",
}
"""What tables say of forces where they have limits; studies of earlier versions do not know it."""


def monte_carlo(
    task: Task | str | Path,
    runs: int,
    path: Path | str | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    force: bool = False,
    resume: bool = False,
    watch: Watch = lambda progress: None,
) -> "MonteCarloRuns":
    """Run a task many times, each with a seed of its own: the task's plus the number of the run.

    Args:
        task: The task, its file or the name of a built-in one. Something below its key `uncertainty` is random.
        runs: How many runs; a resumed study may have more than before.
        path: File of the results; None for none that stays.
        jobs: Processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to compute on.
        force: Whether an existing file is overwritten.
        resume: Whether the cells that wait in an existing file are computed; those that failed are computed again.
        watch: Called with the progress at the beginning and after every run.

    Returns:
        The runs, with what was measured of each.

    Raises:
        InputError: An argument is of another type, nothing of the task is random, its seed is too large for others to
            follow, or as for `run_study`.
        SpecError: The task is not valid.
    """
    require_whole("runs", runs, least=1, most=MOST_CELLS)
    require_callable("watch", watch, "the progress")
    path = require_options(path, jobs, force, resume, dask)
    study = monte_carlo_study(task, runs)
    return MonteCarloRuns(run_study(study, path, jobs, dask, force, resume, watch))


def monte_carlo_study(reference: Task | str | Path, runs: int, changes: tuple[str, ...] = ()) -> Study:
    """Describe the study that runs a task many times with other random numbers; `run_study` then computes it.

    The runs differ in their seeds alone: those of the task's own and the numbers that follow it.

    Args:
        reference: The task, its file or the name of a built-in one.
        runs: Number of runs.
        changes: Keys to change in the task, each `path=value`.

    Raises:
        InputError: Nothing of the task is random, or its seed is too large for others to follow.
        SpecError: The task is not valid.
    """
    task = with_changes(reference, (*changes, *REDUCED_LOG))
    task_name = reference.spec.name if isinstance(reference, Task) else str(reference)
    spec = task.spec
    if not spec.uncertainty.is_random:
        raise InputError(
            f"{task_name}: found nothing random below uncertainty, all runs would be equal; expected a range of mass, "
            "inertia or centre_of_mass, or noise, such as --set uncertainty.mass=0.1"
        )
    # of the command that repeats a run, which results name
    options = [word for change in changes for word in ("--set", change)]
    seeds = spec.seed + np.arange(runs)
    return Study(
        kind=MONTE_CARLO,
        task=task,
        cells=[(f"seed={seed}",) for seed in seeds],
        dims=("run",),
        coordinates=[
            Quantity("run", ("run",), np.arange(runs), "1", "number of the run"),
            *names_along(task),
            Quantity("seed", ("run",), seeds, "1", "seed of the run"),
        ],
        quantities=WHOLE_RUN,
        statuses=STATUS,
        attributes={"command": printable(shlex.join(["psmpc", "simulate", task_name, *options]))},
    )


def wilson_interval(count: int, runs: int) -> tuple[float, float]:
    """Return Wilson's 95 % score interval of a fraction of runs; 0 and 1 without runs. Wilson (1927)."""
    from scipy.stats import binomtest

    interval = binomtest(count, runs).proportion_ci(method="wilson") if runs else (0.0, 1.0)
    return float(interval[0]), float(interval[1])


class MonteCarloRuns:
    """The runs of a study, complete or not: how often they succeed, how they spread, which are the worst.

    Attributes:
        results: The content of its file.
        made: Which runs were made, those that crashed among them (runs,).
        succeeded, failed: Which of these succeeded, and which did not; neither where it is not judged (runs,).
        stages: Their names.
        monitors: Units of their margins by name.
        end_time: End of the mission (runs,) [s]; NaN where it did not succeed.

    Raises:
        LogError: The results are not those of such a study.
    """

    def __init__(self, results: Results) -> None:
        check_columns(results, COORDINATES)
        check_columns(results, (*CELL_COLUMNS, *WHOLE_RUN), ("run",))
        self.results = results
        self.made = self["status"] != WAITING
        self.succeeded = self["succeeded"] == 1
        not_judged = (self["succeeded"] == -1) & (self["status"] != FAILED)
        self.failed = self.made & ~self.succeeded & ~not_judged
        self.stages: list[str] = self["stage"].tolist()
        self.monitors: dict[str, str] = {}
        if "monitor" in results.quantities:
            self.monitors = dict(zip(self["monitor"].tolist(), self["monitor_unit"].tolist(), strict=True))
        self.end_time = np.where(self.succeeded, self["end_time"], np.nan)

    def __repr__(self) -> str:
        of_made = f"{np.count_nonzero(self.made)} made, {np.count_nonzero(self.succeeded)} succeeded"
        return f"<MonteCarloRuns: {len(self.made)} runs, {of_made}>"

    def __getitem__(self, name: str) -> Array:
        return self.results[name]

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % score interval of the success rate; 0 and 1 without runs."""
        return wilson_interval(int(self.succeeded.sum()), int(self.made.sum()))

    def exceeded(self, kind: Literal["position", "velocity"]) -> Array:
        """Return by what part of the limit each run exceeded one (runs,); 0 where it did not."""
        excess = np.nan_to_num(-self[f"relative_{kind}_margin"])
        return np.where(excess > EXCEEDED, excess, 0.0)

    @property
    def keeps_clear(self) -> Array:
        """Which runs know the distances of parts that keep clear (runs,); none of a study without such parts."""
        touched = self.results.quantities.get("touched")
        return np.zeros(len(self.made), bool) if touched is None else np.isfinite(touched.values)

    @property
    def is_without_limits(self) -> bool:
        """Whether the task is known to have no limit of forces and accelerations."""
        limits = self.results.quantities.get("limits_dynamics")
        return limits is not None and bool((limits.values == 0).any())

    def spread(self) -> Iterator[tuple[str, Array]]:
        """Yield the quantities whose distribution over the runs a table or a report shows.

        Quantities that the study cannot have are left out, such as distances where no parts keep clear.

        Yields:
            Pairs of a label with its unit, and the values of all runs that have one (at most one for each run).
        """
        by_label = {"mission ends, successful runs [s]": self.end_time}
        # the first stage starts and the last one ends with the mission
        for number, stage in enumerate(self.stages):
            if number:
                by_label[f"{stage} starts [s]"] = self["actual_start"][:, number]
            if number < len(self.stages) - 1:
                by_label[f"{stage} ends [s]"] = self["switch_time"][:, number]
        by_label["final error [tolerances]"] = self["final_error"]
        for kind in ("position", "velocity"):
            by_label[f"tightest {kind} margin [% of the limit]"] = 100 * self[f"relative_{kind}_margin"]
        for name, meaning in SHARES_OF_FORCES.items():
            if name in self.results.quantities and np.isfinite(self[name]).any():
                by_label[meaning] = 100 * self[name]
        if self.keeps_clear.any():
            by_label["smallest distance of parts [mm]"] = 1e3 * self["smallest_clearance"]
        for number, (monitor, unit) in enumerate(self.monitors.items()):
            by_label[f"margin of {monitor} [{unit}]"] = self["monitor_margin"][:, number]
        by_label["control effort [m^2/s^3, rad^2/s^3]"] = self["control_effort"]
        for name, (unit, meaning) in (PEAKS | SLIDING_PEAKS).items():
            if f"peak_{name}" in self.results.quantities and (name in PEAKS or np.isfinite(self[f"peak_{name}"]).any()):
                by_label[f"{meaning} [{unit}]"] = self[f"peak_{name}"]
        for name, values_of_runs in by_label.items():
            yield name, values_of_runs[np.isfinite(values_of_runs)]

    def worst(self, count: int) -> Array:
        """Return the numbers of the worst runs: those that failed first, then the latest, then the largest error."""
        late, wrong = (np.nan_to_num(self[name], nan=np.inf) for name in ("end_time", "final_error"))
        order = np.lexsort((-wrong, -late, ~self.failed))
        return np.asarray(order[self.made[order]][:count])

    def why(self, number: int) -> str:
        """Describe why a run ended, and which monitors did not hold."""
        if self["status"][number] == FAILED:
            return f"crashed: {self['reason'][number]}"
        margins = self["monitor_margin"][number] if self.monitors else ()
        return why_ended(str(self["reason"][number]), self.monitors, margins)

    def repeat(self, number: int, watch: Callable[[Sample], None] = lambda sample: None) -> Run:
        """Repeat a run from its seed, in memory, with its plans."""
        return simulate(task_in(self.results, (f"seed={self['seed'][number]}", "log.plans=true")), watch=watch)

    def command(self, number: int) -> str:
        """Return the command that repeats a run, with its log."""
        return f"{self.results.attributes.get('command', 'psmpc simulate')} --set seed={self['seed'][number]}"
