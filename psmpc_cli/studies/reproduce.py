"""Runs what the paper's claims on its simulations need, and judges them. Documented in docs/reproduce.md."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from psmpc_cli.errors import InputError
from psmpc_cli.logs.comparison import read_comparison
from psmpc_cli.logs.read import Log
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import LoadedTask, load_task
from psmpc_cli.studies.ablations import Ablation, run_ablations
from psmpc_cli.studies.claims import Claim, published_claims
from psmpc_cli.studies.compare import compare
from psmpc_cli.studies.evidence import Evidence, gather_evidence
from psmpc_cli.studies.findings import Finding, judge
from psmpc_cli.studies.published import load_published

TASK = "transport"

METHODS = ("htmpc", "smpc", "psmpc")
"""The controllers whose results are published, in the order of the paper; the slowest one first."""

LOGS = "runs.h5"
"""The file with the logs of all runs; psmpc plot and psmpc show read it."""

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
        ablations: What each departure from the paper is good for, where that was asked for.
    """

    changes: tuple[str, ...]
    logs: Mapping[str, Log]
    judged: tuple[JudgedClaim, ...]
    ablations: tuple[Ablation, ...] = ()

    @property
    def failing(self) -> tuple[JudgedClaim, ...]:
        """The claims that do not hold."""
        return tuple(judged for judged in self.judged if not judged.finding.holds)


def load_variants(changes: Sequence[str] = ()) -> dict[str, LoadedTask]:
    """Return the tasks to run, by method.

    Raises:
        InputError: The changes choose a controller.
        SpecError: They do not fit the task, or no run of it could succeed.
    """
    path = built_ins("task")[TASK]
    own, changed = load_task(path), load_task(path, changes)
    if changed.spec.controller.kind != own.spec.controller.kind:
        raise InputError(f"found a change of controller.kind, expected none: {', '.join(METHODS)} are run anyway")
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
