"""A task file that is followed while its task runs: targets that change in the file change in the run."""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from psmpc_cli.errors import PsmpcError
from psmpc_cli.ocp.feasibility.checks import load_task
from psmpc_cli.specs.document import Changes
from psmpc_cli.specs.load import Task

logger = logging.getLogger(__name__)


class FollowedTask:
    """Reads a task file again whenever it has changed, and tells which targets are others.

    Only targets may change. A file that is no valid task, or in which anything else has changed, is reported once, and
    the targets stay as they were.
    """

    def __init__(
        self, task: Task, path: Path, changes: Changes = (), report: Callable[[str], None] = logger.warning
    ) -> None:
        """Follow the file of a task, so that a user can move targets while the run goes on.

        Args:
            task: The task as it was loaded for the run.
            path: The file that the task was loaded from. It is looked at before every sample.
            changes: Keys that were overridden when the task was loaded (`--set`), and are again at every reading.
            report: Called with a message when the file has changed in a way that is rejected; by default the message
                is logged as a warning.
        """
        self._task = task
        self._path = path
        self._changes = changes
        self._report = report
        self._modified_at = self._modification_time()

    def __call__(self, time: float) -> Mapping[str, Any]:
        """Read the task file again if it was modified, and return the targets in it that are new.

        A file that is no valid task, or in which anything but targets differs, is reported once and changes nothing: a
        typing error must not end a run.

        Args:
            time: Time of the run [s], for messages.

        Returns:
            The new targets as they are written in the file, by the names of their stages; empty where nothing changed.
        """
        modified_at = self._modification_time()
        is_missing = modified_at == 0  # editors remove a file for a moment while they replace it
        if modified_at == self._modified_at or is_missing:
            return {}
        self._modified_at = modified_at
        rejection = f"{time:.1f} s: {self._path} has changed and does not count, the run goes on with the old targets"
        try:
            task = load_task(self._path, self._changes)
        except PsmpcError as error:
            self._report(f"{rejection}:\n{error}")
            return {}
        changed_keys = changed_keys_besides_targets(self._task, task)
        if changed_keys:
            self._report(f"{rejection}: found other values of {', '.join(changed_keys)}, expected other targets alone")
            return {}
        stages = zip(self._task.spec.stages, task.spec.stages, strict=True)
        with_new_target = [index for index, (before, after) in enumerate(stages) if before.target != after.target]
        self._task = task
        return {
            task.spec.stages[index].name: task.source.value(("stages", index, "target")) for index in with_new_target
        }

    def _modification_time(self) -> int:
        """Return when the file was changed last [ns]; 0 where it is not there."""
        try:
            return self._path.stat().st_mtime_ns
        except OSError:
            return 0


def changed_keys_besides_targets(before: Task, after: Task) -> tuple[str, ...]:
    """Return the top-level keys whose values differ between two tasks; targets of stages do not count.

    Targets count only where the tasks have other stages: then `stages` is among the keys.
    """
    dumps = [task.spec.model_dump() for task in (before, after)]
    if [stage.name for stage in before.spec.stages] == [stage.name for stage in after.spec.stages]:
        for stages in (dump["stages"] for dump in dumps):
            for stage in stages:
                stage["target"] = None
    one, other = ({**dump, "robot": task.robot} for dump, task in zip(dumps, (before, after), strict=True))
    return tuple(key for key in one if one[key] != other[key])
