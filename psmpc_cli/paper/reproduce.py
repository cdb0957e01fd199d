"""Runs what the paper's claims on its simulations need. Documented in docs/claims.md."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pydantic_core import to_json

from psmpc_cli import __version__
from psmpc_cli.errors import InputError
from psmpc_cli.logs.files import LOG, PAGE, FileKind, check_output
from psmpc_cli.ocp.feasibility.checks import ensure_feasible
from psmpc_cli.paper.ablations import Ablation, run_ablations
from psmpc_cli.paper.claims import Finding
from psmpc_cli.paper.departures import DEPARTURES, PRINTED, SHIPPED
from psmpc_cli.paper.judge import Reproduction
from psmpc_cli.paper.missions import ENDS
from psmpc_cli.progress import Watch
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.compare import compared_tasks, run_tasks
from psmpc_cli.studies.fronts import front_rows
from psmpc_cli.studies.pareto import ParetoSettings, possible_samples, solve_pareto
from psmpc_cli.studies.runner import Study, run_study
from psmpc_cli.studies.sampling import parse_sampling
from psmpc_cli.studies.sweep import DEFAULT_TASK, SweepCells, load_sweep_task, parse_stages, recommend, weight_study

METHODS = ("htmpc", "smpc", "psmpc")
"""The controllers whose results are published, in the order of the paper; the slowest one first."""

GRASP = "transport_grasp"
"""The task of the claim by mechanics: the object has a mass and is held by grasps of stated strength."""

BARE_ROBOT = (
    "object.grasp.known=false",
    "limits={}",
    "stages.transport.ends_when.object=null",
    "object.destination.tolerance=[0.05, 0.05, 2 deg]",
    "object.destination.speed=0.3",
    "object.grasp.band=[1, 1]",
    "object.grasp.stiffness=[1e4, 1e2]",
)
"""Changes of `GRASP` for a controller that plans, as in the paper, for the robot alone.

It knows nothing of the load, does not wait for the object, does not limit accelerations and lets hands that hold one
body move against each other, in grasps that give way to it. Delivered is what is let go near enough.
"""

LOGS = "runs.h5"
WEIGHTS = "weights.h5"
FRONTS = "fronts.h5"
GRASPS = "grasps.h5"
"""Files of the runs, the sweep over the weights, the Pareto fronts and the grasps, for psmpc plot and psmpc show."""

REPORT = "report.html"

OUTPUTS: Mapping[str, FileKind] = {
    **dict.fromkeys((LOGS, WEIGHTS, FRONTS, GRASPS), LOG),
    REPORT: PAGE,
}
"""The files that are written into the directory, each with its kind; those of ablations come besides."""

SHARED_KEYS = ("controller", "solver", "plant")
"""Changes of these keys also apply to the swept task, the first two to `GRASP`; stages and skills are their own."""

ONE_GUESS = "controller.multistart=1"
"""As printed a window is solved from the last plan alone; sweeps without a pending cost else try several guesses."""

OF_FIRST_STAGES = ("controller", "solver", "plant", "onset", "stages.approach", "stages.capture")
"""The keys of the swept task that are as printed where the judged task is."""

FURTHER_THRESHOLDS = {"control": (1.0, 10.0), "closeness": (0.9,)}
"""Thresholds above the task's own for which actual starts are logged, for the causes of the claims on starts."""


def reproduce(
    directory: Path,
    changes: Sequence[str] = (),
    grid: str = "7x7",
    points: int = 13,
    ablations: bool = False,
    force: bool = False,
    jobs: int | None = None,
    watch: Watch = lambda progress: None,
    task: str = SHIPPED,
) -> Reproduction:
    """Run all that the claims of the paper are judged by, and write its logs and results.

    These are the task under every method, the sweep over the weights, the Pareto fronts of the PSMPC run, the task with
    grasps, and if asked for the ablations. Claims are judged when they are first read from what is returned.

    Args:
        directory: Where logs and results go.
        changes: Keys of the task to change, each `path=value`.
        grid: Points of the weights of Approach and Capture. Cells of equal ratio share their run: 7x7 cells, ratios
            from 1e-6 to 1e6, take 13 runs.
        points: Points of each front: weighted sums at five samples of the PSMPC run.
        ablations: Whether the PSMPC run is repeated without each departure from the paper.
        force: Overwrite files.
        jobs: Number of parallel processes; default the number of cores.
        watch: Called with the progress of the present step, whose title says which of them it is.
        task: `SHIPPED`, or `PRINTED` with the sweep and the grasps as printed too.

    Raises:
        InputError: As for `load_variants` and `load_weights_sweep`; or a file exists already or cannot be written.
        SpecError: The changes do not fit the task, or no run of it could succeed.
        RunError: A file could not be written, or processes are ended from outside repeatedly.
    """
    steps = 5 if ablations else 4

    def step(number: int, name: str) -> Watch:
        """Return a watcher that gives the progress of a step its number and name."""
        return lambda progress: watch(replace(progress, title=f"step {number} of {steps}, {name}"))

    variants = load_variants(changes, task)
    sweep = load_weights_sweep(changes, grid, task=task)
    grasps = load_grasps(changes, task)
    runs = run_tasks(variants, directory / LOGS, jobs, force, step(1, "methods"))
    weights = run_study(
        sweep,
        directory / WEIGHTS,
        jobs,
        force=force,
        watch=step(2, "weights"),
    )
    fronts = None
    path = directory / FRONTS
    if force:  # those of an earlier reproduction, which this one may not have
        check_output(path, force)
        path.unlink(missing_ok=True)
    if len(possible_samples(runs["psmpc"], (0, 1))):  # some window holds the first two stages alone
        settings = ParetoSettings("1,2", (), points, "weighted-sum", free=False)
        fronts = solve_pareto(runs["psmpc"], settings, path, jobs, force, step(3, "fronts"))
    held = run_tasks(grasps, directory / GRASPS, jobs, force, step(4, "grasps"))
    departures = list[Ablation]()
    if ablations:
        departures = run_ablations(variants["psmpc"], jobs, step(5, "ablations"))
    return Reproduction(runs, SweepCells(weights), fronts, tuple(changes), tuple(departures), held)


def load_variants(changes: Sequence[str] = (), task: str = SHIPPED) -> dict[str, Task]:
    """Load the transport task for every method that the paper compares, as the claims on missions need it.

    Args:
        changes: Keys of the task to change, each `path=value`.
        task: `SHIPPED` or `PRINTED`.

    Returns:
        The tasks by method, `htmpc`, `smpc` and `psmpc`. They log actual starts also for `FURTHER_THRESHOLDS`.

    Raises:
        InputError: The changes choose a controller or other stages, or that no plans are logged, from which the fronts
            are found.
        SpecError: They do not fit the task, or no run of it could succeed.
    """
    path = built_ins("task")[task]
    own = load_task(path)
    changed = load_task(path, changes)
    if changed.spec.controller.kind != own.spec.controller.kind:
        raise InputError(f"found a change of controller.kind, expected none: {', '.join(METHODS)} are run anyway")
    if len(changed.spec.stages) != len(ENDS):
        raise InputError(f"found {len(changed.spec.stages)} stages, expected {len(ENDS)}: claims are on each of them")
    if not changed.spec.log.plans:
        raise InputError("found log.plans: false, expected true: the fronts are found from the plans of the PSMPC run")
    ensure_feasible(changed)
    series = sorted({*changed.spec.onset.series, *FURTHER_THRESHOLDS[changed.spec.onset.kind]})
    return {kind: load_task(path, (*changes, f"controller.kind={kind}", f"onset.series={series}")) for kind in METHODS}


def load_weights_sweep(changes: Sequence[str], grid: str, own: Sequence[str] = (), task: str = SHIPPED) -> Study:
    """Build the sweep over the weights of Approach and Capture, for the claims on priorities.

    It sweeps another task than the judged one, with the first two of its stages. So those changes of the judged task
    that concern both apply to it as well.

    Args:
        changes: Keys of the judged task that are changed.
        grid: Points of the weights, such as 7x7, from 1e-3 to 1e3 each.
        own: Keys of the swept task to change.
        task: The judged task, `SHIPPED` or `PRINTED`.

    Raises:
        InputError: The grid is none.
        SpecError: The changes do not fit the swept task.
    """
    all_changes = (
        *_shared_changes(_changes_as_printed(task), OF_FIRST_STAGES),
        *_shared_changes(changes, SHARED_KEYS),
        *own,
    )
    swept = load_sweep_task(str(built_ins("task")[DEFAULT_TASK]), all_changes, ())
    return weight_study(swept, parse_stages("1,2", swept), parse_sampling(grid, (1e-3, 1e3)))


def load_grasps(changes: Sequence[str] = (), task: str = SHIPPED) -> dict[str, Task]:
    """Return the tasks of the claim by mechanics, by method, with those changes that apply to them as well.

    Raises:
        SpecError: The changes do not fit the task.
    """
    shared = _shared_changes((*_changes_as_printed(task), *changes), SHARED_KEYS[:2])
    loaded = load_task(built_ins("task")[GRASP], (*BARE_ROBOT, *shared))
    return compared_tasks(loaded, ("smpc", "psmpc"), own_settings=True)


def _changes_as_printed(task: str) -> list[str]:
    """Return what makes other tasks as printed where the judged one is; nothing where that is the shipped one."""
    return [*(change for departure in DEPARTURES for change in departure.printed), ONE_GUESS] if task == PRINTED else []


def _shared_changes(changes: Sequence[str], keys: Sequence[str]) -> tuple[str, ...]:
    """Return the changes of these keys, or of keys inside them."""
    paths = [change.partition("=")[0].strip() for change in changes]
    return tuple(
        change
        for change, path in zip(changes, paths, strict=True)
        if any(path == key or path.startswith(f"{key}.") for key in keys)
    )


def claims_json(reproduction: Reproduction, created: str, printed: Reproduction | None = None) -> bytes:
    """Write the claim table as JSON; what is unknown, or does not apply, is null. Keys: docs/claims.md.

    Args:
        reproduction: Of the shipped task.
        created: When, in ISO 8601.
        printed: Of the task as printed, if it was run.
    """
    data = _table_of_claims(reproduction, created)
    data["as_printed"] = None if printed is None else _table_of_claims(printed, created)
    return to_json(data, indent=2, inf_nan_mode="null") + b"\n"


def _table_of_claims(reproduction: Reproduction, created: str) -> dict[str, object]:
    """Return the claims on one task with what they were judged by, in the form of the JSON file. Keys: docs/claims.md.

    The digests identify the tasks of all runs: equal digests mean the same task and robot.
    """
    cells = reproduction.weights
    fronts = reproduction.fronts
    best = recommend(reproduction.weights).ratio
    held, count = reproduction.count()
    return {
        "format": 3,  # increases when a key is removed or changes its meaning
        "psmpc_version": __version__,
        "created": created,
        "task": reproduction.task,
        "changes": reproduction.changes,
        "digests": {name: str(run.attributes["digest"]) for name, run in reproduction.runs.items()},
        "grasps": {name: str(run.attributes["digest"]) for name, run in reproduction.grasps.items()},
        "weights": {
            "task": cells.task.spec.name,
            "digest": str(cells.results.attributes["digest"]),
            "sampling": str(cells.results.attributes["sampling"]),
            "failed_cells": int(cells.failed.sum()),
            "failed_solves": cells.count("solves_failed"),
            "recommended": best,
        },
        "fronts": None
        if fronts is None
        else {
            "stages": fronts["stage"].tolist(),
            "method": str(fronts.attributes["method"]),
            "samples": front_rows(fronts),
        },
        "claims": [_entry_of_claim(finding) for finding in reproduction.findings],
        "ablations": [{"name": ablation.name, "numbers": ablation.numbers} for ablation in reproduction.ablations],
        "held": held,
        "failed": count - held,
    }


def _entry_of_claim(finding: Finding) -> dict[str, object]:
    measured = {name: value for name, value in finding._asdict().items() if name != "claim"}
    about = finding.claim.model_dump(include={"id", "statement", "source", "unit", "apart", "published", "searched"})
    return {**about, "unit": about["unit"] or None, **measured, "cause": "; ".join(finding.cause) or None}
