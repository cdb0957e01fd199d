"""What our departures from the paper are good for: a task as it is, and with each of them taken back.

Nothing here draws: an `Ablation` carries plain arrays for whoever does.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from psmpc_cli.logs.read import read_log
from psmpc_cli.specs.document import read, write
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.overrides import override
from psmpc_cli.studies.ablate_discretization import KINDS, ablate_discretization, meshes, run_on_mesh
from psmpc_cli.studies.ablate_normalization import ALL_PRINTED, NONE, RANGE, ablate_normalization
from psmpc_cli.studies.ablate_pending_cost import EQUAL, PRINTED, ablate_pending_cost
from psmpc_cli.studies.ablation import OURS, Ablation
from psmpc_cli.studies.one_window import pick_window, with_priorities
from psmpc_cli.studies.variants import run_variants

__all__ = ["Ablation", "run_ablations"]

EVERY_RUN = ("controller.kind=psmpc", "log.plans=false", "log.shares=false")

CHANGES: Mapping[str, tuple[str, ...]] = {
    OURS: ("log.plans=true",),
    EQUAL: ("controller.kind=smpc", "log.plans=true"),
    PRINTED: ("controller.pending_cost=0",),
    NONE: ("controller.normalization=none",),
    RANGE: ("controller.normalization=range",),
    ALL_PRINTED: ("controller.normalization=range", "controller.pending_cost=0"),
}
"""The runs on the task's own mesh, by what is taken back."""

POINTS = 40
"""Instants at which J(t_s) is scanned."""


def run_ablations(
    task: Task,
    directory: Path,
    jobs: int | None = None,
    done: Callable[[str], None] = lambda name: None,
    points: int = POINTS,
) -> list[Ablation]:
    """Run a task of several stages under PSMPC as it is and with each departure taken back, and compare.

    Args:
        task: The task.
        directory: Where the logs go; existing ones of the same name are overwritten.
        jobs: Processes at once; default as many as there are cores.
        done: Told the name of each run as it ends.
        points: Instants at which J(t_s) is scanned.

    Raises:
        LogError: The task has a single stage.
        RunError: A log could not be written.
    """
    nodes = task.spec.controller.uniform_nodes
    tasks = {name: _changed(task, changes) for name, changes in _variants(nodes).items()}
    logs = {name: read_log(path) for name, path in run_variants(tasks, directory, jobs, done).items()}
    equal, ours = pick_window(logs[EQUAL]), pick_window(logs[OURS])
    return [
        ablate_pending_cost(logs, (equal, ours, with_priorities(ours, (1.0, 1.0))), points),
        ablate_normalization(logs),
        ablate_discretization(logs, ours, nodes),
    ]


def _variants(nodes: int) -> dict[str, tuple[str, ...]]:
    """Return the changes of every run by its name."""
    variants = {name: (*EVERY_RUN, *changes) for name, changes in CHANGES.items()}
    for count in meshes(nodes):
        for kind in KINDS:
            mesh = (f"controller.nodes={count}", f"controller.discretization={kind}")
            variants.setdefault(run_on_mesh(kind, count, nodes), (*EVERY_RUN, *mesh))
    return variants


def _changed(task: Task, changes: Iterable[str]) -> Task:
    """Return a task with keys changed, its windows solved to convergence.

    What the real-time solver finds from the last plan says nothing of where the optimum is.
    """
    converged = ("solver.kind=fatrop", "solver.deadline=null") if task.spec.solver.kind == "sqp" else ()
    document, _ = override(read(task.spec.name, task.task_yaml), (*converged, *changes))
    return parse_task(write(document.data), task.robot_yaml, task.spec.name)
