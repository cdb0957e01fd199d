"""The file of a Monte Carlo study: what is in it, and how a study goes on that was stopped, or with more runs."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from psmpc_cli import __version__
from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Quantity, Results, create_results
from psmpc_cli.logs.schema import MONTE_CARLO
from psmpc_cli.simulation.monte_carlo_runs import ENDED, STATUS, WAITING, read_monte_carlo
from psmpc_cli.specs.load import Task
from psmpc_cli.studies.per_cell import Identity, PerCell, ensure_same, unfilled


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """A Monte Carlo study as it was asked for.

    Attributes:
        task: The task; a run's seed is the task's plus the number of the run.
        runs: How many.
        command: What simulates the task, but for the seed, as a shell takes it.
    """

    task: Task
    runs: int
    command: str

    @property
    def identity(self) -> Identity:
        """What two studies must have in common for one to go on where the other stopped."""
        return {"psmpc_version": __version__, "digest": self.task.digest}

    @property
    def seeds(self) -> np.ndarray:
        """The seed of each run (runs,)."""
        return self.task.spec.seed + np.arange(self.runs)


RUN_QUANTITIES = (
    PerCell("completed", "1", "1 if the last stage met its end condition, 0 if not", whole=True),
    PerCell("succeeded", "1", "1 if it did and every monitor held on the true state, 0 if not", whole=True),
    PerCell("end_time", "s", "end of the run, whatever ended it"),
    PerCell("switch_time", "s", "instant that ended each stage", "stage"),
    PerCell("actual_start", "s", "actual start of each stage", "stage"),
    PerCell("final_error", "1", "largest error of the last stage's end condition at the end, over its tolerance"),
    PerCell("position_margin", "m, rad", "tightest distance to a position limit at a tick; negative beyond it"),
    PerCell("velocity_margin", "m/s, rad/s", "tightest distance to a velocity limit at a tick; negative beyond it"),
    PerCell("relative_position_margin", "1", "the same distance to a position limit, over half the limits' distance"),
    PerCell("relative_velocity_margin", "1", "the same distance to a velocity limit, over half the limits' distance"),
    PerCell("monitor_margin", "m, m/s", "smallest distance of each monitor's signal to its bounds", "monitor"),
    PerCell("fallbacks", "1", "failed solves after which the shifted plan went on", whole=True),
    PerCell("unmeasured", "1", "samples whose state was not measured, at least in part", whole=True),
    PerCell("control_effort", "m^2/s^3, rad^2/s^3", "integral of |u|^2"),
    PerCell("run_time", "s", "wall time of the run, with all that is around"),
)
"""What every run leaves behind."""


def create_monte_carlo(path: Path, study: MonteCarlo, force: bool) -> None:
    """Write the file of a study with all runs waiting.

    Raises:
        InputError: The file exists already or cannot be written.
    """
    create_results(path, MONTE_CARLO, _attributes(study), _quantities(study), force)


def _attributes(study: MonteCarlo) -> dict[str, str | int | float]:
    task = study.task.spec
    return {
        **study.identity,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "task_name": task.name,
        "controller": task.controller.kind,
        "command": study.command,
        "task_yaml": study.task.task_yaml,
        "robot_yaml": study.task.robot_yaml,
    }


def _quantities(study: MonteCarlo) -> list[Quantity]:
    """Return everything that is filled in, run by run, and what it stands along."""
    task, runs, dims = study.task.spec, study.runs, ("run",)
    names = {"stage": [stage.name for stage in task.stages], "monitor": [monitor.name for monitor in task.monitors]}
    along = {name: len(entries) for name, entries in names.items() if entries}
    filled = unfilled((each for each in RUN_QUANTITIES if each.along in {"", *along}), dims, (runs,), along)
    return [
        Quantity("run", dims, np.arange(runs), "1", "number of the run"),
        *(Quantity(name, (name,), np.array(names[name]), "1", name) for name in along),
        Quantity("seed", dims, study.seeds, "1", "seed of the run"),
        Quantity("status", dims, np.full(runs, WAITING, "i4"), "1", "status of the run", STATUS),
        Quantity("reason", dims, np.full(runs, ""), "1", "why the run ended"),
        Quantity("failure", dims, np.full(runs, ""), "1", "what made the run crash"),
        *filled,
        Quantity("wall_time", (), np.array(0.0), "s", "wall time spent on the study"),
    ]


def resume_monte_carlo(path: Path, study: MonteCarlo) -> Results:
    """Return what a stopped study has come to; where it had fewer runs, its file takes more from now on.

    Raises:
        InputError: The file holds another study, or more runs than are asked for.
        LogError: As for `read_monte_carlo`.
    """
    if not path.exists():
        raise InputError(f"--resume: found no file {path}, expected a study that was stopped; leave --resume out")
    results = read_monte_carlo(path).results
    ensure_same(results, study.identity, study.task, "study")
    if (found := len(results["run"])) > study.runs:
        raise InputError(f"--resume: {path} has {found} runs, found --runs {study.runs}, expected at least as many")
    if found == study.runs:
        return results
    _extend(path, study, results)
    return read_monte_carlo(path).results


def _extend(path: Path, study: MonteCarlo, results: Results) -> None:
    """Put a file with more runs in the place of a study's, in one step."""
    part = path.with_name(f".{path.name}.longer")
    create_results(part, MONTE_CARLO, _attributes(study), [_kept(new, results) for new in _quantities(study)], True)
    part.replace(path)


def _kept(new: Quantity, results: Results) -> Quantity:
    """Return a quantity with what is known of it from before."""
    old = results[new.name]
    if new.dims[:1] != ("run",):
        return replace(new, values=old)
    return replace(new, values=np.concatenate([old, new.values[len(old) :]]))


def todo(results: Results) -> np.ndarray:
    """Return the numbers of the runs that wait or crashed."""
    return np.flatnonzero(results["status"] != ENDED)
