"""Comparisons: several controllers on one task, in parallel, with their logs in one file."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

from psmpc_cli.errors import InputError
from psmpc_cli.logs.comparison import save_comparison
from psmpc_cli.logs.files import check_output
from psmpc_cli.logs.numbers import number
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.progress import Watch
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.arguments import rejected, require, require_options
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.task import ControllerSpec
from psmpc_cli.studies.runner import compute_all, documents_of, with_changes

CONTROLLERS: tuple[str, ...] = ("psmpc", "smpc", "htmpc", "hard")
"""What is compared by default, in the order of the table."""

SAME_SAMPLE = 1e-6
"""Part of a sample by which two missions may differ beyond one and still count as equally soon: rounding."""

VARIED = "controller.kind"
"""The one key in which the tasks of a comparison differ."""


def compare(
    task: Task | str | Path,
    controllers: Sequence[str] = CONTROLLERS,
    path: Path | str | None = None,
    jobs: int | None = None,
    force: bool = False,
) -> dict[str, Run]:
    """Run a task under several controllers; nothing else differs.

    Args:
        task: The task, its file or the name of a built-in one.
        controllers: Their kinds.
        path: File of all logs; None for none that stays.
        jobs: Processes; by default one for each core.
        force: Whether an existing file is overwritten.

    Returns:
        The runs by controller.

    Raises:
        InputError: An argument is of another type, a controller is unknown, or the file exists or cannot be written.
        SpecError: The task does not hold.
        RunError: A process was killed each time.
    """
    wanted = 'a list of names such as ["psmpc", "smpc"]'
    if isinstance(controllers, str) or not isinstance(controllers, Sequence):
        raise rejected("controllers", controllers, wanted)
    for kind in controllers:
        require("controllers", kind, str, wanted)
    path = require_options(path, jobs, force)
    return run_tasks(compared_tasks(task, controllers), path, jobs, force)


def compared_tasks(task: Task | str | Path, controllers: Iterable[str], changes: Sequence[str] = ()) -> dict[str, Task]:
    """Build the task with keys changed under each controller, each once; nothing else differs.

    Raises:
        InputError: A controller is unknown, or there is none; or the changes are of the controller itself.
        SpecError: The task does not hold.
    """
    known = get_args(ControllerSpec.model_fields["kind"].annotation)
    wanted = dict.fromkeys(controllers)
    unknown = ", ".join(name for name in wanted if name not in known)
    if unknown or not wanted:
        raise InputError(f"--controllers: found '{unknown}', expected one or more of {', '.join(known)} between commas")
    if any(change.partition("=")[0].strip() == VARIED for change in changes):
        raise InputError(f"--set {VARIED}: a comparison varies it; choose with --controllers")
    documents = documents_of(with_changes(task, changes))
    return {name: documents.changed((f"{VARIED}={name}",)) for name in wanted}


def run_tasks(
    tasks: Mapping[str, Task],
    path: Path | None = None,
    jobs: int | None = None,
    force: bool = False,
    watch: Watch = lambda progress: None,
) -> dict[str, Run]:
    """Run every task in a process of its own, and return the runs by name.

    Args:
        tasks: By name.
        path: File of all logs, written whole or not at all; None for none.
        jobs: Processes; by default one for each core.
        force: Whether an existing file is overwritten.
        watch: Called with the progress, as by `compute_all`.

    Raises:
        InputError: The file exists already or cannot be written.
        RunError: A process was killed each time.
    """
    if path is not None:
        check_output(path, force)
    runs = compute_all(_run, tasks, jobs, watch)
    if path is not None:
        save_comparison(runs, path, force)
    return runs


def _run(task: Task) -> Run:
    """Run a task in a process of its own; its warnings are counted in its log."""
    logging.getLogger("psmpc_cli").setLevel(logging.ERROR)
    return simulate(task)


class Recommended(NamedTuple):
    """The recommended run of a comparison by its name, if any, and a sentence: what speaks for it, or why none is."""

    name: str | None
    sentence: str


def recommend_controller(summaries: Mapping[str, Summary]) -> Recommended:
    """Recommend the run whose mission succeeds first; of those within a sample of it, the one with the least effort."""
    succeeded = {name: summary for name, summary in summaries.items() if summary.ended and summary.succeeded}
    if not succeeded:
        return Recommended(None, f"no controller is recommended: the mission succeeded with none of {len(summaries)}")
    soonest = min(summary.duration for summary in succeeded.values())
    equal = {
        name: summary
        for name, summary in succeeded.items()
        if summary.duration <= soonest + summary.sample_time * (1 + SAME_SAMPLE)
    }
    name = min(equal, key=lambda each: equal[each].control_effort)
    others = [other for other in equal if other != name]
    chosen = f"recommended: {name}, whose mission succeeds"
    end = f"{number(equal[name].duration, 0.1)} s"
    if len(succeeded) == 1:
        reason = f"in {end}, as the only one of {len(summaries)}" if len(summaries) > 1 else f"in {end}"
    elif others:
        reason = f"in {end}, with the least control effort of those within a sample ({', '.join(equal)})"
    else:
        second = min(summary.duration for other, summary in succeeded.items() if other != name)
        reason = f"first, in {end}, {number(second - soonest, 0.1)} s before the next"
    return Recommended(name, f"{chosen} {reason}")
