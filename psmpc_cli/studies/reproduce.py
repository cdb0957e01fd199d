"""Runs what the paper's claims on its simulations need, and judges them. Documented in docs/reproduce.md."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from psmpc_cli import __version__
from psmpc_cli.errors import InputError
from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run, read_comparison
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.ablations import Ablation, run_ablations
from psmpc_cli.studies.claims import Evidence, Finding, Value, gather_run, load_claims
from psmpc_cli.studies.compare import compare_tasks
from psmpc_cli.studies.fronts import front_movement, front_rows, read_pareto
from psmpc_cli.studies.judge import judge
from psmpc_cli.studies.pareto import Question, possible_samples, solve_pareto
from psmpc_cli.studies.runner import Study, Watch, ignore, run_study
from psmpc_cli.studies.sweep import DEFAULT_TASK, load_sweep_task, weight_study
from psmpc_cli.studies.weights import SweepCells, grid_sampling, parse_stages, recommend, sweep_cells

TASK = "transport"

METHODS = ("htmpc", "smpc", "psmpc")
"""The controllers whose results are published, in the order of the paper; the slowest one first."""

LOGS, WEIGHTS, FRONTS = "runs.h5", "weights.h5", "fronts.h5"
"""Files of the runs, the sweep over the weights and the Pareto fronts, which psmpc plot and psmpc show read."""

FORMAT = 1
"""Version of `as_data`; increases when a key is removed or changes its meaning."""

RANGE = (1e-3, 1e3)
"""Range of both weights."""

COMMON = ("controller", "solver", "plant")
"""Changes of these keys of the task also apply to the swept task; its stages and skills are its own."""

FOLLOWED = (1.0, 10.0)
"""Thresholds above the task's own for which actual starts are logged, for the causes of the claims on starts."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What became of the claims.

    Attributes:
        changes: Keys of the task that were changed.
        logs: The runs, by method.
        weights: The sweep over the weights of Approach and Capture.
        fronts: Their Pareto fronts in the PSMPC run; None if none of its windows holds both alone.
        findings: The judged claims.
        ablations: The ablations of the PSMPC run, if they were run.
    """

    changes: tuple[str, ...]
    logs: Mapping[str, Run]
    weights: SweepCells
    fronts: Results | None
    findings: tuple[Finding, ...]
    ablations: tuple[Ablation, ...] = ()

    @property
    def failing(self) -> tuple[Finding, ...]:
        """The claims that do not hold."""
        return tuple(finding for finding in self.findings if not finding.holds)


def judge_claims(
    logs: Mapping[str, Run],
    weights: SweepCells,
    fronts: Results | None,
    changes: Sequence[str] = (),
    ablations: Sequence[Ablation] = (),
) -> Reproduction:
    """Judge every claim on the logs of all methods, the sweep and the fronts; `changes` of the task are noted."""
    claims, movement = load_claims(), None if fronts is None else front_movement(fronts)
    evidence = Evidence(claims, {name: gather_run(log) for name, log in logs.items()}, weights, movement)
    findings = tuple(judge(claim, evidence) for claim in claims.claims)
    return Reproduction(tuple(changes), logs, weights, fronts, findings, tuple(ablations))


def load_variants(changes: Sequence[str] = ()) -> dict[str, Task]:
    """Return the tasks to run, by method.

    Raises:
        InputError: The changes choose a controller, or that no plans are logged, from which the fronts are found.
        SpecError: They do not fit the task, or no run of it could succeed.
    """
    path = built_ins("task")[TASK]
    own, changed = load_task(path), load_task(path, changes)
    if changed.spec.controller.kind != own.spec.controller.kind:
        raise InputError(f"found a change of controller.kind, expected none: {', '.join(METHODS)} are run anyway")
    if not changed.spec.log.plans:
        raise InputError("found log.plans: false, expected true: the fronts are found from the plans of the PSMPC run")
    ensure_feasible(changed)
    series = sorted({*changed.spec.onset.series, *FOLLOWED})
    return {kind: load_task(path, (*changes, f"controller.kind={kind}", f"onset.series={series}")) for kind in METHODS}


def run_methods(
    directory: Path,
    changes: Sequence[str] = (),
    force: bool = False,
    jobs: int | None = None,
    done: Callable[[str], None] = lambda name: None,
) -> Mapping[str, Run]:
    """Run every method and return its log; the logs go to one file of a directory.

    Args:
        directory: The directory.
        changes: Keys of the task to change, each `path=value`.
        force: Overwrite logs.
        jobs: Number of parallel processes; default the number of cores.
        done: Called with the name of each run as it ends.

    Raises:
        InputError: As for `load_variants`; or the logs exist already or cannot be written.
        SpecError: As for `load_variants`.
        RunError: A log could not be written.
    """
    path = directory / LOGS
    compare_tasks(load_variants(changes), path, force, jobs, done)
    return read_comparison(path)


def load_weights_sweep(changes: Sequence[str], grid: str) -> Study:
    """Return the sweep over the weights, with those changes of the task that apply to it as well.

    Raises:
        InputError: The grid is none.
        SpecError: The changes do not fit the swept task.
    """
    common = tuple(change for change in changes if change.partition("=")[0].strip().partition(".")[0] in COMMON)
    task = load_sweep_task(str(built_ins("task")[DEFAULT_TASK]), common, ())
    return weight_study(task, parse_stages("1,2", task), grid_sampling(grid, RANGE))


def sweep_weights(
    directory: Path,
    changes: Sequence[str],
    grid: str,
    force: bool = False,
    jobs: int | None = None,
    watch: Watch = ignore,
) -> SweepCells:
    """Run the sweep over a grid of both weights, such as 7x7, into a file of a directory, and return its cells.

    Cells of equal ratio share their run: 7x7 cells, ratios from 1e-6 to 1e6, take 13 runs of Approach and Capture.

    Raises:
        InputError: As for `load_weights_sweep`; or the results exist already or cannot be written.
        SpecError: As for `load_weights_sweep`.
        RunError: The results could not be written.
    """
    path = directory / WEIGHTS
    return sweep_cells(run_study(load_weights_sweep(changes, grid), path, jobs, force=force, watch=watch))


def find_fronts(
    directory: Path,
    log: Run,
    points: int,
    force: bool = False,
    jobs: int | None = None,
    done: Callable[[float, int, int], None] = lambda instant, ended, count: None,
) -> Results | None:
    """Find the Pareto fronts of the PSMPC run and return them; None if no window holds Approach and Capture alone.

    They are weighted sums, at five samples of the run; no further run is needed.

    Args:
        directory: Where the logs are and the results go.
        log: The PSMPC run.
        points: Points of a front.
        force: Overwrite results.
        jobs: Number of parallel processes; default the number of cores.
        done: Called with the time of each sample as it is done [s], how many are, and how many there are.

    Raises:
        InputError: The results exist already or cannot be written.
        RunError: Processes are ended from outside repeatedly.
    """
    path = directory / FRONTS
    if force:
        path.unlink(missing_ok=True)
    if not len(possible_samples(log, (0, 1))):
        return None
    with TemporaryDirectory(prefix=".fronts-", dir=directory) as meanwhile:
        run = Path(meanwhile) / "psmpc.h5"
        read_comparison(directory / LOGS)["psmpc"].save(run)
        solve_pareto(run, Question("1,2", (), points, "weighted-sum", False), path, jobs, force, done)
    return read_pareto(path)


def ablate(
    directory: Path,
    changes: Sequence[str],
    jobs: int | None = None,
    done: Callable[[str], None] = lambda name: None,
) -> tuple[Ablation, ...]:
    """Run the ablations of the PSMPC run; their logs are in a directory during that time only.

    Raises:
        RunError: A log could not be written.
    """
    task = load_variants(changes)["psmpc"]
    with TemporaryDirectory(prefix=".ablations-", dir=directory) as meanwhile:
        return tuple(run_ablations(task, Path(meanwhile), jobs, done))


def as_data(reproduction: Reproduction, created: str) -> dict[str, Any]:
    """Return the claim table for JSON; what is unknown, or does not apply, is null. Keys: docs/reproduce.md."""
    cells, fronts = reproduction.weights, reproduction.fronts
    best = recommend(cells)
    return {
        "format": FORMAT,
        "psmpc_version": __version__,
        "created": created,
        "task": TASK,
        "changes": list(reproduction.changes),
        "digests": {name: str(log.attributes["digest"]) for name, log in reproduction.logs.items()},
        "weights": {
            "task": cells.task.spec.name,
            "digest": str(cells.results.attributes["digest"]),
            "sampling": str(cells.results.attributes["sampling"]),
            "failed_cells": int(cells.failed.sum()),
            "failed_solves": cells.count("fallbacks"),
            "recommended": None if best is None else best.ratio,
        },
        "fronts": None
        if fronts is None
        else {
            "stages": fronts["stage"].tolist(),
            "method": str(fronts.attributes["method"]),
            "samples": [_plain(asdict(row)) for row in front_rows(fronts)],
        },
        "claims": [_claim_data(finding) for finding in reproduction.findings],
        "ablations": [
            {"name": one.name, "sentence": one.sentence, "numbers": _plain(one.numbers)}
            for one in reproduction.ablations
        ],
        "held": len(reproduction.findings) - len(reproduction.failing),
        "failed": len(reproduction.failing),
    }


def _claim_data(finding: Finding) -> dict[str, Any]:
    values = {key: getattr(finding, key) for key in ("reproduced", "difference", "tolerance", "holds", "earlier")}
    return {
        **finding.claim.model_dump(include={"id", "statement", "source"}),
        "unit": finding.unit or None,
        "published": _plain(finding.claim.published),
        **_plain(values),
        "cause": "; ".join(finding.cause) or None,
    }


def _plain(value: Mapping[str, Any] | Value) -> Any:
    """Return a value for JSON: lists for tuples, null for numbers that are not finite."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not isfinite(value) else value
