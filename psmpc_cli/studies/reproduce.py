"""Runs what the paper's claims on its simulations need, and judges them. Documented in docs/reproduce.md."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from psmpc_cli.errors import InputError
from psmpc_cli.logs.comparison import extract_log, read_comparison
from psmpc_cli.logs.read import Log
from psmpc_cli.logs.results import Results
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.simulation.sweep_cells import SweepCells, sweep_cells
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.studies.ablations import Ablation, run_ablations
from psmpc_cli.studies.claims import Claim, published_claims
from psmpc_cli.studies.compare import compare
from psmpc_cli.studies.evidence import Evidence, gather_evidence
from psmpc_cli.studies.findings import Finding, judge
from psmpc_cli.studies.front_claims import fronts_claims
from psmpc_cli.studies.front_findings import judge_fronts
from psmpc_cli.studies.parallel import LocalCalls
from psmpc_cli.studies.pareto import Question, possible_samples, solve_pareto
from psmpc_cli.studies.pareto_file import read_pareto
from psmpc_cli.studies.published import load_published
from psmpc_cli.studies.sampling import grid_sampling
from psmpc_cli.studies.sweep import DEFAULT_TASK, SweepProgress, load_sweep_task, parse_stages, run_sweep
from psmpc_cli.studies.sweep_claims import weights_claims
from psmpc_cli.studies.sweep_file import Sweep, read_sweep
from psmpc_cli.studies.sweep_findings import judge_weights

TASK = "transport"

METHODS = ("htmpc", "smpc", "psmpc")
"""The controllers whose results are published, in the order of the paper; the slowest one first."""

LOGS = "runs.h5"
"""The file with the logs of all runs; psmpc plot and psmpc show read it."""

WEIGHTS = "weights.h5"
"""The file with the sweep over the weights of Approach and Capture; psmpc plot and psmpc show read it."""

FRONTS = "fronts.h5"
"""The file with the Pareto fronts of Approach and Capture; psmpc plot and psmpc show read it."""

RANGE = (1e-3, 1e3)
"""Range of both weights."""

COMMON = ("controller", "solver", "plant")
"""Changes of these keys of the task are changes of the swept task too; stages and skills are its own."""

FOLLOWED = (1.0, 10.0)
"""Thresholds beyond the task's own up to which a waiting stage is followed, for what they say on a start's cause."""


@dataclass(frozen=True)
class JudgedClaim:
    """A claim and what became of it."""

    claim: Claim
    finding: Finding


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What became of the claims.

    Attributes:
        changes: Keys of the task that were changed.
        logs: The runs, by method.
        judged: The claims.
        weights: The sweep over the weights of Approach and Capture; None as long as it has not been run.
        fronts: Their Pareto fronts in the PSMPC run; None as long as they have not been found, or where there are none.
        ablations: What each departure from the paper is good for, where that was asked for.
    """

    changes: tuple[str, ...]
    logs: Mapping[str, Log]
    judged: tuple[JudgedClaim, ...]
    weights: SweepCells | None = None
    fronts: Results | None = None
    ablations: tuple[Ablation, ...] = ()

    @property
    def failing(self) -> tuple[JudgedClaim, ...]:
        """The claims that do not hold."""
        return tuple(judged for judged in self.judged if not judged.finding.holds)


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


def run_reproduction(
    directory: Path,
    changes: Sequence[str] = (),
    force: bool = False,
    jobs: int | None = None,
    began: Callable[[Mapping[str, Path]], None] = lambda paths: None,
    done: Callable[[str], None] = lambda name: None,
) -> Reproduction:
    """Run every method, keep their logs in one file of a directory, and judge the claims.

    Args:
        directory: Where the logs go.
        changes: Keys of the task to change, each `path=value`.
        force: Overwrite logs.
        jobs: Processes at once; default as many as there are cores.
        began: Told where the logs stand meanwhile.
        done: Told the name of each run as it ends.

    Raises:
        InputError: As for `load_variants`; or the logs exist already or cannot be written.
        SpecError: As for `load_variants`.
        RunError: A log could not be written.
    """
    path = directory / LOGS
    compare(load_variants(changes), path, force, jobs, began, done)
    return judge_claims(read_comparison(path), changes)


def load_weights_sweep(changes: Sequence[str], grid: str) -> Sweep:
    """Return the sweep over the weights, with those changes of the task that concern it as well.

    Raises:
        InputError: The grid is none.
        SpecError: The changes do not fit the swept task.
    """
    common = tuple(change for change in changes if change.partition("=")[0].strip().partition(".")[0] in COMMON)
    task = load_sweep_task(str(built_ins("task")[DEFAULT_TASK]), common, ())
    return Sweep(task, parse_stages("1,2", task), grid_sampling(grid, RANGE), False)


def add_weights(
    reproduction: Reproduction,
    directory: Path,
    grid: str,
    force: bool = False,
    jobs: int | None = None,
    watch: Callable[[SweepProgress], None] = lambda progress: None,
) -> Reproduction:
    """Return the reproduction with the sweep over the weights, kept in a directory, and with the claims on it judged.

    Cells of one ratio share their run: 7x7 cells, ratios from 1e-6 to 1e6, take 13 runs of Approach and Capture.

    Args:
        reproduction: What there is.
        directory: Where the results go.
        grid: Points of both weights, such as 7x7.
        force: Overwrite results.
        jobs: Processes at once; default as many as there are cores.
        watch: Told how far the sweep has come.

    Raises:
        InputError: As for `load_weights_sweep`; or the results exist already or cannot be written.
        SpecError: As for `load_weights_sweep`.
        RunError: The results could not be written.
    """
    path = directory / WEIGHTS
    run_sweep(load_weights_sweep(reproduction.changes, grid), path, LocalCalls(jobs), force, watch=watch)
    return judge_sweep(reproduction, sweep_cells(read_sweep(path)))


def judge_sweep(reproduction: Reproduction, cells: SweepCells) -> Reproduction:
    """Return the reproduction with the claims on the weights judged on a sweep."""
    claims = weights_claims(load_published())
    judged = tuple(JudgedClaim(claim, judge_weights(claim, cells)) for claim in claims)
    return replace(reproduction, judged=(*reproduction.judged, *judged), weights=cells)


def add_fronts(
    reproduction: Reproduction,
    directory: Path,
    points: int,
    force: bool = False,
    jobs: int | None = None,
    done: Callable[[float, int, int], None] = lambda instant, ended, count: None,
) -> Reproduction:
    """Return the reproduction with the fronts of its PSMPC run, and with the claims on them judged.

    They are weighted sums, at five samples whose window holds Approach and Capture alone; no run is made for them.

    Args:
        reproduction: What there is.
        directory: Where its logs are and the results go.
        points: Points of a front.
        force: Overwrite results.
        jobs: Processes at once; default as many as there are cores.
        done: Told the instant of each sample as it is done [s], how many are, and how many there are.

    Raises:
        InputError: The results exist already or cannot be written.
        RunError: Processes are ended from outside again and again.
    """
    path = directory / FRONTS
    if force:
        path.unlink(missing_ok=True)
    if not len(possible_samples(reproduction.logs["psmpc"], (0, 1))):
        return judge_pareto(reproduction, None)
    with TemporaryDirectory(prefix=".fronts-", dir=directory) as meanwhile:
        run = Path(meanwhile) / "psmpc.h5"
        extract_log(directory / LOGS, "psmpc", run)
        solve_pareto(run, Question("1,2", (), points, "weighted-sum", False), path, LocalCalls(jobs), force, done)
    return judge_pareto(reproduction, read_pareto(path))


def judge_pareto(reproduction: Reproduction, results: Results | None) -> Reproduction:
    """Return the reproduction with the claims on the fronts judged; None where there is no window to find them in."""
    claims = fronts_claims(load_published())
    judged = tuple(JudgedClaim(claim, judge_fronts(claim, results)) for claim in claims)
    return replace(reproduction, judged=(*reproduction.judged, *judged), fronts=results)


def add_ablations(
    reproduction: Reproduction,
    directory: Path,
    jobs: int | None = None,
    done: Callable[[str], None] = lambda name: None,
) -> Reproduction:
    """Return the reproduction with the ablations of its PSMPC run; their logs stay in a directory no longer than that.

    Raises:
        RunError: A log could not be written.
    """
    task = load_variants(reproduction.changes)["psmpc"]
    with TemporaryDirectory(prefix=".ablations-", dir=directory) as meanwhile:
        return replace(reproduction, ablations=tuple(run_ablations(task, Path(meanwhile), jobs, done)))


def judge_claims(logs: Mapping[str, Log], changes: Sequence[str] = ()) -> Reproduction:
    """Judge every claim on the logs of all methods; `changes` of the task are noted."""
    runs: dict[str, Evidence] = {name: gather_evidence(log) for name, log in logs.items()}
    claims = published_claims(load_published())
    judged = tuple(JudgedClaim(claim, judge(claim, runs)) for claim in claims)
    return Reproduction(tuple(changes), logs, judged)
