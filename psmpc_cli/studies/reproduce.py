"""Runs what the paper's claims on its simulations need, and judges them. Documented in docs/reproduce.md."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from psmpc_cli.errors import InputError
from psmpc_cli.logs.read import Log, read_log
from psmpc_cli.ocp.feasibility import ensure_feasible
from psmpc_cli.specs.library import built_ins
from psmpc_cli.specs.load import LoadedTask, load_task
from psmpc_cli.studies.claims import Claim, published_claims
from psmpc_cli.studies.evidence import Evidence, gather_evidence
from psmpc_cli.studies.findings import Finding, judge
from psmpc_cli.studies.published import load_published
from psmpc_cli.studies.variants import run_variants

TASK = "transport"

METHODS = ("psmpc", "smpc", "htmpc")
"""The controllers whose results are published."""

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
    """

    changes: tuple[str, ...]
    logs: Mapping[str, Log]
    judged: tuple[JudgedClaim, ...]

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
    jobs: int | None = None,
    done: Callable[[str], None] = lambda name: None,
) -> Reproduction:
    """Run every method into a log of its own below a directory, and judge the claims.

    Args:
        directory: Where the logs go; existing ones of the same name are overwritten.
        changes: Keys of the task to change, each `path=value`.
        jobs: Processes at once; default as many as there are cores.
        done: Told the name of each run as it ends.

    Raises:
        InputError, SpecError: As for `load_variants`.
    """
    paths = run_variants(load_variants(changes), directory, jobs, done)
    return judge_logs({name: read_log(path) for name, path in paths.items()}, changes)


def judge_logs(logs: Mapping[str, Log], changes: Sequence[str] = ()) -> Reproduction:
    """Judge the claims on logs that are there already, by method."""
    runs: dict[str, Evidence] = {name: gather_evidence(log) for name, log in logs.items()}
    claims = published_claims(load_published())
    return Reproduction(tuple(changes), logs, tuple(JudgedClaim(claim, judge(claim, runs)) for claim in claims))
