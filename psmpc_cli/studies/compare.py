"""Comparisons: several controllers on one task, in parallel, with their logs in one file."""

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

from psmpc_cli.errors import InputError
from psmpc_cli.logs.comparison import save_comparison
from psmpc_cli.logs.files import check_output
from psmpc_cli.logs.numbers import format_number
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.progress import Watch
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.arguments import rejected, require, require_options
from psmpc_cli.specs.controller import FREE_END, ControllerSpec
from psmpc_cli.specs.document import BY_CONTROLLER, mapping
from psmpc_cli.specs.load import Task, TaskDocuments
from psmpc_cli.specs.task import TaskSpec
from psmpc_cli.studies.runner import compute_all, documents_of, with_changes

CONTROLLERS: tuple[str, ...] = ("psmpc", "smpc", "htmpc", "hard")
"""What is compared by default, in the order of the table."""

SAME_SAMPLE = 1e-6
"""Part of a sample by which two missions may differ beyond one and still count as equally soon: rounding."""

VARIED_KEY = "controller.kind"
"""The key in which the tasks of a comparison differ."""

ONE_STAGE_KEY = "controller.one_stage"
"""The key that says whether windows over one stage have its end."""

METHOD_SECTIONS = ("controller", "solver")
"""Sections of a task that say how a controller works, not what it is asked for."""

MAY_DIFFER = {"controller", "solver", BY_CONTROLLER}
"""Fields of tasks that are compared on equal terms in which they may differ all the same."""


def compare(
    task: Task | str | Path,
    controllers: Sequence[str] = CONTROLLERS,
    path: Path | str | None = None,
    jobs: int | None = None,
    force: bool = False,
    own_settings: bool = False,
) -> dict[str, Run]:
    """Run a task under several controllers in parallel, by default on equal terms (see `compared_tasks`).

    Args:
        task: The task, its file or the name of a built-in one.
        controllers: Kinds of controllers, such as psmpc and smpc.
        path: File into which the logs of all runs are written; None for no file.
        jobs: Number of processes; by default one for each core.
        force: Whether an existing file is overwritten.
        own_settings: Whether each controller has all that the task's `by_controller` sets for it, instead of equal
            terms.

    Returns:
        The runs by controller.

    Raises:
        InputError: An argument is of another type, a controller is unknown, or the file exists or cannot be written.
        SpecError: The task is not valid.
        RunError: The process of a run was killed again and again.
    """
    wanted = 'a list of names such as ["psmpc", "smpc"]'
    if isinstance(controllers, str) or not isinstance(controllers, Sequence):
        raise rejected("controllers", controllers, wanted)
    for kind in controllers:
        require("controllers", kind, str, wanted)
    path = require_options(path, jobs, force)
    require("own_settings", own_settings, bool, "True or False")
    return run_tasks(compared_tasks(task, controllers, own_settings=own_settings), path, jobs, force)


def compared_tasks(
    task: Task | str | Path, controllers: Iterable[str], changes: Sequence[str] = (), own_settings: bool = False
) -> dict[str, Task]:
    """Build the tasks of a comparison: one task under each controller, by default on equal terms.

    A task may set other values for a controller below its key `by_controller`. On equal terms only those of them count
    that say how the controller works, in `controller` and `solver`; weights, tolerances and limits are the same for
    all. Also, controllers that plan over one stage at a time have the stage's end condition in their windows, at a free
    switch time.

    Args:
        task: The task, its file or the name of a built-in one.
        controllers: Kinds of controllers, such as psmpc and smpc.
        changes: Keys to change in the task, each `path=value`.
        own_settings: Whether each task is as `psmpc simulate` runs it, with all of `by_controller`.

    Returns:
        The tasks by kind of controller.

    Raises:
        InputError: A controller is unknown, none is given, or the changes choose the controller themselves.
        SpecError: The task is not valid.
    """
    all_kinds = get_args(ControllerSpec.model_fields["kind"].annotation)
    kinds = dict.fromkeys(controllers)
    unknown = ", ".join(name for name in kinds if name not in all_kinds)
    if unknown or not kinds:
        raise InputError(
            f"--controllers: found '{unknown}', expected one or more of {', '.join(all_kinds)} between commas"
        )
    if any(change.partition("=")[0].strip() == VARIED_KEY for change in changes):
        raise InputError(f"--set {VARIED_KEY}: a comparison varies it; choose with --controllers")
    documents = documents_of(with_changes(task, changes))
    if own_settings:
        return {name: documents.changed({VARIED_KEY: name}) for name in kinds}
    return {name: _task_on_equal_terms(documents, name) for name in kinds}


def _task_on_equal_terms(documents: TaskDocuments, kind: str) -> Task:
    """Build a task under a kind of controller, on the equal terms that `compared_tasks` describes."""
    own = mapping(documents.task.value((BY_CONTROLLER,)))
    methods = {name: {key: keys[key] for key in keys if _is_key_of_method(key)} for name, keys in own.items()}
    changes = {BY_CONTROLLER: methods, VARIED_KEY: kind}
    task = documents.changed(changes)
    controller = task.spec.controller
    says_end = "one_stage" in controller.model_fields_set
    return (
        task if says_end or not controller.traits.one_stage else documents.changed({**changes, ONE_STAGE_KEY: FREE_END})
    )


def _is_key_of_method(key: str) -> bool:
    """Tell whether a key of a task says how a controller works, not what it is asked for."""
    return re.split(r"[.\[]", key)[0].strip() in METHOD_SECTIONS


def describe_terms(runs: Mapping[str, Run]) -> str:
    """Say whether runs are of one task on equal terms, and what of it differs between controllers."""
    specs = {name: run.task.spec for name, run in runs.items()}
    fields = [key for key in TaskSpec.model_fields if key not in MAY_DIFFER]
    first, *_ = specs.values()
    differing = [key for key in fields if any(getattr(spec, key) != getattr(first, key) for spec in specs.values())]
    if differing:
        return f"terms: not equal: {' and '.join(differing)} of the controllers differ (by_controller of the task)"
    one_stage = [name for name, spec in specs.items() if spec.controller.traits.one_stage]
    free = [name for name in one_stage if specs[name].controller.plans_ends]
    published = [name for name in one_stage if name not in free]
    ends = [f"{' and '.join(free)} with a free end"] if free else []
    ends += [f"{' and '.join(published)} without a planned end"] if published else []
    return "; ".join(["terms: the same weights, tolerances and limits", *ends])


def run_tasks(
    tasks: Mapping[str, Task],
    path: Path | None = None,
    jobs: int | None = None,
    force: bool = False,
    watch: Watch = lambda progress: None,
) -> dict[str, Run]:
    """Run the tasks of a comparison, each in a process of its own and several at a time; return the runs by name.

    Args:
        tasks: The tasks by name.
        path: File into which the logs of all runs are written together once all have ended; None for no file.
        jobs: Number of processes; by default one for each core.
        force: Whether an existing file is overwritten.
        watch: Called with the progress, as by `compute_all`.

    Raises:
        InputError: The file exists already or cannot be written.
        RunError: The process of a run was killed again and again.
    """
    if path is not None:
        check_output(path, force)  # before the runs, which take long
    runs = compute_all(_simulate_quietly, tasks, jobs, watch)
    if path is not None:
        save_comparison(runs, path, force)
    return runs


def _simulate_quietly(task: Task) -> Run:
    """Run a task in a process of its own; its warnings are counted in its log."""
    logging.getLogger("psmpc_cli").setLevel(logging.ERROR)
    return simulate(task)


class Recommended(NamedTuple):
    """The recommended run of a comparison by its name, if any, and a sentence: what speaks for it, or why none is."""

    name: str | None
    sentence: str


def recommend_controller(summaries: Mapping[str, Summary]) -> Recommended:
    """Recommend the controller whose mission succeeds first; of those as fast, the one with the least control effort.

    Runs that end within a sample of the fastest count as equally fast.

    Args:
        summaries: Summaries of the runs by controller.

    Returns:
        The name of the recommended controller and the reason as a sentence. The name is None if no mission succeeded.
    """
    succeeded = {name: summary for name, summary in summaries.items() if summary.ended and summary.succeeded}
    if not succeeded:
        return Recommended(None, f"no controller is recommended: the mission succeeded with none of {len(summaries)}")
    soonest = min(summary.duration for summary in succeeded.values())
    as_soon = {
        name: summary
        for name, summary in succeeded.items()
        if summary.duration <= soonest + summary.sample_time * (1 + SAME_SAMPLE)
    }
    name = min(as_soon, key=lambda kind: as_soon[kind].control_effort)
    others_as_soon = [other for other in as_soon if other != name]
    headline = f"recommended: {name}, whose mission succeeds"
    end = f"{format_number(as_soon[name].duration, 0.1)} s"
    if len(succeeded) == 1:
        reason = f"in {end}, as the only one of {len(summaries)}" if len(summaries) > 1 else f"in {end}"
    elif others_as_soon:
        reason = f"in {end}, with the least control effort of those within a sample ({', '.join(as_soon)})"
    else:
        second = min(summary.duration for other, summary in succeeded.items() if other != name)
        reason = f"first, in {end}, {format_number(second - soonest, 0.1)} s before the next"
    return Recommended(name, f"{headline} {reason}")
