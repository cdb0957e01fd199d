"""Runs several controllers on the identical task, and keeps their logs in one file."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

from psmpc_cli.errors import InputError
from psmpc_cli.logs.comparison import merge_logs
from psmpc_cli.logs.new_file import refuse
from psmpc_cli.specs.load import Task, load_task
from psmpc_cli.specs.task import ControllerSpec
from psmpc_cli.studies.variants import log_paths, run_variants

CONTROLLERS: tuple[str, ...] = ("psmpc", "smpc", "htmpc", "hard")
"""What is compared by default, in the order of the table."""

VARIED = "controller.kind"
"""The one key in which the tasks of a comparison differ."""


def controllers_in(text: str) -> tuple[str, ...]:
    """Return the controllers of a list such as `psmpc,smpc`, each once.

    Raises:
        InputError: One is unknown, or there is none.
    """
    known = get_args(ControllerSpec.model_fields["kind"].annotation)
    wanted = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in wanted if name not in known]
    if unknown or not wanted:
        found = f"no controller '{unknown[0]}'" if unknown else "no controller"
        raise InputError(f"--controllers: found {found}, expected one or more of {', '.join(known)} between commas")
    return wanted


def compared_tasks(reference: str, controllers: Iterable[str], changes: Sequence[str] = ()) -> dict[str, Task]:
    """Return the task under each controller; nothing else differs.

    Raises:
        InputError: The changes are of the controller itself.
        SpecError: The task does not hold.
    """
    if any(change.partition("=")[0].strip() == VARIED for change in changes):
        raise InputError(f"--set {VARIED}: a comparison varies it; choose with --controllers")
    return {kind: load_task(reference, [*changes, f"{VARIED}={kind}"]) for kind in controllers}


def compare(
    tasks: Mapping[str, Task],
    path: Path,
    force: bool = False,
    jobs: int | None = None,
    began: Callable[[Mapping[str, Path]], None] = lambda paths: None,
    done: Callable[[str], None] = lambda name: None,
) -> None:
    """Run every task in a process of its own and write all logs into one file, whole or not at all.

    Args:
        tasks: By controller.
        path: The file.
        force: Overwrite it.
        jobs: Processes at once; default as many as there are cores.
        began: Told where the logs stand meanwhile, for `simulated_times`.
        done: Told the name of each run as it ends.

    Raises:
        InputError: The file exists already or cannot be written.
        RunError: A log could not be written.
    """
    refuse(path, force)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        meanwhile = TemporaryDirectory(prefix=f".{path.stem}-", dir=path.parent)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from None
    with meanwhile as directory:
        began(log_paths(tasks, Path(directory)))
        merge_logs(run_variants(tasks, Path(directory), jobs, done), path, force)
